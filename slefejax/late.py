"""Packages that are imported when they are first needed: one thread at a time.

While usd-core is loaded, a thread may hold the dynamic loader's lock and wait for Python's; whoever loads another
package just then holds Python's and waits for the loader's, and the process hangs. So every late import stands in

    with one_at_a_time:
        from scipy.spatial import KDTree
"""

from __future__ import annotations

from threading import RLock

one_at_a_time = RLock()
"""Held while something is imported late; a thread may take it again."""
