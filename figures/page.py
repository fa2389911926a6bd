"""Where a figure is written, in which format, and what it is of."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

Format = Literal["png", "pdf", "svg"]
FORMATS: tuple[str, ...] = get_args(Format)


@dataclass(frozen=True)
class Page:
    """A file for a figure; its suffix, one of ``FORMATS``, says the format.

    caption   : the settings, which stand below the figure in small letters; none if empty
    described : what a program can read in the file
    """

    path: Path
    caption: str = ""
    described: str = ""

    def __post_init__(self) -> None:
        if self.path.suffix[1:] not in FORMATS:
            raise ValueError(f"figures are {', '.join(FORMATS)}, not {self.path.name!r}")


@dataclass(frozen=True)
class Pages:
    """What all figures of a run have in common."""

    format: Format = "png"
    caption: str = ""

    def page(self, folder: Path, name: str) -> Page:
        """The one of that name, which has no suffix."""
        return Page(folder / f"{name}.{self.format}", self.caption)
