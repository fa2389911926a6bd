"""One figure a file, drawn from tables and images that are handed in; nothing is recomputed."""

from slefejax.late import check_app

check_app("figures")
