"""The stages that ``slefejax bench`` times: what each computes, and the same in plain NumPy or SciPy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from slefejax import Camera, Scene, View, load, tessellation_factors, worst_points
from slefejax.bounds.slefe import slefe_table
from slefejax.bounds.slefe_tables import build_table
from slefejax.experiments.bench import peers
from slefejax.geometry.packed import Packed, pack
from slefejax.geometry.projection import Projection
from slefejax.gpu import Device, Renderer
from slefejax.lanes import layout
from slefejax.lanes.tuning import TUNING
from slefejax.measure.error import pixel_error
from slefejax.model.skinning import linear_blend
from slefejax.predict.estimate import Boxes
from slefejax.predict.kernel import Kernel, Prepared, Tolerances, view_pass
from slefejax.predict.methods import Certified, Slefe

SEGMENTS = 3
TOLERANCE = 0.5
_ESTIMATE = Slefe(SEGMENTS)
_MOST_SEARCHED = 2000  # patches
_SHAKEN = 0.02  # of the teapot's coordinates, so that no two patches are the same
_WHOLE = 1e-3  # relative; single precision loses up to that in differences of positions on the screen


@dataclass(frozen=True)
class Work:
    """One stage, ready to run: what it does, how much of it there is, and peers that do the same.

    peers : by name
    same  : takes a result of either to an array, or None where there is none; they must agree but for ``close`` times
            their largest entry
    """

    run: Callable[[], Any]
    items: int
    unit: str
    peers: dict[str, Callable[[], Any]]
    same: Callable[[Any], np.ndarray | None] | None = None
    close: float = _WHOLE


@dataclass(frozen=True)
class Setting:
    """So many patches in a precision: the teapot's, each shaken a little, and the walker so many times side by side."""

    count: int
    dtype: Any
    device: Device | None

    @cached_property
    def patches(self) -> np.ndarray:
        """Control points ``(count, 4, 4, 3)``."""
        rng, teapot = np.random.default_rng(0), load("teapot").patches()
        shaken = teapot[rng.integers(0, len(teapot), self.count)] + _SHAKEN * rng.normal(size=(self.count, 4, 4, 3))
        return shaken.astype(self.dtype)

    @cached_property
    def view(self) -> View:
        """Of the teapot."""
        return View(Camera.look_at((4.5, -6.0, 4.0), (0.0, 0.0, 1.2)), 1440, 900)

    @cached_property
    def packed(self) -> Packed:
        """The control points as the kernels want them."""
        return pack(self.patches)

    @cached_property
    def projection(self) -> Projection:
        """Of the view, relative to a point near the patches."""
        return self.packed.placed(self.view)[1]

    @cached_property
    def boxes(self) -> Prepared:
        """With slefe boxes."""
        return Prepared(self.packed, jax.block_until_ready(self.new_boxes()))

    def new_boxes(self) -> Boxes:
        """Slefe boxes, made anew."""
        return Boxes.of(self.packed.chunks, self.projection.origin, (SEGMENTS, SEGMENTS))

    @cached_property
    def walker(self) -> Scene:
        """The walker, side by side until there are that many patches, or nearly."""
        one = load("walker")
        return one if self.count < 2 * len(one.control) else load("walker", copies=round(self.count / len(one.control)))

    @cached_property
    def drawing(self) -> tuple[Renderer, View, Any]:
        """The shaken patches, and the levels of the estimate: certified ones of this many patches take minutes."""
        patches = self.patches.astype(np.float64)
        return Renderer(patches, self.device), self.view, tessellation_factors(patches, self.view, "slefe")

    def seen(self, method: Kernel, prepared: Prepared | None = None) -> Callable[[], Any]:
        """The view pass of a method."""
        given, projection = (prepared or Prepared(self.packed)).seen(self.view)
        numbers = method.numbers(Tolerances(TOLERANCE), self.dtype)
        return lambda: view_pass(given, projection, *numbers)


def table(_: Setting) -> Work:
    """The table of one degree and number of segments, which is kept: ``slefe_table(4, 6)``."""
    return Work(lambda: build_table(4, 6), 1, "tables", {"kept": lambda: slefe_table(4, 6)})


