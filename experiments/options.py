"""Command-line options that several experiments share."""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

import slefejax
from slefejax.conversion.acc import ALPHA
from slefejax.errors import InputError
from slefejax.experiments.commands import COMMANDS
from slefejax.experiments.shading import ShadingOptions, both_tolerances
from slefejax.figures.page import Format, Pages
from slefejax.framing import clipping_planes
from slefejax.geometry.gregory import GregoryPatches
from slefejax.geometry.view import Camera, View, bounding_sphere
from slefejax.io.content import read_bytes
from slefejax.loading import load
from slefejax.measure.rounding import rounding_error
from slefejax.model.rig import Deformation
from slefejax.model.skinning import dual_quaternion_blend, linear_blend
from slefejax.predict.kernel import Method
from slefejax.predict.methods import Options, Request, method_of, name_of
from slefejax.scene import Scene

Three = tuple[float, float, float]
Scenes = Annotated[
    tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="SCENE ...", help_behavior_hint="(at least one)")
]

_MUCH = 0.1  # of the tolerance: what single precision adds is worth a note


@dataclass(frozen=True)
class ViewOptions:
    """The camera and the size of the picture. What is not given is the scene's own, or frames the scene."""

    size: str = "1440x900"
    """Width x height of the picture in pixels."""
    eye: Three | None = None
    """Position of the camera."""
    target: Three | None = None
    """A point that the camera looks at."""
    up: Three | None = None
    """The direction that is up in the picture."""
    fov: float | None = None
    """Vertical field of view in degrees."""
    near: float | None = None
    """Distance of the near clipping plane."""
    far: float | None = None
    """Distance of the far clipping plane."""
    cover: float | None = None
    """Share of the picture that the scene shall cover, 0 to 1; .38, as was published, where it has no own camera."""

    def view(self, scene: Scene) -> View:
        """The view that these options ask for. Raises InputError for numbers that make no camera."""
        width, height = parse_size(self.size)
        own = self._framed(scene, width / height)
        eye = own.eye if self.eye is None else np.asarray(self.eye)
        near, far = map(float, clipping_planes(bounding_sphere(scene.points()), own, eye))
        near, far = near if self.near is None else self.near, far if self.far is None else self.far
        camera = Camera.look_at(
            eye,
            own.target if self.target is None else self.target,
            own.up if self.up is None else self.up,
            own.extent if self.fov is None else self.fov,
            near,
            far,
        )
        return View(camera, width, height)

    def _framed(self, scene: Scene, aspect: float) -> Camera:
        """The scene's own camera, or one that frames it with what is asked for up if the eye is not given."""
        if self.eye is not None:
            if self.cover is not None:
                raise InputError("--cover frames the scene and --eye places the camera: give one of them")
            return scene.default_camera(aspect)
        return scene.default_camera(aspect, self.cover, self.up)


def camera_record(view: View) -> dict:
    """The camera that was used, for the record of a run."""
    camera = view.camera
    numbers = {name: np.asarray(getattr(camera, name)).tolist() for name in ("eye", "target", "up", "near", "far")}
    return {**numbers, "fov_y": float(camera.extent), "width": view.width, "height": view.height}


