"""Numbers as OpenEXR files, read back by a reader that knows nothing of the writer."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from slefejax import InputError
from slefejax.experiments.looks.exr import write_exr


def terminated(data: bytes, at: int) -> tuple[str, int]:
    end = data.index(b"\0", at)
    return data[at:end].decode(), end + 1


def read_exr(path) -> tuple[dict[str, np.ndarray], dict[str, tuple[str, bytes]]]:
    """Channels, row 0 at the top, and attributes by name; of files of scan lines that are not compressed ([EXR])."""
    data = path.read_bytes()
    magic, version = struct.unpack_from("<II", data)
    assert magic == 20000630
    assert version & 0xFF == 2
    assert version & ~0x4FF == 0, "scan lines in one part; names may be long"
    at, attributes = 8, {}
    while data[at]:
        name, at = terminated(data, at)
        kind, at = terminated(data, at)
        (size,) = struct.unpack_from("<i", data, at)
        attributes[name] = (kind, data[at + 4 : at + 4 + size])
        at += 4 + size
        assert version & 0x400 or max(len(name), len(kind)) <= 31
    at += 1
    listed, names, k = attributes["channels"][1], [], 0
    while listed[k]:
        name, k = terminated(listed, k)
        pixel_type, _, x_step, y_step = struct.unpack_from("<iIii", listed, k)
        assert (pixel_type, x_step, y_step) == (2, 1, 1)
        names.append(name)
        k += 16
    assert k + 1 == len(listed)
    assert names == sorted(names)
    left, low, right, high = struct.unpack("<4i", attributes["dataWindow"][1])
    width, height = right - left + 1, high - low + 1
    assert attributes["compression"][1] == attributes["lineOrder"][1] == b"\0"
    offsets = struct.unpack_from(f"<{height}Q", data, at)
    found = {name: np.zeros((height, width), np.float32) for name in names}
    for row, offset in enumerate(offsets):
        number, size = struct.unpack_from("<ii", data, offset)
        assert (number, size) == (low + row, 4 * width * len(names))
        for k, name in enumerate(names):
            found[name][row] = np.frombuffer(data, "<f4", width, offset + 8 + 4 * width * k)
    assert offsets[-1] + 8 + 4 * width * len(names) == len(data)
    return found, attributes


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (5, 1), (13, 8)])
def test_what_is_written_is_read_back(tmp_path, rng, shape):
    channels = {"v": rng.normal(size=shape), "u": rng.normal(size=shape).astype(np.float32), "a_px": np.ones(shape)}
    channels["v"][0, 0] = np.nan
    channels["a_px"][-1, -1] = np.inf
    write_exr(tmp_path / "a.exr", channels, {"scene": "teapot", "how": "½ px, scale 1"})
    found, attributes = read_exr(tmp_path / "a.exr")
    assert set(found) == set(channels)
    for name, own in channels.items():
        assert np.array_equal(found[name][::-1], own.astype(np.float32), equal_nan=True), "row 0 of the file is the top"
    assert attributes["how"] == ("string", "½ px, scale 1".encode())
    wanted = {"displayWindow", "pixelAspectRatio", "screenWindowCenter", "screenWindowWidth"}
    assert wanted < set(attributes), "every reader asks for these"
    assert attributes["displayWindow"] == attributes["dataWindow"]


def test_names_may_be_long(tmp_path):
    write_exr(tmp_path / "a.exr", {"a" * 40: np.zeros((2, 2))}, {"b" * 50: ""})
    found, attributes = read_exr(tmp_path / "a.exr")
    assert list(found) == ["a" * 40]
    assert attributes["b" * 50] == ("string", b"")


@pytest.mark.parametrize("channels", [{}, {"a": np.zeros((2, 3)), "b": np.zeros((3, 2))}, {"a": np.zeros((0, 3))}])
def test_channels_of_no_picture(tmp_path, channels):
    with pytest.raises(InputError, match="the channels of a picture have one size"):
        write_exr(tmp_path / "a.exr", channels, {})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["", "a\0b", "a" * 256])
def test_names_that_a_file_cannot_have(tmp_path, name):
    with pytest.raises(InputError, match="has 1 to 255 bytes"):
        write_exr(tmp_path / "a.exr", {name: np.zeros((2, 2))}, {})
