"""Tessellation factors: methods as values, the published estimate, the certified factor and its levels, other rules."""
