"""Tessellation factors of patches in a view: one call for every method (docs/math.md, 3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, Literal, Unpack

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from slefejax.arguments import Number, Patches, check_positive, on_host
from slefejax.errors import InputError
from slefejax.geometry.evaluate import as_control
from slefejax.geometry.gregory import GregoryPatches, Twisted
from slefejax.geometry.normals import kind_of_normals, tangent_nets
from slefejax.geometry.packed import Packed, pack
from slefejax.geometry.projection import Projection
from slefejax.geometry.view import View, check_view
from slefejax.lanes import layout
from slefejax.lanes.memory import Memory
from slefejax.predict.cells import Pictured, Pictures, verified_factors
from slefejax.predict.certificate import Certificate
from slefejax.predict.drawn.levels import drawn_levels, small_grids
from slefejax.predict.kernel import Kernel, Method, Prepared, Tolerances
from slefejax.predict.methods import Certified, Knobs, Name, Request, name_of
from slefejax.predict.normals.shading import Shading
from slefejax.tessellator.edges import check_edge_numbers, edge_maxima, shared_edges
from slefejax.tessellator.levels import with_pieces

_LARGEST_LEVEL = 2**31


@dataclass(frozen=True, eq=False)
class Factors:
    """Tessellation factors of a batch of patches.

    factor  : ``(patches,)``, real, before rounding up; 0 for a patch that is off-screen
    request : what they were computed for, of those that come out of jit too
    packed  : the patches, from which shared edges are found when they are asked for; None of those that were traced
    known   : the result of ``slefejax.tessellator.edges.shared_edges`` if it is there already
    pairs   : ``(patches, 2)``, levels along u and v with few cells, if they were asked for (``anisotropic``)
    certify : of certified factors: makes what decides which grids and transition rings keep the tolerance
    without_normal : ``(patches,)``, on which patches that are seen normals have no claim, such as at cusps; None if
            there is no tolerance for normals
    """

    factor: Float[Array | np.ndarray, "patches"]
    request: Request | None = field(default=None, repr=False)
    packed: Packed | None = field(default=None, repr=False)
    known: Int[np.ndarray, "patches 4"] | None = field(default=None, repr=False)
    pairs: Int[np.ndarray, "patches 2"] | None = field(default=None, repr=False)
    certify: Callable[[], Certificate] | None = field(default=None, repr=False)
    without_normal: Bool[Array | np.ndarray, "patches"] | None = field(default=None, repr=False)

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
        """A number for every edge, equal where edges are shared (``slefejax.tessellator.edges``)."""
        if self.known is not None:
            return self.known
        if self.packed is None:
            raise InputError(_TRACED)
        return shared_edges(on_host(self.packed.patches()))

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
            assert self.request is not None
            method = self.request.method
            anisotropic, fewest = bool(method.anisotropic), method.levels == "fewest"
            found = drawn_levels(self.certify(), self.edge_numbers, anisotropic=anisotropic, fewest=fewest)
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

    def at(
        self,
        patches: Patches,
        view: View,
        *,
        tangents: Any = None,
        edge_numbers: Int[np.ndarray, "patches 4"] | None = None,
    ) -> Factors:
        """The same with levels and edges again, for factors that come out of jit.

        patches, view, tangents : those that the factors were computed of
        edge_numbers            : as of ``tessellation_factors``

        Raises InputError for other numbers of patches, and inside of jit.

        >>> from slefejax import Camera, load
        >>> patches = load("teapot").patches()
        >>> view = View(Camera.look_at((4.5, -6.0, 4.0), (0.0, 0.0, 1.2)), width=1440, height=900)
        >>> found = jax.jit(lambda given: tessellation_factors(given, view, "minmax"))(patches)
        >>> found.at(patches, view).edges.shape
        (32, 4)
        """
        packed = pack(patches)
        check_view(view)
        if self.request is None:
            raise InputError("these factors do not know of what method they are: compute them anew")
        if len(packed) != len(self.factor):
            raise InputError(f"these are factors of {len(self.factor)} patches, not of {len(packed)}")
        if isinstance(self.factor, Tracer):
            raise InputError(_TRACED)
        prepared = shaded(self.request, Prepared(packed), "surface" if tangents is None else "tangents", tangents)
        return _settled(self.factor, self.request, prepared, view, _checked(edge_numbers, packed))


_TRACED = (
    "edges and whole levels need concrete control points: call tessellation_factors outside of jit and grad, or give"
    " these factors their patches and view there: factors.at(patches, view)"
)


def _flatten(factors: Factors) -> tuple[tuple[Any, Any, Any], Any]:
    """The factors and what was asked for; methods of one's own that are no pytrees are static."""
    request = factors.request
    own, without = factors.factor, factors.without_normal
    if request is None or isinstance(request.method, Kernel):
        return (own, request, without), None
    return (own, request.tolerances, without), request.method


