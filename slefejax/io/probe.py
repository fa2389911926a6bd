"""Whether a library can read a file without running wild: a script that is run in a process of its own.

    python probe.py usd|3dm FILE MEGABYTES

Libraries written in C++ may hang on a broken binary file, take all memory, or end the process. This one is allowed
so much memory and so many seconds of the processor; it reads everything that the file holds, and keeps nothing. Exit
status 0 if all went well; otherwise it prints what the library said, if that can be told. It imports nothing of this
package, which would take longer than what it does.
"""

import os
import re
import resource
import sys
from typing import Any

_SECONDS = 10  # of the processor, ten times what a slow one takes to import a library; one more for every megabyte


def said_by_usd(error: BaseException) -> str:
    """What usd-core says, in one line: where in the file (line, column) and what, or its first sentence."""
    parts = error.args if type(error).__name__ == "ErrorException" else (error,)  # of pxr.Tf: one a message
    told = [" ".join(_text(part).split()) for part in parts]
    said = next((text for text in told if text), type(error).__name__)
    placed = (re.match(r"(.*?):(\d+):(\d+): (.*)", text) for text in told)
    if place := next((found for found in placed if found), None):
        said = f"line {place[2]}, column {place[3]}: {place[4]}"
        if inside := re.search(r"\[(.*)\]$", place[1]):  # of a .usdz
            said = f"{inside[1]}, {said}"
    if said.startswith("Failed to open layer"):  # which says nothing
        said = "is it complete?"
    return re.sub(r"pxrInternal\w+::", "", said)[:300]


def _text(part: Any) -> str:
    try:
        return str(getattr(part, "commentary", part))
    except UnicodeDecodeError as odd:  # it quotes the file, which is no text there
        return odd.object.decode(errors="replace")


def _usd(path: str) -> None:
    from pxr import Tf, Usd

    usd: Any = Usd
    try:
        stage = usd.Stage.Open(path)
    except Tf.ErrorException as error:
        sys.exit(print(said_by_usd(error)) or 1)
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
