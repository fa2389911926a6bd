"""A scene: patches and the camera to look at them with."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import prod
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from slefejax.arguments import Number, check_not_negative, did_you_mean
from slefejax.conversion.acc import ALPHA
from slefejax.conversion.common import blocks_of, common_degree, common_weights, patches_of
from slefejax.conversion.nurbs import bezier_axis, spline_patches
from slefejax.conversion.patchwork import KINDS
from slefejax.conversion.scheme import Conversion, Scheme, convert
from slefejax.conversion.weld import places, weld_tolerance, welded
from slefejax.data.small import (
    QUAD_EYE,
    QUAD_TARGET,
    STEEP_EYE,
    STEEP_FOV,
    STEEP_TARGET,
    steep_patch,
    twisted_quad,
)
from slefejax.data.teapot import EYE, TARGET, teapot
from slefejax.data.walker import walker
from slefejax.errors import InputError, naming
from slefejax.framing import PAPERS_SHARE, frame_share
from slefejax.geometry.gregory import GregoryPatches
from slefejax.geometry.view import LARGEST, Camera, Vector
from slefejax.io.bpt import read_bpt, write_bpt
from slefejax.io.bv import read_bv
from slefejax.io.content import Z_UP, Content, Spline
from slefejax.io.copies import with_copies
from slefejax.io.gltf.read import read_gltf
from slefejax.io.limits import check_corners, check_numbers, check_spline
from slefejax.io.makehuman import read_makehuman
from slefejax.io.obj import read_obj
from slefejax.io.pair import read_pair, write_pair
from slefejax.io.ply.read import read_ply
from slefejax.io.rhino.read import read_3dm
from slefejax.io.usd.read import read_usd
from slefejax.model.defects import check_manifold, isolated_vertices, without_defects
from slefejax.model.mesh import Mesh
from slefejax.model.rig import Deformation, Pose, Rig
from slefejax.tessellator.edges import Sides


@dataclass(frozen=True, eq=False)
class Scene:
    """Patches with a name, where they come from, and what was noticed when they were read.

    control    : ``(patches, du+1, dv+1, 3)`` float64, 4 at the end if rational, at rest; or ``GregoryPatches``
    camera     : the camera that belongs to the scene, or None: ``default_camera`` then frames it
    notes      : sentences about what loading changed or left out
    up         : the direction that is up
    faces      : ``(patches,)``, the face, the surface or the patch of the file that each comes from
    kinds      : ``(patches,)``, numbers in ``slefejax.conversion.patchwork.KINDS``
    conversion : of a control mesh: how patches are made of it, differentiably, in any pose; None for other scenes
    rig        : what moves the control mesh; None if nothing does. The vertices of ``conversion.mesh`` are those that
                 it moves; ``vertices()`` are where they stand at rest

    >>> load("teapot").points().shape
    (512, 3)
    """

    name: str
    control: Any
    camera: Camera | None = None
    notes: tuple[str, ...] = field(default=())
    up: tuple[float, float, float] = Z_UP
    faces: Int[np.ndarray, "patches"] | None = None
    kinds: Int[np.ndarray, "patches"] | None = None
    conversion: Conversion | None = None
    rig: Rig | None = None

    def patches(self) -> Any:
        """Control points at rest, ``(patches, du+1, dv+1, 3)``, u before v; ``GregoryPatches`` of that scheme."""
        return self.control

    def vertices(self, pose: Any = None, deform: Deformation | None = None) -> Any:
        """Positions ``(vertices, 3)`` of the control mesh in a pose, by JAX; differentiable by it.

        pose   : a time of the scene's motion, a ``Pose`` (``Scene.rig.pose`` makes some), or None for the pose at rest
        deform : how bones move vertices: ``linear_blend``, ``dual_quaternion_blend``, or a function like them; None: as
                 the file says, linear if it says nothing

        Raises InputError for a scene without a control mesh, for a time before the first or after the last sample, and
        for a pose of another rig.
        """
        if self.conversion is None:
            raise InputError(f"{self.name} is no control mesh: there are no vertices to move")
        rest = jnp.asarray(self.conversion.mesh.vertices)
        if self.rig is None:
            return rest
        return self.rig.posed(rest, pose if isinstance(pose, Pose) else self.rig.pose(pose), deform)

    def pose(self, pose: Any = None, deform: Deformation | None = None) -> Any:
        """Control points of all patches in a pose, ``(patches, du+1, dv+1, 3)``: those at rest if nothing moves.

        Pose and deform as in ``vertices``.
        """
        if self.rig is None or self.conversion is None:
            return self.control
        return self.conversion.patchwork.patches(self.vertices(pose, deform))

    def posed(self, pose: Any, deform: Deformation | None = None) -> Scene:
        """The scene as it stands in a pose, with nothing that moves any more.

        >>> load("walker").posed(6.0).rig is None
        True
        """
        if self.conversion is None or self.rig is None:
            raise InputError(f"{self.name} does not move: it has no pose but the one at rest")
        vertices = np.asarray(self.vertices(pose, deform), np.float64)
        conversion = replace(self.conversion, mesh=replace(self.conversion.mesh, vertices=vertices))
        control = conversion.patchwork.on_host(vertices)
        return replace(self, control=control, conversion=conversion, rig=None)

    @cached_property
    def sides(self) -> Sides:
        """Which curve each side is, found once: of a control mesh from its topology, otherwise from the points."""
        return Sides.of(self.control) if self.conversion is None else self.conversion.patchwork.sides

    @property
    def edge_numbers(self) -> Int[np.ndarray, "patches 4"]:
        """Which edges are shared: whole sides that are one curve have equal numbers."""
        return self.sides.numbers

    def points(self) -> Float[np.ndarray, "points 3"]:
        """All control points, divided by their weights if there are any; of Gregory patches their nets'."""
        if isinstance(self.control, GregoryPatches):
            return np.asarray(self.control.net).reshape(-1, 3)
        points = self.control[..., :3] / (self.control[..., 3:] if self.control.shape[-1] == 4 else 1.0)
        return points.reshape(-1, 3)

    def left_out(self) -> tuple[str, ...]:
        """What is not computed because this scene does not need it, a sentence each."""
        left = []
        if self.rig is None:
            left.append("skinning and shape keys: the scene does not move")
        elif self.rig.skeleton is None:
            left.append("skinning: there is no skeleton")
        elif self.rig.keys is None:
            left.append("shape keys: there are none")
        if self.control.shape[-1] == 3:
            left.append("weights: the patches are polynomial")
        if self.conversion is not None and self.conversion.finer.sizes.min() > 3:
            left.append("triangle stencils: patches come from quads only")
        return tuple(left)

    def tangents(self) -> tuple[Any, Any]:
        """Tangent patches at rest (``Conversion.tangents``). Raises InputError for a scene without a control mesh."""
        if self.conversion is None:
            raise InputError(f"{self.name} is no control mesh: only those have tangent patches")
        return self.conversion.tangents(self.vertices())

    def default_camera(self, aspect: float = 1.6, cover: Number | None = None, up: Vector | None = None) -> Camera:
        """The scene's own camera, or one that frames it in a picture of that width over height.

        cover : the share of the picture that the scene shall cover; .38, as in [YBP12], where it has no own camera.
                Less where all of it would not be on the screen otherwise
        up    : the direction that is up in the picture; the scene's own if not given
        """
        if self.camera is not None and cover is None and up is None:
            return self.camera
        return frame_share(
            self.control, PAPERS_SHARE if cover is None else cover, aspect, self.up if up is None else up
        )


