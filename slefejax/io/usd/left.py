"""What of a stage is drawn, and what of that is not read: always said, with the prim's path."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from slefejax.io.usd.library import Library

_DRAWN = ("default", "render")
_SAMPLED = (
    *("points", "faceVertexCounts", "faceVertexIndices", "holeIndices", "orientation", "visibility"),
    *("creaseIndices", "creaseLengths", "creaseSharpnesses", "cornerIndices", "cornerSharpnesses"),
    *("pointWeights", "uKnots", "vKnots", "primvars:skel:geomBindTransform"),
    *("primvars:skel:jointIndices", "primvars:skel:jointWeights", "primvars:st", "primvars:st:indices"),
)


@dataclass
class LeftOut:
    """What was left out, by kind: how often, and the path of the first."""

    library: Library
    time: Any
    kinds: dict[str, tuple[int, str]] = field(default_factory=dict)

    def add(self, kind: str, path: str) -> None:
        """One more."""
        count, first = self.kinds.get(kind, (0, path))
        self.kinds[kind] = (count + 1, first)

    def says(self) -> str:
        """All of it in a few words; nothing if there is none."""
        return ", ".join(f"{n} of {kind} (the first is {path})" for kind, (n, path) in sorted(self.kinds.items()))

    def draws(self, prim: Any) -> bool:
        """Whether a prim is something that is drawn; it is added if it would be, but is hidden."""
        geometry = self.library.geometry
        if not (prim.IsA(geometry.Gprim) or prim.IsA(geometry.PointInstancer)):
            self._unknown(prim)
            return False
        shape, path = geometry.Imageable(prim), str(prim.GetPath())
        purpose = str(shape.ComputePurpose())
        if purpose not in _DRAWN:
            self.add(f"purpose '{purpose}'", path)
            return False
        if shape.ComputeEffectiveVisibility(purpose, self.time) == "invisible":
            self.add("what is invisible", path)
            return False
        return True

    def _unknown(self, prim: Any) -> None:
        """Types that this usd-core knows nothing of: whether they are drawn cannot be told."""
        name = str(prim.GetTypeName())
        if name and not prim.GetPrimTypeInfo().GetSchemaTypeName():
            self.add(f"the unknown type {name}", str(prim.GetPath()))


def sampled_note(prim: Any) -> str | None:
    """A sentence if what a prim is made of changes over time, which is not followed."""
    names = [name for name in _SAMPLED if (own := prim.GetAttribute(name)) and own.GetNumTimeSamples() > 1]
    return f"{prim.GetPath()} has {' and '.join(names)} over time: the first is used" if names else None
