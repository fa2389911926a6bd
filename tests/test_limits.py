"""Files that are too large, and headers that tell of more than there is."""

from __future__ import annotations

import gc
import os
import tracemalloc
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from slefejax import InputError, load
from slefejax.io import limits
from slefejax.io.bvh import read_bvh
from slefejax.io.content import read_bytes
from slefejax.io.limits import (
    LARGEST_FILE,
    MEMORY_A_BYTE,
    MOST_CORNERS,
    MOST_NUMBERS,
    check_corners,
    check_count,
    check_numbers,
    check_spline,
)
from slefejax.loading import read
from tests.test_makehuman import BVH


def sparse(path: Path, size: int) -> Path:
    """A file of that size that takes no room."""
    with path.open("wb") as file:
        file.truncate(size)
    return path


@pytest.mark.parametrize("name", ["a.obj", "a.ply", "a.gltf", "a.glb", "a.json", "a.bpt", "a.bv", "a.usda", "a.3dm"])
def test_files_that_are_too_large(tmp_path, name):
    path = sparse(tmp_path / name, LARGEST_FILE + 1)
    with pytest.raises(InputError, match=f"{name} has 1,074 MB, more than the .* MB that a file of its kind may have"):
        load(path)


def test_pipes_and_devices_are_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "a.obj")
    with pytest.raises(InputError, match=r"a\.obj is a device or a pipe"):
        load(tmp_path / "a.obj")
    (tmp_path / "b.obj").symlink_to("/dev/zero")
    with pytest.raises(InputError, match=r"b\.obj is a device or a pipe"):
        load(tmp_path / "b.obj")


def test_counts_are_compared_with_what_is_there(tmp_path):
    path = tmp_path / "a.ply"
    check_count(path, "vertices", 10, 12, 120)
    check_count(path, "vertices", 0, 12, 0)
    for count in (11, -1, 10**30):
        with pytest.raises(InputError, match=f"tells of {count:,} vertices, but has 120 bytes for them"):
            check_count(path, "vertices", count, 12, 120)
    check_numbers(path, "a table", MOST_NUMBERS)
    with pytest.raises(InputError, match=r"a\.ply asks for 200,000,001 numbers for a table"):
        check_numbers(path, "a table", MOST_NUMBERS + 1)
    path.write_bytes(b"abc")
    assert read_bytes(path, 3) == b"abc"
    with pytest.raises(InputError, match="more than the 0 MB"):
        read_bytes(path, 2)


BIG = 80_000  # bytes of a hostile file
OBJ_END = "v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n"
BVH_START = "HIERARCHY ROOT a { "
PLY_START = "ply\nformat ascii 1.0\nelement vertex {}\nproperty uchar x\nproperty uchar y\nproperty uchar z\n"
PLY_FACES = (
    PLY_START.format(3) + "element face {}\nproperty list uchar uchar vertex_index\nend_header\n0 0 0\n1 0 0\n0 1 0\n"
)


