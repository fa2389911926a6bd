"""All commands, by the names that are typed."""

from __future__ import annotations

from functools import reduce
from importlib import import_module
from operator import or_
from typing import Annotated, Any

from tyro.conf import subcommand

COMMANDS = {
    "minimality": "studies.minimality:Minimality",
    "factors": "checks.factors:FactorsOfScene",
    "inspect": "checks.inspect:Inspect",
    "study": "grid.command:StudyOfFile",
    "render": "looks.render:Render",
    "animate": "studies.animate:Animate",
    "certify": "studies.certify:Certify",
    "fit-km": "studies.fit_km:FitKm",
    "budget": "moves.budget:BudgetOfScene",
    "sensitivity": "moves.sensitivity:SensitivityOfScene",
    "optimise": "moves.optimise:Optimise",
    "error-time": "studies.error_time:ErrorTime",
    "scaling": "bench.scaling:Scaling",
    "limit": "checks.limit:Limit",
    "gaussian": "products.gaussian:GaussianOfScene",
    "tightness": "checks.tightness:Tightness",
    "stability": "checks.stability:Stability",
    "attack": "attack.attack:Attack",
    "bench": "bench.bench:Bench",
    "compare": "compare.compare:Compare",
    "doctor": "checks.doctor:Doctor",
}


def command_of(name: str) -> Any:
    """The class of a command. Its module is imported only now: all of them take longer than a short command."""
    module, _, command = COMMANDS[name].partition(":")
    return getattr(import_module(f"slefejax.experiments.{module}"), command)


def all_commands() -> Any:
    """One of the classes, chosen by its name."""
    return reduce(or_, (Annotated[command_of(name), subcommand(name)] for name in COMMANDS))
