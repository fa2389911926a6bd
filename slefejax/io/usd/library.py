"""usd-core itself: imported when it is needed, asked for a stage, and what it says against a file in one sentence."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slefejax.errors import InputError
from slefejax.io.content import probe, read_bytes
from slefejax.io.probe import said_by_usd
from slefejax.late import one_at_a_time


@dataclass(frozen=True)
class Library:
    """The modules of usd-core; its stubs know little of them."""

    sdf: Any
    tf: Any
    usd: Any
    geometry: Any
    skel: Any

    @staticmethod
    def of(path: Path) -> Library:
        """Raises InputError where usd-core is not installed."""
        with one_at_a_time:
            try:
                from pxr import Sdf, Tf, Usd, UsdGeom, UsdSkel
            except ImportError:
                raise InputError(f"{path}: to read USD, install usd-core (pip install 'slefejax[usd]')") from None
        return Library(Sdf, Tf, Usd, UsdGeom, UsdSkel)


def opened(path: Path) -> tuple[Library, Any]:
    """The library and the stage of a file. Raises InputError, with the line where the library tells one."""
    data = read_bytes(path)  # says what is wrong with the file itself
    library = Library.of(path)
    if not data.startswith(b"#usda") or b"@" in data:  # binary, or it may name others that are
        probe("usd", path)
    try:
        return library, _as_on_disk(library, path)
    except library.tf.ErrorException as error:
        raise InputError(f"{path} is no USD file that can be read: {said_by_usd(error)}") from None


def _as_on_disk(library: Library, path: Path) -> Any:
    """The stage of a file. What some other stage still holds is read again: it may be older than the file."""
    held = {layer.identifier for layer in library.sdf.Layer.GetLoadedLayers() if not layer.anonymous}
    stage = library.usd.Stage.Open(str(path))
    for layer in stage.GetUsedLayers():
        if layer.identifier in held:
            layer.Reload(force=True)
    return stage


def composition_notes(stage: Any) -> list[str]:
    """A sentence if files or prims that the stage refers to are missing or broken."""
    errors = [" ".join(str(error).split()) for error in stage.GetCompositionErrors()]
    if not errors:
        return []
    more = f", and {len(errors) - 1} more like it" if len(errors) > 1 else ""
    return [f"what the file refers to is not all there: {sorted(errors)[0][:300].rstrip('.')}{more}"]