def load(
    path: str | Path,
    scheme: Scheme | str = "auto",
    *,
    alpha: Any = ALPHA,
    steps: Any = None,
    group: Any = None,
    drop_defects: Any = False,
    animation: Any = None,
    copies: Any = 1,
    weld: Any = None,
) -> Scene:
    """A scene from a file (.obj, .ply, .usd…, .gltf, .glb, .json, .3dm, .bpt, .bv), a folder in MakeHuman's formats, or
    by its built-in name (``"teapot"``, ``"walker"``, ``"twisted-quad"``, ``"steep-patch"``).

    scheme, alpha, steps : of control meshes: how patches are made of them (``slefejax.conversion.scheme.convert``)
    group        : of .obj: read only the faces of these groups or objects
    drop_defects : of control meshes: leave out faces that keep them from being manifold, instead of refusing them
    animation    : of .gltf and .glb: the name of the animation, if not the first
    copies       : of control meshes: how many of them stand side by side, and move alike
    weld         : of patches and splines: how far apart sides may be that become one (``slefejax.conversion.weld``), in
                   the file's units; if not given, what its digits leave open, 1e-6 of the scene's size where that
                   cannot be told; 0 leaves them as they are

    Spline surfaces become Bézier patches exactly. Patches of different degrees are raised to the highest ones, and
    polynomial ones beside rational ones get weights of 1, which leaves their shape as it is. What was changed or left
    out stands in the scene's notes.

    Raises InputError for a file that is missing, of an unknown kind, or not what its name says; for options that have
    no meaning for a file of its kind; for a control mesh that is not manifold or that the scheme cannot do with, with
    the number of the face or vertex; for trimmed surfaces.

    >>> load("teapot").patches().shape
    (32, 4, 4, 3)
    """
    options = {
        "copies": copies != 1,
        "alpha": alpha is not ALPHA and not np.array_equal(alpha, ALPHA),
        "steps": steps is not None,
        "drop_defects": drop_defects,
    }
    asked = [name for name, given in {"scheme": scheme != "auto", **options}.items() if given]
    if str(path) in BUILT_IN:
        given = (("group", group), ("animation", animation), ("weld", weld))
        more = [name for name, value in given if value is not None]
        return _built_in(str(path), scheme, alpha, steps, copies, asked + more)
    if not isinstance(path, (str, Path)) or not str(path):
        raise InputError(f"a file name or a built-in scene is needed, not {path!r}")
    if not isinstance(drop_defects, (bool, np.bool_)):
        raise InputError(f"drop_defects must be True or False, not {drop_defects!r}", options=("drop_defects",))
    if weld is not None:
        check_not_negative("weld", weld)
    path = Path(path)
    with naming(path):
        content = read(path, group, animation)
        if content.mesh is None and asked:
            raise InputError(f"{path} holds no control mesh: {asked[0]} has no meaning for it", options=asked[:1])
        if weld is not None and not content.patches and not content.splines:
            said = f"{path} holds a control mesh and nothing else: weld has no meaning for it"
            raise InputError(said, options=("weld",))
        content = content if copies == 1 else with_copies(content, copies)
        return _scene(path, content, scheme, alpha, steps, bool(drop_defects), None if weld is None else float(weld))


