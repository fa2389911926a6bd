"""A folder in MakeHuman's formats: base.obj, one .mhskel, one .mhw, .target files (in targets/), and one .bvh pose.

A bone begins at the mean of some vertices of the base mesh. Bones have no roll: at rest all of them are turned as the
world is, and a pose from a BVH file, whose figure may be another one, hands over its rotations. The motion goes from
rest (time 0) to that pose (time 1). Targets are shape keys, all of weight 0 in that motion.
"""

from __future__ import annotations

import json
from array import array
from pathlib import Path
from typing import Any

import numpy as np

from slefejax.arguments import whole_numbers
from slefejax.errors import InputError, naming
from slefejax.io.bvh import Bvh, read_bvh
from slefejax.io.content import Content, read_bytes
from slefejax.io.limits import LARGEST_TEXT, check_numbers
from slefejax.io.numbers import Numbers, parse_whole, rows_of
from slefejax.io.obj import read_obj
from slefejax.late import one_at_a_time
from slefejax.model.rig import Motion, Rig, Skeleton
from slefejax.model.skinning import Influences, Key, ShapeKeys

_TARGET = np.dtype([("vertex", np.int64), ("offset", np.float64, 3)])
# MakeHuman exports poses with z up; its meshes have y up.
_UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def read_makehuman(folder: Path, group: Any = None) -> Content:
    """The base mesh of a folder with its rig. Raises InputError for what is missing or does not fit together."""
    content = read_obj(folder / "base.obj", group)
    assert content.mesh is not None
    vertices = content.mesh.vertices
    skeleton, heads = _skeleton(_one(folder, ".mhskel"), vertices)
    influences = _influences(_one(folder, ".mhw"), skeleton, len(vertices))
    targets = [_target(path, len(vertices)) for path in sorted((folder / "targets").glob("*.target"))]
    keys = ShapeKeys.of(targets, len(vertices)) if targets else None
    poses = sorted(folder.glob("*.bvh"))
    motion = _motion(poses[0], skeleton, heads, len(targets)) if poses else None
    rig = Rig(skeleton, influences, keys, motion, rate=1.0)
    return Content(content.mesh, up=content.up, notes=content.notes, rig=rig)


def _one(folder: Path, suffix: str) -> Path:
    found = sorted(folder.glob(f"*{suffix}"))
    if not found:
        raise InputError(f"{folder} has no {suffix} file: a MakeHuman folder needs base.obj, a .mhskel and a .mhw file")
    return found[0]


def _json(path: Path, *names: str) -> list[dict]:
    data = read_bytes(path, LARGEST_TEXT)
    try:
        content = json.loads(data)
        return [dict(content[name]) for name in names]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise InputError(f"{path} is no JSON object with {' and '.join(map(repr, names))}: is it complete?") from None


def _skeleton(path: Path, vertices: np.ndarray) -> tuple[Skeleton, np.ndarray]:
    """The skeleton and where its bones begin."""
    bones, joints = _json(path, "bones", "joints")
    number: dict[Any, int] = {name: k for k, name in enumerate(bones)}
    places: dict[str, np.ndarray] = {}
    heads, parents = np.zeros((len(bones), 3)), []
    for name, bone in bones.items():
        head, parent = (bone.get("head"), bone.get("parent")) if isinstance(bone, dict) else (None, None)
        if not (parent is None or isinstance(parent, str)) or (parent and parent not in number):
            raise InputError(f"{path}: the parent {parent!r} of bone {name!r} does not exist")
        parents.append(number[parent] if parent else -1)
        if not isinstance(head, str) or head not in joints:
            raise InputError(f"{path}: the head of bone {name!r} is at no vertices of the base mesh")
        if head not in places:
            places[head] = _mean(path, name, joints[head], vertices)
        heads[number[name]] = places[head]
    bind = np.tile(np.eye(4), (len(bones), 1, 1))
    bind[:, :3, 3] = heads
    with naming(path):
        return Skeleton.of(list(bones), parents, bind), heads


def _mean(path: Path, name: str, numbers: Any, vertices: np.ndarray) -> np.ndarray:
    """The mean of some vertices."""
    near = whole_numbers(numbers, f"{path}: the head of bone {name!r}")
    if near.ndim != 1 or not near.size or not 0 <= near.min() <= near.max() < len(vertices):
        raise InputError(f"{path}: the head of bone {name!r} is at no vertices of the base mesh")
    return vertices[near].mean(axis=0)


