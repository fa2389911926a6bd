"""The frames of a motion, their levels, and how pixels move when levels change."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Real

from slefejax import Factors, Scene, Session, View
from slefejax.errors import InputError
from slefejax.experiments.levels import levels_of
from slefejax.experiments.store import Row
from slefejax.experiments.studies.times import milliseconds
from slefejax.gpu import GBuffer
from slefejax.measure.error import surface_on_screen
from slefejax.session import PARTS

_MOST = 100_000
_STILL_RATE = 24.0  # frames a second of the film of a scene without a motion


@dataclass(frozen=True)
class Frames:
    """The times of a film, the poses at them, what share of a camera's path is done; ``moves``: whether poses differ.

    seconds_a_frame : how long each is shown in the film
    """

    times: Float[np.ndarray, "frames"]
    poses: list[Any]
    shares: Float[np.ndarray, "frames"]
    moves: bool
    seconds_a_frame: float

    @staticmethod
    def of(scene: Scene, text: str, keys: dict[str, float] | None = None) -> Frames:
        """From ``--frames``. Raises InputError for what is no such text, and for times outside of the motion."""
        motion = None if scene.rig is None else scene.rig.motion
        first, last = (0.0, 1.0) if motion is None else motion.span
        times = _times(text, first, last)
        shares = np.arange(len(times)) / max(1, len(times) - 1)
        if scene.rig is None:
            if keys:
                raise InputError(f"{scene.name} does not move: --keys has no meaning for it")
            return Frames(times, [None] * len(times), shares, False, 1.0 / _STILL_RATE)
        poses: list[Any] = [scene.rig.pose(t, keys) if keys else t for t in times.tolist()]
        for t in times if motion is not None else ():
            motion.check(t)  # type: ignore[union-attr]
        step = (times[-1] - times[0]) / max(1, len(times) - 1) / scene.rig.rate if motion is not None else 0.0
        return Frames(times, poses, shares, motion is not None, step or 1.0 / _STILL_RATE)

    def notes(self, scene: Scene) -> tuple[str, ...]:
        """A sentence if nothing moves although there is a rig."""
        motion = None if scene.rig is None else scene.rig.motion
        if scene.rig is None or (motion is not None and len(motion.times) > 1):
            return ()
        return (f"{scene.name} has a rig, but no motion of more than one sample: it stands still",)


def _times(text: str, first: float, last: float) -> np.ndarray:
    """So many times from the first on, before the last; or all from one to another in steps."""
    parts = text.split(":")
    try:
        if len(parts) == 1:
            count = int(text)
            if not 1 <= count <= _MOST:
                raise ValueError
            return first + (last - first) * np.arange(count) / count
        if len(parts) > 3:
            raise ValueError
        start, end, step = (*(float(part) for part in parts), 1.0)[:3]
        count = int(np.floor((end - start) / step + 1e-9)) + 1
        if step <= 0 or not 1 <= count <= _MOST:
            raise ValueError
        return start + step * np.arange(count)
    except (ValueError, OverflowError, ZeroDivisionError):
        raise InputError(
            f"--frames must be a number of frames, at most {_MOST}, or FIRST:LAST:STEP with a positive step,"
            f" not {text!r}"
        ) from None


@dataclass(frozen=True)
class Levels:
    """What is drawn in a frame, and how long it took to find.

    patches      : control points of the pose;  tangents : its tangent patches, where normals are theirs
    factors      : before rounding up; ``factor`` as numbers
    milliseconds : of the parts of the prediction, by the names of columns
    """

    patches: Any  # (patches, nu, nv, dim), or GregoryPatches
    tangents: Any
    factors: Factors
    inner: Real[np.ndarray, "patches 2"]
    outer: Real[np.ndarray, "patches 4"]
    milliseconds: Row

    @property
    def factor(self) -> Float[np.ndarray, "patches"]:
        """Of every patch, real."""
        return np.asarray(self.factors.factor, np.float64)

    def drawn_with(self, other: Levels) -> tuple[Any, Any]:
        """These levels where both are drawn, the others' elsewhere."""
        both = (self.factor > 0) & (other.factor > 0)
        inner = np.where(both[:, None], self.inner, other.inner)
        return inner, np.where(both[:, None] & (self.outer > 0), self.outer, other.outer)


def frame_levels(session: Session, view: View, pose: Any, spacing: str) -> Levels:
    """Factors and levels of a scene in a pose; whole ones, or real ones for fractional spacing."""
    factors = session.factors(view, pose)
    names = zip(("skinning_ms", "boxes_ms", "view_ms"), PARTS, strict=True)
    spent = {name: 1e3 * session.seconds[part] for name, part in names}
    hand_over_ms = milliseconds(lambda: session.patches)
    start = time.perf_counter()
    inner, outer = levels_of(factors, spacing)
    spent |= {"levels_ms": 1e3 * (time.perf_counter() - start), "hand_over_ms": hand_over_ms}
    return Levels(session.patches, session.tangents, factors, inner, outer, spent)


def change_of_levels(before: Levels, after: Levels) -> Row:
    """The share of the patches seen in both frames whose levels differ by half a piece or more."""
    both = (before.factor > 0) & (after.factor > 0)
    jumps = np.abs(np.asarray(after.inner, float) - before.inner).max(axis=1) >= 0.5
    return {"changed_share": float(np.mean(jumps[both])) if both.any() else 0.0}


def moves_of_pixels(patches: np.ndarray, view: View, seen: GBuffer, other: GBuffer) -> Row:
    """How far apart two tessellations of the same patches put the texture, in pixels: what pops when one follows.

    At every pixel where both show the same patch: the points of the surface whose parameters they have there lie so and
    so far on the screen from where they are drawn; the difference, along x or y; its 99 % quantile and maximum.
    """
    same = (seen.patch >= 0) & (seen.patch == other.patch)
    if not same.any():
        return {"pop_p99_px": 0.0, "pop_max_px": 0.0}
    places = [
        surface_on_screen(patches, view, seen.patch[same], g.u[same].astype(float), g.v[same].astype(float))[:, :2]
        - g.drawn[same]
        for g in (seen, other)
    ]
    apart = np.abs(places[0] - places[1]).max(axis=1)
    return {"pop_p99_px": float(np.quantile(apart, 0.99)), "pop_max_px": float(apart.max())}
