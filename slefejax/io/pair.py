"""A control mesh with its rig as a pair of files, .json for names and .npz for numbers (docs/animation.md lists them).

For whatever has no reader of its own: a few lines of Python write such a pair, and any scene with a control mesh can be
saved as one.
"""

from __future__ import annotations

import io
import json
import os
import struct
import zipfile
import zlib
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from slefejax.errors import InputError
from slefejax.io.content import Content, read_bytes
from slefejax.io.limits import LARGEST_TEXT, check_count, check_size, within
from slefejax.model.gaussians import with_gaussians
from slefejax.model.mesh import Mesh
from slefejax.model.rig import Motion, Pose, Rig, Skeleton
from slefejax.model.skinning import Influences, Key, ShapeKeys
from slefejax.model.stencils import StencilTable

FORMAT, VERSION = "slefejax rig", 1
_SHARP = ("creases", "crease_sharpness", "points", "point_sharpness")
_MOTION = ("translations", "rotations", "scales", "key_weights")


# what NumPy, zip files and their compression raise for arrays that are none
_BROKEN = (
    *(ValueError, TypeError, OSError, EOFError, KeyError, AttributeError, MemoryError, NotImplementedError),
    *(RuntimeError, zipfile.BadZipFile, zlib.error, struct.error),
)
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def read_pair(path: Path) -> Content:
    """The mesh and the rig of a pair, by the name of its .json file.

    Raises InputError for what is none of a pair, or not whole.
    """
    data = read_bytes(path, LARGEST_TEXT)
    try:
        names = json.loads(data)
        if names["format"] != FORMAT or names["version"] != VERSION:
            raise ValueError
        joints = [(str(joint["name"]), int(joint["parent"])) for joint in names.get("joints", [])]
        keys = [(str(key["name"]), tuple(float(p) for p in key.get("places", (1.0,)))) for key in names.get("keys", [])]
        up, rate = tuple(float(x) for x in names.get("up", (0, 0, 1))), float(names.get("rate", 24.0))
        arrays_at = str(names["arrays"])
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError):
        raise InputError(
            f"{path} is none of a pair that can be read: it needs 'format': '{FORMAT}', 'version': {VERSION}, 'arrays'"
            " and names as docs/animation.md has them"
        ) from None
    if len(up) != 3 or not np.isfinite([*up, rate]).all() or not np.any(up) or rate <= 0:
        raise InputError(f"{path}: up must be a direction and rate a positive number")
    if within(path.parent, arrays_at) is None:
        raise InputError(
            f"{path}: its arrays are to be read from {arrays_at[:80]!r}, which is no file in its folder or below: put"
            " them beside it"
        )
    other = path.parent / arrays_at
    arrays = _Arrays(other, _loaded(other))
    try:
        mesh = _mesh(arrays)
        return Content(mesh, up=up, rig=_rig(arrays, mesh, joints, keys, rate))  # type: ignore[arg-type]
    except InputError as error:
        raise InputError(str(error) if str(other) in str(error) else f"{path}: {error}") from None


class _Arrays:
    """The arrays of a file, each checked when it is asked for."""

    def __init__(self, path: Path, found: dict[str, np.ndarray]) -> None:
        self.path, self.found = path, found

    def __contains__(self, name: str) -> bool:
        return name in self.found

    def get(self, name: str, shape: tuple[int | None, ...], kind: str = "fiu") -> np.ndarray:
        """An array of numbers of that shape, None for any length."""
        if name not in self.found:
            raise InputError(f"{self.path} has no array {name!r}")
        values = self.found[name]
        fits = values.ndim == len(shape) and all(n in (None, m) for n, m in zip(shape, values.shape, strict=True))
        if not fits or values.dtype.kind not in kind:
            wanted = ", ".join("any" if n is None else str(n) for n in shape)
            numbers = "whole numbers" if kind == "iu" else "numbers"
            raise InputError(
                f"{self.path}: {name!r} must be {numbers} ({wanted}), not {values.dtype} {tuple(values.shape)}"
            )
        return values.astype(np.int64 if kind == "iu" else np.float64)


