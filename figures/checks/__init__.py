"""Pictures of one scene's numbers, and of digits that are kept."""
