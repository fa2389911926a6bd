"""Readers, one format a file. Each returns plain arrays; ``slefejax.scene`` makes a Scene of them."""
