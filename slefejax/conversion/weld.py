"""Sides of patches that were one curve before a file's digits, or a program's rounding, parted them.

Two sides are *twins* if the control points of one, raised to the degree of the other if that is higher, lie within a
tolerance of the other's, coordinate by coordinate, in the same or in the opposite order. Of sides that are twins of the
one of the lowest degree, the *owner*, all get its points, raised to their own degree: equal bit for bit once everything
is raised to one degree, since raising goes step by step (``slefejax.geometry.bezier.elevate``).

- Corners first: those within the tolerance of one corner, the first in the file, become one point, so that no point
  goes further than that, and no chain of near ones is drawn together. Two ends of a side that would shrink to a point
  by it stay apart; a side that is a point stays one.
- Only corners of twins move. The inside of a patch stays as it is.

Homogeneous control points (w x, w y, w z, w) may be multiplied by any number without moving the surface, so rational
twins may have weights that differ by a factor, which neither a tessellator nor ``tessellator.edges`` sees as the same:
each patch is multiplied by its own. Weights that are no multiple of the twin's run through the same control points at
another pace or along another curve, and no factor helps.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from slefejax.errors import InputError
from slefejax.geometry.bezier import elevate
from slefejax.late import one_at_a_time
from slefejax.model.mesh import connected
from slefejax.tessellator.edges import EDGES, number_by_first_use

_UNKNOWN_DIGITS = 1e-6  # of the size of a scene
_ROUNDINGS = 16  # eps of the largest coordinate
_SAME_PLACE = 1e-9  # of the size of the model: rational twins this near have to have weights that agree
_SAME_RATIO = 1e-9
_ENDS = ((0, 1), (0, 2), (2, 3), (1, 3))  # corners of every edge; corner 2 i + j is at u = i, v = j
Patch = np.ndarray  # (du+1, dv+1, 3), or 4 at the end if rational


class Twin(NamedTuple):
    """A side that is the owner's curve.

    owner, other : sides, 4 patch + edge
    backwards    : whether it runs the other way
    ratio        : the owner's weights over its own
    """

    owner: int
    other: int
    backwards: bool
    ratio: float


def welded(patches: list[Patch], tolerance: float) -> tuple[list[Patch], tuple[str, ...]]:
    """The patches with twins made equal (module docstring), and notes about what that changed.

    patches   : all polynomial or all rational; their degrees may differ and stay as they are
    tolerance : scene units; 0 leaves polynomial patches alone. Rational ones within 1e-9 of the size of the model are
                always twins

    Raises InputError where rational sides are one but for weights that no factors bring together, with the numbers of
    the patches.

    >>> one = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], float)
    >>> other = one + [1.0, 1e-9, 0.0]
    >>> patches, notes = welded([one, other], 1e-6)
    >>> np.array_equal(patches[0][1], patches[1][0])
    True
    """
    size = size_of(patches)
    rational = patches[0].shape[2] == 4
    tolerance = max(tolerance, _SAME_PLACE * size) if rational else tolerance
    if tolerance == 0:
        return patches, ()
    corners = _Corners.of(patches, tolerance)
    twins = _twins(patches, corners, tolerance, max(_SAME_RATIO, 2.0 * tolerance / max(size, tolerance)))
    if all(twin.ratio == 1.0 and _equal(patches, twin) for twin in twins):
        return patches, ()
    factor = _factors(len(patches), twins, len(patches) * max(_SAME_RATIO, tolerance / max(size, tolerance)))
    scaled = [patch if f == 1.0 else patch * f for patch, f in zip(patches, factor, strict=True)]
    found = _made_equal(scaled, twins, corners)
    changed, notes = int(np.count_nonzero(factor != 1.0)), []
    if changed:
        notes.append(
            f"the weights of {changed} of {len(patches)} patches were multiplied by a factor to agree with neighbours"
        )
    return found, (*notes, *_said(scaled, found, twins, tolerance))


def weld_tolerance(patches: list[Patch], digits: float | None) -> float:
    """How far apart sides may be that are welded if nobody says otherwise, in scene units.

    digits : what a file's digits leave open (``slefejax.io.content``); None: 1e-6 of the size of the scene. Never less
             than the rounding of a program that computes in float64

    >>> weld_tolerance([np.array([[[0, 0, 0], [1, 0, 0]], [[0, 3, 0], [1, 3, 0]]], float)], None)
    3e-06
    """
    rounding = _ROUNDINGS * np.finfo(np.float64).eps * max(float(np.abs(patch[..., :3]).max()) for patch in patches)
    return max(rounding, _UNKNOWN_DIGITS * size_of(patches) if digits is None else digits)


def size_of(patches: list[Patch]) -> float:
    """The longest side of the box around all control points, in scene units.

    >>> size_of([np.array([[[0, 0, 0], [1, 0, 0]], [[0, 3, 0], [1, 3, 0]]], float)])
    3.0
    """
    points = np.concatenate([places(patch).reshape(-1, 3) for patch in patches])
    return float(np.max(np.ptp(points, axis=0)))


def places(points: Float[np.ndarray, "*rest dim"]) -> Float[np.ndarray, "*rest 3"]:
    """Where control points lie in space: divided by their weights, if there are any.

    >>> places(np.array([[2.0, 4.0, 6.0, 2.0]])).tolist()
    [[1.0, 2.0, 3.0]]
    """
    return points if points.shape[-1] == 3 else points[..., :3] / points[..., 3:]


def _side(patch: np.ndarray, edge: int) -> np.ndarray:
    """The points of an edge; a view, to be written to."""
    return (patch[0], patch[:, 0], patch[-1], patch[:, -1])[edge]


def _points(patches: list[Patch], side: int) -> np.ndarray:
    return _side(patches[side // 4], side % 4)


def _corner(patch: np.ndarray, number: int) -> np.ndarray:
    return patch[-(number // 2), -(number % 2)]


def _ends(side: int) -> tuple[int, int]:
    """The corners 4 patch + corner in which a side begins and ends."""
    first, last = _ENDS[side % 4]
    return 4 * (side // 4) + first, 4 * (side // 4) + last


def _is_point(points: np.ndarray) -> bool:
    return bool(np.all(points == points[0]))


def _at_one_place(points: np.ndarray) -> bool:
    """Whether a side has no length; where weights are divided by, but for their rounding."""
    where = places(points)
    rounding = 0.0 if points.shape[1] == 3 else 8.0 * np.finfo(np.float64).eps * np.abs(where).max()
    return bool(np.abs(where - where[0]).max() <= rounding)


def _equal(patches: list[Patch], twin: Twin) -> bool:
    one, other = _points(patches, twin.owner), _points(patches, twin.other)
    return np.array_equal(one, other[::-1] if twin.backwards else other)


@dataclass(frozen=True, eq=False)
class _Corners:
    """Which corners become one point.

    place  : where they lie, each place once
    number : which of them each corner, 4 patch + corner, is at
    centre : to which of them it goes, at most the tolerance away
    """

    place: Float[np.ndarray, "places 3"]
    number: Int[np.ndarray, "corners"]
    centre: Int[np.ndarray, "corners"]

    @staticmethod
    def of(patches: list[Patch], tolerance: float) -> _Corners:
        with one_at_a_time:
            from scipy.spatial import KDTree  # slow to import

        place = places(np.array([_corner(patch, k) for patch in patches for k in range(4)])) + 0.0
        number = number_by_first_use(place)
        place = place[np.unique(number, return_index=True)[1]]
        tree, centre = KDTree(place), np.arange(len(place))
        crowded = np.flatnonzero(tree.query(place, 2, p=np.inf)[0][:, 1] <= tolerance).tolist()
        if crowded:
            apart = _apart(patches, number, tolerance)
            _find_centres(
                centre,
                crowded,
                lambda i: tree.query_ball_point(place[i], tolerance, p=np.inf, return_sorted=True),
                apart,
            )
        return _Corners(place, number, centre[number])

    def moved(self, point: np.ndarray, corner: int) -> np.ndarray:
        """The control point of a corner, once it has gone where it goes."""
        if self.centre[corner] == self.number[corner]:
            return point
        there = self.place[self.centre[corner]]
        return there if len(point) == 3 else np.append(there * point[3], point[3])


def _apart(patches: list[Patch], number: np.ndarray, tolerance: float) -> set[tuple[int, int]]:
    """Places that are the two ends of a side which would be next to nothing if they were one."""
    found = set()
    for side in range(4 * len(patches)):
        points = _points(patches, side)
        if not _at_one_place(points) and np.abs(places(points) - places(points[0])).max() <= 2.0 * tolerance:
            a, b = (int(number[corner]) for corner in _ends(side))
            found |= {(a, b), (b, a)}
    return found


def _find_centres(
    centre: np.ndarray, crowded: list[int], near: Callable[[int], list[int]], apart: set[tuple[int, int]]
) -> None:
    """Where places go, written to ``centre``: to the first of those near them that has not gone anywhere itself."""
    taken = set()
    for i in crowded:
        if i in taken:
            continue
        members = [i]
        for j in near(i):
            if j != i and j not in taken and not any((k, j) in apart for k in members):
                centre[j] = i
                members.append(j)
        taken.update(members)


def _twins(patches: list[Patch], corners: _Corners, tolerance: float, same_ratio: float) -> list[Twin]:
    """All twins, each with the owner of its curve, whose own degree is at most theirs."""
    meeting = defaultdict(list)
    for side in range(4 * len(patches)):
        if not _at_one_place(_points(patches, side)):
            meeting[tuple(sorted(corners.centre[list(_ends(side))].tolist()))].append(side)
    degrees = tuple(int(n) - 1 for n in np.max([patch.shape[:2] for patch in patches], axis=0))
    match = _Match(patches, corners, tolerance, same_ratio, _SAME_PLACE * size_of(patches), degrees)
    found = []
    for sides in meeting.values():
        rest = sorted(sides, key=lambda side: (len(_points(patches, side)), side))
        while len(rest) > 1:
            owner, *rest = rest
            twins = [match.twin(owner, side) for side in rest]
            found += [twin for twin in twins if twin is not None]
            rest = [side for side, twin in zip(rest, twins, strict=True) if twin is None]
    return found


@dataclass(frozen=True, eq=False)
class _Match:
    """Compares sides; ``degrees``: the highest along u and v, ``same_place``: so near rational twins have to agree."""

    patches: list[Patch]
    corners: _Corners
    tolerance: float
    same_ratio: float
    same_place: float
    degrees: tuple[int, ...]

    def twin(self, owner: int, side: int) -> Twin | None:
        """The side as the owner's twin, or None. Raises InputError for weights that cannot agree."""
        own, other = (_points(self.patches, k) for k in (owner, side))
        for backwards in (False, True):
            if np.array_equal(own, other[::-1] if backwards else other):
                return Twin(owner, side, backwards, 1.0)
        one = own.copy()
        for k, corner in zip((0, -1), _ends(owner), strict=True):
            one[k] = self.corners.moved(own[k], corner)
        one = elevate(one, len(other) - 1)
        for backwards in (False, True):
            turned = other[::-1] if backwards else other
            same_start = self.corners.centre[_ends(side)[int(backwards)]] == self.corners.centre[_ends(owner)[0]]
            if not same_start or np.abs(places(one) - places(turned)).max() > self.tolerance:
                continue
            ratio = self._ratio(one, turned)
            if ratio is not None:
                return Twin(owner, side, backwards, ratio)
            self._check_weights(owner, side, one, turned)
        return None

    def _ratio(self, one: np.ndarray, other: np.ndarray) -> float | None:
        """The weights of one over those of the other, if that is one number."""
        if one.shape[1] == 3:
            return 1.0
        ratios = one[:, 3] / other[:, 3]
        ratio = float(ratios[0])
        if np.max(np.abs(ratios / ratio - 1.0)) > self.same_ratio:
            return None
        return 1.0 if abs(ratio - 1.0) <= self.same_ratio else ratio

    def _check_weights(self, owner: int, side: int, one: np.ndarray, other: np.ndarray) -> None:
        """InputError if the sides have the same control points in the scene's common degree, but for the weights."""
        degree = self.degrees[1 - side % 2]  # edges 0 and 2 run along v
        apart = places(elevate(one, degree)) - places(elevate(other, degree))
        if owner % 2 == side % 2 and np.abs(apart).max() <= self.same_place:
            raise InputError(
                f"patches {owner // 4} and {side // 4} (counted from 0) have an edge in common ({EDGES[owner % 4]} and"
                f" {EDGES[side % 4]}), but its weights in one are no multiple of those in the other: reparametrise one"
                " of them"
            )


