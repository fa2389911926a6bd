"""What the package raises when it is given something that it cannot use."""

from __future__ import annotations


class InputError(ValueError):
    """An argument, a file or an option is wrong: the message says what, where and what to do.

    The command line prints the message as one sentence and exits with status 2.
    """


class NoOpenGLError(RuntimeError):
    """No usable OpenGL device: the message names what is missing and what brings it."""


class OpenGLError(RuntimeError):
    """The OpenGL device fails while it is used: it was lost, ran out of memory, or does what it should not."""
