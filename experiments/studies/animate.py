"""A scene in motion, frame by frame: factors, triangles, bad pixels, and where the time goes."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any

import jax
import numpy as np
import tyro

from slefejax import GregoryPatches, Scene, Session, View
from slefejax.arguments import on_host
from slefejax.errors import InputError
from slefejax.experiments.levels import Spacing, check_levels_are_real, unproved
from slefejax.experiments.looks.kinds import FRAMES, LOOKS, chosen, needed
from slefejax.experiments.options import FigureOptions, LoadOptions, PredictionOptions, ViewOptions, camera_record
from slefejax.experiments.report import Report, progress
from slefejax.experiments.shading import FOR_CERTIFIED, unclaimed_numbers
from slefejax.experiments.store import Row, Run, digest
from slefejax.experiments.studies.camera_path import ViewPath, camera_path
from slefejax.experiments.studies.frames import Frames, Levels, change_of_levels, frame_levels, moves_of_pixels
from slefejax.experiments.studies.look import Look, Shown
from slefejax.experiments.studies.measures import Measure, measure, normals, pixels_or_none, size, without_normal
from slefejax.experiments.studies.modes import COLUMNS, MODES, mode_row
from slefejax.experiments.studies.study import Case, Study, shown
from slefejax.experiments.studies.times import milliseconds
from slefejax.experiments.tables import write_csv
from slefejax.figures.looks.film import write_film, write_frames, write_strip
from slefejax.figures.looks.panels import Heading
from slefejax.figures.page import Page
from slefejax.figures.studies.animate import write_timeline, write_work
from slefejax.gpu import Device, Renderer, open_device
from slefejax.predict.methods import Certified, Options, Slefe

_LOOKED_AT = 4  # poses that the camera frames
_SHOWN = (
    *("frame", "time", "triangles", "share_above_0.5", "max_error_px", "slipped_pixels", "changed_share", "pop_max_px"),
    *("skinning_ms", "boxes_ms", "view_ms", "levels_ms", "hand_over_ms", "render_ms"),
)


@dataclass(frozen=True)
class Animate:
    """Move a scene: per frame factors, triangles, bad pixels, time a pass; what posing less often saves; a film."""

    scene: tyro.conf.Positional[str]
    """A file, or walker, teapot, twisted-quad, steep-patch."""
    frames: str = "24"
    """How many frames, spread over the motion from its first time on, before its last; or FIRST:LAST:STEP in its units
    of time."""
    look: tuple[str, ...] = ("shaded", "wire", "error")
    """What the film shows side by side: shaded, wire, error, reflection."""
    camera_path: str = "still"
    """still, orbit:DEGREES (around the target), zoom:FACTOR (so many times as close in the end), or a .csv file with
    the columns eye_x eye_y eye_z target_x target_y target_z."""
    spacing: Spacing = "equal"
    """How the tessellator places vertices; fractional ones move with the factor instead of coming and going."""
    seconds: float = 1.0
    """How long each of the modes (pose every frame, at 33 Hz, never) is run; 0 leaves them out."""
    prediction: tyro.conf.OmitArgPrefixes[PredictionOptions] = field(default_factory=PredictionOptions)
    camera: tyro.conf.OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)
    loading: tyro.conf.OmitArgPrefixes[LoadOptions] = field(default_factory=LoadOptions)
    output: tyro.conf.OmitArgPrefixes[FigureOptions] = field(default_factory=FigureOptions)

    def run(self) -> Report:
        """Move, predict, draw, measure, frame by frame; then the modes, the figures and the film."""
        self._check()
        scene = replace(self.loading, time=None, keys=()).load(self.scene)
        frames = Frames.of(scene, self.frames, self.loading.weights())
        reached = _reached(scene, frames, self.loading)
        view = self.camera.view(reached)
        path = camera_path(self.camera_path, reached, view)
        session = Session(scene, deform=self.loading.deformation(), **self.prediction.arguments())
        device = open_device()
        arguments = {**asdict(self), "output": None, "camera": camera_record(view)}
        inputs = {"scene": digest(scene.patches().tobytes()), "opengl": device.renderer}
        with Run("animate", arguments, self.output.out, inputs, self.output.pages(self)) as run:
            film = _Film(scene, frames, _views(path, frames), session, self, run, device)
            turned = (normals, without_normal) if self.prediction.shading.degrees else ()
            study = Study(film.cases(), (size, pixels_or_none, *turned, *PARTS_OF_FRAMES), picture_name)
            found = study.rows(run, "frames")
            rows = shown(found)
            modes = film.modes()
            film.draw(rows, modes)
            left_out = session.left_out()
            own = (*scene.notes, *_of_normals(found, modes)) if turned else scene.notes
            record = {"scene": scene.name, "notes": own, "left_out": left_out, "modes": modes}
            record |= {"memory": session.memory(), "opengl": {"renderer": device.renderer, "version": device.version}}
            if modes:
                write_csv(run.file("modes.csv"), modes)
            out = run.finish(rows, record)
        title = f"{scene.name}: {len(scene.patches()):,} patches in {len(rows)} frames at {self.camera.size}"
        notes = (*own, *frames.notes(scene), *(f"left out: {what}" for what in left_out))
        notes += unproved(session.request.method, self.spacing)
        columns = (*_SHOWN, *normals.columns) if turned else _SHOWN
        more = (("where the time of a frame goes, in milliseconds, and how many frames a second that makes", modes),)
        return Report(scene.name, out, rows, title, notes, {"modes": modes}, self.output.json, more=more, shown=columns)

    def _check(self) -> None:
        if self.loading.time is not None:
            raise InputError("animate goes through the times of --frames: --time has no meaning for it")
        if not (np.isfinite(self.seconds) and self.seconds >= 0):
            raise InputError(f"--seconds must not be negative, not {self.seconds}")
        check_levels_are_real(self.prediction, self.spacing)
        chosen(self.look, FRAMES)


def _of_normals(rows: list[Row], modes: list[Row]) -> tuple[str, ...]:
    """What to say of patches without a claim, in whatever frame they are seen, and of the modes."""
    numbers = sorted({patch for row in rows for patch in row["_without_normal"]})
    said = (FOR_CERTIFIED, "where the time of a frame goes is measured without drawing normals") if modes else ()
    return (*unclaimed_numbers(numbers), *said)


def _views(path: ViewPath, frames: Frames) -> list[View]:
    """The view of every frame. Raises InputError, with the number of the frame, for a camera that is none."""
    views = []
    for frame, share in enumerate(frames.shares):
        try:
            views.append(path(share))
        except InputError as error:
            raise InputError(f"--camera-path, frame {frame}: {error}") from None  # whose columns are no options
    return views


def picture_name(frame: int) -> str:
    """File name of the looks of a frame, without letters."""
    return f"looks_{frame:04d}.png"


def said(rows: list[Row], tolerance: float) -> list[tuple[str, str]]:
    """What stands above every frame: which it is, and how right. Letters stay where they are."""
    digits = len(str(len(rows)))
    numbers = [f"frame {k:0{digits}} of {len(rows)}, {row['triangles']:,} triangles" for k, row in enumerate(rows, 1)]
    return list(zip(numbers, (_how_right(row["max_error_px"], tolerance) for row in rows), strict=True))


def _how_right(largest: float, tolerance: float) -> str:
    if not np.isfinite(largest):
        return "nothing of it is on the screen"
    right = "every pixel is right" if largest <= tolerance else "not every pixel is right"
    return f"{right} to within {tolerance:g} px: the largest error is {largest:.2f} px"


def _reached(scene: Scene, frames: Frames, loading: LoadOptions) -> Scene:
    """The scene with the patches of some of the frames, to be framed as a whole."""
    if not frames.moves:
        return scene
    chosen = [frames.poses[k] for k in np.unique(np.linspace(0, len(frames.poses) - 1, _LOOKED_AT).astype(int))]
    control = [on_host(scene.pose(pose, loading.deformation())) for pose in chosen]
    whole = jax.tree.map(lambda *parts: np.concatenate(parts), *control)
    return replace(scene, control=whole, faces=None, kinds=None, rig=None, conversion=None)


_CHANGES = ("changed_share", "pop_p99_px", "pop_max_px")


@dataclass
class _Frame(Look):
    """A frame, what changed since the one before, and milliseconds spent on its parts."""

    own: Any = None
    changed: Row = field(default_factory=lambda: dict.fromkeys(_CHANGES, float("nan")))
    spent: Row = field(default_factory=dict)


@measure("visible_patches", "sum_of_factors")
def _factors(look: Any) -> Row:
    """Of the patches that are on the screen."""
    return {"visible_patches": int(np.sum(look.own.factor > 0)), "sum_of_factors": float(look.own.factor.sum())}


PARTS_OF_FRAMES = (
    _factors,
    Measure(_CHANGES, lambda look: {name: look.changed[name] for name in _CHANGES}),
    Measure(COLUMNS, lambda look: {name: look.spent[name] for name in COLUMNS}),
)


@dataclass
class _Film:
    scene: Scene
    frames: Frames
    views: list[View]
    session: Session
    options: Animate
    run: Run
    device: Device

    def __post_init__(self) -> None:
        self._shaded = self.options.prediction.shading.of(self.scene)
        self._renderer = self._make_renderer(**self._shaded.drawn)
        self._looks = chosen(self.options.look, FRAMES)
        own = needed(self._looks, self._shaded)
        self._painter = self._make_renderer(**own) if own else None  # apart: what is timed draws nothing else
        self._levels: dict[int, Levels] = {}

    def _make_renderer(self, **drawn: Any) -> Renderer:
        return Renderer(self.scene.patches(), self.device, self.options.spacing, **drawn)

    def levels(self, frame: int) -> Levels:
        """Those of a frame; of the last two they are kept."""
        if frame not in self._levels:
            found = frame_levels(self.session, self.views[frame], self.frames.poses[frame], self.options.spacing)
            self._levels = {k: kept for k, kept in self._levels.items() if k == frame - 1} | {frame: found}
        return self._levels[frame]

    def cases(self) -> list[Case]:
        """The frames."""
        proved = isinstance(self.session.request.method, Certified) and self.options.spacing == "equal"
        same = {"method": self.session.request.name, "spacing": self.options.spacing, "proved": proved}
        times = self.frames.times.tolist()
        return [Case(k, {"frame": k, "time": time, **same}, partial(self.look, k)) for k, time in enumerate(times)]

    def look(self, frame: int) -> _Frame:
        """Predict, draw, and see what would have moved had the levels stayed those of the frame before."""
        before = self.levels(frame - 1) if frame else None
        own, view = self.levels(frame), self.views[frame]
        hand_over_ms = own.milliseconds["hand_over_ms"] + milliseconds(
            lambda: self._renderer.move(own.patches, own.tangents)
        )
        spacing = self.options.spacing
        beside = Shown(self.scene, view, self.options.prediction.tolerance, shaded=self._shaded.moved(own.tangents))
        beside.heard(own.factors)
        found = _Frame(own.patches, view, self._renderer, own.inner, own.outer, spacing, shown=beside, own=own)
        found.spent = {**own.milliseconds, "hand_over_ms": hand_over_ms, "render_ms": found.render_ms}
        write_strip(self.run.file(picture_name(frame)), self._pictures(found))
        if before is not None:
            other = self._renderer.draw(view, *before.drawn_with(own))
            found.changed = change_of_levels(before, own) | moves_of_pixels(own.patches, view, found.seen, other)
        return found

    def _pictures(self, found: _Frame) -> list[np.ndarray]:
        """The looks of a frame, side by side."""
        painted: Look = found
        if self._painter is not None:
            self._painter.move(found.patches, found.own.tangents)
            levels = found.inner, found.outer, found.spacing
            painted = Look(found.patches, found.view, self._painter, *levels, shown=found.shown)
        looks = [(LOOKS[name], FRAMES[name]) for name in self._looks]
        return [frame.colours(painted if kind.normals or kind.wire else found) for kind, frame in looks]

    def modes(self) -> list[Row]:
        """How long frames take if the pose changes with each of them, 33 times a second, or never."""
        if not self.options.seconds:
            return []
        own = self.options.prediction.arguments()
        estimate: Options = {**own, "method": Slefe(), "normal_tolerance": None, "normals": "surface"}
        alone = isinstance(self.session.request.method, Slefe) or isinstance(self.scene.control, GregoryPatches)
        every: list[Options] = [own] if alone else [own, estimate]
        rows, renderer = [], self._make_renderer() if self._shaded else self._renderer
        with progress("modes", len(MODES) * len(every)) as show:
            for arguments in every:
                session = Session(self.scene, deform=self.options.loading.deformation(), **arguments)
                for mode in MODES:
                    show(len(rows), mode)
                    rows.append(mode_row(mode, session, renderer, self.frames, self.views, self.options.seconds))
        return rows

    def draw(self, rows: list[Row], modes: list[Row]) -> None:
        """The figures and the film."""
        name, run = self.scene.name, self.run
        if not any(row["covered_pixels"] for row in rows):
            raise InputError("nothing of the scene is on the screen in any frame: turn the camera to it")
        write_timeline(run.figure("timeline"), rows, name, self.options.prediction.tolerance)
        if modes:
            write_work(run.figure("time_of_a_frame"), modes, name, self.device.renderer)
        caption = self.options.output.pages(self.options).caption
        pages = [Page(run.file(f"frame_{row['frame']:04d}.png"), caption) for row in rows]
        headings = [Heading(name, *own) for own in said(rows, self.options.prediction.tolerance)]
        titles = {FRAMES[look].says: look == "error" for look in self._looks}
        with progress("film", len(rows)) as show:
            write_frames(pages, headings, [run.file(picture_name(row["frame"])) for row in rows], titles, show)
        write_film(run.file("animation.gif"), pages, self.frames.seconds_a_frame)
