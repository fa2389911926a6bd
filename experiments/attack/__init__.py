"""Hostile patches in hostile views: does the certified factor hold? (docs/attack.md)."""
