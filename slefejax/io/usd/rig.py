"""The rig of a stage: skeletons, prims whose transform is animated, and blend shapes, as joints, keys and a motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from slefejax.errors import InputError
from slefejax.io.usd.places import Mover, Places
from slefejax.io.usd.skel import Bones, Bound, Skinning
from slefejax.model.rig import Motion, Pose, Rig, Skeleton, transform_parts
from slefejax.model.skinning import Influences, Key, ShapeKeys

_STILL = 1e-12  # what moves vertices at rest beside the identity, from rounding


class Part(NamedTuple):
    """A mesh among those that are joined: how many vertices, and what moves it."""

    vertices: int
    bound: Bound | None
    mover: Mover | None


def rig_of(stage: Any, skinning: Skinning, places: Places, parts: list[Part]) -> Rig | None:
    """The rig of meshes that are joined in this order; None if nothing moves them."""
    movers = list(dict.fromkeys(mover for part in parts if (mover := _mover(part)) is not None))
    bones = list(dict.fromkeys(part.bound.bones for part in parts if part.bound is not None))
    if not movers and not bones:
        return None
    joints = _Joints(movers, [own for own in bones if any(_skinned_by(part, own) for part in parts)])
    keys, sources = _keys(parts)
    skeleton = influences = dual = None
    if movers or joints.bones:
        skeleton = joints.skeleton()
        influences, dual = joints.influences(parts, skinning)
    codes = _codes(places, movers, bones)
    moving = bool(movers) or any(own.animation is not None for own in bones)
    motion = _motion(places, joints if skeleton is not None else None, codes, sources) if moving else None
    rest = Pose(None if skeleton is None else joints.rest(skeleton, places), _rest_keys(places, sources))
    count = sum(part.vertices for part in parts)
    shapes = ShapeKeys.of(keys, count) if keys else None
    return Rig(skeleton, influences, shapes, motion, float(stage.GetTimeCodesPerSecond()), rest, dual)


def _mover(part: Part) -> Mover | None:
    return part.bound.bones.mover if part.bound is not None and part.bound.skinned else part.mover


def _skinned_by(part: Part, bones: Bones) -> bool:
    return part.bound is not None and part.bound.skinned and part.bound.bones is bones


@dataclass
class _Joints:
    """All joints: one that stays, for what nothing moves, then movers, then those of the skeletons."""

    movers: list[Mover]
    bones: list[Bones]

    def home(self, mover: Mover | None) -> int:
        """The joint of a mover, or the one that stays."""
        return 0 if mover is None else 1 + self.movers.index(mover)

    def starts(self) -> list[int]:
        """The first joint of each skeleton."""
        counts = [len(own.joints) for own in self.bones]
        return (1 + len(self.movers) + np.cumsum([0, *counts])[:-1]).tolist()

    def skeleton(self) -> Skeleton:
        names = ["(fixed)", *(str(mover.prim.GetPath()) for mover in self.movers)]
        parents = [-1] * len(names)
        binds = [np.eye(4), *(mover.bind for mover in self.movers)]
        for own, start in zip(self.bones, self.starts(), strict=True):
            names += own.joints
            top = self.home(own.mover) or -1
            parents += [top if parent < 0 else start + parent for parent in own.parents()]
            binds += list(own.place @ own.bind())
        return Skeleton.of(names, parents, np.array(binds))

    def influences(self, parts: list[Part], skinning: Skinning) -> tuple[Influences, np.ndarray | None]:
        """Joints and weights of all vertices, and which of them are blended by dual quaternions."""
        count = sum(part.vertices for part in parts)
        width = max([1, *(part.bound.indices.shape[1] for part in parts if part.bound is not None)])
        indices, weights = np.zeros((count, width), np.int64), np.zeros((count, width))
        dual = np.zeros(count, bool)
        at, free = 0, 0
        starts = dict(zip(map(id, self.bones), self.starts(), strict=True))
        for part in parts:
            own = slice(at, at + part.vertices)
            at += part.vertices
            bound = part.bound
            if bound is not None and bound.skinned:
                k = bound.indices.shape[1]
                indices[own, :k] = bound.indices + starts[id(bound.bones)]
                weights[own, :k] = bound.weights
                dual[own] = bound.dual
            none = np.flatnonzero(~np.any(weights[own] != 0, axis=1)) + own.start
            indices[none], weights[none, 0] = self.home(_mover(part)), 1.0
            free += len(none) if bound is not None and bound.skinned else 0
        if free:
            skinning.notes.append(f"{free} points of skinned meshes have no weight: they move with their skeletons")
        names = 1 + len(self.movers) + sum(len(own.joints) for own in self.bones)
        return Influences.of(indices, weights, names), dual if dual.any() else None

    def local(self, places: Places, code: Any) -> Float[np.ndarray, "joints 4 4"]:
        """From joints to their parents at a time."""
        found = [np.eye(4), *(places.matrix(mover.prim, code) for mover in self.movers)]
        for own in self.bones:
            for matrix, parent in zip(own.local(code), own.parents(), strict=True):
                found.append(own.below @ matrix if parent < 0 else matrix)
        return np.array(found)

    def rest(self, skeleton: Skeleton, places: Places) -> Float[np.ndarray, "joints 4 4"] | None:
        """As they are at the earliest time; None if that moves nothing."""
        local = self.local(places, places.time)
        world = np.empty_like(local)
        for joint in np.argsort(skeleton.depth, kind="stable"):
            parent = skeleton.parents[joint]
            world[joint] = local[joint] if parent < 0 else world[parent] @ local[joint]
        moves = world @ skeleton.inverse_bind
        return None if np.abs(moves - np.eye(4)).max() <= _STILL * max(1.0, np.abs(world).max()) else local


def _codes(places: Places, movers: list[Mover], bones: list[Bones]) -> list[Any]:
    """The times of all samples."""
    times = set(places.times(movers))
    for own in bones:
        if (query := own.animation) is not None:
            times.update(query.GetJointTransformTimeSamples())
            times.update(query.GetBlendShapeWeightTimeSamples())
    return [places.library.usd.TimeCode(time) for time in sorted(times)]


def _motion(places: Places, joints: _Joints | None, codes: list[Any], sources: list[tuple[Bones, str]]) -> Motion:
    times = [code.GetValue() for code in codes] or [0.0]
    codes = codes or [places.time]
    moves = turns = scales = None
    if joints is not None:
        parts = [[transform_parts(matrix) for matrix in joints.local(places, code)] for code in codes]
        moves, turns, scales = (np.array([[own[k] for own in row] for row in parts]) for k in range(3))
    weights = np.array([_weights(sources, code) for code in codes]) if sources else None
    return Motion(np.array(times, float), moves, turns, scales, weights)


def _rest_keys(places: Places, sources: list[tuple[Bones, str]]) -> Float[np.ndarray, "keys"] | None:
    """Weights at the earliest time; None if all are 0."""
    found = np.array(_weights(sources, places.time))
    return found if np.any(found != 0) else None


def _weights(sources: list[tuple[Bones, str]], code: Any) -> list[float]:
    """Weights of keys at a time, 0 for those that nothing animates."""
    found: dict[Bones, dict[str, float]] = {}
    for bones in dict.fromkeys(own for own, _ in sources):
        found[bones] = {}
        if (query := bones.animation) is not None:
            names = [str(name) for name in query.GetBlendShapeOrder()]
            found[bones] = dict(zip(names, query.ComputeBlendShapeWeights(code) or [0.0] * len(names), strict=True))
    return [float(found[bones].get(name, 0.0)) for bones, name in sources]


def _keys(parts: list[Part]) -> tuple[list[Key], list[tuple[Bones, str]]]:
    """Keys of all meshes with their vertices numbered on, and where the weight of each comes from.

    Those of one name below one skeleton are one; below another skeleton a key of the same name gets a number.
    """
    found: dict[tuple[Bones, str], Key] = {}
    start = 0
    for part in parts:
        for key in part.bound.keys if part.bound is not None else ():
            source = (part.bound.bones, key.name)  # type: ignore[union-attr]
            shapes = tuple((np.asarray(indices) + start, offsets) for indices, offsets in key.shapes)
            before = found.get(source)
            if before is not None:
                if before.places != key.places:
                    raise InputError(f"blend shape {key.name!r} has in-betweens at other weights in another mesh")
                shapes = tuple(
                    (np.concatenate([a[0], b[0]]), np.concatenate([a[1], b[1]]))
                    for a, b in zip(before.shapes, shapes, strict=True)
                )
            found[source] = Key(key.name, shapes, key.places)
        start += part.vertices
    keys, used = [], {name: 0 for _, name in found}
    for (_, name), key in found.items():
        used[name] += 1
        keys.append(key if used[name] == 1 else Key(f"{name} {used[name]}", key.shapes, key.places))
    return keys, list(found)
