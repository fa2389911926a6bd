"""What leaving out saves: the same scene with what it has no need of put in, both timed in turn."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from slefejax import GregoryPatches, Pose, Scene, Session, View
from slefejax.experiments.options import applicable
from slefejax.experiments.store import Row
from slefejax.model.rig import Rig, Skeleton
from slefejax.model.skinning import Influences
from slefejax.predict.methods import Certified, Options, Slefe, name_of
from slefejax.session import PARTS

_REPEATS = 15
_DEPTH = 1e-3
METHODS = {"certified": Certified(), "slefe": Slefe()}


def savings(scene: Scene, view: View) -> list[Row]:
    """One row for each thing left out, and method: milliseconds of the pose and view passes without and with it.

    Medians of passes whose pose and view are new, once compiled; where a pass is kept, of calls in which nothing is.
    Methods that do not take the scene's patches have no rows.
    """
    rows = []
    for method in applicable(METHODS, scene)[0].values():
        plain = Session(scene, method=method)
        for what, other, options in _with(scene):
            asked: Options = {"method": method, **options}
            session = Session(other, **asked)
            times = _in_turn([plain, session], view)
            rows.append({"left_out": what, "method": name_of(method), "without_ms": times[0], "with_ms": times[1]})
        times = _in_turn([plain], view)
        rows.append(
            {
                "left_out": "view that is the same",
                "method": name_of(method),
                "without_ms": _kept(plain, view),
                "with_ms": times[0],
            }
        )
    return rows


def _with(scene: Scene) -> list[tuple[str, Scene, Options]]:
    """Scenes and options with each thing put in that this scene has none of."""
    found: list[tuple[str, Scene, Options]] = [("depth widths", scene, {"depth_tolerance": _DEPTH})]
    if scene.control.shape[-1] == 3 and scene.rig is None and not isinstance(scene.control, GregoryPatches):
        weighted = np.concatenate([scene.control, np.ones_like(scene.control[..., :1])], axis=3)
        found.append(("weights", replace(scene, control=weighted), {}))
    if scene.rig is None and scene.conversion is not None:
        count = scene.conversion.mesh.vertex_count
        bones = Influences.of(np.zeros((count, 1), int), np.ones((count, 1)), 1)
        rig = Rig(Skeleton.of(["bone"], [-1], np.eye(4)[None]), bones)
        found.append(("skinning by one bone", replace(scene, rig=rig), {}))
    return found


def _in_turn(sessions: list[Session], view: View) -> list[float]:
    """Median milliseconds of all passes of each session, one after the other."""
    spent: list[list[float]] = [[] for _ in sessions]
    for turn in range(_REPEATS + 2):
        camera = replace(view.camera, eye=np.asarray(view.camera.eye) * (1.0 + 1e-6 * turn))
        for session, times in zip(sessions, spent, strict=True):
            session.factors(replace(view, camera=camera), _pose(session, turn))
            times.append(1e3 * sum(session.seconds[part] for part in PARTS))
    return [float(np.median(times[2:])) for times in spent]


def _pose(session: Session, turn: int) -> Any:
    """A pose that is new with every turn; None for a scene that does not move."""
    rig = session.scene.rig
    if rig is None:
        return None
    if rig.motion is not None and len(rig.motion.times) > 1:
        first, last = rig.motion.span
        return first + (last - first) * (turn + 1) / (_REPEATS + 3)
    if rig.skeleton is None:
        return Pose()
    local = rig.skeleton.rest.copy()
    local[0, 2, 3] += 1e-9 * turn
    return Pose(local)


def _kept(session: Session, view: View) -> float:
    """Median milliseconds of calls in which nothing is new: of the passes, which are not run."""
    times = []
    session.factors(view)
    for _ in range(_REPEATS):
        session.factors(view)
        times.append(1e3 * sum(session.seconds[part] for part in PARTS))
    return float(np.median(times))