def save(scene: Any, path: Any) -> None:
    """Write a scene to a file that ``load`` reads again.

    scene : from ``load``
    path  : ending in .json: the control mesh and its rig, as a pair of files, .json and .npz (docs/animation.md);
            ending in .bpt: the patches, polynomial ones, as they are at rest

    Raises InputError for a scene without a control mesh (.json) or with weights (.bpt), another ending, and for a place
    where nothing can be written.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     save(load("teapot"), Path(folder) / "copy.bpt")
    ...     print(np.array_equal(load(Path(folder) / "copy.bpt").patches(), load("teapot").patches()))
    True
    """
    if not isinstance(scene, Scene) or not isinstance(path, (str, Path)) or not str(path):
        raise InputError("save needs a scene and the name of a .json or .bpt file")
    if Path(path).suffix.lower() == ".bpt":
        if scene.control.shape[3] == 4 or isinstance(scene.control, GregoryPatches):
            kind = "rational" if scene.control.shape[3] == 4 else "Gregory"
            raise InputError(f"{scene.name} has {kind} patches, which a .bpt file cannot hold")
        if not np.isfinite(scene.control).all():
            raise InputError(f"{scene.name} has control points that are not finite: nothing was written")
        return write_bpt(Path(path), scene.patches())
    if scene.conversion is None:
        raise InputError(f"{scene.name} is no control mesh, as a .json file needs one: save the patches as .bpt")
    write_pair(Path(path), scene.conversion.mesh, scene.rig, scene.up)


