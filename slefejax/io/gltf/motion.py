"""The animations of a glTF file as samples of poses."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from jaxtyping import Float

from slefejax.arguments import is_whole, no_such
from slefejax.errors import InputError
from slefejax.io.gltf.extensions import extension_of
from slefejax.io.gltf.file import GltfFile
from slefejax.model.rig import Motion

_CURVE = 16  # samples of every piece of a cubic curve
_BEFORE = 1e-6  # of the span of an animation: how long before a step the value is still the old one
_MOST = 5 * 10**6  # times times nodes
_PATHS = {"translation": 3, "rotation": 4, "scale": 3, "weights": 1}
_POINTER = re.compile(r"/nodes/(\d{1,9})/(translation|rotation|scale|weights)")
_HARMLESS = ("/materials/", "/cameras/", "/extensions/KHR_lights", "/textures/")

Channel = tuple[int, str, dict[str, Any]]
"""What an animation moves: a node, one of _PATHS of it, and the sampler that says how."""


def chosen_animation(file: GltfFile, wanted: Any, notes: list[str]) -> dict[str, Any] | None:
    """The animation of that name or number, the first if None; the others are noted."""
    animations = file.content.get("animations", [])
    names = [str(file.item("animations", k).get("name", k)) for k in range(len(animations))]
    if wanted is None:
        if len(names) > 1:
            notes.append(f"animation {names[0]!r} of {', '.join(names)} was taken: choose another one by its name")
        return animations[0] if animations else None
    if isinstance(wanted, str) and wanted in names:
        return animations[names.index(wanted)]
    number = int(wanted) if is_whole(wanted, 0) or (isinstance(wanted, str) and wanted.isdecimal()) else len(names)
    if number < len(names):
        return animations[number]
    raise InputError(f"{file.path}: {no_such('animation', wanted, names)}")


def channels_of(file: GltfFile, animation: dict[str, Any] | None, notes: list[str]) -> list[Channel]:
    """The channels of an animation that move shapes; those that cannot be followed are noted."""
    found, lost = [], []
    for channel in (animation or {}).get("channels", []):
        target = channel["target"]
        node, path = target.get("node"), target.get("path")
        if path == "pointer":
            pointer = str((extension_of(target, "KHR_animation_pointer") or {}).get("pointer"))
            if named := _POINTER.fullmatch(pointer):
                node, path = int(named[1]), named[2]
            elif not pointer.startswith(_HARMLESS):
                lost.append(pointer[:60])
        if node is None or path not in _PATHS:
            continue
        file.item("nodes", node)
        samplers = animation["samplers"]  # type: ignore[index]
        if not 0 <= channel["sampler"] < len(samplers):
            raise file.fail(f"the animation has no sampler {channel['sampler']}")
        found.append((node, path, samplers[channel["sampler"]]))
    if lost:
        notes.append(f"the animation also moves {lost[0]} ({len(lost)} such pointers), which is not followed")
    return found


def motion_of(
    file: GltfFile,
    channels: list[Channel],
    nodes: list[Any],
    more: int | None,
    owners: list[tuple[int, int]],
    weights: np.ndarray,
) -> Motion:
    """Poses of all joints (nodes, then ``more`` that only stand in their parents; None for no joints) and keys.

    owners  : (node, number of the morph target) of every key
    weights : of the keys where nothing moves them
    """
    curves = {(node, path): _curve(file, sampler, node, path, nodes) for node, path, sampler in channels}
    times = _times(curves)
    if len(times) * max(1, len(nodes), len(owners)) > _MOST:
        raise file.fail(
            f"its animation has {len(times):,} times of {len(nodes):,} nodes, more than {_MOST:,} poses of one:"
            " shorten it"
        )
    translations, rotations, scales = (
        np.array([getattr(n, name) for n in nodes]) for name in ("translation", "rotation", "scale")
    )
    poses = [np.repeat(part[None], len(times), axis=0) for part in (translations, rotations, scales)]
    for (node, path), curve in curves.items():
        if path != "weights":
            poses[("translation", "rotation", "scale").index(path)][:, node] = curve.at(times)
    if not all(np.isfinite(pose).all() for pose in poses):
        raise file.fail("its animation leads to transforms that are not finite")
    keys = _weights(curves, times, owners, weights)
    if more is None:
        return Motion(times, keys=keys)
    still = (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.ones(3))
    own = [
        np.concatenate([p, np.broadcast_to(s, (len(times), more, len(s)))], axis=1)
        for p, s in zip(poses, still, strict=True)
    ]
    return Motion(times, own[0], own[1], None if np.all(own[2] == 1.0) else own[2], keys)


def _weights(curves: dict, times: np.ndarray, owners: list, weights: np.ndarray) -> np.ndarray | None:
    if not owners:
        return None
    found = np.repeat(weights[None], len(times), axis=0)
    for k, (node, target) in enumerate(owners):
        if (node, "weights") in curves:
            found[:, k] = curves[node, "weights"].at(times)[:, target]
    return found


class _Curve:
    """One channel: values at its own times, and how they go in between."""

    def __init__(self, times: np.ndarray, values: np.ndarray, kind: str, turns: bool) -> None:
        self.times, self.kind, self.turns = times, kind, turns
        self.values = values[:, 1] if kind == "CUBICSPLINE" else values
        self.before, self.after = (values[:, 0], values[:, 2]) if kind == "CUBICSPLINE" else (None, None)

    def samples(self, span: float) -> np.ndarray:
        """Times between which straight lines (arcs) follow the curve."""
        if self.kind == "STEP":
            return np.concatenate(
                [self.times, self.times[1:] - min(_BEFORE * span, 0.5 * np.diff(self.times).min(initial=np.inf))]
            )
        if self.kind == "CUBICSPLINE":
            steps = np.arange(_CURVE) / _CURVE
            return np.append((self.times[:-1, None] + np.diff(self.times)[:, None] * steps).ravel(), self.times[-1])
        return self.times

    def at(self, times: Float[np.ndarray, "samples"]) -> np.ndarray:
        """Values at any times; they stay before the first and after the last."""
        k = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, max(0, len(self.times) - 2))
        last = np.minimum(k + 1, len(self.times) - 1)
        length = self.times[last] - self.times[k]
        share = np.clip((times - self.times[k]) / np.where(length > 0, length, 1.0), 0.0, 1.0)[:, None]
        p, q = self.values[k], self.values[last]
        if self.kind == "STEP":
            found = np.where(share >= 1.0, q, p)
        elif self.before is not None and self.after is not None:
            s, d = share, length[:, None]
            found = (2 * s**3 - 3 * s**2 + 1) * p + d * (s**3 - 2 * s**2 + s) * self.after[k]
            found = found + (3 * s**2 - 2 * s**3) * q + d * (s**3 - s**2) * self.before[last]
        elif self.turns:
            found = _arcs(p, q, share)
        else:
            found = (1.0 - share) * p + share * q
        return _turned(found) if self.turns else found


def _arcs(p: np.ndarray, q: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Along the shorter arc between unit quaternions."""
    cosine = np.sum(p * q, axis=1, keepdims=True)
    q, cosine = np.where(cosine < 0, -q, q), np.minimum(np.abs(cosine), 1.0)
    angle = np.arccos(cosine)
    sine = np.where(angle > 1e-6, np.sin(angle), 1.0)
    a = np.where(angle > 1e-6, np.sin((1.0 - share) * angle) / sine, 1.0 - share)
    b = np.where(angle > 1e-6, np.sin(share * angle) / sine, share)
    return a * p + b * q


