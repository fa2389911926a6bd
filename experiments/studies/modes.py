"""How many frames a second, and where their time goes, if the pose changes often, seldom or never."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from slefejax import Session, View
from slefejax.experiments.store import Row
from slefejax.experiments.studies.frames import Frames, frame_levels
from slefejax.experiments.studies.times import milliseconds
from slefejax.gpu import Renderer

POSES_A_SECOND = 33.0  # of [YBP14], section 5
MODES = ("pose every frame", f"pose at {POSES_A_SECOND:g} Hz, view every frame", "view every frame", "static")
COLUMNS = ("skinning_ms", "boxes_ms", "view_ms", "levels_ms", "hand_over_ms", "render_ms")


def mode_row(mode: str, session: Session, renderer: Renderer, frames: Frames, views: list[View], seconds: float) -> Row:
    """Draw as fast as it goes for so many seconds. Milliseconds are means over the frames that were drawn.

    The pose goes on with every frame, or with the time that has gone by, in steps of 1/33 s, or not at all; so does the
    view, there and back along the camera's path, except where nothing moves.
    """
    player = _Player(mode, session, renderer, frames, views)
    for number in range(2):  # unmeasured: the first frame compiles
        player.frame(number, number / POSES_A_SECOND)
    spent: Row = dict.fromkeys(COLUMNS, 0.0)
    start, count = time.perf_counter(), 0
    while (gone := time.perf_counter() - start) < seconds or count == 0:
        for name, ms in player.frame(count, gone).items():
            spent[name] += ms
        count += 1
    total = time.perf_counter() - start
    parts = {name: spent[name] / count for name in COLUMNS}
    return {"mode": mode, "method": session.request.name, **parts, "frames_per_second": count / total}


@dataclass
class _Player:
    mode: str
    session: Session
    renderer: Renderer
    frames: Frames
    views: list[View]
    held: np.ndarray | None = None  # control points that the renderer has

    def frame(self, number: int, gone: float) -> Row:
        """Draw one frame; what its parts took, in milliseconds."""
        pose = {MODES[0]: number, MODES[1]: int(gone * POSES_A_SECOND)}.get(self.mode, 0)
        view = self.views[0] if self.mode == MODES[3] else _there_and_back(self.views, number)
        levels = frame_levels(
            self.session, view, self.frames.poses[pose % len(self.frames.poses)], self.renderer.spacing
        )
        spent = dict(levels.milliseconds)
        if levels.patches is not self.held:
            spent["hand_over_ms"] += milliseconds(lambda: self.renderer.move(levels.patches))
            self.held = levels.patches
        spent["render_ms"] = milliseconds(lambda: self.renderer.submit(view, levels.inner, levels.outer))
        return spent


def _there_and_back(views: list[View], number: int) -> View:
    """The next view of the path; a camera that stays sways by some thousandths of its distance."""
    turn = max(1, 2 * (len(views) - 1))
    place = min(number % turn, turn - number % turn) if len(views) > 1 else 0
    camera = views[place].camera
    sway = 1e-3 * (1 + number % 7) * np.cross(camera.target - camera.eye, camera.up)
    return replace(views[place], camera=replace(camera, eye=camera.eye + sway))
