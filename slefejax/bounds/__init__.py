"""Slefes and their tables, B-splines, tiles of rational patches, rival enclosures, the narrowest that exists."""
