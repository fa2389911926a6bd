"""PLY files, as text and binary."""