def _loaded(path: Path) -> dict[str, np.ndarray]:
    """All arrays of an .npz file. Nothing is inflated before all of it was found to be small enough."""
    data = read_bytes(path)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as file:
            members = file.infolist()
            check_size(path, sum(member.file_size for member in members))
            return {member.filename.removesuffix(".npy"): _array(path, _inflated(file, member)) for member in members}
    except InputError:
        raise
    except _BROKEN:
        raise InputError(f"{path} is no .npz file of plain arrays, or not whole") from None


def _inflated(file: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """So many bytes of a member as the file says that it has, whatever more there is; the checksum then is wrong."""
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # others are inflated at once
        raise ValueError
    with file.open(member) as stream:
        return stream.read(member.file_size)


def _array(path: Path, data: bytes) -> np.ndarray:
    """The array of an .npy file. Raises InputError, or what _BROKEN lists, if it is none."""
    stream = io.BytesIO(data)
    shape, columns_first, dtype = _HEADERS[np.lib.format.read_magic(stream)](stream)
    if dtype.hasobject or dtype.itemsize == 0:
        raise ValueError
    count, rest = prod(shape), len(data) - stream.tell()
    check_count(path, f"numbers in an array {tuple(shape)}", count, dtype.itemsize, rest)
    return np.ndarray(shape, dtype, data, stream.tell(), order="F" if columns_first else "C")


def _mesh(arrays: _Arrays) -> Mesh:
    vertices, sizes = arrays.get("vertices", (None, 3)), arrays.get("sizes", (None,), "iu")
    corners = arrays.get("corners", (None,), "iu")
    if np.any(sizes < 0) or sizes.sum() != len(corners):
        raise InputError(f"{arrays.path}: 'sizes' add up to {sizes.sum()}, but there are {len(corners)} corners")
    sharp: dict[str, Any] = {}
    for place, sharpness, shape in (("creases", "crease_sharpness", (None, 2)), ("points", "point_sharpness", (None,))):
        if place in arrays:
            sharp[place] = arrays.get(place, shape, "iu")
            sharp[sharpness] = arrays.get(sharpness, (len(sharp[place]),))
    texture = arrays.get("texture", (len(corners), 2)) if "texture" in arrays else None
    mesh = Mesh.packed(vertices, corners, sizes, texture=texture, **sharp)
    if "covariances" not in arrays:
        return mesh
    return with_gaussians(mesh, arrays.get("covariances", (mesh.vertex_count, 3, 3)))


def _rig(arrays: _Arrays, mesh: Mesh, joints: list, keys: list, rate: float) -> Rig | None:
    if not joints and not keys:
        return None
    count, skeleton, influences, dual = mesh.vertex_count, None, None, None
    if joints:
        names, parents = zip(*joints, strict=True)
        bind = arrays.get("bind", (len(joints), 4, 4)) if "bind" in arrays else None
        skeleton = Skeleton.of(names, parents, bind)
        indices = arrays.get("influence_joints", (count, None), "iu")
        weights = arrays.get("influence_weights", indices.shape)
        influences = Influences.of(indices, weights, len(joints))
        if "dual_quaternions" in arrays:
            dual = arrays.get("dual_quaternions", (count,), "iu") != 0
    shapes = ShapeKeys.of([_key(arrays, k, *key) for k, key in enumerate(keys)], count) if keys else None
    rest = Pose(
        arrays.get("rest_joints", (len(joints), 4, 4)) if "rest_joints" in arrays else None,
        arrays.get("rest_keys", (len(keys),)) if "rest_keys" in arrays else None,
    )
    return Rig(skeleton, influences, shapes, _motion(arrays, len(joints), len(keys)), rate, rest, dual)


def _key(arrays: _Arrays, number: int, name: str, places: tuple[float, ...]) -> Key:
    if not places or 0.0 in places or len(set(places)) < len(places) or not np.isfinite(places).all():
        raise InputError(f"the places of shape key {name!r} must be different numbers other than 0")
    shapes = []
    for k in range(len(places)):
        vertices = arrays.get(f"key{number}_{k}_vertices", (None,), "iu")
        shapes.append((vertices, arrays.get(f"key{number}_{k}_offsets", (len(vertices), 3))))
    return Key(name, tuple(shapes), places)


def _motion(arrays: _Arrays, joints: int, keys: int) -> Motion | None:
    if "times" not in arrays:
        return None
    times = arrays.get("times", (None,))
    n = len(times)
    shapes = {
        "translations": (n, joints, 3),
        "rotations": (n, joints, 4),
        "scales": (n, joints, 3),
        "key_weights": (n, keys),
    }
    found = {name: arrays.get(name, shapes[name]) for name in _MOTION if name in arrays}
    moves, turns = found.get("translations"), found.get("rotations")
    if (moves is None) != (turns is None):
        raise InputError(f"{arrays.path}: a motion of joints needs both translations and rotations")
    for name, values in found.items():
        if not np.isfinite(values).all():
            raise InputError(f"{arrays.path}: {name!r} holds numbers that are not finite")
    if turns is not None:
        lengths = np.linalg.norm(turns, axis=2, keepdims=True)
        if not np.all(lengths > 0):
            raise InputError(f"{arrays.path}: 'rotations' holds a quaternion of no length")
        turns = turns / lengths
    return Motion(times, moves, turns, found.get("scales"), found.get("key_weights"))


def write_pair(path: Path, mesh: Mesh, rig: Rig | None, up: tuple[float, float, float]) -> None:
    """Write path, a .json, and beside it the .npz of the same name. Raises InputError if that cannot be."""
    if path.suffix.lower() != ".json":
        raise InputError(f"{path}: a pair is saved under the name of its .json file")
    arrays: dict[str, Any] = {"vertices": mesh.vertices, "sizes": mesh.sizes, "corners": mesh.corners}
    arrays |= {name: getattr(mesh, name) for name in _SHARP if len(getattr(mesh, name))}
    optional = {"covariances": mesh.covariances, "texture": mesh.texture}
    arrays |= {name: values for name, values in optional.items() if values is not None}
    names: dict[str, Any] = {"format": FORMAT, "version": VERSION, "arrays": f"{path.stem}.npz", "up": list(up)}
    if rig is not None:
        names["rate"] = rig.rate
        _describe(rig, names, arrays)
    numbers = path.with_suffix(".npz")
    try:
        with (part := numbers.with_name(f".{numbers.name}.partial")).open("wb") as file:
            np.savez_compressed(file, **arrays)
        (text := path.with_name(f".{path.name}.partial")).write_text(json.dumps(names, indent=1) + "\n")
        os.replace(part, numbers)
        os.replace(text, path)
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be written: {getattr(error, 'strerror', None) or error}") from None


def _describe(rig: Rig, names: dict[str, Any], arrays: dict[str, Any]) -> None:
    if rig.skeleton is not None and rig.influences is not None:
        own = rig.skeleton
        names["joints"] = [{"name": n, "parent": int(p)} for n, p in zip(own.names, own.parents, strict=True)]
        arrays["bind"] = own.bind
        arrays["influence_joints"], arrays["influence_weights"] = _padded(rig.influences.table)
        if rig.dual_quaternions is not None:
            arrays["dual_quaternions"] = rig.dual_quaternions.astype(np.uint8)
    if rig.keys is not None:
        names["keys"] = [
            {"name": n, "places": list(p[1:])} for n, p in zip(rig.keys.names, rig.keys.places, strict=True)
        ]
        column, matrix = 0, rig.keys.table.matrix.tocsc()
        for number, places in enumerate(rig.keys.places):
            for k in range(len(places) - 1):
                offsets = matrix[:, [column]].toarray().reshape(-1, 3)
                moved = np.flatnonzero(np.any(offsets != 0, axis=1))
                arrays |= {f"key{number}_{k}_vertices": moved, f"key{number}_{k}_offsets": offsets[moved]}
                column += 1
    rest = {"rest_joints": rig.rest.local, "rest_keys": rig.rest.keys}
    arrays |= {name: values for name, values in rest.items() if values is not None}
    if rig.motion is not None:
        motion = rig.motion
        parts = {"times": motion.times, "translations": motion.translations, "rotations": motion.rotations}
        parts |= {"scales": motion.scales, "key_weights": motion.keys}
        arrays |= {name: values for name, values in parts.items() if values is not None}


def _padded(table: StencilTable) -> tuple[np.ndarray, np.ndarray]:
    """Bones and weights of every vertex, padded with weights of 0."""
    slots = np.arange(table.counts.max(initial=1))
    there = slots < table.counts[:, None]
    at = table.matrix.indptr[:-1, None] + np.where(there, slots, 0)
    return np.where(there, table.matrix.indices[at], 0), np.where(there, table.matrix.data[at], 0.0)
