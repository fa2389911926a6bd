"""Files that are broken in seeded ways, and a process of its own that reads them: a crash of it is a result too."""

from __future__ import annotations

import json
import re
import resource
import select
import shutil
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

NASTY = (
    *(b"-1", b"0", b"1", b"64", b"255", b"65536", b"2147483647", b"2147483648", b"4294967296", b"99999999999"),
    *(
        b"-99999999999999999999",
        b"1e999",
        b"-1e308",
        b"1e-320",
        b"nan",
        b"inf",
        b"0x10",
        b"1_0",
        b"\xd9\xa3",
        b"",
        b"a",
    ),
)
NESTED = (b"[", b"{", b'{"a":', b"(", b'def Xform "a" {', b"f 1 1 1 1 ", b"v 0 0 0\n", b"\x00", b"0 ", b"4 0 1 2 3\n")
PATIENCE = 600.0  # seconds, a thousand times what a case takes: only what hangs passes it, on any machine
MEGABYTES = 400
KINDS = (
    *("obj", "bv", "bpt", "ply", "ply-binary", "ply-strips", "gltf", "glb", "pair", "makehuman"),
    *("usda", "usda-nurbs", "usda-skel", "usdc", "3dm", "3dm-blocks"),
)


def broken(data: bytes, rng: np.random.Generator, others: list[bytes]) -> bytes:
    """One to three changes."""
    for _ in range(rng.integers(1, 4)):
        data = CHANGES[rng.integers(len(CHANGES))](data, rng, others)
    return data


def _cut(data: bytes, rng: np.random.Generator, _: Any) -> bytes:
    return data[: rng.integers(0, len(data) + 1)]


def _flip(data: bytes, rng: np.random.Generator, _: Any) -> bytes:
    found = bytearray(data)
    for place in rng.integers(0, max(1, len(data)), rng.integers(1, 6)) if data else ():
        found[place] = rng.integers(256)
    return bytes(found)


def _without(data: bytes, rng: np.random.Generator, _: Any) -> bytes:
    start, length = rng.integers(0, len(data) + 1), rng.integers(1, 40)
    return data[:start] + data[start + length :]


def _again(data: bytes, rng: np.random.Generator, _: Any) -> bytes:
    start, length = rng.integers(0, len(data) + 1), rng.integers(1, 200)
    return data[: start + length] + data[start:]


def _noise(data: bytes, rng: np.random.Generator, _: Any) -> bytes:
    start = rng.integers(0, len(data) + 1)
    return data[:start] + rng.bytes(int(rng.integers(1, 30))) + data[start:]


def _number(data: bytes, rng: np.random.Generator, _: Any) -> bytes:
    numbers = list(re.finditer(rb"-?\d+\.?\d*(?:e[-+]?\d+)?", data))
    if not numbers:
        return data
    found = numbers[rng.integers(len(numbers))]
    return data[: found.start()] + NASTY[rng.integers(len(NASTY))] + data[found.end() :]


def _binary_number(data: bytes, rng: np.random.Generator, _: Any) -> bytes:
    if len(data) < 8:
        return data
    start = int(rng.integers(0, len(data) - 7))
    value = [
        struct.pack("<i", int(rng.choice([-1, 0, 2**31 - 1, -(2**31), 65536]))),
        struct.pack("<f", float(rng.choice([np.nan, np.inf, 1e38, -0.0, 1e-45]))),
        struct.pack("<q", int(rng.choice([-1, 2**62, 2**40]))),
    ][rng.integers(3)]
    return data[:start] + value + data[start + len(value) :]


def _lines(data: bytes, rng: np.random.Generator, _: Any) -> bytes:
    lines = data.split(b"\n")
    a, b = rng.integers(0, len(lines), 2)
    way = rng.integers(3)
    if way == 0:
        lines[a], lines[b] = lines[b], lines[a]
    elif way == 1:
        del lines[a]
    else:
        lines[a:a] = [lines[b]] * int(rng.integers(1, 50))
    return b"\n".join(lines)


def _words(data: bytes, rng: np.random.Generator, _: Any) -> bytes:
    words = list(re.finditer(rb"[A-Za-z_]{3,}", data))
    if len(words) < 2:
        return data
    one, other = (words[k] for k in rng.integers(0, len(words), 2))
    return data[: one.start()] + other.group() + data[one.end() :]


