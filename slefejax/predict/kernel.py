"""What a method for tessellation factors is, and methods whose formula is a kernel.

A method is a value: it holds its own numbers, and nothing else knows what they mean. It works in two phases, so that
what does not depend on the view is made once a pose: ``prepare`` and ``factor``. Anything that has both is one:

    @dataclass(frozen=True)
    class EverySo:
        pixels: float = 20.0

        def prepare(self, patches):                     # (patches, du+1, dv+1, 3 or 4): whatever views can share
            return patches

        def factor(self, prepared, view, tolerances):   # (patches,): real, 0 off-screen
            ...
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slefejax.arguments import Patches
from slefejax.errors import InputError
from slefejax.geometry.packed import Packed, pack
from slefejax.geometry.projection import Projection, least_distance, unless_bad
from slefejax.geometry.view import View, check_view
from slefejax.geometry.volume import on_screen
from slefejax.lanes import layout, loops, passes
from slefejax.predict.normals.shading import Shading


class Tolerances(NamedTuple):
    """What errors are allowed: in pixels, and in window depth (0 to 1) or None for no depth test.

    >>> Tolerances(0.25).depth is None
    True
    """

    pixels: Any = 0.5
    depth: Any = None


@runtime_checkable
class Method(Protocol):
    """What ``tessellation_factors`` takes as a method besides the names of those that come with the package."""

    def prepare(self, patches: Any, /) -> Any:
        """What all views of patches ``(patches, du+1, dv+1, 3 or 4)`` share; the patches themselves if nothing is."""
        ...

    def factor(self, prepared: Any, view: View, tolerances: Tolerances, /) -> Any:
        """Real factors ``(patches,)`` in a view, before they are rounded up; 0 for patches that are off-screen."""
        ...


class Prepared(NamedTuple):
    """Patches of a pose, and what a method made of them: slefe boxes, or whatever one's own method prepares.

    shading : which of their normals have to be right, too, and how far (``predict.normals``)
    """

    packed: Packed
    made: Any = None
    shading: Shading | None = None

    @staticmethod
    def of(patches: Patches | Prepared) -> Prepared:
        """Nothing but the patches: what is missing is computed on the way."""
        return patches if isinstance(patches, Prepared) else Prepared(pack(patches))

    def seen(self, view: View) -> tuple[tuple[Any, Any, Any], Projection]:
        """What the view pass works on, and the projection for it: control points where boxes are not enough, boxes."""
        if self.made is None:
            chunks, projection = self.packed.placed(view)
            return (chunks, None, None), projection
        needed = self.packed.chunks if self.packed.dimension == 4 else None
        projection = Projection.of(view, self.packed.dtype, self.made.origin, self.packed.rounded)
        return (needed, self.made.lower, self.made.upper), projection


class Kernel:
    """A method whose formula is a kernel, with patches along the last axis (``slefejax.lanes.layout``).

    Subclasses are frozen dataclasses and plain pytrees (``lanes.plain``): numbers that may be traced are children.
    """

    name: ClassVar[str]
    takes_depth: ClassVar[bool] = False
    takes_rational: ClassVar[bool] = True
    takes_gregory: ClassVar[bool] = False

    def check(self, dimension: int, tolerances: Tolerances) -> None:
        """InputError for numbers out of their range, for patches of that dimension and for such tolerances."""
        if dimension == 4 and not self.takes_rational:
            raise InputError(
                f"method {self.name!r} is for polynomial patches, (patches, du+1, dv+1, 3): these are rational"
            )
        if tolerances.depth is not None and not self.takes_depth:
            raise InputError(f"method {self.name!r} knows no depth_tolerance", options=("depth_tolerance",))

    def check_kind(self, packed: Packed) -> None:
        """InputError for Gregory patches, if the method is for Bézier patches."""
        if packed.gregory and not self.takes_gregory:
            said = f"method {self.name!r} is for Bézier patches, and these are Gregory patches, which 'certified' takes"
            raise InputError(said, options=("method",))

    @property
    def formula(self) -> Kernel:
        """The same without what the kernel does not look at, so that it is not compiled anew for that."""
        return self

    @property
    def label(self) -> str:
        """Such as ``screen-box 8``: the name, and the numbers that are its own."""
        own = [getattr(self, part.name) for part in fields(self)]  # type: ignore[arg-type]
        return " ".join([self.name, *(f"{number:g}" for number in own)])

    def left_out(self, tolerances: Tolerances) -> tuple[str, ...]:
        """What is not computed because it was not asked for, a sentence each."""
        return (f"slefe boxes: the method {self.name} does without",)

    def prepare(self, patches: Patches, /) -> Prepared:
        """What all views of patches share: their layout."""
        return Prepared.of(patches)

    def factor(self, prepared: Any, view: View, tolerances: Tolerances, /) -> Float[Array, "patches"]:
        """Real factors in a view, NaN where patches are not finite; ``prepared``, or patches that were not prepared."""
        prepared = Prepared.of(prepared)
        check_view(view)
        self.check(prepared.packed.dimension, tolerances)
        self.check_kind(prepared.packed)
        chunks = view_pass(*prepared.seen(view), *self.numbers(tolerances, prepared.packed.dtype))
        return layout.unpack(chunks, len(prepared.packed))

    def numbers(self, tolerances: Tolerances, dtype: Any) -> tuple[Any, Tolerances]:
        """The formula and the tolerances with their numbers in the precision of the kernels."""
        return jax.tree.map(lambda number: jnp.asarray(number, dtype), (self.formula, tolerances))

    def kernel(self, control: Array, projection: Projection, tolerances: Tolerances) -> Float[Array, "lanes"]:
        """The factors of patches ``(du+1, dv+1, dim, lanes)`` relative to the projection's origin."""
        raise NotImplementedError

    def over(self, seen: tuple[Any, Any, Any], projection: Projection, tolerances: Tolerances) -> Array:
        """The kernel for all chunks; 0 for patches that are off the screen, NaN for harmful ones."""

        def visible(control: Any, projection: Projection, tolerances: Tolerances, formula: Any) -> Any:
            factor = formula.kernel(control, projection, tolerances)
            return jnp.where(on_screen(control, projection), factor, 0.0)

        return loops.over_chunks(unless_bad(visible), seen[0], projection, tolerances, self)


@passes.as_pass()
def view_pass(
    seen: tuple[Any, Any, Any], projection: Projection, formula: Any, tolerances: Tolerances
) -> Float[Array, "chunks lanes"]:
    """Real factors of all patches in one view, in the layout of the kernels; NaN for patches that are not finite.

    seen : control points, None where boxes are enough; lower and upper ends of slefe boxes relative to the origin, or
           None twice, to compute them on the way
    """
    found = formula.over(seen, projection, tolerances)
    return jnp.where(_out_of_range(formula, tolerances, projection), jnp.nan, found)


def _out_of_range(formula: Any, tolerances: Tolerances, projection: Projection) -> Any:
    """Whether a number that was traced, so that nobody could look at it, is not positive, or no temperature.

    Or whether the view is so small or so large that numbers of this type lose their digits.
    """
    least = least_distance(projection.near_w.dtype)
    bad: Any = ~(projection.near_w >= least) | ~(jnp.max(jnp.abs(projection.frustum[:, :3])) <= 1.0 / least)
    for number in jax.tree.leaves((tolerances, formula)):
        bad |= ~(number > 0)
    smooth = getattr(formula, "smooth", None)
    return jnp.asarray(bad if smooth is None else bad | ~(smooth <= 1))
