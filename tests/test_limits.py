"""Files that are too large, and headers that tell of more than there is."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from slefejax import InputError, load
from slefejax.io.content import read_bytes
from slefejax.io.limits import LARGEST_FILE, check_count, check_numbers


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
    check_numbers(path, "a table", 10**8)
    with pytest.raises(InputError, match=r"a\.ply asks for 100,000,001 numbers for a table"):
        check_numbers(path, "a table", 10**8 + 1)
    path.write_bytes(b"abc")
    assert read_bytes(path, 3) == b"abc"
    with pytest.raises(InputError, match="more than the 0 MB"):
        read_bytes(path, 2)
