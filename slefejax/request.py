"""What can be asked of ``slefejax.tessellation_factors``, checked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jax.core import Tracer

from slefejax.arguments import Number, Segments, check_choice, check_positive, check_whole, segment_pair
from slefejax.errors import InputError
from slefejax.rings import Pattern, direct3d11
from slefejax.rules import RULES, SETTINGS

METHODS = ("certified", "slefe", *RULES)


@dataclass(frozen=True)
class Request:
    """What ``tessellation_factors`` is asked for besides patches and a view, checked. Make it with ``Request.of``.

    fineness : static: tiles of ``certified``, (m_u, m_v) of ``slefe``
    numbers  : tolerance, then those of the method; None for what is not asked for
    """

    method: str
    fineness: Any
    numbers: tuple[Any, ...]
    anisotropic: bool
    verify: bool
    pattern: Pattern

    @staticmethod
    def of(
        method: str = "certified",
        dimension: int = 3,
        *,
        tiles: int = 2,
        anisotropic: bool = False,
        verify: bool = False,
        segments: Segments = 3,
        tolerance: Number = 0.5,
        depth_tolerance: Number | None = None,
        k: Number = 1.0,
        setting: Number | None = None,
        smooth: Number | None = None,
        pattern: Pattern | None = None,
    ) -> Request:
        """From the arguments of ``tessellation_factors``, for control points of that dimension. Raises as it does."""
        _check_method(method, dimension, depth_tolerance, setting)
        asked = {"anisotropic": anisotropic, "verify": verify, "pattern": pattern is not None}
        _check_numbers(method, asked, tiles, {"tolerance": tolerance, "k": k, "depth_tolerance": depth_tolerance})
        check_smooth(method, smooth, bool(anisotropic or verify))
        if pattern is not None and not isinstance(pattern, Pattern):
            raise InputError(f"pattern must be a slefejax.rings.Pattern, not {type(pattern).__name__}")
        if method == "certified":
            numbers: tuple[Any, ...] = (tolerance, depth_tolerance, smooth)
        elif method == "slefe":
            numbers = (tolerance, depth_tolerance, k, smooth)
        else:
            numbers = (tolerance, SETTINGS.get(method) if setting is None else setting)
        fineness = {"certified": int(tiles), "slefe": segment_pair(segments)}.get(method)
        return Request(method, fineness, numbers, anisotropic, verify, pattern or direct3d11())

    @property
    def smooth(self) -> Any:
        """The temperature, or None."""
        return self.numbers[-1] if self.method in ("certified", "slefe") else None

    def left_out(self) -> tuple[str, ...]:
        """What is not computed because it was not asked for, a sentence each."""
        left = []
        if self.method in ("certified", "slefe") and self.numbers[1] is None:
            left.append("depth widths: no depth tolerance was given")
        if self.method != "slefe":
            left.append(f"slefe boxes: the method {self.method} does without")
        return tuple(left)


def _check_method(method: str, dimension: int, depth_tolerance: Any, setting: Any) -> None:
    check_choice("method", method, METHODS)
    if method == "filip" and dimension == 4:
        raise InputError("method 'filip' bounds polynomial patches, (patches, du+1, dv+1, 3): these are rational")
    if depth_tolerance is not None and method not in ("certified", "slefe"):
        raise InputError(f"method {method!r} knows no depth_tolerance", options=("depth_tolerance",))
    if setting is not None:
        if method not in SETTINGS:
            raise InputError(f"method {method!r} has no setting: {', '.join(SETTINGS)} have one", options=("setting",))
        check_positive("setting", setting)


def check_smooth(method: str, smooth: Any, whole: bool = False) -> None:
    """InputError unless the method knows a temperature, and this is one; ``whole``: whole numbers are asked for too."""
    if smooth is None:
        return
    if method not in ("certified", "slefe"):
        raise InputError(f"method {method!r} knows no smooth: 'certified' and 'slefe' do", options=("smooth",))
    if whole:
        raise InputError(
            "smooth is of real factors: anisotropic and verify find whole numbers without it",
            options=("smooth", "anisotropic", "verify"),
        )
    if isinstance(smooth, bool):
        raise InputError("smooth is a temperature, such as 0.01, and not yes or no", options=("smooth",))
    check_positive("smooth", smooth)
    if not isinstance(smooth, Tracer) and float(smooth) > 1.0:
        raise InputError(
            f"smooth is a temperature of at most 1, not {smooth}: 0.01 or less is close to the maximum",
            options=("smooth",),
        )


def _check_numbers(method: str, asked: dict[str, bool], tiles: Any, positive: dict[str, Any]) -> None:
    for name, value in asked.items():
        if not isinstance(value, (bool, np.bool_)):
            raise InputError(f"{name} must be True or False, not {value!r}", options=(name,))
    check_whole("tiles", tiles, 1)
    if method != "certified" and any(asked.values()):
        name = max(asked, key=asked.__getitem__)
        raise InputError(f"method {method!r} knows no {name}: 'certified' does", options=(name,))
    for name, value in positive.items():
        if value is not None or name != "depth_tolerance":
            check_positive(name, value)