def _turned(values: np.ndarray) -> np.ndarray:
    return values / np.linalg.norm(values, axis=1, keepdims=True)


def _curve(file: GltfFile, sampler: dict[str, Any], node: int, path: str, nodes: list[Any]) -> _Curve:
    kind, what = sampler.get("interpolation", "LINEAR"), f"the {path} of node {node} over time"
    times = file.array(sampler["input"], 1, f"times of {what}").ravel().astype(np.float64)
    values = np.asarray(file.array(sampler["output"], _PATHS[path], what), np.float64)
    if path == "weights":
        mesh = file.item("meshes", nodes[node].mesh)
        values = values.reshape(-1, max(1, len(mesh["primitives"][0].get("targets", []))))
    if kind not in ("LINEAR", "STEP", "CUBICSPLINE"):
        raise file.fail(f"{what} goes by {kind!r}, which is unknown")
    parts = 3 if kind == "CUBICSPLINE" else 1
    if not len(times) or np.any(np.diff(times) <= 0) or len(values) != parts * len(times):
        raise file.fail(f"{what} has {len(values)} values at {len(times)} times, which must grow")
    if path == "rotation":
        values = values[:, [3, 0, 1, 2]]
        norms = np.linalg.norm(values[1::3] if parts == 3 else values, axis=1)
        if not np.all(norms > 0):
            raise file.fail(f"{what} has a quaternion of no length")
    shaped = values.reshape(len(times), 3, -1) if parts == 3 else values
    return _Curve(times, shaped if parts == 3 or path != "rotation" else _turned(shaped), kind, path == "rotation")


def _times(curves: dict[tuple[int, str], _Curve]) -> Float[np.ndarray, "samples"]:
    """All times at which some curve has a sample; 0 if there is none."""
    every = [curve.times for curve in curves.values()]
    if not every:
        return np.zeros(1)
    span = max(times[-1] for times in every) - min(times[0] for times in every)
    return np.unique(np.concatenate([curve.samples(span) for curve in curves.values()]))
