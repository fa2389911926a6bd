"""Pictures of Gaussian products."""