@dataclass(frozen=True)
class LoadOptions:
    """How a file becomes patches."""

    scheme: str = "auto"
    """acc (quads), pinched (quads and triangles), bspline (regular meshes), catmull-clark+acc (any polygons), gregory
    and catmull-clark+gregory (smooth across edges), gaussian (Gaussian products); auto takes the last where there are
    covariances, else the first of acc, pinched, catmull-clark+acc that can do with the faces. Or one's own:
    my_module:MyScheme."""
    alpha: float = ALPHA
    """Of triangles: the weight of a neighbour."""
    steps: int | None = None
    """Of catmull-clark+acc and +gregory: steps of subdivision, each with four times as many patches; 1 if not given.
    Of gaussian: 0 if not given."""
    gaussians: str | None = None
    """Of the scheme gaussian: infer, a radius in the file's units, or an .npy file of covariances (vertices, 3, 3)."""
    allow_thin: bool = False
    """Of the scheme gaussian: take patches whose weights differ by more than 10^6."""
    group: tuple[str, ...] = ()
    """Of .obj files: only faces of these groups or objects."""
    drop_defects: bool = False
    """Leave out faces that keep a mesh from being manifold, instead of refusing it."""
    animation: str | None = None
    """Of .gltf and .glb files: the name of the animation, if not the first."""
    copies: int = 1
    """Of control meshes: how many stand side by side."""
    weld: float | None = None
    """Of patches and splines: sides that are so far apart at most become one, in the file's units; 0 for none. If not
    given, what the file's digits leave open."""
    time: float | None = None
    """Of scenes that move: when to look, in the units of the file; at rest if not given."""
    keys: tuple[str, ...] = ()
    """Weights of shape keys, such as smile=0.5, instead of the motion's."""
    deform: Literal["linear", "dual-quaternion"] | None = None
    """How bones move vertices; if not given, as the file says, linear if it says nothing."""

    def arguments(self) -> dict:
        """Keyword arguments for load."""
        own = {"alpha": self.alpha, "steps": self.steps, "drop_defects": self.drop_defects}
        return {
            "scheme": self.scheme,
            "group": self.group or None,
            "animation": self.animation,
            "copies": self.copies,
            "weld": self.weld,
            "gaussians": gaussians_of(self.gaussians),
            "allow_thin": self.allow_thin,
            **own,
        }

    def bezier(self, scene: str, why: str) -> Scene:
        """The same of Bézier patches. Raises InputError for Gregory patches, too, which says why."""
        found = self.load(scene)
        if isinstance(found.control, GregoryPatches):
            raise InputError(f"{why}: choose --scheme acc or pinched for {found.name}", options=("scheme",))
        return found

    def load(self, scene: str) -> Scene:
        """The scene of that name or file, with these options, in the pose that they ask for."""
        with own_modules(self.scheme):
            found = load(scene, **self.arguments())
        if self.time is None and not self.keys:
            return found
        if found.rig is None:
            option = "--keys" if self.time is None else "--time"
            raise InputError(f"{found.name} does not move: {option} has no meaning for it")
        return found.posed(found.rig.pose(self.time, self.weights()), self.deformation())

    def deformation(self) -> Deformation | None:
        """The function of that name, None for the file's own."""
        return {None: None, "linear": linear_blend, "dual-quaternion": dual_quaternion_blend}[self.deform]

    def weights(self) -> dict[str, float] | None:
        """Names and weights of shape keys, None for the motion's own. Raises InputError for what is none."""
        found = {}
        for text in self.keys:
            name, _, value = text.rpartition("=")
            if name in found:
                raise InputError(f"--keys names {name!r} twice")
            try:
                found[name] = float(value)
            except ValueError:
                found[name] = np.nan
            if not name or not np.isfinite(found[name]):
                raise InputError(f"--keys are names and weights, such as smile=0.5, not {text!r}")
        return found or None


@dataclass(frozen=True)
class OutputOptions:
    """Where results go."""

    out: Path | None = None
    """Folder of this run's results; without it runs/EXPERIMENT/TIME."""
    json: bool = False
    """Print one JSON object on standard output instead of the table."""


@dataclass(frozen=True)
class FigureOptions(OutputOptions):
    """Where results go, and how figures are written."""

    format: Format = "png"
    """Of figures: png, or pdf and svg for papers; pictures within these, and error images, stay pixels."""

    def pages(self, command: Any) -> Pages:
        """What the figures of that command have in common."""
        return Pages(self.format, caption_of(command))