def _unflatten(method: Any, children: tuple[Any, Any, Any]) -> Factors:
    factor, rest, without = children
    return Factors(factor, rest if method is None else Request(method, rest), without_normal=without)


jax.tree_util.register_pytree_node(Factors, _flatten, _unflatten)


def tessellation_factors(
    patches: Patches,
    view: View,
    method: Name | Method | str = "certified",
    *,
    tolerance: Number = 0.5,
    depth_tolerance: Number | None = None,
    normal_tolerance: Number | None = None,
    normals: Literal["surface", "tangents"] = "surface",
    tangents: Any = None,
    edge_numbers: Int[np.ndarray, "patches 4"] | None = None,
    **knobs: Unpack[Knobs],
) -> Factors:
    """How finely each patch must be cut so that pixels are right to within ``tolerance``.

    patches         : control points ``(patches, du+1, dv+1, 3)``, u before v, any bi-degree; 4 at the end if rational,
                      (w x, w y, w z, w) with positive weights; or ``slefejax.pack`` of them
    view            : camera and picture size
    method          : the name of a method, a value of ``predict.methods``, or one's own (``predict.kernel``).
                      ``"certified"``, a bound with a proof (docs/certified.md): cut uniformly by any whole number from
                      ``.factor`` on, and as ``.inner`` and ``.edges`` say, every visible point of the patch keeps the
                      tolerance. ``"slefe"``, the published estimate ([YBP12], (7) to (10)), which is no bound. The
                      rules of ``slefejax.predict.rules``: ``"filip"`` (a bound), ``"minmax"``, ``"edge-length"``,
                      ``"screen-box"``, ``"fixed"``
    tolerance       : pixels
    depth_tolerance : window depth (0 to 1), or None for no depth test; of ``certified`` and ``slefe``
    normal_tolerance : degrees, more than 0 and less than 90, or None; of ``certified``. Interpolated normals, as a
                      ``Renderer(…, normals=…)`` draws them, are where they are seen no further from the exact ones, on
                      all patches but those ``without_normal``, whose normals do not exist somewhere, such as at cusps
    normals         : which these are: ``"surface"``, p_u x p_v, or ``"tangents"``, the cross product of tangent patches
    tangents        : these, along u ``(patches, du, dv+1, 3)`` and along v, as ``scene.tangents()`` returns them
    edge_numbers    : ``(patches, 4)``, the result of ``shared_edges``, if it is already known
    knobs           : numbers of the method, where that is given by name; None is what the method takes by itself.
                      Of ``certified`` (``methods.Certified`` says more): ``tiles``, 2; ``anisotropic``, ``verify``,
                      False; ``pattern``. Of ``slefe``: ``segments`` m or (m_u, m_v), 3; the constant ``k``, 1. Of both
                      ``smooth``, a temperature, 0 < smooth <= 1: maxima become soft ones, never smaller (at most
                      N^smooth times as large, of N numbers), so that ``.factor`` can be differentiated where they tie
                      (docs/gradients.md). ``setting`` of ``edge-length`` (pixels a piece, 8), ``screen-box`` (mu,
                      pixels, 1) and ``fixed`` (the factor, 16)

    Returns Factors: ``.factor`` (at least 1 on the screen, 0 off it), ``.inner`` and ``.edges``.
    ``slefe``: only tiles whose boxes reach into the view volume count; where a box touches or lies behind the near
    plane it is measured as if it lay in it, which is as near as anything is drawn; nothing is divided by a smaller W.
    ``.factor`` is differentiable by patches, camera, tolerance and the methods' real numbers, in forward and reverse
    mode; derivatives are finite everywhere (docs/gradients.md). Traced numbers out of their range give NaN.

    Raises InputError for wrong shapes, control points that are not finite (with the patch's number), segments or tiles
    < 1, a tolerance or k that is not positive, a temperature beyond its range, numbers that the method does not have,
    or results that overflow.

    >>> from slefejax import Camera, load
    >>> scene = load("teapot")
    >>> view = View(Camera.look_at((4.5, -6.0, 4.0), (0.0, 0.0, 1.2)), width=1440, height=900)
    >>> tessellation_factors(scene.patches(), view).factor.shape
    (32,)
    """
    packed = pack(patches)
    options = {
        "method": method,
        "tolerance": tolerance,
        "depth_tolerance": depth_tolerance,
        "normal_tolerance": normal_tolerance,
        **knobs,
    }
    request = Request.of(options, packed.dimension)
    check_view(view)
    prepared = shaded(request, Prepared(packed), normals, tangents)
    return predicted(request, prepared, view, _checked(edge_numbers, packed))


