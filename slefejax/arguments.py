"""What the public functions take, and the checks that turn a wrong argument into one clear sentence.

Entry points take anything that NumPy or JAX can make an array of, so their parameters have the wide types below; what
they need is said in their docstrings and checked here. A traced argument is only checked for its shape.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from difflib import get_close_matches
from importlib import import_module
from typing import Any, Literal, Protocol, overload, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jaxtyping import Float, Int

from slefejax.errors import InputError


@runtime_checkable
class HasArray(Protocol):
    """What JAX makes arrays of: packed patches."""

    def __jax_array__(self) -> Any:
        """The array."""
        ...


Patches = (
    Array | np.ndarray | Sequence[Any] | HasArray
)  # control points (patches, du+1, dv+1, 3), u before v; 4 at the end if rational
Numbers = Array | np.ndarray | Sequence[Any] | float | int  # an array of numbers, of the shape that the docstring gives
Number = Array | np.ndarray | np.floating | np.integer | float | int  # one number
Segments = int | tuple[int, ...]  # a whole number m >= 1, or a pair (m_u, m_v)
_LISTED = 40  # names in a sentence


def is_whole(value: Any, lowest: int) -> bool:
    """Whether ``value`` is an integer (no bool, no float) of at least ``lowest``.

    >>> is_whole(3, 1), is_whole(3.0, 1), is_whole(True, 1)
    (True, False, False)
    """
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool) and int(value) >= lowest


def check_segments(segments: Any) -> int:
    """The number of segments, or InputError unless it is a whole number of at least 1.

    >>> check_segments(3)
    3
    >>> check_segments(0)
    Traceback (most recent call last):
        ...
    slefejax.errors.InputError: the number of segments must be a whole number of at least 1, not 0
    """
    if not is_whole(segments, 1):
        raise InputError(
            f"the number of segments must be a whole number of at least 1, not {segments!r}", options=("segments",)
        )
    return int(segments)


def check_temperature(smooth: Any) -> None:
    """InputError unless this is a temperature of soft maxima, or None.

    >>> check_temperature(0.01)
    >>> check_temperature(2)
    Traceback (most recent call last):
        ...
    slefejax.errors.InputError: smooth is a temperature of at most 1, not 2: 0.01 or less is close to the maximum
    """
    if smooth is None:
        return
    if isinstance(smooth, bool):
        raise InputError("smooth is a temperature, such as 0.01, and not yes or no", options=("smooth",))
    check_positive("smooth", smooth)
    if not isinstance(smooth, Tracer) and float(smooth) > 1.0:
        raise InputError(
            f"smooth is a temperature of at most 1, not {smooth}: 0.01 or less is close to the maximum",
            options=("smooth",),
        )


def check_whole(name: str, value: Any, lowest: int) -> None:
    """InputError unless the number is a whole one of at least ``lowest``.

    >>> check_whole("tiles", 2.5, 1)
    Traceback (most recent call last):
        ...
    slefejax.errors.InputError: tiles must be a whole number of at least 1, not 2.5
    """
    if not is_whole(value, lowest):
        raise InputError(f"{name} must be a whole number of at least {lowest}, not {value!r}", options=(name,))


def segment_pair(segments: Any) -> tuple[int, int]:
    """(m_u, m_v) from one number or two, or InputError.

    >>> segment_pair(3), segment_pair((2, 4))
    ((3, 3), (2, 4))
    """
    pair = tuple(segments) if isinstance(segments, (tuple, list)) else (segments, segments)
    if len(pair) != 2:
        raise InputError(
            f"segments must be one number or a pair (along u, along v), not {segments!r}", options=("segments",)
        )
    return check_segments(pair[0]), check_segments(pair[1])


def check_axis(axis: Any, rank: int) -> int:
    """The axis, or InputError unless an array of that rank has it.

    >>> check_axis(-1, 3)
    -1
    >>> check_axis(3, 3)
    Traceback (most recent call last):
        ...
    slefejax.errors.InputError: axis 3 is none of an array with 3 axes
    """
    if not is_whole(axis, -rank) or axis >= rank:
        raise InputError(f"axis {axis!r} is none of an array with {rank} axes")
    return int(axis)


def check_concrete(what: str, *values: Any) -> None:
    """InputError inside of jit, grad and the like; ``what``: the function that works on the host."""
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values)):
        raise InputError(f"{what} measures on the host, in float64: call it outside of jit, grad and vmap")


def check_positive(name: str, value: Any) -> None:
    """InputError unless the number is positive and finite.

    >>> check_positive("tolerance", 0.0)
    Traceback (most recent call last):
        ...
    slefejax.errors.InputError: tolerance must be a positive number, not 0.0
    """
    if isinstance(value, Tracer):
        return
    try:
        number = np.asarray(value) if isinstance(value, jax.Array) else value  # in jit JAX would trace what it compares
        fine = np.ndim(number) == 0 and bool(np.isfinite(number)) and bool(number > 0)
    except (TypeError, ValueError):
        fine = False
    if not fine:
        raise InputError(f"{name} must be a positive number, not {value!r}", options=(name,))


def check_degrees(name: str, value: Any) -> None:
    """InputError unless the number is an acute angle in degrees.

    >>> check_degrees("normal_tolerance", 200)
    Traceback (most recent call last):
        ...
    slefejax.errors.InputError: normal_tolerance must be more than 0 and less than 90 degrees, not 200
    """
    if isinstance(value, Tracer):
        return
    try:
        number = np.asarray(value) if isinstance(value, jax.Array) else value  # in jit JAX would trace what it compares
        fine = np.ndim(number) == 0 and not isinstance(value, bool) and bool(number > 0) and bool(number < 90)
    except (TypeError, ValueError):
        fine = False
    if not fine:
        raise InputError(f"{name} must be more than 0 and less than 90 degrees, not {value!r}", options=(name,))


def check_not_negative(name: str, value: Any) -> None:
    """InputError unless the number is finite and at least 0.

    >>> check_not_negative("weld", -1)
    Traceback (most recent call last):
        ...
    slefejax.errors.InputError: weld must be a number of at least 0, not -1
    """
    try:
        fine = np.ndim(value) == 0 and not isinstance(value, bool) and bool(np.isfinite(value)) and value >= 0
    except (TypeError, ValueError):
        fine = False
    if not fine:
        raise InputError(f"{name} must be a number of at least 0, not {value!r}", options=(name,))


def check_choice(what: str, value: Any, choices: Collection[str]) -> None:
    """InputError unless the value is one of the names; ``what``: a method, a scheme.

    >>> check_choice("spacing", "even", ("equal", "fractional-even"))
    Traceback (most recent call last):
        ...
    slefejax.errors.InputError: there is no spacing 'even': choose one of equal, fractional-even
    """
    if not isinstance(value, str) or value not in choices:
        raise InputError(no_such(what, value, choices))


def no_such(what: str, value: Any, choices: Collection[str]) -> str:
    """The sentence about a name that is none of those that there are: the nearest of them, and a list.

    >>> no_such("scheme", "pinchd", ("auto", "acc", "pinched"))
    "there is no scheme 'pinchd' (did you mean pinched?): choose one of auto, acc, pinched"
    """
    names = list(choices)
    if not names:
        return f"there is no {what} {value!r}: there is none at all"
    listed = ", ".join(names[:_LISTED]) + (f" and {len(names) - _LISTED} more" if len(names) > _LISTED else "")
    return f"there is no {what} {value!r}{did_you_mean(value, names)}: choose one of {listed}"


def did_you_mean(value: Any, choices: Iterable[str]) -> str:
    """In brackets, behind a space, the name that was meant most likely; nothing if none is near.

    >>> did_you_mean("teapott", ["teapot", "walker"])
    ' (did you mean teapot?)'
    """
    names = {name.lower(): name for name in choices}
    near = get_close_matches(str(value).lower(), list(names), 1)
    return f" (did you mean {names[near[0]]}?)" if near else ""


def imported(name: str, what: str) -> Any:
    """The value of ``module:name``. Raises InputError if there is none; ``what``: a method, a scheme.

    >>> imported("math:floor", "method")(2.5)
    2
    """
    module, _, inside = name.partition(":")
    try:
        return getattr(import_module(module), inside)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(f"there is no {what} {name!r}: {error}") from None


def real_numbers(values: Any, what: str) -> Float[np.ndarray, "*shape"]:
    """Values as an array of float64, or InputError.

    >>> real_numbers([[1, 2], [3, 4]], "levels").dtype.name
    'float64'
    """
    try:
        return np.asarray(values, np.float64)
    except (ValueError, TypeError, OverflowError):
        raise InputError(f"{what} must be real numbers, in rows of equal lengths") from None


def floating(values: Any) -> Array | np.ndarray:
    """Numbers as an array of float32 or float64, whichever they are, or InputError.

    Half precision becomes float32; anything else, whole numbers too, float64, on the host, whether JAX has that or not.

    >>> floating([[1, 2]]).tolist(), floating(np.float32([1.5])).dtype.name
    ([[1.0, 2.0]], 'float32')
    """
    if not isinstance(values, (jax.Array, np.ndarray)) and hasattr(values, "__jax_array__"):  # packed patches
        values = values.__jax_array__()
    try:
        array = values if isinstance(values, (jax.Array, np.ndarray)) else np.asarray(values)
    except ValueError as error:
        raise InputError("an array of numbers is needed: these rows are of different lengths") from error
    if array.dtype == object or not jnp.issubdtype(array.dtype, jnp.number):
        raise InputError(f"an array of numbers is needed, not of {array.dtype}")
    if jnp.issubdtype(array.dtype, jnp.complexfloating):
        raise InputError("an array of real numbers is needed, not of complex ones")
    if str(array.dtype) in ("float32", "float64"):  # not of the other byte order
        return array
    if str(array.dtype) in ("float16", "bfloat16"):
        return array.astype(np.float32)
    if isinstance(array, Tracer):
        return array.astype(jax.dtypes.canonicalize_dtype(np.float64))
    whole = np.asarray(array).astype(np.float64)
    if array.dtype.kind in "iu" and array.size and max(int(array.max()), -int(array.min())) > 2**53:
        raise InputError("whole numbers beyond 2^53 are not exact as float64: take an offset off them first")
    return whole


@overload
def check_patches(patches: Any, dims: tuple[int, ...] | None = ...) -> Array | np.ndarray: ...
@overload
def check_patches(patches: Any, dims: tuple[int, ...] | None = ..., *, gregory: Literal[True]) -> Any: ...
def check_patches(patches: Any, dims: tuple[int, ...] | None = (3, 4), *, gregory: bool = False) -> Any:
    """Patches as a floating-point array of rank 4, or InputError that says what is wrong with its shape.

    gregory : whether ``GregoryPatches`` will do, which are returned as they are

    >>> check_patches(np.zeros((2, 4, 4, 2)))
    Traceback (most recent call last):
        ...
    slefejax.errors.InputError: control points must have 3 or 4 coordinates, not 2
    """
    patches = patches.patches() if hasattr(patches, "chunks") else patches  # packed ones
    if hasattr(patches, "twists"):
        if not gregory:
            raise InputError(
                "this takes Bézier patches, such as those of the scheme 'acc', and these are Gregory patches"
            )
        return patches
    patches = floating(patches)
    if patches.ndim != 4:
        raise InputError(f"patches must have shape (patches, du+1, dv+1, 3), not {tuple(patches.shape)}")
    if patches.shape[0] == 0:
        raise InputError("there are no patches: at least one is needed")
    if min(patches.shape[1:3]) < 2:
        raise InputError(f"patches need a degree of at least 1 in u and v, not shape {tuple(patches.shape)}")
    if dims is not None and patches.shape[3] not in dims:
        raise InputError(f"control points must have {' or '.join(map(str, dims))} coordinates, not {patches.shape[3]}")
    return patches


def on_host(patches: Any) -> Any:
    """Patches of any kind as NumPy's.

    >>> on_host(jnp.zeros((1, 2, 2, 3))).shape
    (1, 2, 2, 3)
    """
    return patches.on_host() if hasattr(patches, "twists") else np.asarray(patches)


def on_device(patches: Any) -> Any:
    """Patches of any kind as JAX's.

    >>> on_device(np.zeros((1, 2, 2, 3))).shape
    (1, 2, 2, 3)
    """
    return jax.tree.map(jnp.asarray, patches) if hasattr(patches, "twists") else jnp.asarray(patches)


def check_weights(patches: Any) -> None:
    """InputError unless all weights of rational patches are positive and finite; the others pass.

    >>> check_weights(np.zeros((1, 2, 2, 4)))
    Traceback (most recent call last):
        ...
    slefejax.errors.InputError: the weights of rational patches must be positive: patch 0 (counted from 0) has 0
    """
    if patches.shape[3] != 4 or isinstance(patches, Tracer):
        return
    weights = np.asarray(patches)[..., 3]
    bad = np.flatnonzero(~np.all((weights > 0) & np.isfinite(weights), axis=(1, 2)))
    if bad.size:
        worst = weights[bad[0]].min()
        raise InputError(
            f"the weights of rational patches must be positive: patch {bad[0]} (counted from 0) has {worst:g}"
            + (f", and {bad.size - 1} more patches have such weights" if bad.size > 1 else "")
        )


def whole_numbers(values: Any, what: str) -> Int[np.ndarray, "*shape"]:
    """Values as an array of whole numbers, or InputError.

    >>> whole_numbers([1.0, 2.0], "factors").tolist()
    [1, 2]
    """
    try:
        found = np.asarray(values)
        with np.errstate(invalid="ignore"):
            whole = found.astype(np.int64)
        if found.size and not np.array_equal(whole, found):
            raise ValueError
    except (ValueError, TypeError, OverflowError):
        raise InputError(f"{what} must be whole numbers (round them up), none of them beyond 64 bits") from None
    return whole
