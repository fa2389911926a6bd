"""How long things take, and what it grows with (docs/benchmarks.md)."""
