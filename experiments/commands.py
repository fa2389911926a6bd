"""All commands, by the names that are typed."""

from __future__ import annotations

from functools import reduce
from importlib import import_module
from operator import or_
from typing import Annotated, Any

from tyro.conf import subcommand

COMMANDS = {
    "minimality": "Minimality",
    "factors": "FactorsOfScene",
    "inspect": "Inspect",
    "animate": "Animate",
    "certify": "Certify",
    "fit-km": "FitKm",
    "budget": "BudgetOfScene",
    "sensitivity": "SensitivityOfScene",
    "optimise": "Optimise",
    "error-time": "ErrorTime",
    "scaling": "Scaling",
    "tightness": "Tightness",
    "stability": "Stability",
    "attack": "Attack",
    "bench": "Bench",
    "doctor": "Doctor",
}


def command_of(name: str) -> Any:
    """The class of a command. Its module is imported only now: all of them take longer than a short command."""
    return getattr(import_module(f"slefejax.experiments.{name.replace('-', '_')}"), COMMANDS[name])


def all_commands() -> Any:
    """One of the classes, chosen by its name."""
    return reduce(or_, (Annotated[command_of(name), subcommand(name)] for name in COMMANDS))
