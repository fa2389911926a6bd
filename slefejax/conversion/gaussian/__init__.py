"""Gaussian-product surfaces as rational patches."""
