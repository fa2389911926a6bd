"""What a Rhino model shows, and where: objects that are not hidden, and instances of blocks, nested ones too.

A block definition is a list of objects that stand nowhere by themselves. An instance places all of them by a transform;
in a block there may be instances of other blocks. Transforms are 4 x 4, for column vectors.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from slefejax.errors import InputError

_DEEPEST = 64  # blocks in blocks
_MOST = 100_000  # objects and instances that are placed
_LAYERS_UP = 1000


@dataclass(frozen=True, eq=False)
class _Instance:
    block: Any
    place: np.ndarray
    affine: bool


class Blocks:
    """The objects of a model, by ``rhino3dm``, and what of them is shown.

    left_out : how many were left out, by the reason
    """

    def __init__(self, path: Path, model: Any) -> None:
        self.path, self.left_out = path, Counter[str]()
        self._shapes = [item.Geometry for item in model.Objects]
        attributes = [item.Attributes for item in model.Objects]
        off = _layers_off(model)
        self._reasons = [_reason(own, off) for own in attributes]
        self._instances = [_instance(shape) for shape in self._shapes]
        self._alone = [k for k, own in enumerate(attributes) if not own.IsInstanceDefinitionObject]
        number = {own.Id: k for k, own in enumerate(attributes)}
        self._names = {block.Id: str(block.Name) for block in model.InstanceDefinitions}
        self._members = {
            block.Id: [number[member] for member in block.GetObjectIds() if member in number]
            for block in model.InstanceDefinitions
        }

    def shown(self) -> Iterator[tuple[int, Any, Float[np.ndarray, "4 4"]]]:
        """Number, geometry and transform of every object that is shown, as often as it is placed.

        Raises InputError for a block in itself, for too many of them, and for transforms that are not affine.
        """
        ahead: list[tuple[int, np.ndarray, tuple[Any, ...]]] = [(k, np.eye(4), ()) for k in reversed(self._alone)]
        placed, used = 0, set()
        while ahead:
            number, place, above = ahead.pop()
            instance, placed = self._instances[number], placed + 1
            if placed > max(_MOST, len(self._shapes)):
                raise InputError(
                    f"{self.path} places more than {_MOST:,} objects by its blocks: explode or delete some"
                )
            if self._reasons[number]:
                self.left_out[self._reasons[number]] += 1
            elif instance is None:
                yield number, self._shapes[number], place
            elif instance.block not in self._members:
                self.left_out["instances of blocks that are not in the file"] += 1
            else:
                self._check(number, instance, above)
                used.add(instance.block)
                place, above = place @ instance.place, (*above, instance.block)
                ahead += [(member, place, above) for member in reversed(self._members[instance.block])]
        if unused := len(self._names) - len(used):
            self.left_out["blocks that nothing places"] += unused

    def _check(self, number: int, instance: _Instance, above: tuple[Any, ...]) -> None:
        name = f"the block {self._names[instance.block]!r}"
        if instance.block in above:
            raise InputError(f"{self.path}: {name} is in itself, so that it has no end")
        if len(above) == _DEEPEST:
            raise InputError(f"{self.path}: {name} is more than {_DEEPEST} blocks deep: explode some of them")
        if not instance.affine:
            raise InputError(f"{self.path}: object {number} (counted from 0) places {name} by no affine transform")


def _instance(shape: Any) -> _Instance | None:
    if not hasattr(shape, "ParentIdefId"):
        return None
    own = shape.Xform
    place = np.array([[getattr(own, f"M{i}{j}") for j in range(4)] for i in range(4)], np.float64)
    affine = bool(np.isfinite(place).all()) and place[3].tolist() == [0.0, 0.0, 0.0, 1.0]
    return _Instance(shape.ParentIdefId, place, affine)


def _reason(attributes: Any, off: set[int]) -> str:
    """Why an object is not shown; empty if it is."""
    if not attributes.Visible:
        return "objects that are hidden"
    return "objects on layers that are off" if attributes.LayerIndex in off else ""


def _layers_off(model: Any) -> set[int]:
    """The numbers of layers that are off, or below one that is."""
    layers = list(model.Layers)
    number = {layer.Id: k for k, layer in enumerate(layers)}
    above = [number.get(layer.ParentLayerId, -1) for layer in layers]
    off = {k for k, layer in enumerate(layers) if not layer.Visible}
    for _ in range(min(len(layers), _LAYERS_UP)):
        more = {k for k, parent in enumerate(above) if parent in off and k not in off}
        if not more:
            break
        off |= more
    return {layers[k].Index for k in off}