@dataclass(frozen=True)
class PredictionOptions:
    """How factors are predicted."""

    method: str = "certified"
    """How factors are predicted: certified (a bound with a proof), slefe (the published estimate), filip, minmax,
    edge-length, screen-box or fixed; or one's own, as my_module:MyMethod."""
    tiles: int | None = None
    """Of certified: pieces along each side that a patch is cut into to bound it; 2 if not given."""
    anisotropic: bool = False
    """Of certified: levels that differ along u and v, where that saves triangles."""
    verify: bool = False
    """Of certified: smaller numbers are proved cell by cell, which is slower and tighter."""
    levels: Literal["fast", "fewest"] | None = None
    """Of certified: how levels are found that can be drawn; fewest takes longer. fast if not given."""
    segments: int | None = None
    """Of slefe: pieces m in each direction; 3 if not given."""
    tolerance: float = 0.5
    """Error in pixels that is allowed."""
    depth_tolerance: float | None = None
    """Error in window depth (0 to 1) that is allowed; not looked at if not given."""
    k: float | None = None
    """Of slefe: the constant k_m; 1 if not given."""
    setting: float | None = None
    """Of edge-length: pixels a piece, 8 if not given; of screen-box: mu, pixels, 1; of fixed: the factor, 16."""
    smooth: float | None = None
    """Of certified and slefe: the temperature of soft maxima, 0 to 1; exact ones if not given."""
    shading: tyro.conf.OmitArgPrefixes[ShadingOptions] = field(default_factory=ShadingOptions)

    def value(self) -> Method:
        """The method with its numbers. Raises InputError for those that it does not have."""
        own = {"tiles": self.tiles, "segments": self.segments, "k": self.k, "setting": self.setting}
        own |= {"smooth": self.smooth, "anisotropic": self.anisotropic or None, "verify": self.verify or None}
        own |= {"levels": self.levels}
        with own_modules(self.method):
            return method_of(self.method, own)

    def arguments(self) -> Options:
        """Keyword arguments for tessellation_factors, but for tangent patches (``shading.of``)."""
        own: Options = {"method": self.value(), "tolerance": self.tolerance, "depth_tolerance": self.depth_tolerance}
        return {**own, **self.shading.arguments()}

    @property
    def asked(self) -> str:
        """The tolerances, as titles say them."""
        return both_tolerances(self.tolerance, self.shading.degrees)

    def request(self, scene: Scene) -> Request:
        """The same as values, for the scene's patches."""
        return Request.of(self.arguments(), scene.control.shape[3])

    def left_out(self, scene: Scene) -> tuple[str, ...]:
        """What is not computed because the scene has no need of it or it was not asked for; a sentence each."""
        return (*scene.left_out(), *self.request(scene).left_out())


def gaussians_of(text: str | None) -> Any:
    """What ``--gaussians`` names. Raises InputError for a file that holds no array, and for what is none of all."""
    if text is None or text == "infer":
        return text
    if not text.endswith(".npy"):
        try:
            return float(text)
        except ValueError:
            said = f"--gaussians is infer, a radius or an .npy file, not {text!r}"
            raise InputError(said, options=("gaussians",)) from None
    data = read_bytes(Path(text))
    try:
        return np.load(io.BytesIO(data), allow_pickle=False)
    except (ValueError, EOFError, OSError):
        raise InputError(f"{text} is no .npy file of numbers, or not whole", options=("gaussians",)) from None


def columns_of(method: Method) -> dict[str, Any]:
    """The columns of tables that say which method it is; methods without segments have none."""
    return {"method": name_of(method), "segments": getattr(method, "segments", float("nan"))}


def applicable(methods: Mapping[str, Method], scene: Scene) -> tuple[dict[str, Method], str]:
    """Those that take the scene's patches, and a sentence about the others, empty if there are none."""
    gregory, rational = isinstance(scene.control, GregoryPatches), scene.control.shape[3] == 4
    kind = "takes_gregory" if gregory else "takes_rational" if rational else ""
    taken = {name: method for name, method in methods.items() if not kind or getattr(method, kind, True)}
    left = ", ".join(name for name in methods if name not in taken)
    wanted, given = ("Bézier", "Gregory") if gregory else ("polynomial", "rational")
    return taken, left and f"left out, as they are for {wanted} patches and these are {given} ones: {left}"


@contextmanager
def own_modules(*names: str) -> Iterator[None]:
    """Within, names such as my_module:MyMethod are looked for in the folder that a command is run in, too.

    Last, and only where there are such names: a file of the user's must not stand in for a package.
    """
    if not any(":" in name for name in names):
        yield
        return
    here = str(Path.cwd())
    sys.path.append(here)
    try:
        yield
    finally:
        sys.path.remove(here)