def repeated(start: str, unit: str, end: str = "") -> str:
    return start + unit * ((BIG - len(start) - len(end)) // len(unit.encode())) + end


def numbered(start: str, unit: str, end: str = "") -> str:
    return start + "".join(unit.format(f"{k:x}") for k in range(BIG // (len(unit) + 2))) + end


HOSTILE = {
    "vertices": ("a.obj", repeated("", "v 0 0 0\n", OBJ_END)),
    "faces": ("a.obj", repeated(OBJ_END, "f 1\n")),
    "one line": ("a.obj", repeated("f", " 1")),
    "words": ("a.obj", repeated("", "ab ", "\n" + OBJ_END)),
    "wide characters": ("a.obj", repeated("", "\u0100 ", "\n" + OBJ_END)),
    "one character": ("a.obj", repeated("#", "\U0001f600", "\n" + OBJ_END)),
    "no lines": ("a.obj", repeated("", "\r", OBJ_END)),
    "continued": ("a.obj", repeated("", "ab\\\n", "\n" + OBJ_END)),
    "keywords": ("a.obj", numbered("", "{}\n", OBJ_END)),
    "groups": ("a.obj", numbered(OBJ_END, "g {}\nf 1\n")),
    "tags": ("a.obj", repeated(OBJ_END, "t corner 1/1/0 0 1\n")),
    "long tag": ("a.obj", f"{OBJ_END}t corner {BIG}/1/0" + " 1234" * (BIG // 5)),
    "ply vertices": ("a.ply", repeated(PLY_START.format(BIG // 6 - 100) + "end_header\n", "0 0 0\n")),
    "ply faces": ("a.ply", repeated(PLY_FACES.format(BIG // 2 - 200), "0\n")),
    "ply list": (
        "a.ply",
        repeated(PLY_FACES.format(1).replace("uchar uchar", "int uchar") + f"{BIG // 2 - 200}", " 0"),
    ),
    "bpt": ("a.bpt", repeated(f"{BIG // 28 - 9}\n", "1 1 " + "0 " * 12)),
    "bv": ("a.bv", repeated(f"1\n{BIG // 6 - 9} 1\n", "0 0 0 ", "3 0 1 2\n")),
    "bv faces": ("a.bv", repeated(f"1\n3 {BIG // 2 - 99}\n0 0 0 1 0 0 0 1 0\n", "0 ")),
    "bvh": ("a.bvh", repeated(BVH_START, "joint a{ } ".replace("a{", "a {"), "} MOTION\nFrames: 1\nFrame Time: 1\n")),
    "deep bvh": ("a.bvh", repeated(BVH_START, "JOINT a { ")),
    "json lists": ("a.json", repeated("[", "[],", "[]]")),
    "json objects": ("a.json", repeated("[", '{"":0},', "0]")),
    "deep json": ("a.json", "[" * BIG),
    "long json": ("a.json", '{"rate":' + "9" * BIG + "}"),
    "long number": ("a.bpt", "1\n1 1\n1." + "3" * BIG + "e" + "0" * BIG),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_memory_for_every_byte(tmp_path, name):
    path = tmp_path / HOSTILE[name][0]
    path.write_text(HOSTILE[name][1], newline="")
    reader: Any = {".bvh": read_bvh}.get(path.suffix, read)
    if path.suffix == ".bvh":  # what it imports takes memory once
        (tmp_path / "small.bvh").write_text(BVH)
        read_bvh(tmp_path / "small.bvh")
    gc.collect()
    tracemalloc.start()
    try:
        with suppress(InputError):
            reader(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak <= MEMORY_A_BYTE * path.stat().st_size + 200_000, peak / path.stat().st_size


def bvh_table(joints: int, frames: int) -> str:
    """So many joints, most of them without a channel, in so many frames."""
    tree = "ROOT a { CHANNELS 1 Xposition" + " JOINT a { }" * (joints - 1) + " }"
    return f"HIERARCHY {tree} MOTION Frames: {frames} Frame Time: 1" + " 0" * frames


def spread(degree: int, others: int) -> str:
    """A patch of a high degree beside many of a low one."""
    high = f"{degree} {degree}" + " 0 0 1" * (degree + 1) ** 2
    return f"{others + 1}\n{high}\n" + "1 1 0 0 0 0 1 0 1 0 0 1 1 0\n" * others


def test_small_files_that_ask_for_much(tmp_path, monkeypatch):
    """What would take gigabytes is refused: a table that grows with the square of the file, patches all raised."""
    monkeypatch.setattr(limits, "MOST_NUMBERS", 2 * 10**6)
    for name, text, says in (
        ("a.bvh", bvh_table(600, 600), "2,520,000 numbers for 600 joints in 600 frames"),
        ("b.bvh", "HIERARCHY ROOT a { JOINT b { } JOINT c { } } MOTION Frames: 9999999 Frame Time: 1", "numbers for 3"),
        ("a.bpt", spread(64, 160), "numbers for patches of one degree, more than"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(InputError, match=says):
            read_bvh(tmp_path / name) if name.endswith("bvh") else load(tmp_path / name)
    monkeypatch.undo()
    with pytest.raises(InputError, match=r"the patch asks for .* numbers for how Bézier points are made"):
        check_spline("the patch", (100_000, 2), (3, 1))
    with pytest.raises(InputError, match=r"the patch asks for .* numbers for its Bézier patches"):
        check_spline("the patch", (500, 500), (32, 32))
    check_spline("the patch", (200, 300), (3, 3))
    check_spline("the patch", (2, 3), (-1, 99))
    check_corners(tmp_path / "a.ply", MOST_CORNERS)
    with pytest.raises(InputError, match=r"a\.ply has faces with 16,000,001 corners"):
        check_corners(tmp_path / "a.ply", MOST_CORNERS + 1)


def test_work_grows_with_the_file(tmp_path):
    """Quadratic work would take hours here, and the suite would be stopped: groups that every face has; long items."""
    many = " ".join(f"g{k}" for k in range(20_000))
    faces = "o a\nf 1 2 3\no b\nf 1 3 2\n" * 20_000
    (tmp_path / "a.obj").write_text(OBJ_END + f"g {many}\n{faces}")
    content = read(tmp_path / "a.obj", ("g7", "a"))
    assert content.mesh is not None
    assert content.mesh.face_count == 40_000
    (tmp_path / "a.bpt").write_text("1\n1 1\n" + f"0.{'0' * 10**6}1 1e-{'0' * 10**6}1 3 " * 4)
    assert load(tmp_path / "a.bpt").patches()[0, 0, 0].tolist() == [0.0, 0.1, 3.0]
