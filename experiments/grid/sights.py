"""What a study's cases look like, and rows of them: what cases share is made once while they come one after another."""

from __future__ import annotations

import time
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from slefejax import Factors, Scene, View, tessellation_factors
from slefejax.errors import InputError, naming
from slefejax.experiments.grid.measured import ALWAYS, DRAWN, MEASURES, Sight
from slefejax.experiments.grid.plan import Case, Study
from slefejax.experiments.levels import levels_of
from slefejax.experiments.shading import Shaded
from slefejax.experiments.studies.look import Shown
from slefejax.experiments.tables import Row
from slefejax.gpu import Renderer
from slefejax.gpu.renderer import check_levels

REFUSED = "refused"
FAILED = "failed"  # of rows that are there for as long as the process only


class Asked(NamedTuple):
    """What is to be measured of a case.

    key : what no other case has;  measures : their names, besides what is always measured
    """

    key: str
    case: Case
    measures: tuple[str, ...]


class Sights:
    """Of cases of scenes that are handed in; one thread's own, which has the OpenGL context."""

    def __init__(self, study: Study) -> None:
        self.study = study
        self._drawn = bool(set(study.measure) & set(DRAWN))
        self._normals = "normals" in study.measure
        self._of: tuple[Any, ...] = ()
        self._renderers: dict[str, Renderer] = {}
        self._shown: dict[tuple[Any, ...], Shown] = {}
        self._factors: dict[tuple[Any, ...], tuple[Factors, Any]] = {}

    def row(self, asked: Asked, scene: Scene, view: View) -> Row:
        """What was asked for, or why it is refused, and how many seconds it took."""
        start = time.perf_counter()
        row: Row = {"case": asked.key, "scene": asked.case.scene, REFUSED: ""}
        try:
            with naming(f"scene {asked.case.scene!r}"):
                look = self._look(asked.case, scene, view)
                for own in (ALWAYS, *(MEASURES[name] for name in asked.measures)):
                    row |= own(look)
        except InputError as error:
            row[REFUSED] = str(error)
        return row | {"seconds": time.perf_counter() - start}

    def release(self) -> None:
        """Give the device's memory back."""
        for renderer in self._renderers.values():
            renderer.release()
        self._renderers = {}

    def _look(self, case: Case, scene: Scene, view: View) -> Sight:
        """What measures look at."""
        if self._of[:2] != case[:2]:
            self.release()
        if self._of != case[:3]:
            self._shown, self._factors = {}, {}
        self._of = case[:3]
        renderer = self._renderer(scene, case.spacing)
        shown = self._shared(case, scene, view, renderer)
        factors, again = self._predicted(case, shown)
        shown.heard(factors)
        scaled = factors.scaled(case.scale)
        inner, outer = levels_of(scaled, case.spacing)
        check_levels(np.max(inner, axis=1))
        return Sight(
            scene.patches(), view, renderer, inner, outer, case.spacing, factors=scaled, shown=shown, again=again
        )

    def _renderer(self, scene: Scene, spacing: str) -> Any:
        """None where nothing is drawn."""
        if not self._drawn:
            return None
        if spacing not in self._renderers:
            self._renderers[spacing] = Renderer(scene.patches(), spacing=spacing, normals=self._normals)
        return self._renderers[spacing]

    def _shared(self, case: Case, scene: Scene, view: View, renderer: Any) -> Shown:
        own = case.pixels, case.degrees
        if own not in self._shown:
            self._shown[own] = Shown(scene, view, case.pixels, shaded=Shaded(case.degrees))
        if case.spacing == "equal" and renderer is not None:
            self._shown[own].renderer = renderer
        return self._shown[own]

    def _predicted(self, case: Case, shown: Shown) -> tuple[Factors, Any]:
        own = case.pixels, case.degrees, case.depth, case.rule
        if own not in self._factors:
            rule, scene = self.study.rules[case.rule], shown.scene
            kept = {**shown.shaded.asked(rule.method), "depth_tolerance": case.depth}
            again = partial(
                tessellation_factors,
                *(scene.patches(), shown.view, rule.method),
                tolerance=case.pixels,
                edge_numbers=scene.edge_numbers,
                **kept,
            )
            self._factors[own] = again(), again
        return self._factors[own]
