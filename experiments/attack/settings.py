"""How a batch of ``slefejax attack`` asks for factors, and what of the answer is judged."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, NamedTuple

import jax
import numpy as np

from slefejax import Camera, Factors, InputError, View, tessellation_factors
from slefejax.experiments.attack.families.nets import GAUSSIAN, GREGORY
from slefejax.experiments.attack.families.products import ProductNets
from slefejax.experiments.attack.families.shaded import Shaded
from slefejax.experiments.attack.families.steep import STEEP_FAMILIES
from slefejax.experiments.attack.judge.screen import Look
from slefejax.experiments.attack.views import view_of
from slefejax.predict.methods import Certified


class Tolerances(NamedTuple):
    """Of pixels, of window depth and of normals in degrees; None: there is none."""

    pixels: float
    depth: float | None = None
    degrees: float | None = None


@dataclass(frozen=True)
class Setting:
    """One way to ask.

    options : keyword arguments of ``tessellation_factors``
    judged  : ``uniform`` grids of n = ceil(factor) ... + 3; ``drawn``: the tessellator's triangles for ``.inner`` and
              ``.edges``; ``climb``: uniform grids of nets that are moved towards the worst ratio
    dtype   : of the control points;  double : whether JAX computes in double precision
    depth   : whether window depth is held to a tolerance too
    normals : whether normals are held to a tolerance, and judged instead of positions
    traced  : whether patches, view and tolerance are traced
    patches : of a batch
    claims  : of uniform grids: with different tolerances, of every view
    most    : factors beyond are left out, since they only take time: another patch of the batch takes the place
    levels  : what one of the patches in each view just needs
    share   : which one: so many of the factors, 0 to 1, are below
    """

    name: str
    options: dict[str, Any] = field(default_factory=dict)
    judged: str = "uniform"
    dtype: Any = np.float64
    double: bool = True
    depth: bool = False
    normals: bool = False
    traced: bool = False
    patches: int = 32
    claims: int = 3
    levels: tuple[float, float] = (2.0, 40.0)
    share: tuple[float, float] = (0.4, 0.9)
    most: float = np.inf

    @property
    def single(self) -> bool:
        """Whether kernels run in single precision."""
        return not self.double or self.dtype == np.float32

    @property
    def plain(self) -> Setting:
        """The same without what only costs time where a factor is asked for to find a tolerance."""
        slow = ("verify", "anisotropic")
        return replace(self, options={name: value for name, value in self.options.items() if name not in slow})

    @property
    def hidden(self) -> bool:
        """Whether a claim on normals is one where points are not seen, too: not of levels, which are found by sight."""
        return self.judged != "drawn" and not self.options.get("verify")

    def takes(self, family: str) -> bool:
        """Whether nets of a family can be asked about; steep ones are for normals, Gregory patches for positions."""
        others = (*GREGORY, GAUSSIAN) if self.normals else STEEP_FAMILIES
        return family not in others

    def precision(self) -> AbstractContextManager:
        """JAX as this setting has it."""
        return jax.enable_x64(self.double)


_DRAWN: dict[str, Any] = {"judged": "drawn", "levels": (4.0, 64.0), "share": (0.8, 1.0), "most": 200.0}
_SMALL: dict[str, Any] = {"levels": (1.0, 8.0), "share": (0.5, 1.0), "most": 30.0}
_PROVED: dict[str, Any] = {"patches": 8, "claims": 1, "levels": (2.0, 12.0), "most": 20.0}
_NORMALS: dict[str, Any] = {"normals": True, "claims": 1}
SETTINGS = {
    setting.name: setting
    for setting in (
        Setting("tiles-1", {"tiles": 1}),
        Setting("tiles-2"),
        Setting("tiles-4", {"tiles": 4}),
        Setting("depth", depth=True),
        Setting("float32", dtype=np.float32),
        Setting("x64-off", double=False),
        Setting("traced", {"tiles": 1}, traced=True),
        Setting("traced-float32", {"tiles": 1}, dtype=np.float32, traced=True),
        Setting("smooth", {"tiles": 1, "smooth": 0.05}),
        Setting("verify", {"tiles": 1, "verify": True}, **_PROVED),
        Setting("climb", {"tiles": 1}, "climb", patches=16, levels=(6.0, 24.0)),
        Setting("drawn", {"tiles": 1}, **_DRAWN),
        Setting("drawn-tiles-2", **_DRAWN),
        Setting("drawn-anisotropic", {"tiles": 1, "anisotropic": True}, patches=16, **_DRAWN),
        Setting("drawn-verify", {"tiles": 1, "verify": True}, "drawn", **_PROVED),
        Setting("drawn-fewest", {"tiles": 1, "levels": "fewest"}, **_DRAWN),
        Setting("drawn-small", {}, "drawn", **_SMALL),
        Setting("drawn-small-fewest", {"levels": "fewest", "anisotropic": True}, "drawn", **_SMALL),
        Setting("drawn-float32", {"tiles": 1}, dtype=np.float32, **_DRAWN),
        Setting("normals", **_NORMALS),
        Setting("normals-tiles-1", {"tiles": 1}, **_NORMALS),
        Setting("normals-float32", dtype=np.float32, **_NORMALS),
        Setting("normals-verify", {"tiles": 1, "verify": True}, normals=True, **_PROVED),
        Setting("normals-drawn", normals=True, **_DRAWN),
        Setting("normals-drawn-fewest", {"levels": "fewest", "anisotropic": True}, normals=True, **_DRAWN),
        Setting("drawn-past-64", {"tiles": 1}, "drawn", patches=12, levels=(57.0, 64.0), share=(0.5, 0.9), most=200.0),
    )
}


def predicted(
    patches: Any,
    look: Look,
    setting: Setting,
    tolerances: Tolerances,
    edge_numbers: np.ndarray | None = None,
) -> Factors | None:
    """What is claimed, or None where it is refused in words. Levels are asked for where edges are given."""
    method = Certified(**setting.options)
    patches, shading = _asked(patches)
    try:
        with setting.precision():
            if setting.traced:
                return _traced(patches, look, setting, tolerances.pixels)
            found = tessellation_factors(
                patches,
                view_of(look),
                method,
                tolerance=tolerances.pixels,
                depth_tolerance=tolerances.depth,
                normal_tolerance=tolerances.degrees,
                edge_numbers=edge_numbers,
                **shading,
            )
            if edge_numbers is not None:
                _ = found.inner
            return found
    except InputError:
        return None


def _asked(patches: Any) -> tuple[Any, dict[str, Any]]:
    """Patches as the package takes them, and how it is told which normals they have."""
    if isinstance(patches, Shaded):
        return patches.net, patches.normals()
    return patches.patches() if isinstance(patches, ProductNets) else patches, {}


def _traced(patches: Any, look: Look, setting: Setting, tolerance: float) -> Factors | None:
    """Real factors from inside of jit, where what is refused elsewhere is not a number."""
    numbers = [np.asarray(x, np.float64) for x in (*look[:6], *look[7:])]
    factor = _program(look.perspective, Certified(**setting.options))(patches, numbers, tolerance)
    return Factors(factor) if np.isfinite(factor).all() else None


@cache
def _program(perspective: bool, method: Certified) -> Callable[..., Any]:
    @jax.jit
    def factor(patches: Any, numbers: list[Any], tolerance: Any) -> Any:
        *camera, width, height = numbers
        make = Camera.look_at if perspective else Camera.orthographic
        return tessellation_factors(patches, View(make(*camera), width, height), method, tolerance=tolerance).factor

    return factor
