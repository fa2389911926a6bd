"""The one place that makes an OpenGL context: no window, one a process, used by the thread that made it."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any

import moderngl

from slefejax.errors import NoOpenGLError, OpenGLError
from slefejax.tessellator.levels import HIGHEST_LEVEL

OPENGL = 430
PACKAGES = "libegl1 libgl1 libgl1-mesa-dri"


@dataclass(frozen=True)
class Device:
    """An OpenGL context and what is worth knowing of it."""

    context: Any
    home: Any  # a framebuffer that lives as long as the context, to be bound while no other is
    renderer: str
    version: str
    highest_level: int
    largest_picture: int  # pixels a side
    thread: int

    def check_thread(self) -> None:
        """Raise unless the calling thread is the one that made the context (another one would read garbage)."""
        if threading.get_ident() != self.thread:
            raise RuntimeError(
                "the OpenGL context belongs to another thread: open the device and draw in one and the same thread"
            )

    def collect(self) -> None:
        """Free what belongs to renderers that nobody holds any more."""
        self.home.use()  # moderngl binds the last framebuffer again, which may be one of those
        waiting = self.context.objects
        while waiting:
            thing = waiting.popleft()
            if hasattr(thing, "release"):  # it has none if it was released before
                thing.release()

    def check_error(self, doing: str) -> None:
        """Raise if OpenGL has recorded an error since the last look."""
        error = self.context.error
        if error != "GL_NO_ERROR":
            raise OpenGLError(f"OpenGL reports {error} while {doing} on {self.renderer}")


_device: Device | None = None


def open_device() -> Device:
    """The process's OpenGL device, made and tested (``selftest``) at the first call.

    Raises NoOpenGLError, saying what to install, if there is none with OpenGL 4.3 and tessellation, or if it fails its
    test.
    """
    global _device
    if _device is None:
        device = _describe(_create_context())
        from slefejax.gpu.selftest import check_coverage

        check_coverage(device)
        _device = device
    _device.check_thread()
    return _device


def _create_context() -> Any:
    attempts: list[dict[str, str]] = [{}, {"libgl": "libEGL.so.1"}]
    reasons = []
    for extra in attempts:
        try:
            context = moderngl.create_context(require=OPENGL, standalone=True, backend="egl", **extra)  # type: ignore[arg-type]
        except Exception as error:  # moderngl and glcontext raise bare Exception
            reasons.append(str(error).strip().splitlines()[0])
        else:
            context.gc_mode = "context_gc"  # what Python frees, in whatever thread, waits for ``Device.collect``
            return context
    raise NoOpenGLError(
        f"no OpenGL device with version 4.3 was found ({reasons[0]}): install a driver, or a software OpenGL with"
        f" 'apt-get install {PACKAGES}'"
    )


def _describe(context: Any) -> Device:
    info = context.info
    return Device(
        context,
        home=context.framebuffer([context.renderbuffer((1, 1))]),
        renderer=str(info["GL_RENDERER"]),
        version=str(info["GL_VERSION"]),
        highest_level=HIGHEST_LEVEL,
        largest_picture=min(int(info["GL_MAX_RENDERBUFFER_SIZE"]), *map(int, info["GL_MAX_VIEWPORT_DIMS"])),
        thread=threading.get_ident(),
    )
