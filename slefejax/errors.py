"""What the package raises when it is given something that it cannot use."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager


class InputError(ValueError):
    """An argument, a file or an option is wrong: the message says what, where and what to do.

    The command line prints the message as one sentence and exits with status 2.

    options : words of the message that are names of parameters; the command line spells them as its own options

    >>> InputError("drop_defects must be True or False", options=("drop_defects",)).typed({"drop_defects"})
    '--drop-defects must be True or False'
    """

    def __init__(self, message: str, *, options: Iterable[str] = ()) -> None:
        super().__init__(message)
        self.options = tuple(options)

    def __reduce__(self) -> tuple:
        return type(self), self.args, {"options": self.options}

    def within(self, where: object) -> InputError:
        """The same error with the file, or whatever it is about, in front."""
        return InputError(f"{where}: {self}", options=self.options)

    def typed(self, known: Collection[str]) -> str:
        """The message as a command line says it that has options of these names.

        A word inside of a path is none: neither a slash nor a dot may stand beside it.
        """
        said = str(self)
        for name in self.options:
            own = COMMAND_LINE.get(name, name)
            if own in known:
                said = re.sub(rf"(?<![\w./\\-]){name}(?![\w/\\-]|\.\w)", f"--{own.replace('_', '-')}", said)
        return said


COMMAND_LINE = {"fov_y": "fov", "width": "size", "height": "size"}
"""Parameters that the command line calls otherwise."""


@contextmanager
def naming(where: object) -> Iterator[None]:
    """Within, an InputError says what it is about: a file or a scene is put in front unless the message names it.

    >>> with naming("a.obj"):
    ...     raise InputError("there is no face 7")
    Traceback (most recent call last):
        ...
    slefejax.errors.InputError: a.obj: there is no face 7
    """
    try:
        yield
    except InputError as error:
        if str(where) in str(error):
            raise
        raise error.within(where) from None


class NoOpenGLError(RuntimeError):
    """No usable OpenGL device: the message names what is missing and what brings it."""


class OpenGLError(RuntimeError):
    """The OpenGL device fails while it is used: it was lost, ran out of memory, or does what it should not."""
