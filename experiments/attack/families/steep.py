"""Families of control nets whose normals turn far in little room, or hardly exist: seeded, of a size about 1.

Half of them are turned any way.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from slefejax import GregoryPatches
from slefejax.experiments.attack.families.nets import SHAPES, Net, Rng, Shape, plane
from slefejax.experiments.attack.families.shaded import shaded_nets
from slefejax.geometry.gregory import QUAD_TWISTS, TRIANGLE_TWISTS

_SIDES = (0, slice(None)), (slice(None), 0), (-1, slice(None)), (slice(None), -1)


def _bent(rng: Rng, du: int, dv: int) -> Net:
    """Around a cylinder, by 20 to 170 degrees; half of them uneven."""
    net = plane(du, dv)
    angle = np.deg2rad(rng.uniform(20.0, 170.0)) * net[..., 0]
    bent = np.stack([np.sin(angle), net[..., 1], np.cos(angle)], axis=2)
    return bent + 0.1 * rng.integers(0, 2) * rng.normal(size=net.shape)


def _pole(rng: Rng, du: int, dv: int) -> Net:
    """One or two sides that are points, or so small that they are nearly."""
    net = plane(du, dv) + 0.3 * _relief(rng) * rng.normal(size=(du + 1, dv + 1, 3))
    small = 10.0 ** rng.uniform(-11.0, -1.0) * rng.integers(0, 2)
    for k in rng.permutation(4)[: rng.integers(1, 3)]:
        side = net[_SIDES[k]].copy()
        net[_SIDES[k]] = side[:1] + small * (side - side[:1])
    return net


def _near_cusp(rng: Rng, du: int, dv: int) -> Net:
    """Derivatives along u that are nearly 0 on one side."""
    net = plane(du, dv) + 0.2 * _relief(rng) * rng.normal(size=(du + 1, dv + 1, 3))
    net[1] = net[0] + 10.0 ** rng.uniform(-4.0, -0.5) * (net[1] - net[0])
    return net


def _thin(rng: Rng, du: int, dv: int) -> Net:
    """A thousand times as long as wide."""
    sizes = [0.1, 1e-4, 10.0 ** rng.uniform(-4.0, -1.0)]
    return plane(du, dv) * [1.0, 1e-3, 1.0] + sizes * rng.normal(size=(du + 1, dv + 1, 3))


def _relief(rng: Rng) -> float:
    return 10.0 ** rng.uniform(-3.0, 0.7)


STEEP: dict[str, Shape] = {"bent": _bent, "pole": _pole, "near-cusp": _near_cusp, "thin": _thin}
STEEP_RATIONAL = "steep-rational"
SPUN = {"spun": 3, "spun-pinched": 4}  # degrees of Gregory patches' nets: of quads, of triangles
TANGENTS = "tangents"
STEEP_FAMILIES = (*STEEP, STEEP_RATIONAL, TANGENTS, *SPUN)


def steep_nets(family: str, rng: Rng, degrees: tuple[int, int], count: int) -> Any:
    """So many nets ``(n, du+1, dv+1, 3)``; 4 at the end of ``steep-rational`` ones, with weights over up to 3 decades.

    These, and ``tangents``, take their shapes from the other families here, and from those of ``nets`` with a relief of
    their own.
    """
    if family in SPUN:
        return _spun(SPUN[family], rng, count)
    names = [family] * count if family in STEEP else rng.choice([*STEEP, *SHAPES], count)
    made = np.stack([_placed(name, rng, *degrees) for name in names])
    if family in STEEP:
        return made
    if family == TANGENTS:
        return shaded_nets(rng, made)
    decades = rng.choice([0.2, 1.0, 3.0], (count, 1, 1, 1))
    weights = 10.0 ** (rng.uniform(-0.5, 0.5, (*made.shape[:3], 1)) * decades)
    return np.concatenate([made * weights, weights], axis=3)


def _placed(name: str, rng: Rng, du: int, dv: int) -> Net:
    net = STEEP[name](rng, du, dv) if name in STEEP else plane(du, dv) + _relief(rng) * SHAPES[name](rng, du, dv)
    return net @ np.linalg.qr(rng.normal(size=(3, 3)))[0] if rng.integers(2) else net


def _spun(degree: int, rng: Rng, count: int) -> GregoryPatches:
    """Sheets, some flat, with twists of any size and direction, half of them along the sheet; triangles are pinched."""
    made = [
        plane(degree, degree) + _relief(rng) * 0.3 * rng.normal(size=(degree + 1, degree + 1, 3)) for _ in range(count)
    ]
    net, slots = np.stack(made), QUAD_TWISTS if degree == 3 else QUAD_TWISTS + TRIANGLE_TWISTS
    sizes = 10.0 ** rng.uniform(-4.0, 0.0, (count, 1)) * rng.integers(0, 2, (count, slots))
    if degree != 3:
        net[:, -1] = net[:, -1:, 0]
        sizes[:, :QUAD_TWISTS] = 0.0
    twists = sizes[..., None] * rng.normal(size=(count, slots, 3))
    twists[:, :, 2] *= rng.integers(0, 2, (count, 1))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0] if rng.integers(2) else np.eye(3)
    return GregoryPatches(net @ turn, twists @ turn)
