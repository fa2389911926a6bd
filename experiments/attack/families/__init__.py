"""Families of patches that are meant to break a bound, made again from a seed."""
