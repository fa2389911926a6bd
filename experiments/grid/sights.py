"""What a study's cases look like: scenes, views and factors, each made once for the cases that share it."""

from __future__ import annotations

from functools import lru_cache, partial
from typing import Any

import numpy as np

from slefejax import Factors, Scene, View, load, tessellation_factors
from slefejax.experiments.grid.measured import DRAWN, Sight
from slefejax.experiments.grid.plan import Case, Study
from slefejax.experiments.levels import levels_of
from slefejax.experiments.shading import Shaded
from slefejax.experiments.store import digest
from slefejax.experiments.studies.look import Shown
from slefejax.gpu import Renderer
from slefejax.gpu.renderer import check_levels

_SCENES = 4  # that are kept in memory


class Sights:
    """Of all cases. Raises InputError for scenes that are missing or cannot be read."""

    def __init__(self, study: Study) -> None:
        self.study = study
        self._load = lru_cache(_SCENES)(self._read)
        self._views: dict[tuple[str, str], list[View]] = {}
        self._contents: dict[tuple[str, str], str] = {}
        self._names: dict[tuple[str, str], str] = {}
        for case in study.cases():
            own = case.scene, case.scheme
            if own not in self._views:
                scene = self.scene(case)
                self._views[own] = study.views.around(scene)
                self._contents[own] = digest(scene.patches().tobytes())
                self._names[own] = scene.name
        self._drawn = bool(set(study.measure) & set(DRAWN))
        self._normals = "normals" in study.measure
        self._of: tuple[Any, ...] = ()
        self._renderers: dict[str, Renderer] = {}
        self._shown: dict[tuple[Any, ...], Shown] = {}
        self._factors: dict[tuple[Any, ...], tuple[Factors, Any]] = {}

    def scene(self, case: Case) -> Scene:
        """With the case's scheme."""
        return self._load(case.scene, case.scheme)

    def view(self, case: Case) -> View:
        """The case's own."""
        return self._views[case.scene, case.scheme][case.view]

    def content(self, case: Case) -> str:
        """A short name for the scene's patches."""
        return self._contents[case.scene, case.scheme]

    def name(self, case: Case) -> str:
        """Of the scene."""
        return self._names[case.scene, case.scheme]

    def of(self, case: Case) -> Sight:
        """What measures look at. Cases of a scene and a view share what they can while they come one after another."""
        if self._of[:2] != case[:2]:
            self.release()
        if self._of != case[:3]:
            self._shown, self._factors = {}, {}
        self._of = case[:3]
        scene, view = self.scene(case), self.view(case)
        renderer = self._renderer(scene, case.spacing)
        shown = self._shared(case, renderer)
        factors, again = self._predicted(case, shown)
        shown.heard(factors)
        scaled = factors.scaled(case.scale)
        inner, outer = levels_of(scaled, case.spacing)
        check_levels(np.max(inner, axis=1))
        return Sight(
            scene.patches(), view, renderer, inner, outer, case.spacing, factors=scaled, shown=shown, again=again
        )

    def release(self) -> None:
        """Give the device's memory back."""
        for renderer in self._renderers.values():
            renderer.release()
        self._renderers = {}

    def _read(self, name: str, scheme: str) -> Scene:
        beside = self.study.folder / name
        return load(beside if beside.exists() else name, scheme=scheme)

    def _renderer(self, scene: Scene, spacing: str) -> Any:
        """None where nothing is drawn."""
        if not self._drawn:
            return None
        if spacing not in self._renderers:
            self._renderers[spacing] = Renderer(scene.patches(), spacing=spacing, normals=self._normals)
        return self._renderers[spacing]

    def _shared(self, case: Case, renderer: Any) -> Shown:
        own = case.pixels, case.degrees
        if own not in self._shown:
            self._shown[own] = Shown(self.scene(case), self.view(case), case.pixels, shaded=Shaded(case.degrees))
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
