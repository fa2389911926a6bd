"""What a worker process of a study does; all that it needs comes with its tasks."""

from __future__ import annotations

import importlib
import json
import os
import pickle
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from distributed import Worker, WorkerPlugin, get_worker

from slefejax import Scene, View
from slefejax.experiments.cli import start_jax
from slefejax.experiments.grid.plan import Study
from slefejax.experiments.grid.sights import Asked, Sights
from slefejax.experiments.store import commit, versions


class Parcel(NamedTuple):
    """What a worker has to have before it measures cases of a scene.

    pickled      : study, scene and views
    modules      : files of methods of one's own, which these may need: names and contents
    double, keep : how JAX is set: double precision, and whether compiled programs are kept
    """

    pickled: bytes
    modules: dict[str, str]
    double: bool
    keep: bool


@dataclass
class _Scene:
    """The one that this process has last been sent."""

    name: str
    sights: Sights
    scene: Scene
    views: list[View]


_held: _Scene | None = None


class OneCore(WorkerPlugin):
    """Holds the worker of number k to the k-th of some cores: XLA, and all that counts cores, makes one thread."""

    def __init__(self, cores: list[int]) -> None:
        self.cores = cores

    def setup(self, worker: Worker) -> None:
        """Called in the process, before JAX and OpenGL begin."""
        os.sched_setaffinity(0, [self.cores[int(worker.name) % len(self.cores)]])


def identity() -> dict[str, str | None]:
    """Of which versions this process is."""
    return {**versions(), "commit": commit()}


class Message(NamedTuple):
    """What a task is.

    topic  : where rows are listened for;  number : of the task
    name   : of the scene and its study, which nothing else has
    parcel : None if the worker should have it
    """

    topic: str
    number: int
    name: str
    parcel: Parcel | None
    asked: list[Asked]


def measure(message: bytes) -> None:
    """Send a row of each case to whoever listens, as soon as it is found; nothing where the scene is not at hand.

    message : a pickled ``Message``, which dask does not look into
    """
    topic, number, name, parcel, asked = Message(*pickle.loads(message))
    tell = get_worker().log_event
    if parcel is not None:
        _take(name, parcel)
    if _held is None or _held.name != name:
        tell(topic, [number, None])
        return
    for own in asked:
        row = _held.sights.row(own, _held.scene, _held.views[own.case.view])
        tell(topic, [number, json.dumps(row)])


def _take(name: str, parcel: Parcel) -> None:
    global _held
    if _held is not None:
        _held.sights.release()
    start_jax(parcel.keep, parcel.double)
    _install(parcel.modules)
    study, scene, views = pickle.loads(parcel.pickled)
    assert isinstance(study, Study)
    _held = _Scene(name, Sights(study), scene, views)


def _install(modules: dict[str, str]) -> None:
    """Put sources where Python finds them, instead of what was known by these names."""
    folder = Path(get_worker().local_directory) / "methods"
    for name, source in modules.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(source)
        sys.modules.pop(name.removesuffix(".py").removesuffix("/__init__").replace("/", "."), None)
    if modules and str(folder) not in sys.path:
        sys.path.append(str(folder))
    importlib.invalidate_caches()