def shaded(request: Request, prepared: Prepared, normals: str = "surface", tangents: Any = None) -> Prepared:
    """What was prepared, with the normals that have to be right if there is a tolerance for them.

    Raises InputError for tangents as ``tessellation_factors`` does.
    """
    kind = kind_of_normals(normals)
    if request.normal_tolerance is None:
        if tangents is not None or kind == "tangents":
            raise InputError(
                "normals and tangents are for a normal_tolerance: give one", options=("normals", "normal_tolerance")
            )
        return prepared
    packed, method = prepared.packed, request.method
    nets = tangent_nets(packed.patches(), kind, tangents)
    shading = Shading(packed, nets, request.normal_tolerance, method.maxima, int(method.tiles))
    return prepared._replace(shading=shading)


def prepared_by(method: Method, packed: Packed) -> Prepared:
    """What all views of patches share, for this method: its pose pass."""
    if isinstance(method, Kernel):
        return method.prepare(packed)
    return Prepared(packed, method.prepare(packed.patches()))


def predicted(
    request: Request, patches: Any, view: View, edge_numbers: Any = None, memory: Memory | None = None
) -> Factors:
    """``tessellation_factors`` of what was checked: of ``prepared_by``'s result, or of packed patches at once.

    memory : what is known of the levels of these patches in this view
    """
    method, tolerances = request[:2]
    if isinstance(method, Kernel):
        prepared = Prepared.of(patches)
        factor = method.factor(prepared, view, tolerances)
    else:
        prepared = prepared_by(method, patches.packed if isinstance(patches, Prepared) else patches)
        factor = _of_ones_own(method, method.factor(prepared.made, view, tolerances), len(prepared.packed))
    return _settled(factor, request, prepared, view, edge_numbers, memory)


def _checked(edge_numbers: Any, packed: Packed) -> Any:
    return None if edge_numbers is None else check_edge_numbers(edge_numbers, len(packed))


def _of_ones_own(method: Method, factor: Any, count: int) -> Any:
    """Factors that a method of one's own made, or InputError if they are none."""
    factor = jnp.asarray(factor)
    if factor.shape != (count,) or not jnp.issubdtype(factor.dtype, jnp.number):
        raise InputError(
            f"method {name_of(method)!r} must make real factors of shape ({count},), not {factor.dtype} {factor.shape}"
        )
    factor = factor.astype(jnp.result_type(factor.dtype, jnp.float32))
    if not isinstance(factor, Tracer):
        bad = np.flatnonzero(~(np.isfinite(factor) & (np.asarray(factor) >= 0)))
        if bad.size:
            raise InputError(
                f"method {name_of(method)!r} made the factor {factor[bad[0]]:g} of patch {bad[0]} (counted from 0):"
                " factors must be finite, and at least 0"
            )
    return factor


