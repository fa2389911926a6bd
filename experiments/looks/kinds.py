"""The looks that there are, by the names that are typed, and what they need to be drawn."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

from slefejax.arguments import no_such
from slefejax.errors import InputError
from slefejax.experiments.looks.checker import checker
from slefejax.experiments.looks.light import reflection, shaded, shaded_colours, stripe_colours
from slefejax.experiments.looks.made import Frame, Kind
from slefejax.experiments.looks.texture import texture
from slefejax.experiments.looks.triangle_sizes import triangle_size
from slefejax.experiments.looks.values import coloured_errors, depth, error, factors, normals
from slefejax.experiments.looks.wire import wire, wire_colours
from slefejax.experiments.shading import Shaded

SIZES, TEXTURE = "triangle-size", "texture"
LOOKS = {
    "shaded": Kind(shaded, normals=True, frame=Frame("the surface, shaded", shaded_colours)),
    "wire": Kind(wire, normals=True, wire=True, frame=Frame("the triangles that draw it", wire_colours)),
    "error": Kind(error, frame=Frame("how far each pixel is off", coloured_errors)),
    "normals": Kind(normals, normals=True),
    "reflection": Kind(reflection, normals=True, frame=Frame("stripes that it reflects", stripe_colours)),
    "factors": Kind(factors),
    "depth": Kind(depth),
    "checker": Kind(checker),
    SIZES: Kind(triangle_size, wire=True),
    TEXTURE: Kind(texture),
}
FRAMES = {name: kind.frame for name, kind in LOOKS.items() if kind.frame is not None}


def chosen(names: Sequence[str], among: Collection[str] = LOOKS) -> list[str]:
    """The names of ``--look``, each once. Raises InputError where there is none, or one that is none of those.

    >>> chosen(["wire", "error", "wire"])
    ['wire', 'error']
    """
    if not names:
        raise InputError(f"--look needs at least one of {', '.join(among)}")
    unknown = [name for name in names if name not in among]
    if unknown:
        raise InputError(no_such("look", unknown[0], among))
    return list(dict.fromkeys(names))


def needed(names: Sequence[str], shaded: Shaded) -> dict[str, Any]:
    """What a ``Renderer`` has to draw for these looks, as keyword arguments; ``shaded``: whose normals."""
    kinds = [LOOKS[name] for name in names]
    normals, tangents = shaded.kind
    drawn: dict[str, Any] = {"wire": True} if any(kind.wire for kind in kinds) else {}
    if any(kind.normals for kind in kinds):
        drawn |= {"normals": normals, "tangents": tangents}
    return drawn