def _influences(path: Path, skeleton: Skeleton, count: int) -> Influences:
    (by_bone,) = _json(path, "weights")
    number = {name: k for k, name in enumerate(skeleton.names)}
    vertex, bone, weight = array("q"), array("q"), array("d")
    for name, pairs in by_bone.items():
        if name not in number:
            raise InputError(f"{path} has weights for bone {name!r}, which the skeleton does not have")
        try:
            vertices, weights = zip(*pairs, strict=True) if pairs != [] else ((), ())
            vertex.extend(vertices)
            weight.extend(map(float, weights))
            bone.extend([number[name]] * len(vertices))
        except (TypeError, ValueError, OverflowError):
            what = f"{path}: weights should be pairs of a vertex and a number, a list of them a bone"
            raise InputError(what) from None
    return _padded(path, np.array(vertex), np.array(bone), np.array(weight), skeleton, count)


def _padded(
    path: Path, vertex: np.ndarray, bone: np.ndarray, weight: np.ndarray, skeleton: Skeleton, count: int
) -> Influences:
    """Influences from triples in any order."""
    if vertex.size and not 0 <= vertex.min() <= vertex.max() < count:
        bad = vertex.min() if vertex.min() < 0 else vertex.max()
        raise InputError(f"{path} has a weight for vertex {bad}, but there are {count}")
    order = np.argsort(vertex, kind="stable")
    vertex, bone, weight = vertex[order], bone[order], weight[order]
    slot = np.arange(len(vertex)) - np.searchsorted(vertex, vertex)
    most = int(slot.max(initial=0)) + 1
    check_numbers(path, f"{most} bones for each of {count} vertices", count * most)
    indices, shares = np.zeros((count, most), np.int64), np.zeros((count, most))
    indices[vertex, slot], shares[vertex, slot] = bone, weight
    with naming(path):
        return Influences.of(indices, shares, len(skeleton.names))


def _target(path: Path, count: int) -> Key:
    """Rows of a vertex number and its offset; what begins with # is a comment."""
    rows = rows_of(path, _TARGET, "#")
    if rows is not None and np.all((rows["vertex"] >= 0) & (rows["vertex"] < count)):
        return Key(path.stem, ((rows["vertex"], rows["offset"]),))
    numbers = Numbers(path, comment="#")
    indices, offsets = array("q"), array("d")
    while (item := numbers.rest()) is not None:
        index = parse_whole(item)
        if index is None or not 0 <= index < count:
            raise numbers.fail(f"{item[:40]!r} is no vertex of the {count} of the base mesh")
        indices.append(index)
        offsets.extend([numbers.real("an offset") for _ in range(3)])
    return Key(path.stem, ((np.array(indices), np.array(offsets).reshape(-1, 3)),))


def _motion(path: Path, skeleton: Skeleton, heads: np.ndarray, keys: int) -> Motion:
    """From rest to the first frame of the pose."""
    pose: Bvh = read_bvh(path)
    missing = sorted(set(skeleton.names) - set(pose.names))
    if missing:
        raise InputError(f"{path} does not move bone {missing[0]!r} of the skeleton: is the pose for another one?")
    with one_at_a_time:
        from scipy.spatial.transform import Rotation

    number = {name: k for k, name in reversed(list(enumerate(pose.names)))}  # the first of equal ones
    own = [number[name] for name in skeleton.names]
    assert pose.motion.rotations is not None
    turn = Rotation.from_quat(pose.motion.rotations[0, own][:, [1, 2, 3, 0]]).as_matrix()
    turned = Rotation.from_matrix(_UPRIGHT @ turn @ _UPRIGHT.T).as_quat()[:, [3, 0, 1, 2]]
    still = np.tile([1.0, 0.0, 0.0, 0.0], (len(own), 1))
    parent = np.where((skeleton.parents >= 0)[:, None], heads[skeleton.parents], 0.0)
    return Motion(
        np.array([0.0, 1.0]),
        np.tile(heads - parent, (2, 1, 1)),
        np.stack([still, turned]),
        keys=np.zeros((2, keys)) if keys else None,
    )
