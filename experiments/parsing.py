"""What is typed behind ``slefejax``, as an object of a command's class."""

from __future__ import annotations

from typing import Any, get_args

import tyro
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
    UnsupportedTypeAnnotationError,
)

from slefejax.arguments import no_such
from slefejax.errors import InputError
from slefejax.experiments.commands import COMMANDS, all_commands, command_of

NO_CACHE = "--no-cache"
_DESCRIPTION = (
    "How finely must a curved surface be tessellated? Predict it, render it, measure it."
    f" {NO_CACHE} anywhere: compiled programs are not kept. --version alone: which version this is."
)
_NOTHING = "none"  # how the help calls a default of None or of no values
_CONFIG = (
    tyro.conf.FlagCreatePairsOff,
    tyro.conf.OmitSubcommandPrefixes,
    tyro.conf.PositionalMetavarFromFieldName,
)
Spec = PrimitiveConstructorSpec | UnsupportedTypeAnnotationError | None


def parsed(typed: list[str]) -> Any:
    """The command that these words ask for.

    Shows help, and what is wrong with an option, as ``SystemExit``. Raises InputError for a command that there is not.
    """
    known = bool(typed) and typed[0] in COMMANDS
    if typed and not known and not typed[0].startswith("-"):
        raise InputError(no_such("command", typed[0], COMMANDS))
    return tyro.cli(
        command_of(typed[0]) if known else all_commands(),
        prog=f"slefejax {typed[0]}" if known else "slefejax",
        description=None if known else _DESCRIPTION,
        args=typed[known:],
        config=_CONFIG,
        registry=_registry(),
    )


def _registry() -> ConstructorRegistry:
    """How values are read and named in the help: an option that may be left out is of the kind that is typed."""
    registry = ConstructorRegistry()
    registry.primitive_rule(_optional)
    registry.primitive_rule(_several)
    return registry


def _optional(info: PrimitiveTypeInfo) -> Spec:
    """``kind | None``: a value of that kind; None cannot be typed, only left out."""
    kinds = get_args(info.type)
    if type(None) not in kinds or len(kinds) != 2:
        return None
    own = _spec_of(next(kind for kind in kinds if kind is not type(None)), info)
    if not isinstance(own, PrimitiveConstructorSpec):
        return own
    return PrimitiveConstructorSpec(
        nargs=own.nargs,
        metavar=own.metavar,
        instance_from_str=own.instance_from_str,
        is_instance=lambda value: value is None or own.is_instance(value),
        str_from_instance=lambda value: [_NOTHING] if value is None else own.str_from_instance(value),
        choices=own.choices,
    )


def _several(info: PrimitiveTypeInfo) -> Spec:
    """``tuple[kind, ...]``, as many values as are typed, or ``tuple[kind, kind, kind]``, so many; all of one kind."""
    kinds = [kind for kind in get_args(info.type) if kind is not Ellipsis]
    if info.type_origin is not tuple or len(set(kinds)) != 1:
        return None
    own = _spec_of(kinds[0], info)
    if not isinstance(own, PrimitiveConstructorSpec):
        return own
    any_number = len(kinds) < len(get_args(info.type))
    return PrimitiveConstructorSpec(
        nargs="*" if any_number else len(kinds),
        metavar=f"{own.metavar} ..." if any_number else " ".join([own.metavar] * len(kinds)),
        instance_from_str=lambda words: tuple(own.instance_from_str([word]) for word in words),
        is_instance=lambda value: isinstance(value, tuple) and all(map(own.is_instance, value)),
        str_from_instance=lambda values: (
            [word for value in values for word in own.str_from_instance(value)] or [_NOTHING]
        ),
        choices=own.choices,
    )


def _spec_of(kind: Any, info: PrimitiveTypeInfo) -> Spec:
    return ConstructorRegistry.get_primitive_spec(PrimitiveTypeInfo.make(kind, info.markers))
