"""The command ``slefejax``."""

from __future__ import annotations

import os
import sys
from typing import Annotated

import jax
import tyro
from tyro.conf import subcommand

from slefejax.errors import InputError, NoOpenGLError
from slefejax.experiments.doctor import Doctor
from slefejax.experiments.factors import FactorsOfScene
from slefejax.experiments.minimality import Minimality
from slefejax.experiments.tightness import Tightness

Command = (
    Annotated[Minimality, subcommand("minimality")]
    | Annotated[FactorsOfScene, subcommand("factors")]
    | Annotated[Tightness, subcommand("tightness")]
    | Annotated[Doctor, subcommand("doctor")]
)
BAD_INPUT = 2
INTERRUPTED = 130


def main(arguments: list[str] | None = None) -> int:
    """Run a command. Exit status 0 if it is whole, 2 for bad input or no OpenGL device, 130 if it was interrupted."""
    jax.config.update("jax_enable_x64", True)
    config = (tyro.conf.FlagCreatePairsOff, tyro.conf.OmitSubcommandPrefixes)
    command = tyro.cli(
        Command,  # type: ignore[arg-type]
        prog="slefejax",
        description="How finely must a curved surface be tessellated? Predict it, render it, measure it.",
        args=arguments,
        config=config,
    )
    try:
        if isinstance(command, Doctor):
            return command.examine()
        command.run().print(command.output.json)
        return 0
    except BrokenPipeError:  # whoever reads the table has read enough; the results are in place
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (InputError, NoOpenGLError) as error:
        print(f"slefejax: {error}", file=sys.stderr)
        return BAD_INPUT
    except OSError as error:
        print(f"slefejax: the results could not be written: {error}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("slefejax: stopped; the same command goes on where it was", file=sys.stderr)
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
