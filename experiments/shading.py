"""Normals that have to be right: the options for them, whose they are, and what to say of patches that have none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Array, Bool

from slefejax import Scene
from slefejax.errors import InputError
from slefejax.predict.methods import Certified, Options, Request

FOR_CERTIFIED = "the tolerance for normals is for certified and minimal factors alone: no other method looks at normals"
_NAMED = 5  # patches that a note names


@dataclass(frozen=True)
class ShadingOptions:
    """Which normals have to be right, and how far they may be off."""

    normal_tolerance: float | None = None
    """Of certified: angle in degrees that is allowed between interpolated and exact normals; not looked at if not
    given."""
    normals: Literal["surface", "tangents"] = "surface"
    """Which normals --normal-tolerance is for, and render draws: the surface's own, or those of tangent patches, which
    control meshes have."""

    @property
    def degrees(self) -> float | None:
        """The tolerance. Raises InputError where normals are chosen without one."""
        if self.normal_tolerance is None and self.normals != "surface":
            raise InputError("--normals says which normals --normal-tolerance is for: give that, too")
        return self.normal_tolerance

    def arguments(self) -> Options:
        """Keyword arguments for tessellation_factors, but for the tangent patches."""
        return {"normal_tolerance": self.degrees, "normals": self.normals}

    def check(self) -> None:
        """Raise InputError for an angle that is none."""
        Request.of(self.arguments())

    def of(self, scene: Scene) -> Shaded:
        """The same for a scene. Raises InputError for one without tangent patches, where these are asked for."""
        return Shaded(self.degrees, self.normals, scene.tangents() if self.normals == "tangents" else None)


@dataclass(frozen=True, eq=False)
class Shaded:
    """Which normals of a scene have to be right.

    degrees  : how far they may be off;  None: normals are not looked at
    normals  : "surface" or "tangents";  tangents : tangent patches, where normals are theirs
    """

    degrees: float | None = None
    normals: Literal["surface", "tangents"] = "surface"
    tangents: Any = None

    def __bool__(self) -> bool:
        return self.degrees is not None

    @property
    def kind(self) -> tuple[str, Any]:
        """Which normals, as functions that measure take them."""
        return self.normals, self.tangents

    @property
    def drawn(self) -> dict[str, Any]:
        """Keyword arguments for ``Renderer``."""
        return {"normals": self.normals, "tangents": self.tangents} if self else {}

    def asked(self, method: Any) -> dict[str, Any]:
        """Keyword arguments for ``tessellation_factors`` and ``minimal_factors``; none for methods without normals."""
        if not self or not isinstance(method, Certified):
            return {}
        return {"normal_tolerance": self.degrees, "normals": self.normals, "tangents": self.tangents}

    def moved(self, tangents: Any) -> Shaded:
        """In another pose, with its tangent patches."""
        return Shaded(self.degrees, self.normals, tangents)

    def some(self, which: np.ndarray) -> Shaded:
        """Of some of the patches."""
        return self.moved(None if self.tangents is None else tuple(np.asarray(net)[which] for net in self.tangents))


def both_tolerances(pixels: float, degrees: float | None) -> str:
    """Tolerances as titles say them.

    >>> both_tolerances(0.5, None), both_tolerances(0.5, 1.0)
    ('0.5 px', '0.5 px and 1°')
    """
    return f"{pixels:g} px" + ("" if degrees is None else f" and {degrees:g}°")


def unclaimed(without: Bool[Array | np.ndarray, "patches"] | None) -> tuple[str, ...]:
    """A sentence about patches that are seen and whose normals have no claim, if there are some.

    without : of ``Factors``

    >>> unclaimed(np.array([False, True, False, True]))
    ('normals of 2 seen patches have no claim, as some points have none, or nearly: patches 1, 3 (counted from 0)',)
    """
    return unclaimed_numbers(numbers_without(without))


def numbers_without(without: Bool[Array | np.ndarray, "patches"] | None) -> list[int]:
    """The numbers of these patches; none where normals are not looked at."""
    return [] if without is None else np.flatnonzero(np.asarray(without)).tolist()


def unclaimed_numbers(numbers: Sequence[int]) -> tuple[str, ...]:
    """The same of the patches' numbers."""
    if not numbers:
        return ()
    patches = "patch" if len(numbers) == 1 else "patches"
    listed = ", ".join(map(str, numbers[:_NAMED])) + (" …" if len(numbers) > _NAMED else "")
    return (
        f"normals of {len(numbers)} seen {patches} have no claim, as some points have none, or nearly:"
        f" {patches} {listed} (counted from 0)",
    )