def stencils(at: Setting) -> Work:
    """Control mesh to Bézier control points."""
    scene = at.walker
    assert scene.conversion is not None
    work = scene.conversion.patchwork
    vertices = scene.conversion.mesh.vertices.astype(at.dtype)
    if work.first is not None:
        vertices = np.asarray(work.first.on_host(vertices), at.dtype)
    tables = work.points
    matrix = tables.matrix.astype(at.dtype)
    compiled = jax.jit(lambda own, given: own(given))
    given = jnp.asarray(vertices)
    return Work(
        lambda: compiled(tables, given), tables.rows, "points", {"SciPy": lambda: matrix @ vertices}, np.asarray
    )


def skinning(at: Setting) -> Work:
    """Linear blend of four bones a vertex."""
    scene = at.walker
    assert scene.rig is not None
    assert scene.conversion is not None
    influences = scene.rig.influences
    assert influences is not None
    rest = scene.conversion.mesh.vertices.astype(at.dtype)
    rng = np.random.default_rng(0)
    bones = influences.table.columns
    transforms = (np.eye(3, 4) + 0.1 * rng.normal(size=(bones, 3, 4))).astype(at.dtype)
    compiled = jax.jit(lambda rest, transforms, table: linear_blend(rest, transforms, type(influences)(table)))
    given = (jnp.asarray(rest), jnp.asarray(transforms), influences.table)
    return Work(
        lambda: compiled(*given),
        len(rest),
        "vertices",
        {"NumPy": lambda: peers.plain_blend(rest, transforms, influences)},
        np.asarray,
    )


def pose_pass(at: Setting) -> Work:
    """Control points to slefe boxes, which are kept."""
    origin = np.asarray(at.projection.origin)
    moved = at.patches - origin
    return Work(
        at.new_boxes,
        at.count,
        "patches",
        {"NumPy": lambda: peers.plain_boxes(moved, SEGMENTS)},
        lambda found: _upper_ends(found, at.count),
    )


def _upper_ends(found: Any, count: int) -> np.ndarray:
    return layout.unpack_on_host(found.upper, count) if isinstance(found, Boxes) else found[1]


def from_boxes(at: Setting) -> Work:
    """Slefe boxes to factors in a view."""
    moved = at.patches - np.asarray(at.projection.origin)
    boxes = peers.plain_boxes(moved, SEGMENTS)
    return Work(
        at.seen(_ESTIMATE, at.boxes),
        at.count,
        "patches",
        {"NumPy": lambda: peers.plain_factors(boxes, at.projection, TOLERANCE, SEGMENTS)},
        lambda found: _in_order(found, at.count),
    )


def _in_order(found: Any, count: int) -> np.ndarray:
    """Factors as users have them, from the layout of the kernels or of a peer."""
    if isinstance(found, np.ndarray):
        return found
    return layout.unpack_on_host(found, count)


def fused(at: Setting) -> Work:
    """Control points to factors of the published estimate in a view."""
    moved = at.patches - np.asarray(at.projection.origin)
    last = np.ascontiguousarray(np.moveaxis(moved, 0, -1))

    def plain() -> np.ndarray:
        return peers.plain_factors(peers.plain_boxes(moved, SEGMENTS), at.projection, TOLERANCE, SEGMENTS)

    def unrolled() -> np.ndarray:
        return peers.unrolled_factors(last, at.projection, TOLERANCE, SEGMENTS)

    def chunks() -> np.ndarray:
        pieces = [np.ascontiguousarray(last[..., k : k + TUNING.lanes]) for k in range(0, at.count, TUNING.lanes)]
        return np.concatenate([peers.unrolled_factors(x, at.projection, TOLERANCE, SEGMENTS) for x in pieces])

    own = {"NumPy": plain, "NumPy, unrolled": unrolled, "NumPy, unrolled, in chunks": chunks}
    return Work(at.seen(_ESTIMATE), at.count, "patches", own, lambda found: _in_order(found, at.count))


