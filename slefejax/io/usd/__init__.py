"""USD files, through usd-core."""
