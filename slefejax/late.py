"""Packages that are imported when they are first needed, one thread at a time, and those that may be missing.

While usd-core is loaded, a thread may hold the dynamic loader's lock and wait for Python's; whoever loads another
package just then holds Python's and waits for the loader's, and the process hangs. So every late import stands in

    with one_at_a_time:
        from scipy.spatial import KDTree
"""

from __future__ import annotations

from importlib.util import find_spec
from threading import RLock

one_at_a_time = RLock()
"""Held while something is imported late; a thread may take it again."""

APP = ("matplotlib", "mpmath", "networkx", "rich", "skimage", "tyro")
"""Modules of the extra ``app``: what pictures and the command line need, and computations do not."""


def check_app(what: str) -> None:
    """ImportError, saying what to install, unless the extra ``app`` is there; ``what``: who needs it."""
    missing = [name for name in APP if find_spec(name) is None]
    if missing:
        raise ImportError(
            f"{what} need packages that are not installed ({', '.join(missing)}): pip install 'slefejax[app]'",
            name=missing[0],
        )
