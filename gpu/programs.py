"""Shader programs, put together from the files under shaders/."""

from __future__ import annotations

import re
from importlib.resources import files
from typing import Any, NamedTuple

import moderngl

from slefejax.errors import OpenGLError

_STAGES = {
    "vertex_shader": "patch.vert",
    "tess_control_shader": "patch.tesc",
    "tess_evaluation_shader": "patch.tese",
}


class Shape(NamedTuple):
    """What a patch is: of a net ``(nu, nv, dim)`` and twists; levels of nested nets if it is a square of those."""

    nu: int
    nv: int
    dim: int
    twists: int
    levels: int | None = None


class Options(NamedTuple):
    """What is drawn of patches: with which spacing, with sides that are their owners' (sides.glsl), which normals,
    and whether with the sides of triangles."""

    spacing: str
    owned: bool
    normals: str | None
    wire: bool


def draw_program(context: Any, shape: Shape, options: Options) -> Any:
    """Draws patches of that shape into the G-buffer."""
    stages = {**_STAGES, "geometry_shader": "gbuffer.geom", "fragment_shader": "gbuffer.frag"}
    return _program(context, shape, options, stages)


def capture_program(context: Any, shape: Shape, options: Options) -> Any:
    """Writes the triangles that the tessellator makes to a storage buffer and draws nothing."""
    return _program(context, shape, options, {**_STAGES, "geometry_shader": "capture.geom"})


def _program(context: Any, shape: Shape, options: Options, stages: dict[str, str]) -> Any:
    defines: dict[str, Any] = {"DEGREE_U": shape.nu - 1, "DEGREE_V": shape.nv - 1, "COORDINATES": shape.dim}
    defines |= {"TWISTS": shape.twists, "NESTED": int(shape.levels is not None), "LEVELS": shape.levels or 0}
    defines |= {"SPACING": options.spacing.replace("-", "_") + "_spacing"}
    defines |= {"OWNED_SIDES": int(options.owned), "NORMALS": int(options.normals is not None)}
    defines |= {"TANGENT_NETS": int(options.normals == "tangents"), "WIRE": int(options.wire)}
    sources = {stage: _source(name, defines) for stage, name in stages.items()}
    try:
        return context.program(**sources)
    except moderngl.Error as error:
        raise OpenGLError(f"the shaders {', '.join(stages.values())} did not compile: {error}") from error


def _source(name: str, defines: dict[str, Any]) -> str:
    """A shader's text, with its includes in place and the definitions behind its #version line."""
    text = _read(name)
    while '#include "' in text:
        text = re.sub(r'^#include "(.+)"$', lambda match: _read(match.group(1)), text, flags=re.MULTILINE)
    version, rest = text.split("\n", 1)
    lines = [f"#define {key} {value}" for key, value in defines.items()]
    return "\n".join([version, *lines, rest])


def _read(name: str) -> str:
    return (files("slefejax.gpu") / "shaders" / name).read_text()
