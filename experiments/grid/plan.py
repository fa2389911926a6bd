"""What a study asks: its file, checked as a whole before anything runs, and its cases."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from slefejax.arguments import check_choice, did_you_mean, no_such
from slefejax.errors import InputError
from slefejax.experiments.grid.measured import MEASURES
from slefejax.experiments.grid.views import Views
from slefejax.experiments.options import own_modules
from slefejax.experiments.tables import Row
from slefejax.io.content import read_bytes
from slefejax.predict.kernel import Method
from slefejax.predict.methods import Certified, Request, method_of, name_of
from slefejax.tessellator.levels import SPACINGS

NONE = "none"  # of a list of tolerances: a case without that tolerance


class Rule(NamedTuple):
    """A method of a study.

    name, settings : as the file has them;  method : the value
    """

    name: str
    settings: Row
    method: Method


class Case(NamedTuple):
    """What a row is of, but for the scene's content: numbers and names alone.

    view : its number among those of the scene;  degrees, depth : None where that tolerance is not asked for
    """

    scene: str
    scheme: str
    view: int
    pixels: float
    degrees: float | None
    depth: float | None
    rule: int
    scale: float
    spacing: str


@dataclass(frozen=True)
class Study:
    """A grid of settings: every scene in every view, by every method for every tolerance, scaled and spaced in turn.

    scenes           : names or files, as of ``load``; files are looked for beside the study's own
    views            : cameras around every scene, or those of a file
    tolerances_px    : pixels
    tolerances_deg   : of normals, degrees, for methods that know of such; ``"none"`` among them: a case without one
    tolerances_depth : of window depth, likewise
    methods          : names and settings, such as ``{"name": "slefe", "segments": 3}``
    scales           : what factors are multiplied by
    spacings         : of vertices, ``"equal"``, ``"fractional-even"``, ``"fractional-odd"``
    schemes          : how control meshes become patches
    measure          : what is looked at: pixels domain drawn covering normals limit minimal times
    folder           : of the file;  trust_rules : whether methods may be code of one's own, ``"my_module:MyMethod"``

    Raises InputError for what is none of that, and for a grid that is empty.

    >>> study = Study(scenes=("teapot",), tolerances_px=(0.25, 0.5), methods=("certified", "filip"))
    >>> len(list(study.cases()))
    4
    """

    scenes: tuple[str, ...]
    views: Any = field(default_factory=dict)
    tolerances_px: tuple[float, ...] = (0.5,)
    tolerances_deg: tuple[Any, ...] = ()
    tolerances_depth: tuple[Any, ...] = ()
    methods: tuple[Any, ...] = ("certified",)
    scales: tuple[float, ...] = (1.0,)
    spacings: tuple[str, ...] = ("equal",)
    schemes: tuple[str, ...] = ("auto",)
    measure: tuple[str, ...] = ("pixels",)
    folder: Path = Path()
    trust_rules: bool = False

    def __post_init__(self) -> None:
        """Check all of it."""
        for name in _LISTS:
            given = getattr(self, name)
            if isinstance(given, (str, bytes)) or not isinstance(given, (list, tuple)):
                raise InputError(f"{name} is a list, not {given!r}")
            if not given and name not in _MAY_BE_EMPTY:
                raise InputError(f"{name} is empty: the study has no case")
            if any(given[k] in given[:k] for k in range(len(given))):
                raise InputError(f"{name} names something twice")
            object.__setattr__(self, name, tuple(given))
        for name in ("scenes", "schemes"):
            _check_texts(name, getattr(self, name))
        for name in ("tolerances_px", "scales"):
            _check_positive(name, getattr(self, name))
        for name in _MAY_BE_EMPTY:
            _check_positive(name, [value for value in getattr(self, name) if value != NONE])
        for spacing in self.spacings:
            check_choice("spacing", spacing, SPACINGS)
        for name in self.measure:
            check_choice("measure", name, MEASURES)
        object.__setattr__(self, "views", Views.of(self.views, self.folder))
        object.__setattr__(self, "rules", tuple(self._rules()))

    rules: tuple[Rule, ...] = field(init=False, repr=False, compare=False)

    @staticmethod
    def load(path: str | Path, *, trust_rules: bool = False) -> Study:
        """A study's file (TOML): the names above are its keys.

        trust_rules : whether it may name methods of one's own, whose modules are run

        Raises InputError for a file that is missing or no TOML, unknown keys, and as ``Study`` does.
        """
        path = Path(path)
        try:
            found = tomllib.loads(read_bytes(path).decode())
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise InputError(f"{path.name} is no TOML file: {error}") from None
        for name in found:
            if name not in _KEYS:
                raise InputError(f"{path.name}: {no_such('key', name, _KEYS)}")
        if "scenes" not in found:
            raise InputError(f"{path.name} names no scenes")
        return Study(**found, folder=path.parent, trust_rules=trust_rules)

    def cases(self) -> Iterator[Case]:
        """All of them, those that share something beside each other. What a method does not know of counts once."""
        for scene, scheme, view in product(self.scenes, self.schemes, range(len(self.views))):
            for pixels, (number, rule) in product(self.tolerances_px, enumerate(self.rules)):
                degrees = _or_none(self.tolerances_deg if isinstance(rule.method, Certified) else ())
                depth = _or_none(self.tolerances_depth if getattr(rule.method, "takes_depth", False) else ())
                for own in product(degrees, depth, self.scales, self.spacings):
                    yield Case(scene, scheme, view, pixels, own[0], own[1], number, own[2], own[3])

    def columns(self, case: Case, name: str) -> Row:
        """A row's first columns, which say what case it is; ``name``: of the scene."""
        settings = {knob: None for rule in self.rules for knob in rule.settings} | self.rules[case.rule].settings
        found = {"scene": name, "scheme": case.scheme, "view": case.view, "method": self.rules[case.rule].name}
        found |= settings | {"tolerance_px": case.pixels}
        found |= {"tolerance_deg": case.degrees} if self.tolerances_deg else {}
        found |= {"tolerance_depth": case.depth} if self.tolerances_depth else {}
        found |= {"scale": case.scale, "spacing": case.spacing}
        return {key: np.nan if value is None else value for key, value in found.items()}

    def run(
        self, out: str | Path | None = None, *, workers: int | None = None, scheduler: str | None = None
    ) -> list[Row]:
        """A row a case; rows are kept in a folder as they are found, and taken over from there.

        out       : the folder; without it runs/study
        workers   : so many processes of this machine measure, a thread each; without them this one does
        scheduler : the address of one of dask.distributed, ``"tcp://HOST:8786"``, whose workers measure

        Raises InputError as ``Study`` does, for scenes that are missing and for a scheduler that does not answer,
        before anything is measured. Workers are started like those of ``multiprocessing``: a script that asks for
        some does so below ``if __name__ == "__main__":``.
        """
        from slefejax.experiments.grid.crew import Crew
        from slefejax.experiments.grid.running import Running

        return Running(self, Path(out) if out else Path("runs/study"), Crew(workers, scheduler)).rows()

    def _rules(self) -> Iterator[Rule]:
        for given in self.methods:
            named = {"name": given} if isinstance(given, str) else given
            if not isinstance(named, Mapping) or not isinstance(named.get("name"), str):
                raise InputError(f'methods are tables such as {{ name = "slefe", segments = 3 }}, not {given!r}')
            name, settings = named["name"], {key: value for key, value in named.items() if key != "name"}
            if ":" in name and not self.trust_rules:
                raise InputError(f"the method {name!r} is code that would be run: --trust-rules allows that")
            with own_modules(name):
                method = method_of(name, settings)
            Request.of({"method": method})
            if getattr(method, "whole", False) and self.spacings != ("equal",):
                raise InputError(f"{name} with anisotropic or verify finds whole levels: they need the spacing equal")
            yield Rule(name_of(method), settings, method)


_LISTS = (
    *("scenes", "tolerances_px", "tolerances_deg", "tolerances_depth", "methods", "scales", "spacings", "schemes"),
    "measure",
)
_MAY_BE_EMPTY = ("tolerances_deg", "tolerances_depth")
_KEYS = tuple(own.name for own in fields(Study) if own.name not in ("folder", "trust_rules", "rules"))


def _or_none(values: tuple[Any, ...]) -> list[float | None]:
    return [None if value == NONE else float(value) for value in values] or [None]


def _check_texts(name: str, values: tuple[Any, ...]) -> None:
    for value in values:
        if not isinstance(value, str):
            raise InputError(f"{name} are texts, not {value!r}")


def _check_positive(name: str, values: Any) -> None:
    for value in values:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < np.inf:
            hint = did_you_mean(value, [NONE]) if name in _MAY_BE_EMPTY else ""
            raise InputError(f"{name} are positive numbers, not {value!r}{hint}")
