"""Skeletons, animation and blend shapes of USD (UsdSkel), in the coordinates of the stage.

USD multiplies row vectors from the left; here matrices are transposed once, where they are read. A skinned mesh stands
where its geometry bind transform and its skeleton put it, not where its own transform would.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from slefejax.errors import InputError
from slefejax.rig import Motion, Rig, Skeleton, transform_parts
from slefejax.skinning import Influences, Key, ShapeKeys


@dataclass
class _Bound:
    """What a mesh is bound to: number of its skeleton, joints and weights of its points, blend shapes."""

    skeleton: int
    place: np.ndarray
    indices: np.ndarray
    weights: np.ndarray
    keys: list[Key] = field(default_factory=list)


@dataclass
class SkelReader:
    """Everything below the skeleton roots of a stage. ``place`` of a mesh, then ``rig`` of all meshes together."""

    path: Any
    stage: Any
    time: Any
    skeletons: list[Any] = field(default_factory=list)
    bound: dict[str, _Bound] = field(default_factory=dict)
    places: list[np.ndarray] = field(default_factory=list)

    def __post_init__(self) -> None:
        from pxr import Usd, UsdGeom, UsdSkel

        usd: Any = Usd
        skel: Any = UsdSkel
        self.skel, self.usd = skel, usd
        geometry: Any = UsdGeom
        transforms = geometry.XformCache(self.time)
        cache = skel.Cache()
        proxies = usd.TraverseInstanceProxies()
        for prim in usd.PrimRange.Stage(self.stage, proxies):
            if not prim.IsA(skel.Root):
                continue
            root = skel.Root(prim)
            cache.Populate(root, proxies)
            for binding in cache.ComputeSkelBindings(root, proxies):
                query = cache.GetSkelQuery(binding.GetSkeleton())
                self.places.append(_matrix(transforms.GetLocalToWorldTransform(query.GetPrim())))
                self.skeletons.append(query)
                for target in binding.GetSkinningTargets():
                    self._bind(target, len(self.skeletons) - 1)

    def _bind(self, target: Any, number: int) -> None:
        prim = target.GetPrim()
        name = f"{self.path}: {prim.GetPath()}"
        joints = list(self.skeletons[number].GetJointOrder())
        points = prim.GetAttribute("points").Get(self.time)
        keys = self._keys(prim, name, len(points or ()))
        indices, weights = np.zeros((len(points or ()), 0), np.int64), np.zeros((len(points or ()), 0))
        if target.HasJointInfluences() and points is not None:
            found = target.ComputeVaryingJointInfluences(len(points), self.time)
            if not found:
                raise InputError(f"{name}: its joint indices and weights do not fit its {len(points)} points")
            indices = np.array(found[0], np.int64).reshape(len(points), -1)
            weights = np.array(found[1], np.float64).reshape(len(points), -1)
            own = list(target.GetJointOrder() or joints)
            missing = [joint for joint in own if joint not in joints]
            if missing:
                raise InputError(f"{name} is bound to joint {missing[0]!r}, which its skeleton does not have")
            beyond = (indices < 0) | (indices >= len(own))
            if beyond.any():
                raise InputError(
                    f"{name} has a weight for joint {indices[beyond][0]}, but is bound to {len(own)} joints"
                )
            indices = np.array([joints.index(joint) for joint in own])[indices]
        place = self.places[number] @ _matrix(target.GetGeomBindTransform(self.time))
        self.bound[str(prim.GetPath())] = _Bound(number, place, indices, weights, keys)

    def _keys(self, prim: Any, name: str, points: int) -> list[Key]:
        query = self.skel.BlendShapeQuery(self.skel.BindingAPI(prim))
        names = self.skel.BindingAPI(prim).GetBlendShapesAttr().Get() or []
        if not names:
            return []
        if len(names) != query.GetNumBlendShapes():
            raise InputError(f"{name} names {len(names)} blend shapes, but has {query.GetNumBlendShapes()}")
        keys = []
        for number, key in enumerate(names):
            shape = query.GetBlendShape(number)
            offsets = np.array(shape.GetOffsetsAttr().Get() or [], np.float64).reshape(-1, 3)
            given = shape.GetPointIndicesAttr().Get()
            indices = np.arange(len(offsets)) if given is None else np.array(given, np.int64)
            if indices.size and not 0 <= indices.min() <= indices.max() < points:
                raise InputError(f"{name}: blend shape {key!r} moves point {indices.max()}, but there are {points}")
            shapes, places = [(indices, offsets)], [1.0]
            for between in shape.GetInbetweens():
                shapes.append((indices, np.array(between.GetOffsets(), np.float64).reshape(-1, 3)))
                places.append(float(between.GetWeight()))
            keys.append(Key(str(key), tuple(shapes), tuple(places)))
        return keys

    def place(self, path: str) -> np.ndarray | None:
        """Where a skinned mesh stands at rest, ``(4, 4)``; None if it is not skinned."""
        bound = self.bound.get(path)
        return None if bound is None or not bound.indices.shape[1] else bound.place

    def rig(self, meshes: list[tuple[str, int, int]]) -> Rig | None:
        """The rig of meshes joined in this order: (path, vertices, where they begin). None if nothing moves them."""
        own = [(self.bound[path], count, start) for path, count, start in meshes if path in self.bound]
        if not own:
            return None
        total = sum(count for _, count, _ in meshes)
        keys = _joined_keys(own)
        skinned = any(bound.indices.shape[1] for bound, _, _ in own)
        skeleton, influences = self._skeleton(own, total) if skinned else (None, None)
        motion = self._motion(skeleton, [key.name for key in keys])
        rate = float(self.stage.GetTimeCodesPerSecond())
        return Rig(skeleton, influences, ShapeKeys.of(keys, total) if keys else None, motion, rate)

    def _skeleton(self, own: list[tuple[_Bound, int, int]], total: int) -> tuple[Skeleton, Influences]:
        """All skeletons as one, and a joint that stays for what none of them moves."""
        names, parents, binds, starts = ["(fixed)"], [-1], [np.eye(4)], []
        for number, query in enumerate(self.skeletons):
            starts.append(len(names))
            topology = query.GetTopology()
            for joint, name in enumerate(query.GetJointOrder()):
                names.append(str(name))
                parent = topology.GetParent(joint)
                parents.append(parent + starts[-1] if parent >= 0 else -1)
            bind = query.GetJointWorldBindTransforms()
            if not bind or len(bind) != len(query.GetJointOrder()):
                raise InputError(
                    f"{self.path}: skeleton {query.GetPrim().GetPath()} has no bind transform of each of its joints"
                )
            binds += [self.places[number] @ _matrix(m) for m in bind]
        width = max(1, *(bound.indices.shape[1] for bound, _, _ in own))
        indices, weights = np.zeros((total, width), np.int64), np.zeros((total, width))
        weights[:, 0] = 1.0
        for bound, count, start in own:
            if k := bound.indices.shape[1]:
                indices[start : start + count] = 0
                weights[start : start + count] = 0.0
                indices[start : start + count, :k] = bound.indices + starts[bound.skeleton]
                weights[start : start + count, :k] = bound.weights
        try:
            return Skeleton.of(names, parents, np.array(binds)), Influences.of(indices, weights, len(names))
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from None

    def _motion(self, skeleton: Skeleton | None, keys: list[str]) -> Motion | None:
        queries = [query.GetAnimQuery() for query in self.skeletons]
        times = sorted({t for q in queries if q for t in (*q.GetJointTransformTimeSamples(), *_weight_times(q))})
        if not any(bool(query) for query in queries):
            return None
        codes = [self.usd.TimeCode(t) for t in times] or [self.usd.TimeCode.Default()]
        samples = [self._pose(skeleton, code) for code in codes] if skeleton is not None else []
        parts = [np.array(part) for part in zip(*samples, strict=True)] if samples else [None, None, None]
        weights = np.array([self._weights(queries, keys, code) for code in codes]) if keys else None
        return Motion(np.array(times or [0.0], float), parts[0], parts[1], parts[2], weights)

    def _pose(self, skeleton: Skeleton, code: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Translations, rotations, scales of all joints at a time."""
        matrices = [np.eye(4)]
        for number, query in enumerate(self.skeletons):
            local = query.ComputeJointLocalTransforms(code)
            parents = skeleton.parents[len(matrices) :][: len(local)]
            for matrix, parent in zip(local, parents, strict=True):
                own = _matrix(matrix)
                matrices.append(self.places[number] @ own if parent < 0 else own)
        parts = [transform_parts(matrix) for matrix in matrices]
        return tuple(np.array(part) for part in zip(*parts, strict=True))  # type: ignore[return-value]

    def _weights(self, queries: list[Any], keys: list[str], code: Any) -> list[float]:
        found: dict[str, float] = {}
        for query in queries:
            if query:
                names = [str(name) for name in query.GetBlendShapeOrder()]
                found |= dict(zip(names, query.ComputeBlendShapeWeights(code) or [0.0] * len(names), strict=True))
        return [float(found.get(key, 0.0)) for key in keys]


def _joined_keys(own: list[tuple[_Bound, int, int]]) -> list[Key]:
    """Keys of all meshes with their vertices numbered on; those of one name at the same places are one."""
    found: dict[str, Key] = {}
    for bound, _, start in own:
        for key in bound.keys:
            shapes = tuple((np.asarray(indices) + start, offsets) for indices, offsets in key.shapes)
            before = found.get(key.name)
            if before is not None:
                if before.places != key.places:
                    raise InputError(f"blend shape {key.name!r} has in-betweens at other weights in another mesh")
                shapes = tuple(
                    (np.concatenate([a[0], b[0]]), np.concatenate([a[1], b[1]]))
                    for a, b in zip(before.shapes, shapes, strict=True)
                )
            found[key.name] = Key(key.name, shapes, key.places)
    return list(found.values())


def _weight_times(query: Any) -> list[float]:
    return list(query.GetBlendShapeWeightTimeSamples())


def _matrix(matrix: Any) -> np.ndarray:
    return np.array(matrix, np.float64).T
