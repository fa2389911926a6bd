"""A folder in MakeHuman's formats: base.obj, one .mhskel, one .mhw, .target files (in targets/), and one .bvh pose.

A bone begins at the mean of some vertices of the base mesh. Bones have no roll: at rest all of them are turned as the
world is, and a pose from a BVH file, whose figure may be another one, hands over its rotations. The motion goes from
rest (time 0) to that pose (time 1). Targets are shape keys, all of weight 0 in that motion.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from slefejax.arguments import whole_numbers
from slefejax.errors import InputError
from slefejax.io.bvh import Bvh, read_bvh
from slefejax.io.content import Content, read_bytes
from slefejax.io.limits import LARGEST_TEXT
from slefejax.io.numbers import Numbers
from slefejax.io.obj import read_obj
from slefejax.rig import Motion, Rig, Skeleton
from slefejax.skinning import Influences, Key, ShapeKeys

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
    heads = []
    for name, bone in bones.items():
        near = whole_numbers(joints.get(bone.get("head"), []), f"{path}: the head of bone {name!r}")
        if not near.size or not 0 <= near.min() <= near.max() < len(vertices):
            raise InputError(f"{path}: the head of bone {name!r} is at no vertices of the base mesh")
        heads.append(vertices[near].mean(axis=0))
    names = list(bones)
    unknown = [name for name in names if bones[name].get("parent") not in (None, *names)]
    if unknown:
        raise InputError(f"{path}: the parent {bones[unknown[0]]['parent']!r} of bone {unknown[0]!r} does not exist")
    parents = [names.index(bone["parent"]) if bone.get("parent") else -1 for bone in bones.values()]
    bind = np.tile(np.eye(4), (len(names), 1, 1))
    bind[:, :3, 3] = heads
    try:
        return Skeleton.of(names, parents, bind), np.array(heads)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _influences(path: Path, skeleton: Skeleton, count: int) -> Influences:
    (weights,) = _json(path, "weights")
    unknown = sorted(set(weights) - set(skeleton.names))
    if unknown:
        raise InputError(f"{path} has weights for bone {unknown[0]!r}, which the skeleton does not have")
    number = {name: k for k, name in enumerate(skeleton.names)}
    try:
        entries = [(int(v), number[name], float(w)) for name, pairs in weights.items() for v, w in pairs]
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{path}: weights should be pairs of a vertex and a number, a list of them a bone") from None
    vertex, bone, weight = (np.array(part) for part in zip(*entries, strict=True))
    if not 0 <= vertex.min() <= vertex.max() < count:
        raise InputError(f"{path} has a weight for vertex {vertex.max()}, but there are {count}")
    order = np.argsort(vertex, kind="stable")
    vertex, bone, weight = vertex[order], bone[order], weight[order]
    slot = np.arange(len(vertex)) - np.searchsorted(vertex, vertex)
    indices, shares = np.zeros((count, slot.max() + 1), np.int64), np.zeros((count, slot.max() + 1))
    indices[vertex, slot], shares[vertex, slot] = bone, weight
    try:
        return Influences.of(indices, shares, len(skeleton.names))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _target(path: Path, count: int) -> Key:
    """Rows of a vertex number and its offset; lines that begin with # are comments."""
    numbers = Numbers(path, comment="#")
    indices, offsets = [], []
    while (item := numbers.rest()) is not None:
        if not (item.isascii() and item.isdigit() and len(item) < 10 and int(item) < count):
            raise numbers.fail(f"{item[:40]!r} is no vertex of the {count} of the base mesh")
        indices.append(int(item))
        offsets.append(numbers.points((3,), "an offset"))
    return Key(path.stem, ((np.array(indices, np.int64), np.array(offsets).reshape(-1, 3)),))


def _motion(path: Path, skeleton: Skeleton, heads: np.ndarray, keys: int) -> Motion:
    """From rest to the first frame of the pose."""
    pose: Bvh = read_bvh(path)
    missing = sorted(set(skeleton.names) - set(pose.names))
    if missing:
        raise InputError(f"{path} does not move bone {missing[0]!r} of the skeleton: is the pose for another one?")
    from scipy.spatial.transform import Rotation

    own = [pose.names.index(name) for name in skeleton.names]
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
