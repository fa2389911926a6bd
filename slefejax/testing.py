"""Assertions for your own pytest checks; a failure names the worst offender.

>>> from slefejax import slefe
>>> from slefejax.geometry.bezier import evaluate_curve
>>> curve = np.array([0.0, -1.0, 1.0, 0.0])
>>> assert_encloses(*slefe(curve, 3), lambda t: evaluate_curve(curve, t))
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from slefejax.geometry.view import View
from slefejax.measure.error import drawn_error


def assert_encloses(
    lower: Any, upper: Any, function: Callable[..., Any], *, parameters: int = 1, samples: int = 201, slack: float = 0.0
) -> None:
    """Assert that breakpoint values enclose a function, between the breakpoints too (by dense samples).

    lower, upper : ``(m+1, *rest)``, or ``(m_u+1, m_v+1, *rest)`` with ``parameters=2``; linear (bilinear) in between
    function     : of t in [0, 1] (of u and v), numbers; returns ``rest``
    samples      : along each parameter, spread evenly, ends included
    slack        : how far outside a value may lie; rounding of the size of the largest value is always forgiven

    Raises AssertionError that names the parameter, the entry, the value and the bound that it passes the furthest.
    """
    lower, upper = np.asarray(lower, np.float64), np.asarray(upper, np.float64)
    assert lower.shape == upper.shape, f"lower and upper differ in shape: {lower.shape} and {upper.shape}"
    forgiven = slack + 64 * np.finfo(np.float64).eps * float(np.max(np.abs([lower, upper])))
    worst: tuple[float, str] = (-np.inf, "")
    axes = [np.linspace(0, 1, samples)] * parameters
    for at in np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, parameters):
        value = np.asarray(function(*at), np.float64)
        for name, excess in (("below lower", _at(lower, at) - value), ("above upper", value - _at(upper, at))):
            most = np.unravel_index(int(np.argmax(np.where(np.isnan(excess), np.inf, excess))), np.shape(excess))
            if not excess[most] <= worst[0]:
                place = ", ".join(f"{t:.6g}" for t in at)
                entry = f", entry {tuple(map(int, most))}" if most else ""
                worst = (
                    float(excess[most]),
                    f"value {value[most]:.17g} at ({place}){entry} lies {excess[most]:.3g} {name}",
                )
    assert worst[0] <= forgiven, f"not enclosed: {worst[1]}; {forgiven:.3g} would be forgiven"


def assert_pixel_accurate(patches: Any, view: View, seen: Any, *, tolerance: float = 0.5, share: float = 0.0) -> None:
    """Assert that the covered pixels of a picture are right to within ``tolerance`` pixels ([YBP12], (1)).

    patches : control points ``(patches, du+1, dv+1, 3)``, or 4 at the end if rational
    seen    : what was rendered from them in this view, a ``slefejax.gpu.GBuffer`` or anything with ``.u``, ``.v`` and
              ``.patch``, each ``(height, width)``, and ``.drawn`` if not all of it was drawn at the pixels' centres
    share   : of the covered pixels may be worse

    Raises AssertionError that names the worst pixel, its patch and parameters, and how many are too far off.
    """
    error = drawn_error(np.asarray(patches), view, seen)
    covered = np.count_nonzero(np.isfinite(error))
    assert covered, "the picture is empty: no pixel is covered, so none is accurate"
    bad = np.count_nonzero(error > tolerance)
    row, column = np.unravel_index(int(np.nanargmax(error)), error.shape)
    place = f"pixel ({column}, {row}), {error[row, column]:.4g} px off, from patch {seen.patch[row, column]}"
    assert bad <= share * covered, (
        f"{bad} of {covered} covered pixels are off by more than {tolerance:g} px; the worst is {place}"
        f" at u = {seen.u[row, column]:.6g}, v = {seen.v[row, column]:.6g}"
    )


def _at(breakpoints: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """The piecewise-linear function with these breakpoint values, one parameter an axis."""
    for t in parameters:
        segments = breakpoints.shape[0] - 1
        i = min(int(t * segments), segments - 1)
        breakpoints = (1 - (t * segments - i)) * breakpoints[i] + (t * segments - i) * breakpoints[i + 1]
    return breakpoints
