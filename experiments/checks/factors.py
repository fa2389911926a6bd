"""The tessellation factors of a scene in a view, patch by patch. Needs no OpenGL."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, field

import numpy as np
import tyro

from slefejax import tessellation_factors
from slefejax.experiments.options import (
    LoadOptions,
    OutputOptions,
    PredictionOptions,
    ViewOptions,
    camera_record,
    rounding_notes,
)
from slefejax.experiments.report import Report
from slefejax.experiments.shading import unclaimed
from slefejax.experiments.store import Run
from slefejax.predict.methods import Certified
from slefejax.tessellator.edges import EDGES
from slefejax.tessellator.levels import HIGHEST_LEVEL, triangle_counts


@dataclass(frozen=True)
class FactorsOfScene:
    """The predicted tessellation factor of every patch, and the inner and edge levels that follow from it."""

    scene: tyro.conf.Positional[str]
    """A file (.obj, .usd…, .glb, …: the README lists them), or walker, teapot, twisted-quad, steep-patch."""
    prediction: tyro.conf.OmitArgPrefixes[PredictionOptions] = field(default_factory=PredictionOptions)
    camera: tyro.conf.OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)
    loading: tyro.conf.OmitArgPrefixes[LoadOptions] = field(default_factory=LoadOptions)
    output: tyro.conf.OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def run(self) -> Report:
        """Predict and list."""
        scene = self.loading.load(self.scene)
        view = self.camera.view(scene)
        options, shaded = self.prediction.arguments(), self.prediction.shading.of(scene)
        factors = tessellation_factors(
            scene.patches(), view, edge_numbers=scene.edge_numbers, tangents=shaded.tangents, **options
        )
        triangles = triangle_counts(factors.inner, factors.edges)
        rows = []
        for patch, (factor, inner, edges) in enumerate(zip(factors.factor, factors.inner, factors.edges, strict=True)):
            row = {"patch": patch, "factor": float(factor), "inner_u": int(inner[0]), "inner_v": int(inner[1])}
            row |= {f"edge_{name}": int(level) for name, level in zip(EDGES, edges, strict=True)}
            rows.append({**row, "triangles": int(triangles[patch])})
        total = {"sum_of_factors": float(np.sum(factors.factor)), "triangles": int(triangles.sum())}
        title = (
            f"{scene.name}: {len(rows)} patches, sum of factors {total['sum_of_factors']:.3f},"
            f" {total['triangles']:,} triangles"
        )
        if factors.without_normal is not None:
            total["patches_without_normal"] = count = int(np.count_nonzero(factors.without_normal))
            title += f", normals within {shaded.degrees:g}°" + (f" on all but {count} patches" if count else "")
        rounding = rounding_notes(scene, view, self.prediction.tolerance) if self._proved() else ()
        notes = (*scene.notes, *_beyond(factors.levels), *rounding, *unclaimed(factors.without_normal))
        arguments = {**asdict(self), "output": None, "camera": camera_record(view)}
        with Run("factors", arguments, self.output.out, {"process": os.getpid()}) as run:
            out = run.finish(rows, {"scene": scene.name, "notes": notes, **total})
        return Report(scene.name, out, rows, title, notes, total, self.output.json)

    def _proved(self) -> bool:
        """Whether anything is claimed that rounding could break."""
        return isinstance(self.prediction.value(), Certified)


def _beyond(levels: np.ndarray) -> tuple[str, ...]:
    """What to say if some patches need more than OpenGL's limit."""
    count = int(np.count_nonzero(levels > HIGHEST_LEVEL))
    if not count:
        return ()
    return (f"{count} of {len(levels)} patches need more than OpenGL's limit of {HIGHEST_LEVEL}: in pieces",)
