"""Runs that are finished, side by side."""
