"""Scripted experiments, the store of their runs, and the command line."""
