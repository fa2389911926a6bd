"""The container of glTF 2.0: JSON, binary buffers, and accessors that make arrays of them.

What a file says about itself is not believed: sizes are compared with what is there before anything is made of them,
and no name of a buffer leads out of the file's folder.
"""

from __future__ import annotations

import base64
import binascii
import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from slefejax.errors import InputError
from slefejax.io.content import read_bytes
from slefejax.io.gltf.extensions import DRACO, MESHOPT, extension_of, hides_shapes
from slefejax.io.limits import LARGEST_TEXT, check_size, within

_TYPES = {5120: "i1", 5121: "u1", 5122: "i2", 5123: "u2", 5125: "u4", 5126: "f4"}
_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_MOST = 2 * 10**7  # numbers of an accessor
_MOST_ZEROS = 3 * 10**6  # numbers of an accessor of which nothing is in the file
_MOST_IN_ALL = 10**8  # numbers of all that is read, the same ones again if they are asked for again


@dataclass
class GltfFile:
    """A file that was read: ``content`` is its JSON, ``array`` makes an accessor's numbers."""

    path: Path
    content: dict[str, Any]
    binary: bytes | None
    _buffers: dict[int, bytes] = field(default_factory=dict)
    _files: dict[Path, bytes] = field(default_factory=dict)
    _asked: int = 0

    @staticmethod
    def of(path: Path) -> GltfFile:
        """From .gltf or .glb. Raises InputError for what is neither, and for extensions that hide the shapes."""
        data = read_bytes(path)
        text, binary = _chunks(path, data) if data[:4] == b"glTF" else (data, None)
        check_size(path, len(text), LARGEST_TEXT)
        try:
            content = json.loads(text)
            version = str(content["asset"]["version"])
            required = [str(name) for name in content.get("extensionsRequired", [])]
        except (ValueError, KeyError, TypeError, RecursionError):
            raise InputError(f"{path} is no glTF file: its JSON is not whole, or has no asset and version") from None
        if not version.startswith("2"):
            raise InputError(f"{path} is glTF {version[:20]}: only version 2 is read")
        hiding = [name for name in required if hides_shapes(name)]
        if hiding:
            what = " (Draco)" if hiding[0] == DRACO else ""
            without = "compression" if hiding[0] in (DRACO, *MESHOPT) else "it"
            raise InputError(
                f"{path} requires the extension {hiding[0][:60]}{what}, which is not read: export without {without}"
            )
        return GltfFile(path, content, binary)

    def fail(self, what: str) -> InputError:
        """An error that names the file."""
        return InputError(f"{self.path}: {what}")

    def item(self, kind: str, number: Any) -> dict[str, Any]:
        """One of the objects of a list of the file, such as ``nodes``."""
        items = self.content.get(kind, [])
        if not isinstance(items, list) or not isinstance(number, int) or isinstance(number, bool):
            raise self.fail(f"{kind} {number!r} is no number of one of its {kind}")
        if not 0 <= number < len(items) or not isinstance(items[number], dict):
            raise self.fail(f"{kind} {number} does not exist: there are {len(items)}")
        return items[number]

    def array(self, number: Any, components: int, what: str, whole: bool = False) -> np.ndarray:
        """``(count, components)`` of an accessor, float64 or whole numbers as they are stored.

        what  : what it is, for messages
        whole : whether it numbers something
        """
        accessor = self.item("accessors", number)
        kind, size = _TYPES.get(accessor.get("componentType", 0)), _SIZES.get(accessor.get("type", ""))
        count = self._whole(accessor, "count", f"accessor {number}")
        if kind is None or size is None or size != components:
            raise self.fail(f"{what} (accessor {number}) must have {components} components of a known type")
        self.allow(count * size, f"{what} (accessor {number})", _MOST if "bufferView" in accessor else _MOST_ZEROS)
        dtype = np.dtype("<" + kind)
        if whole and dtype.kind != "u":
            raise self.fail(f"{what} (accessor {number}) must be whole numbers without a sign")
        values = np.zeros((count, size), dtype)
        if "bufferView" in accessor:
            values = self._view(
                accessor["bufferView"], self._whole(accessor, "byteOffset", what, 0), dtype, count, size
            )
        if "sparse" in accessor:
            values = self._with_sparse(values, accessor["sparse"], what)
        if dtype.kind == "f":
            values = values.astype(np.float64)
            if not np.isfinite(values).all():
                raise self.fail(f"{what} (accessor {number}) holds numbers that are not finite")
        elif accessor.get("normalized"):
            values = np.maximum(values / float(np.iinfo(dtype).max), -1.0)
        return values

    def allow(self, numbers: int, what: str, most: int = _MOST) -> None:
        """Raise InputError if that are too many numbers, or if all that were asked for are."""
        if numbers > most:
            none = " that are not in the file" if most < _MOST else ""
            raise self.fail(f"{what} has {numbers:,} numbers{none}, more than {most:,}")
        self._asked += numbers
        if self._asked > _MOST_IN_ALL:
            raise self.fail(f"its meshes have more than {_MOST_IN_ALL:,} numbers in all: export fewer of them")

    def _whole(self, owner: Any, name: str, what: str, default: int | None = None) -> int:
        value = owner.get(name, default) if isinstance(owner, dict) else None
        if not isinstance(value, int) or isinstance(value, bool) or value < 0:
            raise self.fail(f"{what} needs a whole number as its {name}, not {value!r}")
        return value

    def _with_sparse(self, values: np.ndarray, sparse: Any, what: str) -> np.ndarray:
        """The values with some of them replaced."""
        count = self._whole(sparse, "count", what)
        parts = []
        for name, size in (("indices", 1), ("values", values.shape[1])):
            part = sparse.get(name)
            kind = _TYPES.get(part.get("componentType", 0)) if name == "indices" and isinstance(part, dict) else None
            dtype = values.dtype if name == "values" else np.dtype("<" + (kind or "u4"))
            if not isinstance(part, dict) or count > len(values):
                raise self.fail(f"{what}: its sparse part is not whole")
            offset = self._whole(part, "byteOffset", what, 0)
            parts.append(self._view(part.get("bufferView"), offset, dtype, count, size))
        places = parts[0].ravel().astype(np.int64)
        if places.size and places.max() >= len(values):
            raise self.fail(f"{what}: its sparse part replaces element {places.max()}, but there are {len(values)}")
        values = values.copy()
        values[places] = parts[1]
        return values

    def _view(self, number: Any, offset: int, dtype: np.dtype, count: int, size: int) -> np.ndarray:
        """Elements of a buffer view, which may lie apart."""
        view = self.item("bufferViews", number)
        what = f"bufferViews {number}"
        data = self._buffer(view.get("buffer"))
        start = self._whole(view, "byteOffset", what, 0) + offset
        width = dtype.itemsize * size
        stride = self._whole(view, "byteStride", what, 0) or width
        end = self._whole(view, "byteOffset", what, 0) + self._whole(view, "byteLength", what)
        if stride < width or end > len(data) or (count and start + (count - 1) * stride + width > end):
            raise self.fail(f"{what} ends before its {count} elements do: is the file complete?")
        if not count:
            return np.zeros((0, size), dtype)
        rows = np.ndarray((count, size), dtype, data, start, (stride, dtype.itemsize))
        return rows.copy()

    def _buffer(self, number: Any) -> bytes:
        if number not in self._buffers:
            buffer = self.item("buffers", number)
            length, uri = self._whole(buffer, "byteLength", f"buffer {number}"), buffer.get("uri")
            if uri is None:
                data = self.binary if number == 0 else None
            elif isinstance(uri, str) and uri[:5].lower() == "data:":
                data = self._decoded(uri, number)
            elif isinstance(uri, str):
                data = self._beside(uri, number)
            else:
                data = None
            if data is None and any(extension_of(buffer, name) for name in MESHOPT):
                raise self.fail(
                    f"buffer {number} is compressed (meshopt), which is not read: export without compression"
                )
            if data is None or len(data) < length:
                raise self.fail(f"buffer {number} has {0 if data is None else len(data)} of its {length} bytes")
            self._buffers[number] = data
        return self._buffers[number]

    def _beside(self, uri: str, number: Any) -> bytes:
        """The file of that name in the folder of this one. Raises InputError for a name that leads out of it."""
        found = within(self.path.parent, unquote(uri))
        if found is None:
            raise self.fail(
                f"buffer {number} is to be read from {uri[:80]!r}, which is no file in this one's folder or below: copy"
                " it there, or export a .glb"
            )
        try:
            if found not in self._files:
                self._files[found] = read_bytes(found)
        except InputError as error:
            raise self.fail(f"buffer {number}: {error}") from None
        return self._files[found]

    def _decoded(self, uri: str, number: Any) -> bytes:
        try:
            return base64.b64decode(unquote(uri.partition(",")[2]), validate=True)
        except (binascii.Error, ValueError):
            raise self.fail(f"buffer {number} is not in base 64") from None


def _chunks(path: Path, data: bytes) -> tuple[bytes, bytes | None]:
    """The JSON and the binary chunk of a .glb file."""
    version, whole = struct.unpack("<II", data[4:12]) if len(data) >= 12 else (2, 0)
    if version != 2:
        raise InputError(f"{path} is a .glb file of version {version}: only version 2 is read")
    if whole > len(data):
        raise InputError(f"{path} has {len(data):,} of the {whole:,} bytes that it should have: is it complete?")
    found: dict[bytes, bytes] = {}
    at = 12
    while at + 8 <= len(data):
        length, kind = struct.unpack("<I4s", data[at : at + 8])
        if at + 8 + length > len(data):
            raise InputError(f"{path} ends in the middle of a chunk: is it complete?")
        found.setdefault(kind, data[at + 8 : at + 8 + length])
        at += 8 + length
    if b"JSON" not in found:
        raise InputError(f"{path} is no glTF file: it has no JSON chunk")
    return found[b"JSON"], found.get(b"BIN\0")