def _settled(
    factor: Any, request: Request, prepared: Prepared, view: View, edge_numbers: Any, memory: Memory | None = None
) -> Factors:
    """Factors with what their levels need; of certified ones also whole numbers, where they are asked for."""
    method, tolerances, shading = *request[:2], prepared.shading
    factor, without = (factor, None) if shading is None else shading.joined(factor)
    if isinstance(factor, Tracer):
        if isinstance(method, Certified) and method.whole:
            raise InputError("anisotropic and verify find whole numbers: ask for them outside of jit and grad")
        return Factors(factor, request, known=edge_numbers, without_normal=without)
    packed = prepared.packed
    _check_result(np.asarray(factor), packed.patches)
    if not isinstance(method, Certified):
        return Factors(factor, request, packed, edge_numbers)
    certify = _Certify(method, prepared, view, tolerances, np.asarray(factor), memory or Memory())
    if method.verify:
        factor = verified_factors(np.asarray(factor), certify().even_errors)
    pairs = small_grids(certify(), anisotropic=True) if method.anisotropic else None
    return Factors(factor, request, packed, edge_numbers, pairs, certify, without)


@dataclass(frozen=True, eq=False)
class _Certify:
    """Makes the certificate of some factors, once, when it is asked for; it can be pickled."""

    method: Certified
    prepared: Prepared
    view: View
    tolerances: Tolerances
    factor: np.ndarray
    memory: Memory

    def __call__(self) -> Certificate:
        return self._certificate

    @property
    def packed(self) -> Packed:
        """The patches."""
        return self.prepared.packed

    @cached_property
    def _certificate(self) -> Certificate:
        tolerances = jax.tree.map(lambda number: jnp.asarray(number, self.packed.dtype), tuple(self.tolerances))
        tiles, pattern, pictures = (
            self.method.formula.tiles,
            self.method.drawn_with,
            Pictures(self._on_screen, len(self.packed)),
        )
        # bounds of twist terms are loose on large cells
        loose = self.packed.gregory
        closer = loose and self.method.levels == "fewest"
        claim = None if self.prepared.shading is None else self.prepared.shading.claim()
        given = self._given, tolerances, tiles, pattern, self.factor, pictures, self.memory
        return Certificate(*given, closer, loose, claim)

    def _given(self) -> tuple[Any, Projection]:
        chunks, projection = self.packed.placed(self.view)
        control = jax.tree.map(lambda x: layout.unpack_on_host(x, len(self.packed)), chunks)
        near = projection.relative(control, axis=-1)
        return GregoryPatches(*near) if isinstance(near, Twisted) else near, projection

    def _on_screen(self, which: np.ndarray) -> Pictured:
        """In double precision, whatever the patches are in."""
        patches = on_host(self.packed.patches())[which]
        return Pictured.of(as_control(patches), Projection.of(self.view), self.tolerances)


def _scaled(certify: Callable[[], Certificate], scale: float) -> Certificate:
    return certify().scaled(scale)


def _check_result(factor: np.ndarray, make_patches: Callable[[], Any]) -> None:
    bad = np.flatnonzero(~np.isfinite(factor))
    if bad.size == 0:
        return
    patches = on_host(make_patches())
    numbers = np.concatenate([x[bad[0]].ravel() for x in jax.tree.leaves(patches)])
    where = f"patch {bad[0]}" + (f" and {bad.size - 1} more" if bad.size > 1 else "")
    if not np.isfinite(numbers).all():
        raise InputError(f"{where} (counted from 0) has control points that are not finite numbers: repair or drop it")
    raise InputError(
        f"the factor of {where} (counted from 0) overflows {factor.dtype}: scale the scene, raise the tolerance or move"
        " the near plane away from the eye"
    )
