"""The command ``slefejax``, ``python -m slefejax`` too: one sentence where the extra that it needs is missing."""

from __future__ import annotations

import sys


def entry() -> None:
    """What the console script calls."""
    try:
        from slefejax.experiments import cli
    except ImportError as error:
        print(f"slefejax: {error}", file=sys.stderr)
        sys.exit(2)
    cli.entry()


if __name__ == "__main__":
    entry()
