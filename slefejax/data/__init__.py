"""Small scenes that ship with the package, by name."""
