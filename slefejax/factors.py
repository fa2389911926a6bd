"""Tessellation factors of patches in a view: one call for every method (docs/math.md, 3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from slefejax import layout
from slefejax.arguments import Number, Patches, Segments, check_patches, check_positive
from slefejax.certificate import Certificate
from slefejax.certified import certified_factors
from slefejax.drawn import drawn_levels
from slefejax.edges import check_edge_numbers, edge_maxima, shared_edges
from slefejax.errors import InputError
from slefejax.estimate import Boxes, factor_of_boxes, slefe_factor, slefe_factors
from slefejax.projection import Projection, harmless, least_distance, placed, positive
from slefejax.request import Request
from slefejax.rings import Pattern
from slefejax.rules import RULES, on_screen
from slefejax.tessellator import with_pieces
from slefejax.tiles import check_weights
from slefejax.verified import Nets, drawn_grids_hold, verified_factors
from slefejax.view import View

_LARGEST_LEVEL = 2**31


@jax.tree_util.register_pytree_node_class
@dataclass(frozen=True, eq=False)
class Factors:
    """Tessellation factors of a batch of patches.

    factor  : ``(patches,)``, real, before rounding up; 0 for a patch that is off-screen
    patches : the control points, from which shared edges are found when they are asked for; None inside a trace
    known   : the result of ``slefejax.edges.shared_edges`` if it is there already
    pairs   : ``(patches, 2)``, levels along u and v with few cells, if they were asked for (``anisotropic``)
    certify : of certified factors: makes what decides which grids and transition rings keep the tolerance
    """

    factor: Float[Array | np.ndarray, "patches"]
    patches: Any = field(default=None, repr=False)
    known: Int[np.ndarray, "patches 4"] | None = field(default=None, repr=False)
    pairs: Int[np.ndarray, "patches 2"] | None = field(default=None, repr=False)
    certify: Callable[[], Certificate] | None = field(default=None, repr=False)

    @cached_property
    def levels(self) -> Int[np.ndarray, "patches"]:
        """The factors rounded up to whole numbers.

        Raises InputError for factors too large to be such numbers, and inside of jit, grad and the like.
        """
        if isinstance(self.factor, Tracer):
            raise InputError("levels are whole numbers: ask for levels, inner and edges outside of jit and grad")
        rounded = np.ceil(np.asarray(self.factor, np.float64))
        if not np.all(rounded < _LARGEST_LEVEL):
            worst = int(np.argmax(rounded))
            raise InputError(
                f"the factor of patch {worst} (counted from 0) is {rounded[worst]:.3g}, which no tessellation can have:"
                " raise the tolerance or move the camera away"
            )
        return rounded.astype(np.int64)

    @cached_property
    def edge_numbers(self) -> Int[np.ndarray, "patches 4"]:
        """A number for every edge, equal where edges are shared (``slefejax.edges``)."""
        if self.known is not None:
            return self.known
        if self.patches is None:
            raise InputError("edges need concrete control points: call tessellation_factors outside of jit and grad")
        return shared_edges(np.asarray(self.patches))

    @cached_property
    def inner(self) -> Int[np.ndarray, "patches 2"]:
        """Inner levels along u and v, whole numbers."""
        return self._drawn[0]

    @cached_property
    def edges(self) -> Int[np.ndarray, "patches 4"]:
        """Outer levels at u=0, v=0, u=1, v=1 (OpenGL's order), equal where edges are shared; 0 off-screen.

        The larger of the two neighbours' levels; of certified factors more where the transition rings need it.
        """
        return self._drawn[1]

    @cached_property
    def _drawn(self) -> tuple[np.ndarray, np.ndarray]:
        if self.certify is not None:
            inner = np.repeat(self.levels[:, None], 2, axis=1) if self.pairs is None else self.pairs
            found = drawn_levels(self.certify(), inner, self.edge_numbers, self.pairs is not None)
        else:
            inner = np.repeat(self.levels[:, None], 2, axis=1)
            found = with_pieces(inner, edge_maxima(self.levels, self.edge_numbers), self.edge_numbers)
        for levels in found:
            levels.flags.writeable = False
        return found

    def scaled(self, scale: float) -> Factors:
        """The same with every factor multiplied by ``scale`` > 0, to see whether less would do."""
        check_positive("a scale", scale)
        own = self.certify
        certify = None if own is None else partial(_scaled, own, scale)
        pairs = None if self.pairs is None else np.ceil(self.pairs * scale).astype(np.int64)
        return replace(self, factor=self.factor * scale, pairs=pairs, certify=certify)

    def tree_flatten(self) -> tuple[tuple[Any], None]:
        """For JAX: the factor is data; edge numbers belong to concrete patches and are left behind."""
        return (self.factor,), None

    @classmethod
    def tree_unflatten(cls, _: None, children: tuple[Any]) -> Factors:
        """For JAX: the inverse of ``tree_flatten``."""
        return cls(*children)


def tessellation_factors(
    patches: Patches,
    view: View,
    method: str = "certified",
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
    edge_numbers: Int[np.ndarray, "patches 4"] | None = None,
) -> Factors:
    """How finely each patch must be cut so that pixels are right to within ``tolerance``.

    patches         : control points ``(patches, du+1, dv+1, 3)``, u before v, any bi-degree; 4 at the end if rational,
                      (w x, w y, w z, w) with positive weights
    view            : camera and picture size
    method          : ``"certified"``, a bound with a proof (docs/certified.md): cut uniformly by any whole number from
                      ``.factor`` on, and as ``.inner`` and ``.edges`` say, every visible point of the patch keeps the
                      tolerance.
                      ``"slefe"``, the published estimate: k m sqrt(w / tolerance), with w the width in pixels of
                      the slefe boxes on the screen ([YBP12], (7) to (10); [YBP14], (7)). It is not a bound.
                      For rational patches w is the width of the slefe of X - s W over W (docs/math.md, 6).
                      The rules of ``slefejax.rules``: ``"filip"`` (a bound), ``"minmax"``, ``"edge-length"``,
                      ``"screen-box"``, ``"fixed"``
    tiles           : of ``certified``: into how many pieces along u and along v a patch is cut to bound it. More are
                      tighter and cost more, tiles^2; 1 is the cheapest. Static
    anisotropic     : of ``certified``: ``.inner`` differs along u and v where that saves triangles
    verify          : of ``certified``: smaller whole numbers are proved cell by cell, which is slower and tighter, for
                      factors up to 128
    segments        : m, or (m_u, m_v); static; of ``slefe``
    tolerance       : pixels
    depth_tolerance : window depth (0 to 1), or None for no depth test; of ``certified`` and ``slefe``
    k               : the constant k_m; of ``slefe``
    setting         : of ``edge-length`` (pixels a piece), ``screen-box`` (mu, pixels), ``fixed`` (the factor);
                      None: 8, 1, 16
    smooth          : of ``certified`` and ``slefe``: a temperature, 0 < smooth <= 1, or None. Maxima become soft ones,
                      never smaller (at most N^smooth times as large, of N numbers), so that ``.factor`` can be
                      differentiated where they tie (docs/gradients.md). An estimate gets no smaller, a certified factor
                      stays one
    pattern         : of ``certified``: how the tessellator makes transition rings; None: as Direct3D 11 says
    edge_numbers    : ``(patches, 4)``, the result of ``shared_edges``, if it is already known

    Returns Factors: ``.factor`` (at least 1 on the screen, 0 off it), ``.inner`` and ``.edges``.
    ``slefe``: only tiles whose boxes reach into the view volume count; where a box touches or lies behind the near
    plane it is measured as if it lay in it, which is as near as anything is drawn; nothing is divided by a smaller W.
    ``.factor`` is differentiable by patches, camera, tolerance and k, in forward and reverse mode; derivatives are
    finite everywhere (docs/gradients.md). Traced numbers that are out of their range give NaN.

    Raises InputError for wrong shapes, control points that are not finite (with the patch's number), segments or tiles
    < 1, a tolerance or k that is not positive, a temperature beyond its range, or results that overflow.

    >>> from slefejax import Camera, load
    >>> scene = load("teapot")
    >>> view = View(Camera.look_at((4.5, -6.0, 4.0), (0.0, 0.0, 1.2)), width=1440, height=900)
    >>> tessellation_factors(scene.patches(), view).factor.shape
    (32,)
    """
    patches = check_patches(patches)
    check_weights(patches)
    request = Request.of(
        method,
        patches.shape[3],
        tiles=tiles,
        anisotropic=anisotropic,
        verify=verify,
        segments=segments,
        tolerance=tolerance,
        depth_tolerance=depth_tolerance,
        k=k,
        setting=setting,
        smooth=smooth,
        pattern=pattern,
    )
    if edge_numbers is not None:
        edge_numbers = check_edge_numbers(edge_numbers, len(patches))
    _check_view(view)
    packed, projection = placed(patches, view)
    return factors_of(packed, None, lambda: patches, len(patches), view, projection, request, edge_numbers)


def factors_of(
    packed: Any,
    boxes: Boxes | None,
    patches: Callable[[], Any],
    count: int,
    view: View,
    projection: Projection,
    request: Request,
    edge_numbers: Any,
) -> Factors:
    """Factors of patches in the layout of the kernels (``slefejax.layout``). Raises as ``tessellation_factors`` does.

    boxes      : of ``slefe``: the patches' slefe boxes in the same layout, if they are there already
    patches    : makes them in the order of users, ``(patches, du+1, dv+1, dim)``; called only where that is needed
    projection : of the view, for the packed patches (``slefejax.projection``)
    """
    scales = tuple(None if x is None else jnp.asarray(x, packed.dtype) for x in request.numbers)
    needed = packed if boxes is None or packed.shape[3] == 4 else None
    seen = (needed, None if boxes is None else boxes.lower, None if boxes is None else boxes.upper)
    chunks = view_pass(seen, projection, scales, request.method, request.fineness)
    factor = layout.unpack(chunks, count)
    if isinstance(factor, Tracer):
        if request.anisotropic or request.verify:
            raise InputError("anisotropic and verify find whole numbers: ask for them outside of jit and grad")
        return Factors(factor, known=edge_numbers)
    _check_result(np.asarray(factor), patches)
    if request.method != "certified":
        return Factors(factor, patches() if edge_numbers is None else None, edge_numbers)
    proof = None
    if request.verify:
        # in double precision, whatever the patches are in
        nets = Nets.of(np.asarray(patches()), Projection.of(view), (request.numbers[0], request.numbers[1]))
        factor = verified_factors(np.asarray(factor), nets)
        proof = partial(drawn_grids_hold, nets, request.pattern)
    tolerances = (scales[0], scales[1])
    certify = _Certify(packed, count, projection, tolerances, request.fineness, request.pattern, proof)
    pairs = certify().pairs() if request.anisotropic else None
    return Factors(factor, patches() if edge_numbers is None else None, edge_numbers, pairs, certify)


@dataclass(frozen=True, eq=False)
class _Certify:
    """Makes the certificate of some factors, once, when it is asked for; it can be pickled."""

    packed: Any
    count: int
    projection: Projection
    tolerances: tuple[Any, Any]
    fineness: Any
    pattern: Pattern
    proof: Any

    def __call__(self) -> Certificate:
        return self._certificate

    @cached_property
    def _certificate(self) -> Certificate:
        concrete = self.projection.relative(layout.unpack_on_host(self.packed, self.count), axis=-1)
        return Certificate(concrete, self.projection, self.tolerances, self.fineness, self.pattern, self.proof)


def _scaled(certify: Callable[[], Certificate], scale: float) -> Certificate:
    return certify().scaled(scale)


@layout.as_pass(3, 4)
def view_pass(
    seen: tuple[Any, Any, Any], projection: Projection, scales: tuple[Any, ...], method: str, fineness: Any
) -> Float[Array, "chunks lanes"]:
    """Real factors of all patches in one view, in the layout of the kernels; NaN for patches that are not finite.

    seen : control points, None where boxes are enough; lower and upper ends of slefe boxes relative to the origin, or
           None twice, to compute them on the way
    """
    bad = _out_of_range(scales, method, projection)
    packed, lower, upper = seen
    if method == "certified":
        factor: Any = certified_factors(packed, projection, scales, fineness)
        fine = layout.over_chunks(_harmless_over_scales, packed, projection, *scales[:2])
        return jnp.where(fine & ~bad, factor, jnp.nan)
    if method == "slefe" and lower is None and packed.shape[3] == 3 and scales[3] is None:
        factor = slefe_factors(packed, projection, scales[:3], fineness)
    elif lower is not None:
        kernel = partial(_from_boxes, segments=fineness)
        factor = layout.over_chunks(kernel, (lower, upper, packed), projection, *scales)
    else:
        kernel = partial(slefe_factor, segments=fineness) if method == "slefe" else _seen(RULES[method])
        factor = layout.over_chunks(_unless_bad(kernel), packed, projection, *scales)
    return jnp.where(bad, jnp.nan, factor)


def _check_view(view: Any) -> None:
    if not isinstance(view, View):
        raise InputError(f"the view must be a slefejax.View (a camera and a picture size), not {type(view).__name__}")


def _out_of_range(scales: tuple[Any, ...], method: str, projection: Projection) -> Any:
    """Whether a number that was traced, so that nobody could look at it, is not positive, or no temperature.

    Or whether the view is so small or so large that numbers of this type lose their digits.
    """
    least = least_distance(projection.near_w.dtype)
    bad: Any = ~(projection.near_w >= least) | ~(jnp.max(jnp.abs(projection.frustum[:, :3])) <= 1.0 / least)
    for scale in scales:
        if scale is not None:
            bad |= ~(scale > 0)
    if method in ("certified", "slefe") and scales[-1] is not None:
        bad |= ~(scales[-1] <= 1)
    return jnp.asarray(bad)


def _from_boxes(seen: Any, projection: Projection, *scales: Any, segments: tuple[int, int]) -> Any:
    lower, upper, control = seen
    # boxes of control points that are not finite are not finite either
    fine = harmless(lower, projection) & harmless(upper, projection)
    if control is not None:
        fine &= positive(control)
        control = projection.relative(control)
    factor = factor_of_boxes((lower, upper), control, projection, *scales, segments=segments)
    return jnp.where(fine, factor, jnp.nan)


def _seen(rule: Callable[..., Any]) -> Callable[..., Any]:
    """The rule with 0 for patches that are off the screen."""

    def kernel(control: Any, projection: Projection, *arguments: Any) -> Any:
        return jnp.where(on_screen(control, projection), rule(control, projection, *arguments), 0.0)

    return kernel


def _unless_bad(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """The kernel for points in the world, with NaN for harmful patches: its selects would hide them."""

    def checked(control: Any, projection: Projection, *arguments: Any) -> Any:
        found = kernel(projection.relative(control), projection, *arguments)
        return jnp.where(harmless(control, projection) & positive(control), found, jnp.nan)

    return checked


def _harmless_over_scales(control: Any, projection: Projection, *scales: Any) -> Any:
    """The same where control points are divided by each of these scales too."""
    fine = harmless(control, projection) & positive(control)
    for scale in scales:
        if scale is not None:
            fine &= harmless(control, projection, scale)
    return fine


def _check_result(factor: np.ndarray, make_patches: Callable[[], Any]) -> None:
    bad = np.flatnonzero(~np.isfinite(factor))
    if bad.size == 0:
        return
    patches = np.asarray(make_patches())
    where = f"patch {bad[0]}" + (f" and {bad.size - 1} more" if bad.size > 1 else "")
    if not np.isfinite(patches[bad[0]]).all():
        raise InputError(f"{where} (counted from 0) has control points that are not finite numbers: repair or drop it")
    raise InputError(
        f"the factor of {where} (counted from 0) overflows {factor.dtype}: scale the scene, raise the tolerance or move"
        " the near plane away from the eye"
    )
