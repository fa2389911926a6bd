"""What of patches is sent to the device, and how."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from slefejax.arguments import Patches, check_patches, on_host
from slefejax.errors import InputError
from slefejax.geometry.gregory import GregoryPatches
from slefejax.geometry.nested import NestedNets
from slefejax.geometry.normals import TangentNets, collapsed_sides, still_sides, tangent_nets
from slefejax.geometry.view import LARGEST
from slefejax.gpu.programs import Shape
from slefejax.tessellator.edges import Sides

_HIGHEST_PATCH_NUMBER = 2**24
_CONTROL, _PARTS, _COLLAPSED, _TANGENTS = 0, 5, 6, 7  # bindings, see the shaders


@dataclass(frozen=True, eq=False)
class Sent:
    """Control points as they are on the device.

    records   : ``(patches, numbers)`` float32, as bezier.glsl reads them: a patch's net, then its twists. Of
                ``NestedNets`` as nested.glsl does: a net of q
    to_world  : ``(4, 4)``, from these coordinates to the scene's
    shape     : what they are
    patches   : the same as patches; None of ``NestedNets``
    parts     : of ``NestedNets``: ``(squares, 2)``, the first net of each and whether there are more
    collapsed : for normals: ``(patches,)``, sides along which derivatives are 0, as collapsed.glsl reads them
    tangents  : for normals of tangent patches: ``(patches, numbers)`` float32, as tangents.glsl reads them
    """

    records: Float[np.ndarray, "patches numbers"]
    to_world: Float[np.ndarray, "4 4"]
    shape: Shape
    patches: Any = None
    parts: Int[np.ndarray, "squares 2"] | None = None
    collapsed: Int[np.ndarray, "patches"] | None = None
    tangents: Float[np.ndarray, "patches numbers"] | None = None

    @property
    def buffers(self) -> dict[int, np.ndarray]:
        """What lies on the device, at which binding."""
        every = {_CONTROL: self.records, _PARTS: self.parts, _COLLAPSED: self.collapsed, _TANGENTS: self.tangents}
        return {binding: records for binding, records in every.items() if records is not None}

    def __len__(self) -> int:
        return len(self.records if self.parts is None else self.parts)

    def __str__(self) -> str:
        if self.parts is not None:
            return f"{len(self)} squares of nested nets"
        nu, nv, dim, twists, _ = self.shape
        return f"{(len(self), nu, nv, dim)}{f' and {twists} twists' if twists else ''}"


def sent(patches: Any, before: Sent | None = None, normals: str | None = None, tangents: Any = None) -> Sent:
    """Patches as they are sent, in float32 relative to the box around them, and what normals need beside them.

    before   : what they were, whose box is kept as long as they fill most of it: what did not move then stays the same
    normals  : of which kind, ``slefejax.geometry.normals.NORMALS``; None: none
    tangents : tangent patches, for normals of theirs

    Raises InputError for control points that are not finite or too large, for more patches than can be numbered, and
    for tangents that are not those of the patches.
    """
    own = patches if isinstance(patches, NestedNets) else on_host(check_patches(patches, gregory=True))
    nets = tangent_nets(own, normals, tangents)
    if isinstance(own, NestedNets):
        return _nested(own)
    found = _of_patches(own.astype(np.float64), before)
    if normals is None:
        return found
    if nets is None:
        return replace(found, collapsed=_as_bits(np.asarray(collapsed_sides(own))))
    scale = found.to_world[0, 0]
    return replace(found, collapsed=_as_bits(np.asarray(still_sides(nets))), tangents=_tangent_records(nets, scale))


def _of_patches(given: Any, before: Sent | None) -> Sent:
    """Of patches in float64."""
    control = given.net if isinstance(given, GregoryPatches) else given
    everything = [control] if control is given else [control, given.twists]
    bad = np.flatnonzero(~np.all([np.isfinite(x).reshape(len(x), -1).all(axis=1) for x in everything], axis=0))
    if bad.size:
        raise InputError(f"patch {bad[0]} (counted from 0) has control points that are not finite numbers")
    if not max(np.max(np.abs(x)) for x in everything) < LARGEST:
        raise InputError(f"control points must be below {LARGEST:g} to be drawn: scale the scene down")
    _check_count(len(control))
    to_world = _box(control, None if before is None else before.to_world)
    net = _in_box(control, to_world)
    if control is given:
        return Sent(net.reshape(len(net), -1), to_world, Shape(*net.shape[1:], twists=0), net)
    own = GregoryPatches(net, (given.twists / to_world[0, 0]).astype(np.float32))
    records = np.concatenate([x.reshape(len(x), -1) for x in (own.net, own.twists)], axis=1)
    return Sent(records, to_world, Shape(*net.shape[1:], twists=own.twists.shape[1]), own)


def _as_bits(sides: Bool[np.ndarray, "patches 4"]) -> Int[np.ndarray, "patches"]:
    return (sides @ (1 << np.arange(4))).astype("<i4")


def _tangent_records(nets: TangentNets, scale: float) -> Float[np.ndarray, "patches numbers"]:
    """A patch's tangents along u, then those along v, in units of the box."""
    flat = [net.astype(np.float64).reshape(len(net), -1) for net in nets]
    return (np.concatenate(flat, axis=1) / scale).astype(np.float32)


