"""A scene that is looked at again and again: what has changed is computed anew, what has not is kept.

The two passes of [YBP14], section 4, compiled apart: the *pose pass* makes control points (shape
keys, skinning, conversion) and, for the method that needs them, their slefe boxes; the *view pass* makes factors of
them. A pose that is the same leaves the first one out, a view that is the same too the second one as well. Where the
view is the same and some patches have not moved, what is known of their levels is kept. What a scene
or a method has no need of is not part of the programs at all (``Session.left_out``, ``Session.programs``).
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple, Unpack

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from slefejax.arguments import check_weights
from slefejax.conversion.gaussian.products import Products
from slefejax.errors import InputError
from slefejax.geometry.normals import kind_of_normals
from slefejax.geometry.packed import Packed, chunks_of, pack
from slefejax.geometry.projection import Projection
from slefejax.geometry.view import View, check_view
from slefejax.lanes.memory import Memory
from slefejax.model.gaussians import check_covariances
from slefejax.model.rig import Deformation, Pose, check_time
from slefejax.model.skinning import Influences
from slefejax.model.stencils import StencilTable
from slefejax.predict.estimate import boxes_pass
from slefejax.predict.factors import Factors, predicted, prepared_by, shaded
from slefejax.predict.kernel import Kernel, Prepared, view_pass
from slefejax.predict.methods import Options, Request, Slefe
from slefejax.scene import Scene

PARTS = ("skinning and conversion", "slefe boxes", "view")


class _Tables(NamedTuple):
    """What the pose pass works with; None for what a scene does not have."""

    rest: Any  # (vertices, 3), or Gaussians
    keys: StencilTable | None
    influences: StencilTable | None
    first: StencilTable | None
    points: StencilTable
    products: Products | None
    net: Any  # (chunks, nu, nv, lanes)


class Session:
    """Factors of a scene over time, pose by pose and view by view.

    scene   : from ``load``
    deform  : how bones move vertices: ``linear_blend``, ``dual_quaternion_blend``, or a function like them; None: as
              the file says, linear if it says nothing
    dtype   : float32 or float64; None: float64 if JAX has it
    options : those of ``tessellation_factors``: method, tolerance …

    Raises InputError for options that ``tessellation_factors`` would refuse.

    >>> from slefejax import Session, View, load
    >>> scene = load("walker")
    >>> view = View(scene.default_camera(), 1440, 900)
    >>> session = Session(scene, method="slefe")
    >>> first = session.factors(view, 0.0)
    >>> session.recomputed
    ('pose', 'view')
    >>> session.factors(view, 0.0) is first, session.recomputed
    (True, ())
    """

    recomputed: tuple[str, ...]
    """Which of the passes ``"pose"`` and ``"view"`` the last call of ``factors`` ran."""
    seconds: dict[str, float]
    """How long each of PARTS took in that call; 0 for what was kept. The first call of each compiles."""

    def __init__(
        self, scene: Scene, *, deform: Deformation | None = None, dtype: Any = None, **options: Unpack[Options]
    ) -> None:
        if not isinstance(scene, Scene):
            raise InputError(f"a session is of a slefejax.Scene, as load gives it, not of {type(scene).__name__}")
        check_weights(scene.control)
        self.scene = scene
        self.request = Request.of(options, scene.control.shape[3])
        self._normals = kind_of_normals(options.get("normals", "surface"))
        if deform is not None and not callable(deform):
            raise InputError(f"deform must be a function such as slefejax.linear_blend, not {deform!r}")
        if dtype is not None and str(getattr(dtype, "__name__", dtype)) not in ("float32", "float64"):
            raise InputError(f"dtype must be float32 or float64, not {dtype!r}")
        self._deform = deform
        self._dtype = jax.dtypes.canonicalize_dtype(np.float64 if dtype is None else dtype)
        self._tables = self._make_tables()
        self._pose_pass = jax.jit(self._move)
        self.recomputed, self.seconds = (), dict.fromkeys(PARTS, 0.0)
        self._forget()

    def _forget(self) -> None:
        """Nothing has been computed yet."""
        self._at: _Snapshot | None = None
        self._prepared: Prepared | None = None
        self._patches: Any = None
        self._seen: tuple[_Snapshot, Factors] | None = None
        self._known: _Known | None = None

    def __getstate__(self) -> dict[str, Any]:
        """For pickle and copy: what was computed, without what is compiled or made of the scene.

        A ``deform`` of one's own has to be a function that pickle finds by its name, no lambda.
        """
        return {name: value for name, value in vars(self).items() if name not in ("_pose_pass", "_tables")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Where JAX has another precision than where the session comes from, everything is computed anew."""
        vars(self).update(state)
        dtype = jax.dtypes.canonicalize_dtype(self._dtype)
        if dtype != self._dtype:
            self._dtype = dtype
            self._forget()
        self._tables = self._make_tables()
        self._pose_pass = jax.jit(self._move)

    @property
    def moves(self) -> bool:
        """Whether the scene has a rig, or covariances: otherwise there is one pose only."""
        return self._tables is not None

    def factors(self, view: View, pose: Any = None) -> Factors:
        """The factors of the scene in a pose, seen so; what is still valid is kept (``recomputed``, ``seconds``).

        pose : a time of the scene's motion, a ``Pose`` (``Scene.rig.pose`` makes some), or None for the pose at rest

        Raises InputError for a time outside of the motion, a pose of another rig, or as ``tessellation_factors`` does.
        """
        if isinstance(jnp.zeros(()), Tracer):
            raise InputError("a session keeps what it computed: inside of jit and grad call Scene.pose instead")
        self.recomputed, self.seconds = (), dict.fromkeys(PARTS, 0.0)
        moved = self._update_pose(pose)
        looked = self._seen is None or not _same(self._seen[0], view)
        if looked:
            self._seen = None
            check_view(view)
            known = self._known = self._still_known(view)
            self._seen = (known.view, self._timed("view", lambda: self._look(view, known.memory)))
        assert self._seen is not None
        self.recomputed = ("pose",) * moved + ("view",) * looked
        return self._seen[1]

    @property
    def patches(self) -> Any:
        """Control points of the pose of the last call, at first those at rest, ``(patches, du+1, dv+1, 3)``."""
        if self._prepared is None:
            self._update_pose(None)
        assert self._prepared is not None
        if self._patches is None:
            found = self._prepared.packed.patches()
            for array in jax.tree.leaves(found):
                array.flags.writeable = False
            self._patches = found
        return self._patches

    @property
    def tangents(self) -> Any:
        """Tangent patches of that pose, as ``Renderer.move`` takes them; None unless ``normals`` are theirs."""
        if self._prepared is None:
            self._update_pose(None)
        assert self._prepared is not None
        return None if self._prepared.shading is None else self._prepared.shading.tangents

    def left_out(self) -> tuple[str, ...]:
        """What is not computed, because the scene has no need of it or it was not asked for; a sentence each."""
        return (*self.scene.left_out(), *self.request.left_out())

    def programs(self, view: View, pose: Any = None) -> dict[str, Any]:
        """The traced programs (jaxprs) of PARTS: what really runs when a pose and a view are new.

        >>> from slefejax import View, load
        >>> teapot = load("teapot")
        >>> sorted(Session(teapot).programs(View(teapot.default_camera(), 1440, 900)))
        ['view']
        """
        found = {}
        check_view(view)
        chunks, at = self._chunks(), self._checked(pose)
        if self.moves:
            with self.scene.conversion.precision():  # type: ignore[union-attr]
                found[PARTS[0]], chunks = jax.make_jaxpr(self._move, return_shape=True)(self._tables, at)
        method, tolerances, degrees = self.request
        if not isinstance(method, Kernel):
            return found
        seen = (chunks, None, None)
        if isinstance(method, Slefe):
            found["slefe boxes"], boxes = jax.make_jaxpr(boxes_pass, static_argnums=3, return_shape=True)(
                chunks, np.zeros(3, self._dtype), method.maxima, method.formula.segments
            )
            seen = (chunks if chunks.shape[3] == 4 else None, *boxes)
        projection = Projection.of(view, self._dtype)
        found["view"] = jax.make_jaxpr(view_pass)(seen, projection, *method.numbers(tolerances, self._dtype))
        if degrees is not None:
            prepared = shaded(
                self.request, Prepared(pack(self.patches)), self._normals or "surface", self._tangents(pose)
            )
            assert prepared.shading is not None
            found["normals"] = prepared.shading.program()
        return found

    def memory(self) -> dict[str, int]:
        """Bytes of what is kept between calls: tables, control points and slefe boxes, as far as they are there."""
        packed, made = (None, None) if self._prepared is None else self._prepared[:2]
        kept = {"tables": self._tables, "control points": packed, "slefe boxes": made}
        return {name: sum(x.nbytes for x in jax.tree.leaves(part)) for name, part in kept.items()}

    def _make_tables(self) -> _Tables | None:
        scene = self.scene
        if self.scene.mover is None or scene.conversion is None:
            return None
        work, rig = scene.conversion.patchwork, self.scene.mover
        tables = _Tables(
            scene.conversion.control,
            rig.keys.table if rig.keys else None,
            rig.influences.table if rig.influences else None,
            work.first,
            work.points,
            work.products,
            work.packed_net,
        )
        floating = lambda x: jnp.issubdtype(jnp.result_type(x), jnp.floating)  # noqa: E731
        with scene.conversion.precision():
            dtype = self._dtype if work.products is None else jnp.float64
            return jax.tree.map(lambda x: jnp.asarray(x, dtype) if floating(x) else jnp.asarray(x), tables)

    def _chunks(self) -> Any:
        """The control points of a scene that does not move, in the layout of the kernels."""
        return pack(self.scene.control.astype(self._dtype)).chunks

    def _checked(self, pose: Any) -> Any:
        """What the pose pass takes: a Pose, or a number."""
        if pose is not None and not isinstance(pose, Pose):
            check_time(pose)
        rig = self.scene.mover
        if rig is None or not self.moves:
            return None
        if isinstance(pose, Pose) and pose.covariances is not None and self.scene.conversion is not None:
            mesh = self.scene.conversion.mesh
            pose = pose._replace(covariances=check_covariances(pose.covariances, mesh.vertex_count))
        if pose is None or rig.motion is None or isinstance(pose, Pose):
            found = rig.check(pose if isinstance(pose, Pose) else Pose())
            return jax.tree.map(lambda x: np.asarray(x, np.float64), found)
        rig.motion.check(pose)
        return np.float64(pose)

    def _update_pose(self, pose: Any) -> bool:
        """Make the control points of a pose, and their boxes, unless they are there."""
        at = self._checked(pose)
        if self._prepared is not None and self._at is not None and _same(self._at, at):
            return False
        chunks = self._timed(PARTS[0], lambda: self._moved(at) if self.moves else self._chunks())
        packed = Packed.made(chunks, len(self.scene.control), rounded=self.scene.control.dtype != self._dtype)
        prepared = self._timed(PARTS[1], lambda: prepared_by(self.request.method, packed))
        if prepared.made is None:
            self.seconds[PARTS[1]] = 0.0
        self._prepared = shaded(self.request, prepared, self._normals or "surface", self._tangents(pose))
        self._at = _snapshot(at)
        self._patches = self._seen = None
        return True

    def _tangents(self, pose: Any) -> Any:
        """Tangent patches, where normals are theirs."""
        return self.scene.tangents(pose, self._deform) if self._normals == "tangents" else None

    def _moved(self, at: Any) -> Any:
        """What the pose pass makes, in the precision that it needs."""
        assert self.scene.conversion is not None
        with self.scene.conversion.precision():
            return self._pose_pass(self._tables, at)

    def _move(self, tables: _Tables, at: Any) -> Any:
        """The pose pass: shape keys, skinning, conversion, into the layout of the kernels."""
        rig, conversion = self.scene.mover, self.scene.conversion
        assert rig is not None
        assert conversion is not None
        keys = None if rig.keys is None else replace(rig.keys, table=tables.keys)
        influences = None if tables.influences is None else Influences(tables.influences)
        rig = replace(rig, keys=keys, influences=influences)
        pose = rig.check(at if isinstance(at, Pose) else rig.pose(at))
        pose = jax.tree.map(lambda x: x.astype(jax.tree.leaves(tables.rest)[0].dtype), pose)
        work = replace(conversion.patchwork, first=tables.first, points=tables.points, products=tables.products)
        points = work.control_points(rig.posed(tables.rest, pose, self._deform))
        return chunks_of(points.astype(self._dtype), tables.net)

    def _still_known(self, view: View) -> _Known:
        """What is known of the levels of the patches that are now to be seen so."""
        assert self._prepared is not None
        chunks, count = self._prepared.packed.chunks, len(self._prepared.packed)
        at, memory, before = _snapshot(view), Memory(), self._known
        if before is not None and _same(before.view, view):
            memory = before.memory.after(_unchanged(before.chunks, chunks)[:count])
        return _Known(at, chunks, memory)

    def _look(self, view: View, memory: Memory) -> Factors:
        return predicted(self.request, self._prepared, view, self.scene.edge_numbers, memory)

    def _timed(self, part: str, work: Callable[[], Any]) -> Any:
        start = clock.perf_counter()
        found = work()
        jax.block_until_ready(found)
        self.seconds[part] = clock.perf_counter() - start
        return found


class _Known(NamedTuple):
    """What is known of the levels of patches in a view."""

    view: _Snapshot
    chunks: Any
    memory: Memory


def _unchanged(before: Any, now: Any) -> np.ndarray:
    """Which patches have the same control points, of chunks."""
    pairs = zip(jax.tree.leaves(before), jax.tree.leaves(now), strict=True)
    same = [np.all(np.asarray(a) == np.asarray(b), axis=tuple(range(1, a.ndim - 1))) for a, b in pairs]
    return np.all(same, axis=0).ravel()


class _Snapshot(NamedTuple):
    """A tree of numbers as it was: whoever owns the arrays may go on to change them."""

    structure: Any
    leaves: list[np.ndarray]


def _snapshot(tree: Any) -> _Snapshot:
    return _Snapshot(jax.tree.structure(tree), [np.array(leaf) for leaf in jax.tree.leaves(tree)])


def _same(before: _Snapshot, tree: Any) -> bool:
    """Whether a tree is as it was, number by number."""
    return before.structure == jax.tree.structure(tree) and all(
        np.array_equal(a, b) for a, b in zip(before.leaves, jax.tree.leaves(tree), strict=True)
    )
