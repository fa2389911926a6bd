"""Numbers of pixels as an OpenEXR file: 32-bit floats, scan lines, not compressed, as [EXR] lays them out.

Every channel has a name, every text beside the pixels too; other programs show both. Nothing is lost: what is read back
is equal bit for bit, NaN included.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from slefejax.errors import InputError

_MAGIC, _VERSION, _LONG_NAMES = 20000630, 2, 0x400
_FLOAT = 2  # the number of the pixel type
_LONGEST = 255  # bytes of a name


def write_exr(path: Path, channels: Mapping[str, Float[np.ndarray, "height width"]], texts: Mapping[str, str]) -> None:
    """Write channels of one size; the file's first row is the picture's top one.

    channels : arrays with row 0 at the bottom, as pictures are everywhere here; rounded to 32 bits
    texts    : attributes of the file, such as units and where the numbers come from

    Raises InputError for channels of different sizes, for none, and for names that a file cannot have.
    """
    names = sorted(channels, key=str.encode)
    sizes = {np.shape(channels[name]) for name in names}
    if len(sizes) != 1 or len(next(iter(sizes))) != 2 or 0 in next(iter(sizes)):
        raise InputError(f"the channels of a picture have one size, (height, width), not {sorted(sizes)}")
    ((height, width),) = sizes
    header = _header(names, texts, width, height)
    planes = np.stack([np.asarray(channels[name])[::-1] for name in names], axis=1).astype("<f4")
    size = planes[0].nbytes
    blocks = np.zeros(height, [("row", "<i4"), ("size", "<i4"), ("values", "<f4", planes.shape[1:])])
    blocks["row"], blocks["size"], blocks["values"] = np.arange(height), size, planes
    first = len(header) + 8 * height
    offsets = first + (8 + size) * np.arange(height, dtype="<u8")
    path.write_bytes(header + offsets.tobytes() + blocks.tobytes())


def _header(names: list[str], texts: Mapping[str, str], width: int, height: int) -> bytes:
    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    listed = b"".join(_name(name) + struct.pack("<i4xii", _FLOAT, 1, 1) for name in names) + b"\0"
    required = {
        "channels": ("chlist", listed),
        "compression": ("compression", b"\0"),
        "dataWindow": ("box2i", box),
        "displayWindow": ("box2i", box),
        "lineOrder": ("lineOrder", b"\0"),
        "pixelAspectRatio": ("float", struct.pack("<f", 1.0)),
        "screenWindowCenter": ("v2f", struct.pack("<2f", 0.0, 0.0)),
        "screenWindowWidth": ("float", struct.pack("<f", 1.0)),
    }
    every = {**{name: ("string", text.encode()) for name, text in texts.items()}, **required}
    long = _LONG_NAMES if any(len(name.encode()) > 31 for name in [*names, *every]) else 0
    parts = [struct.pack("<ii", _MAGIC, _VERSION | long)]
    for name, (kind, value) in every.items():
        parts += [_name(name), _name(kind), struct.pack("<i", len(value)), value]
    return b"".join(parts) + b"\0"


def _name(name: str) -> bytes:
    found = name.encode()
    if not 0 < len(found) <= _LONGEST or b"\0" in found:
        raise InputError(f"a name in an OpenEXR file has 1 to {_LONGEST} bytes, none of them zero: not {name!r}")
    return found + b"\0"
