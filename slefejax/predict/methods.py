"""The methods for tessellation factors by name, as values, and what can be asked of ``tessellation_factors``.

A method is a value with exactly the numbers that it has: ``Certified(tiles=3)``, ``Slefe(segments=4, k=0.9)``,
``EdgeLength(12.0)``. ``tessellation_factors(…, method="certified", tiles=3)`` makes such a value. A method of one's own
is any value with ``prepare`` and ``factor`` (``predict.kernel.Method``), and ``"my_module:MyMethod"`` is its name.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, NamedTuple, TypedDict

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.lax import stop_gradient

from slefejax.arguments import (
    Number,
    Patches,
    Segments,
    check_choice,
    check_degrees,
    check_positive,
    check_temperature,
    check_whole,
    did_you_mean,
    imported,
    no_such,
    segment_pair,
)
from slefejax.errors import InputError
from slefejax.geometry.projection import Projection, harmless, positive
from slefejax.lanes import loops
from slefejax.lanes.maxima import Maxima, maxima_of
from slefejax.lanes.plain import plain
from slefejax.predict.certified import certified_factors
from slefejax.predict.estimate import Boxes, Scales, factor_of_boxes, slefe_factor, slefe_factors
from slefejax.predict.kernel import Kernel, Method, Prepared, Tolerances
from slefejax.predict.rules import EdgeLength, Filip, Fixed, Minmax, ScreenBox
from slefejax.tessellator.rings import Pattern, direct3d11

LEVELS = ("fast", "fewest")
_ORIGIN_BITS = 8  # of an origin's coordinates: poses that are nearly the same have the same

Name = Literal["certified", "slefe", "filip", "minmax", "edge-length", "screen-box", "fixed"]


@plain("smooth")
@dataclass(frozen=True)
class Certified(Kernel):
    """A bound with a proof (docs/certified.md): no visible point errs more, uniformly cut and as it is drawn.

    tiles       : into how many pieces along u and along v a patch is cut to bound it. More are tighter and cost more,
                  tiles^2; 1 is the cheapest. Static
    anisotropic : levels differ along u and v where that saves triangles
    verify      : smaller whole numbers are proved cell by cell, which is slower and tighter, for factors up to 128
    levels      : how levels are found that can be drawn: ``"fast"``, at about the price of the factors, or
                  ``"fewest"``: patches choose with their neighbours, which takes longer
    smooth      : a temperature, 0 < smooth <= 1, or None. Maxima become soft ones, never smaller
    pattern     : how the tessellator makes transition rings; None: as Direct3D 11 says

    >>> Certified(tiles=3).label
    'certified tiles=3'
    """

    name = "certified"
    takes_depth = True
    takes_gregory = True
    tiles: int = 2
    anisotropic: bool = False
    verify: bool = False
    levels: Literal["fast", "fewest"] = "fast"
    smooth: Number | None = None
    pattern: Pattern | None = None

    def check(self, dimension: int, tolerances: Tolerances) -> None:
        """InputError for numbers out of their range, and for a temperature of whole numbers."""
        for name in ("anisotropic", "verify"):
            value = getattr(self, name)
            if not isinstance(value, (bool, np.bool_)):
                raise InputError(f"{name} must be True or False, not {value!r}", options=(name,))
        check_whole("tiles", self.tiles, 1)
        check_choice("levels", self.levels, LEVELS)
        if self.pattern is not None and not isinstance(self.pattern, Pattern):
            raise InputError(f"pattern must be a slefejax.tessellator.rings.Pattern, not {type(self.pattern).__name__}")
        if self.smooth is not None and self.whole:
            raise InputError(
                "smooth is of real factors: anisotropic and verify find whole numbers without it",
                options=("smooth", "anisotropic", "verify"),
            )
        check_temperature(self.smooth)

    @property
    def whole(self) -> bool:
        """Whether whole numbers are asked for, which have no derivatives."""
        return bool(self.anisotropic or self.verify)

    @property
    def real(self) -> Certified:
        """The same for real factors."""
        return replace(self, anisotropic=False, verify=False)

    @property
    def maxima(self) -> Maxima:
        """Soft ones of the temperature, or exact ones."""
        return maxima_of(self.smooth)

    @property
    def drawn_with(self) -> Pattern:
        """The pattern of the tessellator."""
        return self.pattern or direct3d11()

    @property
    def formula(self) -> Certified:
        """Tiles and temperature."""
        return Certified(tiles=int(self.tiles), smooth=self.smooth)

    @property
    def label(self) -> str:
        """The name, and tiles if there are not two."""
        return self.name if self.tiles == 2 else f"{self.name} tiles={self.tiles}"

    def left_out(self, tolerances: Tolerances) -> tuple[str, ...]:
        """A sentence for what was not asked for."""
        return (*_no_depth(tolerances), *super().left_out(tolerances))

    def over(self, seen: tuple[Any, Any, Any], projection: Projection, tolerances: Tolerances) -> Any:
        """Of all chunks at once: derivatives have loops of their own (``slefejax.predict.certified``)."""
        factor: Any = certified_factors(seen[0], projection, tolerances, self.maxima, tiles=self.tiles)
        fine = loops.over_chunks(_harmless_over_scales, seen[0], projection, *tolerances)
        return jnp.where(fine, factor, jnp.nan)


@plain("k", "smooth")
@dataclass(frozen=True)
class Slefe(Kernel):
    """The published estimate: k m sqrt(w / tolerance), with w the width in pixels of the slefe boxes on the screen.

    [YBP12], (7) to (10); [YBP14], (7). It is not a bound. For rational patches w is the width of the slefe of X - s W
    over W (docs/math.md, 6).

    segments : m, or (m_u, m_v); static
    k        : the constant k_m
    smooth   : a temperature, 0 < smooth <= 1, or None. Maxima become soft ones, never smaller

    >>> Slefe(segments=4, k=0.9).label
    'slefe m=4 k=0.9'
    """

    name = "slefe"
    takes_depth = True
    segments: Segments = 3
    k: Number = 1.0
    smooth: Number | None = None

    def check(self, dimension: int, tolerances: Tolerances) -> None:
        """InputError for numbers out of their range."""
        segment_pair(self.segments)
        check_positive("k", self.k)
        check_temperature(self.smooth)

    @property
    def maxima(self) -> Maxima:
        """Soft ones of the temperature, or exact ones."""
        return maxima_of(self.smooth)

    @property
    def formula(self) -> Slefe:
        """With a pair of segments."""
        return replace(self, segments=segment_pair(self.segments))

    @property
    def label(self) -> str:
        """Such as ``slefe m=3``."""
        pair = segment_pair(self.segments)
        constant = "" if self.k == 1.0 else f" k={self.k:g}"
        return f"{self.name} m={pair[0] if pair[0] == pair[1] else pair}{constant}"

    def left_out(self, tolerances: Tolerances) -> tuple[str, ...]:
        """A sentence for what was not asked for."""
        return _no_depth(tolerances)

    def prepare(self, patches: Patches, /) -> Prepared:
        """Slefe boxes, as rounding leaves them, relative to a place near the patches."""
        packed = Prepared.of(patches).packed
        self.check_kind(packed)
        first = stop_gradient(packed.chunks[0, 0, 0, :, 0])  # boxes depend on no origin
        xp = jnp if isinstance(first, Tracer) else np
        first = first[:3] / (first[3] if packed.dimension == 4 else 1.0)
        digits, power = xp.frexp(xp.where(xp.isfinite(first), first, xp.zeros_like(first)))
        origin = xp.ldexp(xp.round(digits * 2.0**_ORIGIN_BITS), power - _ORIGIN_BITS).astype(packed.dtype)
        return Prepared(packed, Boxes.of(packed.chunks, origin, segment_pair(self.segments), self.maxima))

    def over(self, seen: tuple[Any, Any, Any], projection: Projection, tolerances: Tolerances) -> Any:
        """Of boxes that are there, or that are made on the way."""
        packed, lower, _ = seen
        segments, scales = segment_pair(self.segments), Scales(*tolerances, self.k)
        if lower is not None:
            kernel = partial(_from_boxes, segments=segments)
            return loops.over_chunks(kernel, (*seen[1:], packed), projection, scales, self.maxima)
        if packed.shape[3] == 3 and self.smooth is None:
            return slefe_factors(packed, projection, scales, segments=segments)
        return slefe_factor(packed, projection, scales, self.maxima, segments=segments)


METHODS: dict[str, type[Kernel]] = {
    own.name: own for own in (Certified, Slefe, Filip, Minmax, EdgeLength, ScreenBox, Fixed)
}


class Knobs(TypedDict, total=False):
    """Numbers of the methods, by their names there; None stands for what the method takes by itself."""

    tiles: int | None
    anisotropic: bool | None
    verify: bool | None
    levels: Literal["fast", "fewest"] | None
    segments: Segments
    k: Number | None
    setting: Number | None
    smooth: Number | None
    pattern: Pattern | None


class Options(Knobs, total=False):
    """What ``tessellation_factors`` is asked for besides patches and a view."""

    method: Name | Method | str
    tolerance: Number
    depth_tolerance: Number | None
    normal_tolerance: Number | None
    normals: Literal["surface", "tangents"]


class Request(NamedTuple):
    """The same as values: a method, what errors are allowed, and how far normals may be off, in degrees or None.

    >>> Request.of({"method": "filip", "tolerance": 1.0}).tolerances.pixels
    1.0
    """

    method: Any
    tolerances: Tolerances
    normal_tolerance: Any = None

    @staticmethod
    def of(options: Mapping[str, Any], dimension: int = 3) -> Request:
        """From ``Options``, for control points of that dimension. Raises InputError for what makes no sense."""
        knobs = {name: value for name, value in options.items() if name not in _ASKED}
        method = method_of(options.get("method", "certified"), knobs)
        tolerances = Tolerances(options.get("tolerance", 0.5), options.get("depth_tolerance"))
        check_positive("tolerance", tolerances.pixels)
        if tolerances.depth is not None:
            check_positive("depth_tolerance", tolerances.depth)
        if isinstance(method, Kernel):
            method.check(dimension, tolerances)
        degrees = options.get("normal_tolerance")
        if degrees is not None:
            _check_takes_normals(method)
            check_degrees("normal_tolerance", degrees)
        return Request(method, tolerances, degrees)

    def at(self, tolerance: Any) -> Request:
        """The same with another tolerance in pixels."""
        return self._replace(tolerances=self.tolerances._replace(pixels=tolerance))

    @property
    def real(self) -> Request:
        """The same for real factors, which have derivatives."""
        return self._replace(method=self.method.real) if isinstance(self.method, Certified) else self

    @property
    def name(self) -> str:
        """Of the method."""
        return name_of(self.method)

    def left_out(self) -> tuple[str, ...]:
        """What is not computed because it was not asked for, a sentence each."""
        found = self.method.left_out(self.tolerances) if isinstance(self.method, Kernel) else ()
        asked = self.normal_tolerance is not None or not isinstance(self.method, Certified)
        return found if asked else ("normals: no normal tolerance was given", *found)


_ASKED = ("method", "tolerance", "depth_tolerance", "normal_tolerance", "normals")


def _check_takes_normals(method: Any) -> None:
    if not isinstance(method, Certified):
        said = f"method {name_of(method)!r} knows no normal_tolerance: 'certified' does"
        raise InputError(said, options=("normal_tolerance", "method"))


def name_of(method: Any) -> str:
    """The name of a method, of one's own too.

    >>> name_of(Filip())
    'filip'
    """
    return str(getattr(method, "name", type(method).__name__))


def label_of(method: Any) -> str:
    """The name of a method with its numbers, for legends and tables.

    >>> label_of(EdgeLength(12.0))
    'edge-length 12'
    """
    return str(getattr(method, "label", name_of(method)))


def method_of(method: Any, knobs: Mapping[str, Any] | None = None) -> Method:
    """A method from its name and its numbers, or as it is. Numbers that are None are as if they were not given.

    Raises InputError for a name that there is not, for a number that the method does not have, and for a value that is
    no method.

    >>> method_of("slefe", {"segments": 4})
    Slefe(segments=4, k=1.0, smooth=None)
    """
    given = {name: value for name, value in (knobs or {}).items() if value is not None}
    unknown = [name for name in knobs or {} if name not in Knobs.__annotations__]
    if isinstance(method, str):
        made = _named(method)
        if not isinstance(made, type):
            return method_of(made, given)
        return _made(made, method, given, unknown)
    if isinstance(method, type) and issubclass(method, Kernel):
        raise InputError(f"the method is a class: give a value, such as {method.__name__}()")
    if not isinstance(method, Method) or isinstance(method, type):
        raise InputError(no_such("method", method, METHODS))
    if given or unknown:
        name = next(iter(given or unknown))
        raise InputError(f"the method is a value with its numbers, {method!r}: give {name} to it", options=(name,))
    return method


def _named(name: str) -> Any:
    if ":" not in name:
        if name not in METHODS:
            raise InputError(no_such("method", name, METHODS))
        return METHODS[name]
    return imported(name, "method")


def _made(cls: type, name: str, given: dict[str, Any], unknown: list[str]) -> Any:
    """A value of a class with these numbers."""
    has = [own for own in inspect.signature(cls).parameters if own != "self"]
    for own in unknown:
        if own not in has:
            raise InputError(f"there is no option {own!r}{did_you_mean(own, [*Options.__annotations__, *has])}")
    for own in given:
        if own not in has:
            listed = f"its own are {', '.join(has)}" if has else "it has nothing to set"
            raise InputError(f"method {name!r} has no {own}: {listed}", options=(own,))
    found = cls(**given)
    if not isinstance(found, Method):
        raise InputError(f"{name} is no method: it needs prepare(patches) and factor(prepared, view, tolerances)")
    return found


def _no_depth(tolerances: Tolerances) -> tuple[str, ...]:
    return ("depth widths: no depth tolerance was given",) if tolerances.depth is None else ()


def _from_boxes(seen: Any, projection: Projection, scales: Scales, maxima: Maxima, segments: tuple[int, int]) -> Any:
    lower, upper, control = seen
    # boxes of control points that are not finite are not finite either
    fine = harmless(lower, projection) & harmless(upper, projection)
    if control is not None:
        fine &= positive(control)
        control = projection.relative(control)
    factor = factor_of_boxes((lower, upper), control, projection, scales, maxima, segments)
    return jnp.where(fine, factor, jnp.nan)


def _harmless_over_scales(control: Any, projection: Projection, *scales: Any) -> Any:
    """The same where control points are divided by each of these scales too."""
    fine = harmless(control, projection) & positive(control)
    for scale in scales:
        if scale is not None:
            fine &= harmless(control, projection, scale)
    return fine
