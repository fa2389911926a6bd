"""All commands, by the names that are typed."""

from __future__ import annotations

from typing import Annotated

from tyro.conf import subcommand

from slefejax.experiments.animate import Animate
from slefejax.experiments.bench import Bench
from slefejax.experiments.budget import BudgetOfScene
from slefejax.experiments.certify import Certify
from slefejax.experiments.doctor import Doctor
from slefejax.experiments.error_time import ErrorTime
from slefejax.experiments.factors import FactorsOfScene
from slefejax.experiments.fit_km import FitKm
from slefejax.experiments.inspect import Inspect
from slefejax.experiments.minimality import Minimality
from slefejax.experiments.optimise import Optimise
from slefejax.experiments.scaling import Scaling
from slefejax.experiments.sensitivity import SensitivityOfScene
from slefejax.experiments.stability import Stability
from slefejax.experiments.tightness import Tightness

Command = (
    Annotated[Minimality, subcommand("minimality")]
    | Annotated[FactorsOfScene, subcommand("factors")]
    | Annotated[Inspect, subcommand("inspect")]
    | Annotated[Animate, subcommand("animate")]
    | Annotated[Certify, subcommand("certify")]
    | Annotated[FitKm, subcommand("fit-km")]
    | Annotated[BudgetOfScene, subcommand("budget")]
    | Annotated[SensitivityOfScene, subcommand("sensitivity")]
    | Annotated[Optimise, subcommand("optimise")]
    | Annotated[ErrorTime, subcommand("error-time")]
    | Annotated[Scaling, subcommand("scaling")]
    | Annotated[Tightness, subcommand("tightness")]
    | Annotated[Stability, subcommand("stability")]
    | Annotated[Bench, subcommand("bench")]
    | Annotated[Doctor, subcommand("doctor")]
)
