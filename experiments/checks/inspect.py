"""What is in a file, what conversion makes of it, and how it looks."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from slefejax import Scene, View, tessellation_factors
from slefejax.conversion.acc import acc_patches
from slefejax.conversion.patchwork import KINDS
from slefejax.errors import InputError, NoOpenGLError
from slefejax.experiments.bench.savings import METHODS, savings
from slefejax.experiments.checks.limit import distance_row
from slefejax.experiments.checks.reflected import reflected
from slefejax.experiments.moves.outlines import outlines
from slefejax.experiments.options import (
    FigureOptions,
    LoadOptions,
    ViewOptions,
    applicable,
    camera_record,
    option_names,
)
from slefejax.experiments.report import Report
from slefejax.experiments.shading import ShadingOptions, both_tolerances, unclaimed
from slefejax.experiments.store import Row, Run, digest
from slefejax.experiments.studies.look import Look, Shown
from slefejax.experiments.studies.measures import normals, slips
from slefejax.figures.checks.inspect import Panels, write_inspect_figure
from slefejax.figures.checks.limit import Pictures, write_normal_figure
from slefejax.figures.fitting import short
from slefejax.io.content import Y_UP, Z_UP, Content
from slefejax.loading import BUILT_IN, read
from slefejax.model.defects import find_defects, isolated_vertices
from slefejax.model.mesh import Mesh
from slefejax.predict.methods import Certified
from slefejax.tessellator.coincidence import coincident_sides
from slefejax.tessellator.edges import collapsed
from slefejax.tessellator.levels import HIGHEST_LEVEL, triangle_counts

_MOST_COMPARED = 80_000  # control points: of more it would take long to know how far the limit surface is
_SAY_UP = (".usd", ".usda", ".usdc", ".usdz", ".gltf", ".glb", ".json", ".3dm")


@dataclass(frozen=True)
class Inspect:
    """Counts, valences, boundaries, defects; what patches are made and by what tables; a picture of all that."""

    scene: tyro.conf.Positional[str]
    """A file (.obj, .usd…, .glb, …: the README lists them), or walker, teapot, twisted-quad, steep-patch."""
    tolerance: float = 0.5
    """Error in pixels for the factors that the picture shows."""
    shading: tyro.conf.OmitArgPrefixes[ShadingOptions] = field(default_factory=ShadingOptions)
    reflections: bool = False
    """Draw stripes that normals of the surface reflect, and those of tangent patches beside them: reflections.png."""
    savings: bool = False
    """Measure what leaving out saves: the passes with what the scene has no need of put in."""
    loading: tyro.conf.OmitArgPrefixes[LoadOptions] = field(default_factory=LoadOptions)
    camera: tyro.conf.OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)
    output: tyro.conf.OmitArgPrefixes[FigureOptions] = field(default_factory=FigureOptions)

    def run(self) -> Report:
        """Read, count, convert, draw."""
        self.shading.check()
        content = self._content()
        row: Row = {} if content is None or content.mesh is None else mesh_row(content.mesh)
        try:
            scene = self.loading.load(self.scene)
        except InputError as error:
            if content is None or content.mesh is None or self.loading.drop_defects or not find_defects(content.mesh):
                raise
            return self._refused(content, row, error.typed(option_names(self)))
        row |= patch_row(scene) | rig_row(scene) | {"up": _up(scene, Path(self.scene))}
        view = self.camera.view(scene)
        if scene.conversion is not None and np.prod(scene.patches().shape[:3]) <= _MOST_COMPARED:
            row |= distance_row(scene, view)
        if self.reflections:
            scene.tangents()  # a scene without is refused before anything is drawn
        shown = Shown(scene, view, self.tolerance, shaded=self.shading.of(scene))
        arguments = {**asdict(self), "output": None, "camera": camera_record(view)}
        with Run(
            "inspect", arguments, self.output.out, {"scene": digest(scene.patches().tobytes())}, self.output.pages(self)
        ) as run:
            notes = (*scene.notes, *(f"not needed: {what}" for what in scene.left_out()))
            found, said = _picture(shown, run)
            row |= found
            notes += _unshared(row) + said
            notes += _reflections(scene, view, self.tolerance, run) if self.reflections else ()
            saved = savings(scene, view) if self.savings else []
            left = applicable(METHODS, scene)[1] if self.savings else ""
            notes += (left,) * bool(left)
            out = run.finish([row], {"scene": scene.name, "notes": notes, "savings": saved})
        title = f"{scene.name}: {len(scene.patches()):,} patches"
        more = (("what leaving out saves: pose and view pass without and with it", saved),)
        return Report(scene.name, out, [row], title, notes, {"savings": saved}, self.output.json, more=more)

    def _content(self) -> Content | None:
        """What the file holds; None for a scene that is no file."""
        if self.scene in BUILT_IN:
            made = BUILT_IN[self.scene]()
            return made if isinstance(made, Content) else None
        return read(Path(self.scene), self.loading.group or None, self.loading.animation)

    def _refused(self, content: Content, row: Row, reason: str) -> Report:
        """Of a mesh that makes no scene: what it is, and why not."""
        assert content.mesh is not None
        name = Path(self.scene).stem
        notes = (*content.notes, f"this makes no scene: {reason}")
        with Run(
            "inspect", {**asdict(self), "output": None}, self.output.out, {"reason": reason}, self.output.pages(self)
        ) as run:
            out = run.finish([row], {"scene": name, "notes": notes})
        return Report(name, out, [row], f"{name}: no scene", notes, {}, self.output.json)


def mesh_row(mesh: Mesh) -> Row:
    """The control mesh in numbers. Times are milliseconds of one run on the host."""
    defects, topology_ms = _timed(lambda: find_defects(mesh))
    sizes, valence = mesh.sizes, mesh.valence[mesh.valence > 0]
    sharp = mesh.crease_sharpness
    counts = np.bincount(valence)
    row = {
        "vertices": mesh.vertex_count,
        "isolated_vertices": len(isolated_vertices(mesh)),
        "faces": mesh.face_count,
        "triangles_of_the_mesh": int(np.sum(sizes == 3)),
        "quads": int(np.sum(sizes == 4)),
        "larger_faces": int(np.sum(sizes > 4)),
        "pieces": mesh.components[0],
        "boundary_edges": int(np.sum(mesh.boundary)),
        "valences": ", ".join(f"{counts[n]} of {n}" for n in np.flatnonzero(counts)),
        "creases": f"{len(sharp)}, sharpness up to {sharp.max():g}" if len(sharp) else "none",
        "coincident_vertices": mesh.vertex_count - len(np.unique(mesh.vertices, axis=0)),
        "defects": "; ".join(defect.what for defect in defects) or "none",
        "topology_ms": topology_ms,
    }
    return row


def patch_row(scene: Scene) -> Row:
    """The patches in numbers and, of a control mesh, the table that makes them."""
    _, nu, nv, dimension = scene.patches().shape
    uses = np.bincount(scene.edge_numbers.ravel())
    points = np.sum(collapsed(scene.patches()))
    row: Row = {
        "patches": len(scene.patches()),
        "bi_degree": f"{nu - 1} x {nv - 1}" + (", rational" if dimension == 4 else ""),
        "common_edges": int(np.sum(uses > 1)),
        "free_edges": int(np.sum(uses == 1) - points),
        "coincident_sides": int(np.sum(coincident_sides(scene.patches(), scene.edge_numbers))),
        "edges_of_no_length": int(points),
    }
    if scene.kinds is not None:
        counts = np.bincount(scene.kinds, minlength=len(KINDS))
        row["kinds"] = ", ".join(f"{n} {kind}" for kind, n in zip(KINDS, counts, strict=True) if n)
    if scene.conversion is not None:
        table = scene.conversion.patchwork.points
        _, tables_ms = _timed(lambda: acc_patches(scene.conversion.finer).points.groups)  # type: ignore[union-attr]
        row |= {
            "scheme": scene.conversion.scheme,
            "table_rows": table.rows,
            "table_weights": int(table.matrix.nnz),
            "table_kilobytes": round(table.padded_bytes / 1024),
            "padding_share": table.padding,
            "widest_stencil": int(table.counts.max()),
            "tables_ms": tables_ms,
        }
    return row


def _up(scene: Scene, path: Path) -> str:
    """The direction that is up, and who says so: nothing is guessed from the shape."""
    up = {Y_UP: "y", Z_UP: "z"}.get(scene.up, " ".join(f"{x:g}" for x in scene.up))
    if str(path) in BUILT_IN:
        return up
    suffix = path.suffix.lower()
    if suffix in _SAY_UP:
        return f"{up}, as {suffix} files say or define it"
    return f"{up}, by custom: {suffix or 'such'} files do not say (--up for another)"


def _unshared(row: Row) -> tuple[str, ...]:
    """A note about sides that lie on each other, if any do."""
    count = row["coincident_sides"]
    if not count:
        return ()
    return (f"{count} free sides lie on others without being shared: a crack may show there",)


def rig_row(scene: Scene) -> Row:
    """Joints, influences, shape keys and motion, as far as there are any."""
    rig, row = scene.rig, {}
    if rig is None:
        return {}
    if rig.skeleton is not None and rig.influences is not None:
        row |= {"joints": len(rig.skeleton.names), "depth_of_the_tree": int(rig.skeleton.depth.max())}
        row["most_influences"] = rig.influences.most
    if rig.keys is not None:
        names = rig.keys.names
        row["shape_keys"] = f"{len(names)}: " + ", ".join(names[:8]) + (", …" if len(names) > 8 else "")
        row["moved_coordinates"] = int(rig.keys.table.matrix.nnz)
    if rig.motion is not None:
        first, last = rig.motion.span
        row["motion"] = f"time {first:g} to {last:g}, {len(rig.motion.times)} samples, {rig.rate:g} a second"
    return row


def _timed(work: Callable[[], Any]) -> tuple[Any, float]:
    start = time.perf_counter()
    result = work()
    return result, 1e3 * (time.perf_counter() - start)


def _picture(shown: Shown, run: Run) -> tuple[Row, tuple[str, ...]]:
    """Factors of the view, and the figure if there is an OpenGL device."""
    scene, view, shaded = shown.scene, shown.view, shown.shaded
    asked = {"tolerance": shown.tolerance, **shaded.asked(Certified())}
    factors = tessellation_factors(shown.patches, view, edge_numbers=scene.edge_numbers, **asked)
    shown.heard(factors)
    triangles = int(triangle_counts(factors.inner, factors.edges).sum())
    row = {"triangles": triangles, "factor_max": float(np.max(factors.factor))}
    beyond = int(np.sum(factors.inner.max(axis=1) > HIGHEST_LEVEL))
    notes = (f"{beyond} patches need levels above {HIGHEST_LEVEL} and are drawn in pieces",) if beyond else ()
    notes += unclaimed(factors.without_normal)
    try:
        look = shown.drawn(factors)
    except NoOpenGLError as error:
        return row, (*notes, f"no picture: {error}")
    seen = look.seen
    shown.release()
    if not (seen.patch >= 0).any():
        return row, (*notes, "no picture: nothing of the scene is on the screen")
    row |= {"max_error_px": float(np.nanmax(look.error)), **slips(seen), **(normals(look) if shaded else {})}
    row["covered_share"] = float(np.mean(seen.patch >= 0))
    allowed = both_tolerances(shown.tolerance, shaded.degrees)
    write_inspect_figure(run.figure("inspect"), _panels(look), _title(scene), allowed)
    return row, notes


def _panels(look: Look) -> Panels:
    """The pictures of a look: outlines, kinds, factors, errors."""
    scene, patch = look.beside.scene, look.seen.patch
    kinds = np.full(len(look.patches), KINDS.index("bezier")) if scene.kinds is None else scene.kinds
    painted = np.append(kinds, -1)[patch]
    factor = np.append(np.asarray(look.with_factors.factor, float), np.nan)[patch]
    return Panels(outlines(scene, look.view).polygons, patch, painted, KINDS, factor, look.error)


def _reflections(scene: Scene, view: View, tolerance: float, run: Run) -> tuple[str, ...]:
    """Draw them, or say why not."""
    try:
        found = reflected(scene, view, tolerance)
    except NoOpenGLError as error:
        return (f"no reflections: {error}",)
    if found is None:
        return ("no reflections: nothing of the scene is on the screen",)
    kinds = ("the surface, $P_u \\times P_v$", "tangent patches, $T_u \\times T_v$")
    said = [f"normals of {kind}\njump by up to {short(jump)}°" for kind, jump in zip(kinds, found.jumps, strict=True)]
    whole = Pictures(found.whole, said, scene.name)
    write_normal_figure(run.figure("reflections"), whole, found.near, found.frame)
    return ()


def _title(scene: Scene) -> str:
    made = f"{len(scene.patches()):,} patches"
    if scene.conversion is None:
        return f"{scene.name}: {made}"
    return f"{scene.name}: {scene.conversion.mesh.face_count:,} faces, {made} by '{scene.conversion.scheme}'"
