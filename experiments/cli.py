"""The command ``slefejax``."""

from __future__ import annotations

import os
import sys
from typing import Any

import slefejax

BAD_INPUT = 2
INTERRUPTED = 130


def main(arguments: list[str] | None = None) -> int:
    """Run a command. Exit status 0 if it is whole, 130 if it was interrupted, 2 for whatever else is in its way."""
    try:
        return _run(arguments)
    except KeyboardInterrupt:
        return _fail("stopped; the same command goes on where it was", INTERRUPTED)
    except ImportError as error:
        return _fail(f"the package {error.name!r} is missing or broken ({error}): pip install {error.name}")


def _run(arguments: list[str] | None) -> int:
    given = sys.argv[1:] if arguments is None else arguments
    if given == ["--version"]:
        print(f"slefejax {slefejax.__version__}")
        return 0
    # Imported here, so that a package that is missing is one sentence and Ctrl-C is heard from the beginning.
    from slefejax.errors import InputError, NoOpenGLError, OpenGLError
    from slefejax.experiments.options import option_names
    from slefejax.experiments.parsing import NO_CACHE, parsed
    from slefejax.experiments.report import working
    from slefejax.experiments.store import typed

    command: Any = None
    words = [argument for argument in given if argument != NO_CACHE]
    try:
        command = parsed(words)
        with working(words[0]), typed(given):
            start_jax(keep=NO_CACHE not in given)
            report: Any = command.run()
    except InputError as error:
        return _fail(error.typed(() if command is None else option_names(command)))
    except NoOpenGLError as error:
        return _fail(str(error))
    except OpenGLError as error:
        return _fail(f"{error}: the same command goes on where it was")
    except MemoryError:
        return _fail("there is not enough memory for that: a smaller picture, fewer patches or pieces need less")
    except OSError as error:
        return _fail(f"the results could not be written: {error}; the same command goes on where it was")
    return _show(report)


def start_jax(keep: bool, double: bool = True) -> None:
    """Double precision, a device to compute on, and a folder for compiled programs, unless they are not to be kept.

    Raises InputError if the device that was asked for is not there.
    """
    import jax

    from slefejax.errors import InputError

    jax.config.update("jax_enable_x64", double)
    jax.config.update("jax_enable_compilation_cache", keep)
    if keep:
        slefejax.keep_programs()
    try:
        jax.devices()
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"JAX finds no device ({reason}): unset JAX_PLATFORMS, or set it to cpu") from None


def _show(report: Any) -> int:
    try:
        report.print()
        sys.stdout.flush()
    except BrokenPipeError:  # whoever reads the table has read enough; the results are in place
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        return _fail(f"the results are in {report.out}, but could not be shown: {error}")
    return report.status


def _fail(sentence: str, status: int = BAD_INPUT) -> int:
    print(f"slefejax: {sentence}", file=sys.stderr)
    return status


def entry() -> None:
    """Run what was typed, and exit. After an interruption compiler threads may still run: leave without waiting."""
    status = main()
    if status == INTERRUPTED:
        sys.stderr.flush()
        os._exit(status)
    sys.exit(status)