def _nested(given: NestedNets) -> Sent:
    _check_count(len(given))
    to_world = np.eye(4)
    to_world[:3, 3] = given.origin
    records = given.nets.reshape(len(given.nets), -1)
    shape = Shape(4, 4, 9, 0, given.levels)
    return Sent(records, to_world, shape, parts=np.stack([given.first, given.nested], axis=1).astype("<i4"))


def _check_count(count: int) -> None:
    if count >= _HIGHEST_PATCH_NUMBER:
        raise InputError(f"the G-buffer can number {_HIGHEST_PATCH_NUMBER - 1} patches, not {count}")


def _box(patches: np.ndarray, before: np.ndarray | None) -> Float[np.ndarray, "4 4"]:
    """From the box around control points, -1 to 1, to the world; its scale is a power of two."""
    weights = patches[..., 3] if patches.shape[3] == 4 else None
    axes = [patches[..., a] if weights is None else patches[..., a] / weights for a in range(3)]
    # one coordinate after the other: of short rows NumPy finds the smallest ten times more slowly
    low, high = np.array([axis.min() for axis in axes]), np.array([axis.max() for axis in axes])
    centre = 0.5 * low + 0.5 * high
    extent = float(np.max(0.5 * high - 0.5 * low))
    scale = float(2.0 ** np.ceil(np.log2(extent))) if extent > 0 else 1.0
    if before is not None and scale <= before[0, 0] <= 2.0 * scale:
        middle = before[:3, 3]
        if max(np.abs(low - middle).max(), np.abs(high - middle).max()) <= before[0, 0]:
            return before
    to_world = np.diag([scale, scale, scale, 1.0])
    to_world[:3, 3] = centre
    return to_world


def _in_box(patches: np.ndarray, to_world: np.ndarray) -> np.ndarray:
    """float32 control points relative to the box. Equal points stay equal, so shared edges stay shared."""
    sent = np.empty(patches.shape, np.float32)
    for a in range(3):
        origin = to_world[a, 3] * (patches[..., 3] if patches.shape[3] == 4 else 1.0)
        np.divide(patches[..., a] - origin, to_world[0, 0], out=sent[..., a], casting="same_kind")
    if patches.shape[3] == 4:
        sent[..., 3:] = patches[..., 3:]
    return sent


def runs(changed: Bool[np.ndarray, "patches"]) -> Iterator[tuple[int, int]]:
    """(first, count) of patches in a row that have changed.

    >>> list(runs(np.array([True, False, True, True])))
    [(0, 1), (2, 2)]
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], changed.astype(np.int8), [0]])))
    for first, last in edges.reshape(-1, 2).tolist():
        yield first, last - first


def write_changed(buffer: Any, records: np.ndarray, before: np.ndarray) -> int:
    """Write those records to the buffer that are not what they were, ``before``; how many they are."""
    changed = np.any((records != before).reshape(len(records), -1), axis=1)
    for first, count in runs(changed):
        buffer.write(records[first : first + count].tobytes(), first * records[0].nbytes)
    return int(changed.sum())


def sides_of(patches: Patches) -> Sides:
    """Which curve each side is, in the patches' own precision, as levels are found."""
    return Sides.of(np.asarray(check_patches(patches)))


def owner_records(sides: Sides, count: int) -> bytes:
    """Sides as sides.glsl reads them. Raises InputError for those of other patches."""
    ends = np.stack([sides.first, sides.last])
    whose = np.asarray(sides.owner)
    if whose.shape != (count, 4) or ends.shape != (2, count, 4):
        raise InputError(
            f"sides must be those of {count} patches, ({count}, 4), not {whose.shape}: Sides.of finds them"
        )
    if not (np.all((whose >= 0) & (whose < 4 * count)) and np.all((ends >= 0) & (ends <= 1))):
        raise InputError("sides must be parts, from 0 to 1, of sides of these patches: Sides.of finds them")
    records = np.zeros((count, 4), [("owner", "<i4"), ("first", "<f4"), ("last", "<f4")])
    records["owner"], records["first"], records["last"] = whose, *ends
    return records.tobytes()