def _deep(data: bytes, rng: np.random.Generator, _: Any) -> bytes:
    start = rng.integers(0, len(data) + 1)
    many = NESTED[rng.integers(len(NESTED))] * int(10 ** rng.uniform(2, 4.3))
    return data[:start] + many + data[start:]


def _foreign(data: bytes, rng: np.random.Generator, others: list[bytes]) -> bytes:
    other = others[rng.integers(len(others))]
    way = rng.integers(3)
    return other if way == 0 else data + other if way == 1 else data[: len(data) // 2] + other[len(other) // 2 :]


def _wide(data: bytes, rng: np.random.Generator, _: Any) -> bytes:
    return data.decode("latin-1").encode(str(rng.choice(["utf-16", "utf-32", "utf-8-sig"])))


CHANGES: tuple[Callable[[bytes, np.random.Generator, list[bytes]], bytes], ...] = (
    *(_cut, _flip, _flip, _without, _again, _noise, _number, _number, _number, _binary_number, _lines, _words),
    *(_deep, _foreign, _wide),
)


class Reader:
    """Reads cases in a process of its own; tells what came of each, that it died, or that it never answered."""

    def __init__(self, folder: Path) -> None:
        self.folder, self._process = folder, None

    def read(self, case: tuple[str, int], patience: float = PATIENCE) -> dict[str, Any]:
        """What came of it; ``outcome`` is read, refused, crashed, hung, or the name of an exception."""
        process = self._start()
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            process.stdin.write(json.dumps(case) + "\n")
            process.stdin.flush()
        except BrokenPipeError:
            pass
        if not select.select([process.stdout], [], [], patience)[0]:
            self.close()
            return {"case": case, "outcome": "hung", "said": "", "seconds": patience, "megabytes": 0.0}
        line = process.stdout.readline()
        if not line:
            self.close()
            return {"case": case, "outcome": "crashed", "said": "", "seconds": 0.0, "megabytes": 0.0}
        return json.loads(line)

    def _start(self) -> subprocess.Popen[str]:
        if self._process is None:
            command = [sys.executable, "-m", "tests.fuzzing", str(self.folder)]
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
            )
            assert self._process.stdout is not None
            # it has imported everything, and read a whole file of every kind
            assert self._process.stdout.readline() == "ready\n", "the reading process does not start"
        return self._process

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


@contextmanager
def reading() -> Iterator[Reader]:
    """A reader with a folder for its files."""
    folder = Path(tempfile.mkdtemp(prefix="slefejax-fuzz-"))
    reader = Reader(folder)
    try:
        yield reader
    finally:
        reader.close()
        shutil.rmtree(folder, ignore_errors=True)


def _work(folder: Path) -> None:
    from slefejax import InputError, load
    from tests.fuzz_seeds import write_seeds

    shutil.rmtree(folder / "seeds", ignore_errors=True)
    seeds = write_seeds(folder / "seeds")
    answers = sys.stdout
    sys.stdout = sys.stderr
    for name, main in seeds.items():
        load(folder / "seeds" / name / main)
    others = [path.read_bytes() for path in sorted((folder / "seeds").rglob("*")) if path.is_file()]
    print("ready", file=answers, flush=True)
    for line in sys.stdin:
        kind, seed = json.loads(line)
        place = folder / "broken"
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(folder / "seeds" / kind, place)
        rng = np.random.default_rng([seed, *kind.encode()])
        files = sorted(path for path in place.rglob("*") if path.is_file())
        victim = files[rng.integers(len(files))]
        victim.write_bytes(broken(victim.read_bytes(), rng, others))
        before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.perf_counter()
        try:
            load(place / seeds[kind])
            outcome, said = "read", ""
        except InputError as error:
            outcome, said = "refused", str(error)
        except BaseException as error:  # whatever it is, it is what the test is about
            outcome, said = type(error).__name__, str(error)[:300]
        seconds = time.perf_counter() - start
        grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024.0
        found = {"case": [kind, seed], "outcome": outcome, "said": said, "seconds": seconds, "megabytes": grown}
        print(json.dumps(found), file=answers, flush=True)


if __name__ == "__main__":
    _work(Path(sys.argv[1]))
