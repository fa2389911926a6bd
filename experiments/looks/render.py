"""How a scene looks as it is drawn: shading, lines, errors, whatever is asked for, a picture each."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from slefejax import Factors, InputError, Scene, View, tessellation_factors
from slefejax.arguments import check_positive
from slefejax.experiments.levels import Edges, Spacing, check_levels_are_real, check_seen, levels_of, unproved
from slefejax.experiments.looks.exr import write_exr
from slefejax.experiments.looks.kinds import LOOKS, SIZES, TEXTURE, chosen, needed
from slefejax.experiments.looks.made import Made
from slefejax.experiments.looks.picture import checker_picture, read_picture
from slefejax.experiments.looks.texture import COARSER, FINER, Texture, Textured
from slefejax.experiments.looks.triangle_sizes import size_rows
from slefejax.experiments.options import (
    LoadOptions,
    OutputOptions,
    PredictionOptions,
    ViewOptions,
    camera_record,
    caption_of,
)
from slefejax.experiments.report import Report, progress
from slefejax.experiments.shading import Shaded, ShadingOptions, unclaimed
from slefejax.experiments.store import Row, Run, digest
from slefejax.experiments.studies.look import Look, Shown
from slefejax.experiments.studies.measures import largest
from slefejax.experiments.tables import write_tables
from slefejax.figures.looks.panels import Heading
from slefejax.figures.page import Format, Pages
from slefejax.gpu import Device, Renderer, open_device
from slefejax.predict.methods import label_of
from slefejax.tessellator.levels import triangle_counts

_COLUMNS = ("look", "picture", "values", "median", "largest")


@dataclass(frozen=True)
class LookOptions(OutputOptions):
    """Where results go, as pictures alone or as numbers, too."""

    format: Format | Literal["exr"] = "png"
    """Of pictures: png, or pdf and svg for papers; exr: png, and beside every picture the numbers that it shows, 32-bit
    floats of every pixel."""

    def pages(self, command: Any) -> Pages:
        """What the pictures have in common."""
        return Pages("png" if self.format == "exr" else self.format, caption_of(command))


@dataclass(frozen=True)
class Render:
    """Draw a scene with its predicted tessellation factors, in one look or several."""

    scene: tyro.conf.Positional[str]
    """A file (.obj, .usd…, .glb, …: the README lists them), or walker, teapot, twisted-quad, steep-patch."""
    look: tuple[str, ...] = ("shaded", "wire", "error")
    """What to show: shaded, wire, error, normals, reflection, factors, depth, checker, triangle-size, texture; a
    picture each."""
    texture: Path | None = None
    """The picture that the look texture shows; a checker without."""
    scale: float = 1.0
    """What the predicted factors are multiplied by."""
    edges: Edges = "shared"
    """Edge levels: the larger of the two neighbours', without cracks; or each patch's own, with cracks."""
    spacing: Spacing = "equal"
    """How the tessellator places vertices; fractional ones move with the factor instead of coming and going."""
    prediction: tyro.conf.OmitArgPrefixes[PredictionOptions] = field(default_factory=PredictionOptions)
    camera: tyro.conf.OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)
    loading: tyro.conf.OmitArgPrefixes[LoadOptions] = field(default_factory=LoadOptions)
    output: tyro.conf.OmitArgPrefixes[LookOptions] = field(default_factory=LookOptions)

    def run(self) -> Report:
        """Predict, draw once, and make every look of that."""
        looks = self._looks()
        scene = self.loading.load(self.scene)
        view = self.camera.view(scene)
        shown = _shown(scene, view, self.prediction)
        device = open_device()
        painted = self._painted(scene, device) if TEXTURE in looks else None
        predicted = self._factors(shown)
        given = None if self.texture is None else str(self.texture)
        arguments = {**asdict(self), "output": None, "format": self.output.format, "camera": camera_record(view)}
        arguments["texture"] = given
        inputs = {"scene": digest(scene.patches().tobytes()), "opengl": device.renderer}
        if painted is not None:
            inputs["texture"] = digest(painted.picture.tobytes() + painted.coordinates.tobytes())
        with Run("render", arguments, self.output.out, inputs, self.output.pages(self)) as run:
            own = _Drawn(self, shown, predicted, device, run, painted)
            with progress("drawing", len(looks)) as show:
                rows = run.each("look", looks, own.row, show, own.picture, _COLUMNS)
            sizes = size_rows(own.look) if SIZES in looks else []
            if sizes:
                write_tables(run.file("."), "triangle_sizes", sizes)
            notes = (*scene.notes, *unclaimed(predicted.without_normal), *own.notes(rows))
            record = {
                "scene": scene.name,
                "notes": notes,
                "opengl": {"renderer": device.renderer, "version": device.version},
                "triangles": own.triangles,
                "covered_pixels": own.covered,
                "left_out": _asked(self.prediction).left_out(scene),
            }
            out = run.finish(rows, record)
        extra = {name: record[name] for name in ("triangles", "covered_pixels")}
        extra |= {"triangle_sizes": sizes} if sizes else {}
        title = f"{scene.name}: {own.how}; {own.covered:,} pixels are covered"
        more = (("triangles by their area on the screen", sizes),)
        return Report(scene.name, out, rows, title, notes, extra, self.output.json, more=more)

    def _looks(self) -> list[str]:
        """Those that are asked for, each once."""
        check_positive("scale", self.scale)
        check_levels_are_real(self.prediction, self.spacing)
        looks = chosen(self.look)
        if self.texture is not None and TEXTURE not in looks:
            raise InputError("--texture has a meaning for --look texture only")
        return looks

    def _painted(self, scene: Scene, device: Device) -> Texture:
        """What the look texture shows."""
        coordinates = scene.texture_coordinates()
        if self.texture is None:
            return Texture(checker_picture(), coordinates)
        return Texture(read_picture(self.texture, device.largest_picture), coordinates)

    def _factors(self, shown: Shown) -> Factors:
        """Predicted ones, scaled."""
        asked = _asked(self.prediction).arguments()
        tangents = shown.shaded.tangents if shown.shaded else None
        found = tessellation_factors(
            shown.patches, shown.view, edge_numbers=shown.scene.edge_numbers, tangents=tangents, **asked
        )
        check_seen(found)
        shown.heard(found)
        return found.scaled(self.scale)


def _asked(prediction: PredictionOptions) -> PredictionOptions:
    """The same for factors: which normals are drawn may be said without a tolerance for them."""
    if prediction.shading.normal_tolerance is not None:
        return prediction
    return replace(prediction, shading=ShadingOptions())


def _shown(scene: Scene, view: View, prediction: PredictionOptions) -> Shown:
    own = prediction.shading
    tangents = scene.tangents() if own.normals == "tangents" else None
    return Shown(scene, view, prediction.tolerance, shaded=Shaded(own.normal_tolerance, own.normals, tangents))


@dataclass
class _Drawn:
    """The scene, drawn once with all that the looks need."""

    options: Render
    shown: Shown
    factors: Factors
    device: Device
    run: Run
    texture: Texture | None = None

    @cached_property
    def look(self) -> Look:
        """What was drawn. Raises InputError where nothing is seen."""
        drawn = needed(self.options.look, self.shown.shaded)
        renderer = Renderer(self.shown.patches, self.device, self.options.spacing, **drawn)
        inner, outer = levels_of(self.factors, self.options.spacing, self.options.edges)
        view, spacing = self.shown.view, self.options.spacing
        found = self._with_texture(
            Look(self.shown.patches, view, renderer, inner, outer, spacing, factors=self.factors, shown=self.shown)
        )
        if not (found.seen.patch >= 0).any():
            raise InputError("the picture is empty: no pixel centre is covered by the scene")
        return found

    def _with_texture(self, look: Look) -> Look:
        """The same with the texture, if there is one, and the levels that it is drawn with beside."""
        if self.texture is None:
            return look
        scales = FINER / self.options.scale, COARSER
        levels = [levels_of(self.factors.scaled(x), look.spacing, self.options.edges) for x in scales]
        own = {item.name: getattr(look, item.name) for item in fields(look)}
        return Textured(**own, texture=self.texture, scale=self.options.scale, finer=levels[0], coarser=levels[1])

    @property
    def triangles(self) -> int:
        """How many were made."""
        return int(triangle_counts(self.look.inner, self.look.outer, self.options.spacing).sum())

    @property
    def covered(self) -> int:
        """Pixels that show the scene."""
        return int(np.count_nonzero(self.look.seen.patch >= 0))

    @property
    def how(self) -> str:
        """How it was drawn, in words."""
        options, view = self.options, self.shown.view
        method = label_of(options.prediction.value())
        parts = [f"{method}, {_asked(options.prediction).asked}", f"scale {options.scale:g}"]
        parts += [f"{options.spacing} spacing"] * (options.spacing != "equal")
        parts += ["each patch's own edges"] * (options.edges == "own")
        return f"{', '.join(parts)}: {self.triangles:,} triangles, {view.width} x {view.height} pixels"

    def picture(self, name: str) -> str:
        """The name of the picture of a look."""
        return self.run.figure(name).path.name

    def row(self, name: str) -> Row:
        """Make a look, and write its picture and its numbers."""
        made = LOOKS[name].make(self.look)
        made.draw(self.run.figure(name), Heading(self.shown.scene.name, made.shows, self.how))
        if made.channels and self.options.output.format == "exr":
            texts = {"scene": self.shown.scene.name, "look": name, "shows": made.shows, "how": self.how}
            write_exr(self.run.file(f"{name}.exr"), made.channels, texts)
        return {"picture": self.picture(name), **_summary(made)}

    def notes(self, rows: list[Row]) -> tuple[str, ...]:
        """What to know of the pictures."""
        plain = ", ".join(row["look"] for row in rows if not row["values"])
        said = unproved(self.options.prediction.value(), self.options.spacing)
        if plain and self.options.output.format == "exr":
            said += (f"no .exr file of what has no numbers: {plain}",)
        if self.texture is not None:
            bare = int(np.count_nonzero(np.isnan(self.texture.coordinates).any(axis=(1, 2, 3))))
            said += (f"{bare} patches have no texture coordinates: they are grey",) if bare else ()
        return said


def _summary(made: Made) -> Row:
    """Which numbers there are, and the middle and the largest of the main ones."""
    values = made.channels.get(made.main, np.array([np.nan]))
    known = values[~np.isnan(values)]
    median = float(np.median(known)) if known.size else float("nan")
    return {"values": ", ".join(made.channels), "median": median, "largest": largest(values)}
