"""Rhino files, .3dm, through rhino3dm."""
