"""Scripted experiments, the store of their runs, and the command line."""

from slefejax.late import check_app

check_app("experiments and the command line")
