"""USD (.usd, .usda, .usdc, .usdz), through usd-core: meshes with creases, and NURBS patches, at their earliest time.

Everything is brought to the coordinates of the stage. The package is an extra: ``pip install 'slefejax[usd]'``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from slefejax.errors import InputError, naming
from slefejax.io.content import Y_UP, Z_UP, Content, Spline, joined
from slefejax.io.probe import said_by_usd
from slefejax.io.usd.left import LeftOut, sampled_note
from slefejax.io.usd.library import Library, composition_notes, opened
from slefejax.io.usd.places import Places
from slefejax.io.usd.rig import Part, rig_of
from slefejax.io.usd.shapes import Shapes
from slefejax.io.usd.skel import Skinning
from slefejax.model.mesh import Mesh

_ROUNDINGS = 4  # of points, which USD has in single precision, and of what was computed before


def read_usd(path: Path) -> Content:
    """All meshes of a stage as one control mesh with what moves it, and its NURBS patches.

    Read is what is drawn: of purpose default or render, and visible at the earliest time.

    Raises InputError if the file is none, for trimmed patches, and for geometry that does not fit together.
    """
    library, stage = opened(path)
    try:
        with naming(path):
            return _Reader(path, library, stage).content()
    except InputError:
        raise
    except (library.tf.ErrorException, RuntimeError, TypeError, ValueError, OverflowError) as error:
        # a stage is whatever a file says; the library finds out when it is asked
        raise InputError(f"{path} contradicts itself: {said_by_usd(error)}") from None


class _Reader:
    def __init__(self, path: Path, library: Library, stage: Any) -> None:
        self.path, self.library, self.stage = path, library, stage
        time = library.usd.TimeCode.EarliestTime()
        rate, frames = float(stage.GetTimeCodesPerSecond()), float(stage.GetFramesPerSecond())
        step = rate / frames if rate > 0 and frames > 0 else 1.0  # of one frame
        self.places = Places(library, time, step if np.isfinite(step) and step > 0 else 1.0)
        self.skinning = Skinning.of(library, stage, self.places)
        self.shapes = Shapes(path, time, library.geometry)
        self.left = LeftOut(library, time)
        self.meshes: list[Mesh] = []
        self.counts: list[int] = []
        self.parts: list[Part] = []
        self.splines: list[Spline] = []

    def content(self) -> Content:
        usd, geometry = self.library.usd, self.library.geometry
        walk = iter(usd.PrimRange.Stage(self.stage, usd.TraverseInstanceProxies()))
        for prim in walk:
            self._take(prim)
            if prim.IsA(geometry.PointInstancer):  # what is below is drawn by it only
                walk.PruneChildren()
        missing = composition_notes(self.stage)
        said = self.left.says()
        if not self.meshes and not self.splines:
            more = "; ".join([f"left out: {said}"] * bool(said) + self.shapes.notes + missing)
            raise InputError(f"{self.path} holds no mesh and no NURBS patch that is drawn{': ' * bool(more)}{more}")
        mesh = joined(self.meshes, self.counts) if self.meshes else None
        rig = rig_of(self.stage, self.skinning, self.places, self.parts)
        notes = missing + self.shapes.notes + self.skinning.notes
        notes += [f"left out: {said}"] * bool(said)
        largest = max((float(np.abs(spline.control[..., :3]).max()) for spline in self.splines), default=0.0)
        digits = _ROUNDINGS * float(np.finfo(np.float32).eps) * largest
        up = Y_UP if geometry.GetStageUpAxis(self.stage) == geometry.Tokens.y else Z_UP
        return Content(mesh, tuple(self.splines), up=up, notes=tuple(notes), rig=rig, digits=digits)

    def _take(self, prim: Any) -> None:
        geometry, path = self.library.geometry, str(prim.GetPath())
        if not self.left.draws(prim):
            return
        if prim.IsA(geometry.Mesh):
            self._mesh(prim, path)
        elif prim.IsA(geometry.NurbsPatch):
            self.splines.append(self.shapes.nurbs(geometry.NurbsPatch(prim), self.places.matrix(prim)))
            if self.places.mover(prim) is not None:
                self.shapes.notes.append(f"{path} moves over time: it stays where it is at first")
        else:
            self.left.add(str(prim.GetTypeName()), path)
            return
        if note := sampled_note(prim):
            self.shapes.notes.append(note)

    def _mesh(self, prim: Any, path: str) -> None:
        bound = self.skinning.bind(prim)
        place = self.places.bound(prim) if bound is None else bound.place
        mirrored = bound is not None and bound.mirrored
        found = self.shapes.mesh(self.library.geometry.Mesh(prim), place, mirrored)
        if found is not None:
            mesh, count = found
            self.meshes.append(mesh)
            self.counts.append(count)
            mover = None if bound is not None and bound.skinned else self.places.mover(prim)
            self.parts.append(Part(mesh.vertex_count, bound, mover))