def certified(at: Setting) -> Work:
    """Control points to certified factors, two tiles."""
    return Work(at.seen(Certified()), at.count, "patches", {"slefe estimate": at.seen(_ESTIMATE)})


def certified_one(at: Setting) -> Work:
    """The same, one tile."""
    return Work(at.seen(Certified(1)), at.count, "patches", {"slefe estimate": at.seen(_ESTIMATE)})


def levels(at: Setting) -> Work:
    """Control points to the levels that are drawn: of the walkers, framed, as shaken teapots are no mesh."""
    patches, numbers = pack(at.walker.patches()), at.walker.edge_numbers
    view = View(at.walker.default_camera(), 1440, 900)

    def factors() -> Any:
        return tessellation_factors(patches, view, tolerance=TOLERANCE, edge_numbers=numbers)

    peer = {"their factors": lambda: factors().factor}
    return Work(lambda: factors().inner, len(patches), "patches", peer)


def gradient(at: Setting) -> Work:
    """The gradient of the sum of the estimate's factors by all control points; its peer is the factors alone."""
    return _gradient(at, _ESTIMATE)


def certified_gradient(at: Setting) -> Work:
    """The same of certified factors."""
    return _gradient(at, Certified())


def _gradient(at: Setting, method: Kernel) -> Work:
    numbers = method.numbers(Tolerances(TOLERANCE), at.dtype)

    def total(chunks: Any, projection: Projection) -> Any:
        return view_pass((chunks, None, None), projection, *numbers).sum()

    compiled = jax.jit(jax.grad(total))
    chunks = at.packed.chunks
    return Work(lambda: compiled(chunks, at.projection), at.count, "patches", {"forward": at.seen(method)})


def draw(at: Setting) -> Work:
    """One draw, until OpenGL has finished."""
    renderer, view, factors = at.drawing
    return Work(lambda: renderer.submit(view, factors.inner, factors.edges), at.count, "patches", {})


def read_back(at: Setting) -> Work:
    """Parameters and patch numbers of all pixels."""
    renderer, view, factors = at.drawing
    renderer.submit(view, factors.inner, factors.edges)
    return Work(lambda: renderer.read(view), view.width * view.height, "pixels", {})


def error_image(at: Setting) -> Work:
    """The error of every covered pixel."""
    renderer, view, factors = at.drawing
    found = renderer.draw(view, factors.inner, factors.edges)
    patches, matrix = at.patches.astype(np.float64), np.asarray(view.world_to_screen)
    given = (found.u, found.v, found.patch, found.drawn)

    def draw_and_read() -> Any:
        return renderer.draw(view, factors.inner, factors.edges)

    return Work(
        lambda: pixel_error(patches, view, *given),
        int(np.count_nonzero(found.patch >= 0)),
        "pixels",
        {"NumPy": lambda: peers.plain_pixel_error(patches, matrix, *given), "draw and read": draw_and_read},
        lambda image: np.nan_to_num(image) if isinstance(image, np.ndarray) else None,
        1e-6,
    )


def sup_error(at: Setting) -> Work:
    """The largest error of every patch over its domain; of the first ones only, where there are many."""
    count = min(at.count, _MOST_SEARCHED)
    levels, patches = at.drawing[2].levels[:count], at.patches[:count].astype(np.float64)
    return Work(lambda: worst_points(patches, levels, at.view), count, "patches", {})


STAGES: dict[str, Callable[[Setting], Work]] = {
    "table": table,
    "stencils": stencils,
    "skinning": skinning,
    "pose pass": pose_pass,
    "view pass": from_boxes,
    "fused": fused,
    "certified, 1 tile": certified_one,
    "certified": certified,
    "levels": levels,
    "gradient": gradient,
    "certified gradient": certified_gradient,
    "draw": draw,
    "read-back": read_back,
    "error image": error_image,
    "sup error": sup_error,
}
ONCE = ("table",)  # does not depend on the number of patches
DOUBLE = ("table", "levels", "draw", "read-back", "error image", "sup error")  # in double precision, or none
OPENGL = ("draw", "read-back", "error image", "sup error")
