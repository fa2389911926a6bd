"""What a look is: what it needs of the renderer, and what it makes of a scene that was drawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from slefejax.figures.looks.panels import Heading
from slefejax.figures.page import Page


@dataclass(frozen=True, eq=False)
class Made:
    """A look of a scene.

    shows    : what a heading says
    draw     : writes the picture
    channels : numbers of every pixel, ``(height, width)``, row 0 at the bottom, by names that end with their units; NaN
               where there is none. None at all for a look that is a picture and nothing else
    main     : the channel that a table sums up; none if it is empty
    """

    shows: str
    draw: Callable[[Page, Heading], None]
    channels: dict[str, np.ndarray] = field(default_factory=dict)
    main: str = ""


class Frame(NamedTuple):
    """A look beside others, in a frame of a film: colours that mean the same in every frame.

    says    : what stands above it
    colours : of a ``Look``: those of every pixel, ``(height, width, 3)`` from 0 to 1, row 0 at the bottom
    """

    says: str
    colours: Callable[[Any], np.ndarray]


@dataclass(frozen=True)
class Kind:
    """A kind of look: how it is made of what was drawn, and whether the renderer must draw normals or sides.

    make  : of a ``slefejax.experiments.studies.look.Look``; of one with a texture where the look shows that
    frame : how a film shows it; None if it does not
    """

    make: Callable[[Any], Made]
    normals: bool = False
    wire: bool = False
    frame: Frame | None = None
