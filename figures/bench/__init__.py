"""Pictures of times."""
