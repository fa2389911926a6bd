"""Skeletons, influences and blend shapes of USD (UsdSkel).

A skinned mesh stands where its geometry bind transform and its skeleton put it, not where its own transform would.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from slefejax.errors import InputError
from slefejax.io.usd.library import Library
from slefejax.io.usd.places import Mover, Places, matrix
from slefejax.model.skinning import Key

_SAME = 1e-6  # weights of in-betweens, as usd-core has it
_SUM = 1e-3  # of weights beside 1, which files round


@dataclass(eq=False)
class Bones:
    """A skeleton of the stage.

    below, place : from its coordinates to those of its mover, and to where meshes are put
    """

    query: Any
    mover: Mover | None
    below: Float[np.ndarray, "4 4"]
    place: Float[np.ndarray, "4 4"]

    @property
    def path(self) -> str:
        """Of its prim."""
        return str(self.query.GetPrim().GetPath())

    @cached_property
    def joints(self) -> list[str]:
        """Their names."""
        return [str(name) for name in self.query.GetJointOrder()]

    def parents(self) -> list[int]:
        """Number of the parent of each joint, -1 for roots."""
        topology = self.query.GetTopology()
        return [topology.GetParent(joint) for joint in range(len(self.joints))]

    def bind(self) -> Float[np.ndarray, "joints 4 4"]:
        """From joints to the skeleton. Raises InputError if there is none for each of them."""
        found = self.query.GetJointWorldBindTransforms()
        if not found or len(found) != len(self.joints):
            raise InputError(f"skeleton {self.path} has no bind transform of each of its joints")
        return np.array([matrix(own) for own in found])

    def local(self, code: Any) -> Float[np.ndarray, "joints 4 4"]:
        """From joints to their parents at a time: animated, else at rest, else as bound."""
        found = (
            self.query.ComputeJointLocalTransforms(code) if self.has_rest or self.animated == set(self.joints) else ()
        )
        if len(found or ()) == len(self.joints):
            return np.array([matrix(own) for own in found]).reshape(-1, 4, 4)
        bind = self.bind()
        above = [np.eye(4) if parent < 0 else bind[parent] for parent in self.parents()]
        return np.array([np.linalg.solve(a, b) for a, b in zip(above, bind, strict=True)]).reshape(-1, 4, 4)

    @cached_property
    def has_rest(self) -> bool:
        """Whether there is a rest transform of each of its joints."""
        skeleton = self.query.GetSkeleton()
        return len(skeleton.GetRestTransformsAttr().Get() or ()) == len(self.joints)

    @cached_property
    def animation(self) -> Any:
        """What animates it, or None."""
        return self.query.GetAnimQuery() or None

    @cached_property
    def animated(self) -> set[str]:
        """The joints that its animation moves."""
        own = self.animation
        return {str(name) for name in own.GetJointOrder()} & set(self.joints) if own else set()

    def mirrors(self, code: Any) -> Float[np.ndarray, "joints"]:
        """-1 for joints that turn what is bound to them inside out at a time, 1 for others."""
        local, parents = self.local(code), self.parents()
        sign = np.sign(np.linalg.det(local[:, :3, :3]))
        for joint, parent in enumerate(parents):  # parents come first
            sign[joint] *= 1.0 if parent < 0 else sign[parent]
        return np.where(sign * np.sign(np.linalg.det(self.bind()[:, :3, :3])) < 0, -1.0, 1.0)


@dataclass(eq=False)
class Bound:
    """What a mesh is bound to.

    bones            : its skeleton
    place            : from its own coordinates to where it is put
    indices, weights : ``(points, k)`` joints of the skeleton and weights; k is 0 if only blend shapes move it
    dual             : whether its joints are blended by dual quaternions
    mirrored         : whether its joints turn it inside out at rest
    keys             : its blend shapes
    """

    bones: Bones
    place: Float[np.ndarray, "4 4"]
    indices: Int[np.ndarray, "points k"]
    weights: Float[np.ndarray, "points k"]
    dual: bool
    mirrored: bool
    keys: list[Key]

    @property
    def skinned(self) -> bool:
        """Whether joints move it."""
        return self.indices.shape[1] > 0


@dataclass
class Skinning:
    """What is bound to the skeletons of a stage; what is changed or not followed stands in notes."""

    library: Library
    places: Places
    targets: dict[str, tuple[Any, int]] = field(default_factory=dict)
    found: list[Any] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    _bones: dict[int, Bones] = field(default_factory=dict)
    _checked: set[str] = field(default_factory=set)

    @staticmethod
    def of(library: Library, stage: Any, places: Places) -> Skinning:
        """Whatever is bound below the skeleton roots of a stage."""
        self = Skinning(library, places)
        cache, proxies = library.skel.Cache(), library.usd.TraverseInstanceProxies()
        for prim in library.usd.PrimRange.Stage(stage, proxies):
            if not prim.IsA(library.skel.Root):
                continue
            root = library.skel.Root(prim)
            cache.Populate(root, proxies)
            for binding in cache.ComputeSkelBindings(root, proxies):
                self.found.append(cache.GetSkelQuery(binding.GetSkeleton()))
                for target in binding.GetSkinningTargets():
                    self.targets[str(target.GetPrim().GetPath())] = (target, len(self.found) - 1)
        return self

    def bind(self, prim: Any) -> Bound | None:
        """What a mesh is bound to; None if neither joints nor blend shapes move it.

        Raises InputError for influences and blend shapes that do not fit it.
        """
        path = str(prim.GetPath())
        if path not in self.targets:
            if prim.HasAttribute("primvars:skel:jointIndices"):
                self.notes.append(f"{path} has joints, but no skeleton below one root with it: it was not skinned")
            return None
        target, number = self.targets[path]
        count = len(prim.GetAttribute("points").Get(self.places.time) or ())
        bones = self._skeleton(number)
        indices, weights = np.zeros((count, 0), np.int64), np.zeros((count, 0))
        place = self.places.bound(prim)
        if target.HasJointInfluences() and count:
            indices, weights = self._influences(target, bones, path, count)
            self._check(bones)
            place = bones.place @ matrix(target.GetGeomBindTransform(self.places.time))
        keys = self._keys(prim, path, count, place)
        if not keys and not indices.shape[1]:
            return None
        dual = str(target.GetSkinningMethod()) == str(self.library.skel.Tokens.dualQuaternion)
        mirrored = False
        if indices.shape[1]:
            mirrored = bool(np.sum(weights * bones.mirrors(self.places.time)[indices]) < 0)
        return Bound(bones, place, indices, weights, dual, mirrored, keys)

    def _skeleton(self, number: int) -> Bones:
        if number not in self._bones:
            query = self.found[number]
            prim = query.GetPrim()
            self._bones[number] = Bones(
                query, self.places.mover(prim), self.places.below(prim), self.places.bound(prim)
            )
        return self._bones[number]

    def _check(self, bones: Bones) -> None:
        """Raise InputError without bind transforms, and where a joint is animated and another stands nowhere."""
        bones.bind()
        count = len(bones.joints)
        if bones.path in self._checked or bones.has_rest or len(bones.animated) == count:
            return
        self._checked.add(bones.path)
        what = f"skeleton {bones.path} has no restTransforms of its {count} joints"
        if bones.animated:
            animation = bones.animation.GetPrim().GetPath()
            raise InputError(
                f"{what}, and its animation {animation} moves {len(bones.animated)} of them only:"
                " write restTransforms for where the others are"
            )
        self.notes.append(f"{what}: they rest as they are bound")

    def _influences(self, target: Any, bones: Bones, path: str, count: int) -> tuple[np.ndarray, np.ndarray]:
        found = target.ComputeVaryingJointInfluences(count, self.places.time)
        if not found:
            raise InputError(f"{path}: its joint indices and weights do not fit its {count} points")
        indices = np.array(found[0], np.int64).reshape(count, -1)
        weights = np.array(found[1], np.float64).reshape(count, -1)
        joints = bones.joints
        own = [str(joint) for joint in target.GetJointOrder() or joints]
        numbers = {joint: number for number, joint in enumerate(joints)}
        missing = [joint for joint in own if joint not in numbers]
        if missing:
            raise InputError(f"{path} is bound to joint {missing[0]!r}, which its skeleton does not have")
        beyond = (indices < 0) | (indices >= len(own))
        if beyond.any():
            raise InputError(f"{path} has a weight for joint {indices[beyond][0]}, but is bound to {len(own)} joints")
        sums = weights.sum(axis=1)
        odd = np.count_nonzero((np.abs(sums - 1.0) > _SUM) & (sums != 0))
        if odd:
            self.notes.append(f"{path}: the weights of {odd} points do not add up to 1, and were divided by their sum")
        return np.array([numbers[joint] for joint in own], np.int64)[indices], weights

    def _keys(self, prim: Any, path: str, count: int, place: Float[np.ndarray, "4 4"]) -> list[Key]:
        binding = self.library.skel.BindingAPI(prim)
        names = binding.GetBlendShapesAttr().Get() or []
        if not names:
            return []
        query = self.library.skel.BlendShapeQuery(binding)
        if len(names) != query.GetNumBlendShapes():
            raise InputError(f"{path} names {len(names)} blend shapes, but has {query.GetNumBlendShapes()}")
        keys = []
        for number, key in enumerate(names):
            shape = query.GetBlendShape(number)
            if not shape:
                raise InputError(f"{path}: the target of blend shape {key!r} is none")
            given = np.array(shape.GetPointIndicesAttr().Get() or [], np.int64)
            if given.size and not 0 <= given.min() <= given.max() < count:
                bad = given.max() if given.max() >= count else given.min()
                raise InputError(f"{path}: blend shape {key!r} moves point {bad}, but there are {count}")
            given = given if given.size else np.arange(count)
            parts = [(shape.GetOffsetsAttr().Get(), 1.0), *self._between(shape, path)]
            shapes = tuple(_moves(offsets, given, place, f"{path}: blend shape {key!r}") for offsets, _ in parts)
            keys.append(Key(str(key), shapes, tuple(weight for _, weight in parts)))
        return keys

    def _between(self, shape: Any, path: str) -> list[tuple[Any, float]]:
        """Offsets and weights of the shapes in between."""
        found: list[tuple[Any, float]] = []
        for between in shape.GetInbetweens():
            weight, name = float(between.GetWeight() or 0.0), between.GetAttr().GetPath()
            if not np.isfinite(weight) or min(abs(weight), abs(weight - 1.0)) <= _SAME:
                self.notes.append(f"{name} is in between at weight {weight:g}, which is none: it was left out")
            elif any(abs(weight - other) <= _SAME for _, other in found):
                raise InputError(f"{name}: another shape in between has the same weight {weight:g}")
            else:
                found.append((between.GetOffsets(), weight))
        return found


def _moves(
    given: Any, points: Int[np.ndarray, "points"], place: Float[np.ndarray, "4 4"], what: str
) -> tuple[Int[np.ndarray, "points"], Float[np.ndarray, "points 3"]]:
    """The points that a shape moves, and how far, where the mesh is put. No offsets move nothing."""
    offsets = np.array(given if given is not None else [], np.float64).reshape(-1, 3)
    if not len(offsets):
        return points[:0], offsets
    if len(offsets) != len(points):
        raise InputError(f"{what} needs {len(points)} offsets, not {len(offsets)}")
    return points, offsets @ place[:3, :3].T