def read(path: Path, group: Any = None, animation: Any = None) -> Content:
    """What a file holds, before anything is made of it. Raises InputError as ``load`` does."""
    if path.is_dir() and (path / "base.obj").exists():
        return read_makehuman(path, group)
    if path.suffix.lower() == ".fbx":
        raise InputError(f"{path}: FBX is not supported: export the control mesh as .obj or .usd")
    _check_name(path)
    reader = READERS[path.suffix.lower()]
    if group is not None and reader is not read_obj:
        raise InputError(f"{path}: group has a meaning for .obj files only", options=("group",))
    if animation is not None and reader is not read_gltf:
        raise InputError(f"{path}: animation has a meaning for .gltf and .glb files only", options=("animation",))
    if group is not None:
        return read_obj(path, group)
    return reader(path) if animation is None else read_gltf(path, animation)


def _check_name(path: Path) -> None:
    """InputError for a kind of file that is not read, and for a name beside one that is there."""
    meant = "" if os.path.lexists(path) else did_you_mean(path.name, _names_beside(path))
    if path.suffix.lower() not in READERS:
        missing = f"there is no file {path}{meant}, and" if meant else f"{path}:"
        raise InputError(
            f"{missing} files of this kind are not read; give a file ending in {', '.join(READERS)}"
            f" or a built-in scene ({', '.join(BUILT_IN)})"
        )
    if meant:
        raise InputError(f"there is no file {path}{meant}: check the name")


def _names_beside(path: Path) -> list[str]:
    """Names of scenes that a name could be a slip of: files in its folder, and what is built in."""
    try:
        beside = os.listdir(path.parent)
    except (OSError, ValueError):  # a name may hold what no name can
        beside = []
    return [*BUILT_IN, *(name for name in beside if Path(name).suffix.lower() in READERS)]


@dataclass(frozen=True)
class _Part:
    """Patches of one origin, as blocks of one shape each."""

    blocks: list[np.ndarray]
    faces: np.ndarray
    kinds: np.ndarray


def _scene(
    path: Path,
    content: Content,
    scheme: Scheme | str,
    alpha: Any,
    steps: Any,
    drop_defects: bool,
    weld: float | None = None,
) -> Scene:
    notes, parts, conversion, gregory = content.notes, [], None, None
    if content.mesh is not None:
        check_corners(path, len(content.mesh.corners))
        conversion, found = _converted(content.mesh, scheme, alpha, steps, drop_defects)
        notes += found
        work, mesh = conversion.patchwork, conversion.mesh
        rest = mesh.vertices if content.rig is None else content.rig.at_rest(mesh.vertices)
        own: Any = work.on_host(rest)
        gregory = own if isinstance(own, GregoryPatches) else None
        block: Any = own if gregory is None else gregory.net
        if gregory is not None and (content.splines or content.patches):
            raise InputError(f"{path} has surfaces besides its control mesh: Gregory patches are alone, choose 'acc'")
        parts.append(_Part([block], mesh.numbers[work.faces], work.kinds))
    parts += [_spline_part(spline, number) for number, spline in enumerate(content.splines)]
    if content.patches:
        count = len(content.patches)
        parts.append(_Part(blocks_of(content.patches), np.arange(count), np.full(count, KINDS.index("bezier"))))
    blocks, found = common_weights([block for part in parts for block in part.blocks])
    largest = np.max([block.shape[1:] for block in blocks], axis=0).tolist()
    check_numbers(path, "patches of one degree", sum(len(block) for block in blocks) * prod(largest))
    with np.errstate(over="ignore"):  # of small weights
        far = [max(np.abs(block).max(), np.abs(places(block)).max()) for block in blocks]
    if not np.max(far) < LARGEST:
        raise InputError(f"{path} has coordinates of {LARGEST:g} and more: scale it down, or drop what is out there")
    alone = conversion if len(parts) == 1 else None
    if alone is None:
        patches = patches_of(blocks)
        same, said = welded(patches, weld_tolerance(patches, content.digits) if weld is None else weld)
        blocks, found = blocks if same is patches else blocks_of(same), found + said
    control, said = common_degree(blocks) if gregory is None else (gregory, ())
    found += said
    faces, kinds = (np.concatenate([getattr(part, name) for part in parts]) for name in ("faces", "kinds"))
    rig = content.rig if alone is not None else None
    if content.rig is not None and rig is None:
        found += ("the rig was left out: the scene has surfaces besides its control mesh",)
    return Scene(path.stem, control, None, notes + found, content.up, faces, kinds, alone, rig)


