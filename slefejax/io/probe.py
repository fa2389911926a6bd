"""Whether a library can read a file without running wild: a script that is run in a process of its own.

    python probe.py usd|3dm FILE MEGABYTES

Libraries written in C++ may hang on a broken binary file, take all memory, or end the process. This one is allowed
so much memory and so many seconds of the processor; it reads everything that the file holds, and keeps nothing. Exit
status 0 if all went well. It imports nothing of this package, which would take longer than what it does.
"""

import os
import resource
import sys
from typing import Any

_SECONDS = 10  # of the processor, ten times what a slow one takes to import a library; one more for every megabyte


def _usd(path: str) -> None:
    from pxr import Usd

    usd: Any = Usd
    stage = usd.Stage.Open(path)
    for prim in usd.PrimRange.Stage(stage, usd.TraverseInstanceProxies()):
        for attribute in prim.GetAttributes():
            attribute.Get(usd.TimeCode.EarliestTime())
            attribute.GetNumTimeSamples()


def _3dm(path: str) -> None:
    import rhino3dm

    model: Any = rhino3dm.File3dm.Read(path)
    if model is None:
        sys.exit(1)
    for item in model.Objects:
        str(item.Geometry)


if __name__ == "__main__":
    kind, path, megabytes = sys.argv[1:]
    memory = int(megabytes) << 20
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    seconds = _SECONDS + (os.path.getsize(path) >> 20)
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    {"usd": _usd, "3dm": _3dm}[kind](path)