def caption_of(command: Any) -> str:
    """What figures of a command say of how they were made."""
    return f"slefejax {slefejax.__version__}: {' '.join(words_of(command))}"


_POSITIONAL = ("scene", "scenes")


def words_of(command: Any) -> list[str]:
    """What is typed for a command: its name, its scenes, and the options that are not as they are by themselves."""
    own = f"{type(command).__module__.removeprefix('slefejax.experiments.')}:{type(command).__name__}"
    name = next((name for name, place in COMMANDS.items() if place == own), type(command).__name__)
    given = [getattr(command, field) for field in _POSITIONAL if hasattr(command, field)]
    scenes = [Path(scene).name for one in given for scene in ([one] if isinstance(one, str) else one)]
    return [name, *scenes, *_changed(command)]


def _changed(options: Any) -> Iterator[str]:
    for part in fields(options):
        value = getattr(options, part.name)
        if part.name in (*_POSITIONAL, "output"):
            continue
        if is_dataclass(value):
            yield from _changed(value)
        elif value != part.default:
            yield f"--{part.name.replace('_', '-')}"
            if not isinstance(value, bool):
                yield from (f"{own:g}" if isinstance(own, float) else str(own) for own in _each(value))


def _each(value: Any) -> Sequence[Any]:
    return value if isinstance(value, tuple) else (value,)


def option_names(command: Any) -> set[str]:
    """The parameters that a command, or its class, has as options, those of its groups of options too."""
    found = set()
    for part in fields(command):
        group = part.default_factory
        found |= option_names(group) if is_dataclass(group) else {part.name}
    return found


def notes_of(scenes: Sequence[Scene], more: Sequence[str] = ()) -> tuple[str, ...]:
    """What was noticed when scenes were read, with their names if there are several.

    more : one more note of every scene, empty where there is none
    """
    both = zip(scenes, more or [""] * len(scenes), strict=True)
    notes = [(*scene.notes, *([own] if own else [])) for scene, own in both]
    if len(scenes) == 1:
        return notes[0]
    return tuple(f"{scene.name}: {note}" for scene, own in zip(scenes, notes, strict=True) for note in own)


def rounding_notes(scene: Scene, view: View, tolerance: float) -> tuple[str, ...]:
    """What single precision adds to the tolerance, if that is more than a tenth of it."""
    bound = rounding_error(scene.patches(), view)
    much, broken = (np.flatnonzero(bound > part * tolerance) for part in (_MUCH, 1.0))
    if not much.size:
        return ()
    largest = float(bound.max())
    said = f"up to {largest:.2g} px" if np.isfinite(largest) else "more than can be told"
    note = f"single precision adds {said} in {much.size} patches"
    if broken.size:
        note += f"; what is claimed does not hold in {broken.size} of them, the first is patch {broken[0]}"
        note += " (counted from 0)"
    return (note,)


def parse_size(text: str) -> tuple[int, int]:
    """(width, height) from a text such as 1440x900."""
    match = re.fullmatch(r"([1-9][0-9]{0,4})x([1-9][0-9]{0,4})", text)
    if not match:
        raise InputError(f"--size must be WIDTHxHEIGHT in pixels, such as 1440x900, not {text!r}")
    return int(match.group(1)), int(match.group(2))


def check_scales(scales: tuple[float, ...]) -> None:
    """Raise InputError unless there is a scale and all of them are positive, finite and different."""
    if not scales:
        raise InputError("--scales needs at least one number")
    bad = [scale for scale in scales if not (np.isfinite(scale) and scale > 0)]
    if bad:
        raise InputError(f"--scales must be positive numbers, not {bad[0]}")
    if len(set(scales)) < len(scales):
        raise InputError("--scales names a number twice")


def check_count(name: str, value: int, least: int = 1) -> None:
    """Raise InputError unless the number is large enough."""
    if value < least:
        raise InputError(f"{name} must be at least {least}, not {value}")
