"""Readers, one format a file. Each returns plain arrays; ``slefejax.loading`` makes a Scene of them."""
