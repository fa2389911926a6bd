"""What a file holds, whatever its format: a control mesh, spline surfaces, Bézier patches."""

from __future__ import annotations

import stat
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from slefejax.errors import InputError
from slefejax.io.limits import LARGEST_FILE, check_size
from slefejax.model.mesh import Mesh
from slefejax.model.rig import Rig
from slefejax.model.texture import together

_MEGABYTES = {"usd": 2048, "3dm": 512}  # for a library itself
Y_UP, Z_UP = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Spline:
    """A tensor-product spline surface.

    control : ``(nu, nv, 3)``, or 4 at the end if rational, (w x, w y, w z, w)
    knots   : along u and along v, count + degree + 1 each
    bounds  : the part of each parameter that is wanted, or None for all
    name    : what the file calls it, for messages
    """

    control: Float[np.ndarray, "nu nv dim"]
    degrees: tuple[int, int]
    knots: tuple[np.ndarray, np.ndarray]
    bounds: tuple[tuple[float, float] | None, tuple[float, float] | None] = (None, None)
    name: str = "the surface"


@dataclass(frozen=True, eq=False)
class Content:
    """The content of a file.

    mesh    : all polygons as one control mesh, not yet checked, or None
    splines : surfaces with knots
    patches : Bézier patches, ``(du+1, dv+1, 3)`` each, or 4 at the end if rational
    up      : the direction that is up, by the format's custom or the file's own word
    notes   : sentences about what was left out
    rig     : what moves the mesh, or None
    digits  : how far apart two copies of a point can be that were written with the file's digits, in its units along
              each coordinate; None where that cannot be told

    >>> Content().up
    (0.0, 0.0, 1.0)
    """

    mesh: Mesh | None = None
    splines: tuple[Spline, ...] = ()
    patches: tuple[np.ndarray, ...] = ()
    up: tuple[float, float, float] = Z_UP
    notes: tuple[str, ...] = ()
    rig: Rig | None = None
    digits: float | None = None


def read_bytes(path: Path, largest: int = LARGEST_FILE) -> bytes:
    """All of a plain file of at most so many bytes, or InputError that says why not."""
    try:
        found = path.stat()
        special = not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode))
        data = None if special or found.st_size > largest else path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"there is no file {path}: check the name") from None
    except (OSError, ValueError) as error:  # a name may hold what no name can
        raise InputError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if special:
        raise InputError(f"{path} is a device or a pipe: only plain files are read")
    check_size(path, found.st_size, largest)
    assert data is not None
    return data


def probe(kind: str, path: Path) -> None:
    """InputError for a binary file that a library cannot read within limits (``slefejax.io.probe``)."""
    megabytes = _MEGABYTES[kind] + 20 * (path.stat().st_size >> 20)
    command = [sys.executable, "-I", str(Path(__file__).with_name("probe.py")), kind, str(path), str(megabytes)]
    ended = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True)
    if ended.returncode:
        said = ended.stdout.decode(errors="replace").strip() or "is it complete?"
        raise InputError(f"{path} is no {kind.upper()} file that can be read: {said}")


def joined(meshes: list[Mesh], counts: list[int] | None = None) -> Mesh:
    """Several meshes as one; vertices and faces are numbered on.

    counts : how many faces each has in the file, if some of them were left out
    """
    if len(meshes) == 1:
        return meshes[0]
    faces = np.cumsum([0, *(counts or [mesh.face_count for mesh in meshes])[:-1]])
    starts = np.cumsum([0, *(mesh.vertex_count for mesh in meshes[:-1])])

    every = [mesh.covariances for mesh in meshes]

    def shifted(name: str) -> np.ndarray:
        return np.concatenate([getattr(mesh, name) + start for mesh, start in zip(meshes, starts, strict=True)])

    return Mesh.packed(
        np.concatenate([mesh.vertices for mesh in meshes]),
        shifted("corners"),
        np.concatenate([mesh.sizes for mesh in meshes]),
        np.concatenate([mesh.numbers + start for mesh, start in zip(meshes, faces, strict=True)]),
        together([mesh.texture for mesh in meshes], [len(mesh.corners) for mesh in meshes]),
        creases=shifted("creases"),
        crease_sharpness=np.concatenate([mesh.crease_sharpness for mesh in meshes]),
        points=shifted("points"),
        point_sharpness=np.concatenate([mesh.point_sharpness for mesh in meshes]),
        covariances=None if any(own is None for own in every) else np.concatenate(every),  # type: ignore[arg-type]
    )
