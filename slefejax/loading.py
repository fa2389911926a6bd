"""Scenes from files and built-in names, and to files."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from slefejax.arguments import check_not_negative, did_you_mean
from slefejax.conversion.acc import ALPHA
from slefejax.conversion.common import blocks_of, common_degree, common_weights, patches_of
from slefejax.conversion.gaussian.products import check_spread
from slefejax.conversion.nurbs import bezier_axis, spline_patches
from slefejax.conversion.patchwork import KINDS
from slefejax.conversion.scheme import Conversion, Scheme, convert
from slefejax.conversion.weld import places, weld_tolerance, welded
from slefejax.data.ring import ring
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
from slefejax.geometry.gregory import GregoryPatches
from slefejax.geometry.view import LARGEST, Camera
from slefejax.io.bpt import read_bpt, write_bpt
from slefejax.io.bv import read_bv
from slefejax.io.content import Content, Spline
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
from slefejax.model.gaussians import with_gaussians
from slefejax.model.mesh import Mesh
from slefejax.scene import Scene


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
    gaussians: Any = None,
    allow_thin: Any = False,
) -> Scene:
    """A scene from a file (.obj, .ply, .usd…, .gltf, .glb, .json, .3dm, .bpt, .bv), a folder in MakeHuman's formats, or
    by its built-in name (``"teapot"``, ``"walker"``, ``"ring"``, ``"twisted-quad"``, ``"steep-patch"``).

    scheme, alpha, steps : of control meshes: how patches are made of them (``slefejax.conversion.scheme.convert``)
    group        : of .obj: read only the faces of these groups or objects
    drop_defects : of control meshes: leave out faces that keep them from being manifold, instead of refusing them
    animation    : of .gltf and .glb: the name of the animation, if not the first
    copies       : of control meshes: how many of them stand side by side, and move alike
    weld         : of patches and splines: how far apart sides may be that become one (``slefejax.conversion.weld``), in
                   the file's units; if not given, what its digits leave open, 1e-6 of the scene's size where that
                   cannot be told; 0 leaves them as they are
    gaussians    : of control meshes, for ``scheme="gaussian"``, which is ``"auto"`` then: ``"infer"``, a radius in the
                   file's units, or covariances ``(vertices, 3, 3)`` (``slefejax.model.gaussians``), instead of those
                   that the file has
    allow_thin   : of these: take patches whose weights differ by more than 10^6; see ``rounding_error``

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
        "gaussians": gaussians is not None,
    }
    asked = [name for name, given in {"scheme": scheme != "auto", **options}.items() if given]
    how = _How(scheme, alpha, steps, drop_defects, weld, allow_thin)
    if str(path) in BUILT_IN:
        given = (("group", group), ("animation", animation), ("weld", weld))
        more = [name for name, value in given if value is not None]
        return _built_in(str(path), how, gaussians, copies, asked + more)
    if not isinstance(path, (str, Path)) or not str(path):
        raise InputError(f"a file name or a built-in scene is needed, not {path!r}")
    if not isinstance(drop_defects, (bool, np.bool_)):
        raise InputError(f"drop_defects must be True or False, not {drop_defects!r}", options=("drop_defects",))
    if not isinstance(allow_thin, (bool, np.bool_)):
        raise InputError(f"allow_thin must be True or False, not {allow_thin!r}", options=("allow_thin",))
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
        return _scene(path, _prepared(content, gaussians, copies), how)


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


class _How(NamedTuple):
    """What is asked for of a scene, as ``load`` takes it."""

    scheme: Scheme | str
    alpha: Any
    steps: Any
    drop_defects: Any
    weld: Any
    allow_thin: Any


def _prepared(content: Content, gaussians: Any, copies: Any) -> Content:
    """With covariances if they are given, and so many times."""
    if gaussians is not None and content.mesh is not None:
        content = replace(content, mesh=with_gaussians(content.mesh, gaussians))
    return content if copies == 1 else with_copies(content, copies)


@dataclass(frozen=True)
class _Part:
    """Patches of one origin, as blocks of one shape each."""

    blocks: list[np.ndarray]
    faces: np.ndarray
    kinds: np.ndarray


def _scene(path: Path, content: Content, how: _How) -> Scene:
    notes, parts, conversion, gregory = content.notes, [], None, None
    if content.mesh is not None:
        check_corners(path, len(content.mesh.corners))
        conversion, found = _converted(content.mesh, how)
        work, mesh = conversion.patchwork, conversion.mesh
        rest = conversion.control if content.rig is None else content.rig.at_rest(conversion.control)
        own: Any = work.on_host(rest)
        if work.products is not None:
            found += check_spread(own, mesh, work.faces, bool(how.allow_thin))
        notes += found
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
        same, said = welded(patches, weld_tolerance(patches, content.digits) if how.weld is None else float(how.weld))
        blocks, found = blocks if same is patches else blocks_of(same), found + said
    control, said = common_degree(blocks) if gregory is None else (gregory, ())
    found += said
    faces, kinds = (np.concatenate([getattr(part, name) for part in parts]) for name in ("faces", "kinds"))
    rig = content.rig if alone is not None else None
    if content.rig is not None and rig is None:
        found += ("the rig was left out: the scene has surfaces besides its control mesh",)
    return Scene(path.stem, control, None, notes + found, content.up, faces, kinds, alone, rig)


def _converted(mesh: Mesh, how: _How) -> tuple[Conversion, tuple[str, ...]]:
    notes: tuple[str, ...] = ()
    if how.drop_defects:
        mesh, notes = without_defects(mesh)
    else:
        check_manifold(mesh)
    isolated = isolated_vertices(mesh)
    if isolated.size:
        notes += (f"{isolated.size} vertices belong to no face (the first is {isolated[0]}, counted from 0)",)
    conversion = convert(mesh, how.scheme, how.alpha, how.steps)
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


def _built_in(name: str, how: _How, gaussians: Any, copies: Any, asked: list[str]) -> Scene:
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
        return _scene(Path(name), _prepared(made, gaussians, copies), how)


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
    "ring": ring,
}
