"""Gaussian products beside their published method, and beside other ways to make a feature."""