def _factors(count: int, twins: list[Twin], same_ratio: float) -> Float[np.ndarray, "patches"]:
    """What to multiply each patch by, 1 for the first one of every connected piece."""
    links = defaultdict(list)
    for owner, other, _, ratio in twins:
        links[owner // 4].append((other // 4, ratio))
        links[other // 4].append((owner // 4, 1.0 / ratio))
    factor = np.zeros(count)
    for start in range(count):
        if factor[start]:
            continue
        factor[start] = 1.0
        queue = deque([start])
        while queue:
            here = queue.popleft()
            for there, ratio in links[here]:
                wanted = factor[here] * ratio
                if not factor[there]:
                    factor[there] = wanted
                    queue.append(there)
                elif abs(factor[there] / wanted - 1.0) > same_ratio:
                    raise InputError(
                        f"the weights of patches {here} and {there} (counted from 0) cannot agree along their common"
                        " edge: going around through their neighbours another factor comes out; reparametrise them"
                    )
    return factor


def _made_equal(patches: list[Patch], twins: list[Twin], corners: _Corners) -> list[Patch]:
    """Patches whose twins have their owners' points, raised to their degree."""
    found = [patch.copy() for patch in patches]
    points = [side for side in range(4 * len(found)) if _is_point(_points(found, side))]
    for corner, point in _common_corners(patches, twins, points, corners):
        _corner(found[corner // 4], corner % 4)[:] = point
    for side in points:
        _points(found, side)[:] = _points(found, side)[0]
    for owner, other, backwards, _ in twins:
        own = _points(found, other)
        raised = elevate(_points(found, owner), len(own) - 1)
        own[:] = raised[::-1] if backwards else raised
    return found


def _common_corners(
    patches: list[Patch], twins: list[Twin], points: list[int], corners: _Corners
) -> list[tuple[int, np.ndarray]]:
    """The corners of twins and the point that each gets: that of the corner, among those it is one with, at the centre.

    points : sides that are points, whose two ends are one
    """
    links = [_ends(side) for side in points]
    for owner, other, backwards, _ in twins:
        links += zip(_ends(owner), _ends(other)[:: -1 if backwards else 1], strict=True)
    one, two = np.array(links).T
    _, place = connected(4 * len(patches), one, two)
    away = corners.centre != corners.number
    order = np.lexsort((away, place))  # stable: the first at the centre
    first = order[np.unique(place[order], return_index=True)[1]]
    wanted = {int(place[corner]): corner for corner in first}
    found = []
    for corner in np.unique([one, two]).tolist():
        source = int(wanted[int(place[corner])])
        found.append((corner, corners.moved(_corner(patches[source // 4], source % 4), source)))
    return found


def _said(before: list[Patch], after: list[Patch], twins: list[Twin], tolerance: float) -> tuple[str, ...]:
    """How many sides were moved, and by how much at most."""
    sides = {side for twin in twins for side in (twin.owner, twin.other)}
    moved = [side for side in sides if not np.array_equal(_points(before, side), _points(after, side))]
    if not moved:
        return ()
    most = max(float(np.abs(places(_points(before, s)) - places(_points(after, s))).max()) for s in moved)
    return (
        f"{len(moved)} sides within {tolerance:.2g} of their neighbours' were welded to them: control points moved by"
        f" {most:.2g} at most",
    )