def _converted(
    mesh: Mesh, scheme: Scheme | str, alpha: Any, steps: Any, drop_defects: bool
) -> tuple[Conversion, tuple[str, ...]]:
    notes: tuple[str, ...] = ()
    if drop_defects:
        mesh, notes = without_defects(mesh)
    else:
        check_manifold(mesh)
    isolated = isolated_vertices(mesh)
    if isolated.size:
        notes += (f"{isolated.size} vertices belong to no face (the first is {isolated[0]}, counted from 0)",)
    conversion = convert(mesh, scheme, alpha, steps)
    return conversion, notes + conversion.notes


def _spline_part(spline: Spline, number: int) -> _Part:
    if not np.isfinite(spline.control).all():
        raise InputError(f"{spline.name} has control points or weights that are not finite numbers")
    if spline.control.shape[2] == 4 and not np.all(spline.control[..., 3] > 0):
        raise InputError(f"{spline.name} has a weight that is not positive")
    check_spline(spline.name, spline.control.shape[:2], spline.degrees)
    try:
        axes = [
            bezier_axis(spline.knots[k], spline.degrees[k], spline.control.shape[k], spline.bounds[k]) for k in (0, 1)
        ]
    except InputError as error:
        raise error.within(spline.name) from None
    work = spline_patches(spline.control, (axes[0], axes[1]), number)
    flat = spline.control.reshape(-1, spline.control.shape[2])
    return _Part([work.on_host(flat)], work.faces, work.kinds)


def _built_in(name: str, scheme: Scheme | str, alpha: Any, steps: Any, copies: int, asked: list[str]) -> Scene:
    made = BUILT_IN[name]()
    meaningless = [
        option for option in asked if isinstance(made, Scene) or option in ("group", "drop_defects", "animation")
    ]
    if meaningless:
        what = "a list of patches, no control mesh" if isinstance(made, Scene) else "built in"
        raise InputError(f"{name} is {what}: {meaningless[0]} has no meaning for it", options=meaningless[:1])
    if isinstance(made, Scene):
        return made
    with naming(name):
        return _scene(Path(name), with_copies(made, copies), scheme, alpha, steps, False)


def _teapot() -> Scene:
    return Scene("teapot", teapot(), Camera.look_at(EYE, TARGET))


def _twisted_quad() -> Scene:
    return Scene("twisted-quad", twisted_quad(), Camera.look_at(QUAD_EYE, QUAD_TARGET, up=(0.0, 1.0, 0.0)))


def _steep_patch() -> Scene:
    return Scene("steep-patch", steep_patch(), Camera.look_at(STEEP_EYE, STEEP_TARGET, fov_y=STEEP_FOV, near=0.05))


READERS: dict[str, Callable[[Path], Content]] = {
    ".obj": read_obj,
    ".ply": read_ply,
    ".usd": read_usd,
    ".usda": read_usd,
    ".usdc": read_usd,
    ".usdz": read_usd,
    ".gltf": read_gltf,
    ".glb": read_gltf,
    ".json": read_pair,
    ".3dm": read_3dm,
    ".bpt": read_bpt,
    ".bv": read_bv,
}
BUILT_IN: dict[str, Callable[[], Scene | Content]] = {
    "teapot": _teapot,
    "twisted-quad": _twisted_quad,
    "steep-patch": _steep_patch,
    "walker": walker,
}
