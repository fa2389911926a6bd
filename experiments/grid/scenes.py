"""The scenes of a study, each with every scheme: their patches, and the views that they are seen in."""

from __future__ import annotations

from functools import lru_cache
from itertools import product

from slefejax import Scene, View, load
from slefejax.experiments.grid.plan import Case, Study
from slefejax.experiments.options import camera_record
from slefejax.experiments.store import digest
from slefejax.experiments.tables import Row

_SCENES = 4  # that are kept in memory


class Scenes:
    """Of all cases. Raises InputError for scenes that are missing or cannot be read."""

    def __init__(self, study: Study) -> None:
        self.study = study
        self._load = lru_cache(_SCENES)(self._read)
        self._views: dict[tuple[str, str], list[View]] = {}
        self._contents: dict[tuple[str, str], str] = {}
        self._names: dict[tuple[str, str], str] = {}
        self._cameras: dict[tuple[str, str], list[Row]] = {}
        for own in product(study.scenes, study.schemes):
            scene = self._load(*own)
            self._views[own] = study.views.around(scene)
            self._contents[own] = digest(scene.patches().tobytes())
            self._names[own] = scene.name
            self._cameras[own] = [camera_record(view) for view in self._views[own]]

    def scene(self, case: Case) -> Scene:
        """With the case's scheme."""
        return self._load(case.scene, case.scheme)

    def view(self, case: Case) -> View:
        """The case's own."""
        return self._views[case.scene, case.scheme][case.view]

    def views(self, case: Case) -> list[View]:
        """All of the case's scene."""
        return self._views[case.scene, case.scheme]

    def camera(self, case: Case) -> Row:
        """What the view is, as a record says it."""
        return self._cameras[case.scene, case.scheme][case.view]

    def content(self, case: Case) -> str:
        """A short name for the scene's patches."""
        return self._contents[case.scene, case.scheme]

    def name(self, case: Case) -> str:
        """Of the scene."""
        return self._names[case.scene, case.scheme]

    def _read(self, name: str, scheme: str) -> Scene:
        beside = self.study.folder / name
        return load(beside if beside.exists() else name, scheme=scheme)
