"""Patches through OpenGL's tessellation stages, into a G-buffer or out again as triangles."""

from __future__ import annotations

from typing import Any, NoReturn

import moderngl
import numpy as np
from jaxtyping import Real

from slefejax.arguments import real_numbers, whole_numbers
from slefejax.errors import InputError, OpenGLError
from slefejax.geometry.normals import kind_of_normals
from slefejax.geometry.view import View
from slefejax.gpu.buffers import GBuffer, Triangles
from slefejax.gpu.context import Device, open_device
from slefejax.gpu.programs import Options, capture_program, draw_program
from slefejax.gpu.sent import owner_records, sent, sides_of, write_changed
from slefejax.gpu.strays import Strays, drawn_at, nearest_drawn, normals_at
from slefejax.gpu.unseen import without_unseen
from slefejax.tessellator.edges import Sides
from slefejax.tessellator.levels import (
    MOST_LEVEL,
    Pieces,
    check_spacing,
    highest_level,
    segments,
    triangle_counts,
)

# Software OpenGL numbers the tessellated vertices of a draw call in 16 bits and loses triangles beyond.
VERTICES_A_DRAW = 65_536
_RECORD, _NORMALS = 20, 9  # floats a captured triangle, and how many more with normals, see capture.geom
_PIECE = 12  # floats a piece, see patch.tesc
_OWNERS = 4  # binding, see sides.glsl
_COMPONENTS = {"sample": 4, "drawn": 2, "normal": 4, "side": 4}  # of the G-buffer's parts, see gbuffer.frag
_PROGRAMS = {"draw": draw_program, "capture": capture_program}

Inner = Any  # levels (patches, 2), along u and v
Outer = Any  # levels (patches, 4), at u=0, v=0, u=1, v=1


class Renderer:
    """Holds the control points on the device and draws them with any levels, from any view.

    Patches with levels past the hardware's limit of 64 are drawn in pieces (``tessellator.levels``), which show in
    nothing: parameters are the patch's, and neighbours meet without a crack. Pieces that are off the screen are left
    out.

    patches  : ``(patches, du+1, dv+1, 3)`` or, rational, 4 at the end, or ``GregoryPatches``; sent as float32, relative
               to the box around them, so that a scene far from the origin, or of any size, loses nothing. Or
               ``NestedNets`` of Gaussian products, each of whose squares is a patch
    device   : from ``open_device``, which is called if it is not given
    spacing  : ``"equal"``: levels are whole numbers; ``"fractional-even"``, ``"fractional-odd"``: any numbers up to the
               limit, and vertices move as they change, instead of coming and going
    sides    : which curve each side is (``tessellator.edges``): vertices on it are points of its owner. If they are not
               given, sides are shared where their points are equal, or equal once raised to one degree
    normals  : whether pictures and triangles have normals, too: True or ``"surface"`` for those of the surface,
               ``"tangents"`` for those of tangent patches, which agree along edges where the surface's jump
    tangents : for these: along u ``(patches, du, dv+1, 3)`` and along v ``(patches, du+1, dv, 3)``, as of
               ``scene.tangents()``
    wire     : whether pictures have the sides and areas of triangles, too, ``GBuffer.edge`` and ``GBuffer.area``

    Raises InputError for patches, sides, normals or tangents that do not fit.

    >>> renderer = Renderer(patches)                                        # doctest: +SKIP
    >>> buffer = renderer.draw(view, factors.inner, factors.edges)          # doctest: +SKIP
    """

    moved: int
    """Of how many patches control points were sent when they were made or moved last: of those that changed."""

    def __init__(
        self,
        patches: Any,
        device: Device | None = None,
        spacing: str = "equal",
        sides: Sides | None = None,
        normals: bool | str = False,
        tangents: Any = None,
        wire: bool = False,
    ) -> None:
        check_spacing(spacing)
        self.normals, self.wire = kind_of_normals(normals), wire
        self.device, self.spacing = device or open_device(), spacing
        asked = {"normal": self.normals is not None, "side": wire}
        self._components = {name: count for name, count in _COMPONENTS.items() if asked.get(name, True)}
        self.device.check_thread()
        self.device.collect()
        self._sent = sent(patches, None, self.normals, tangents)
        self._count = self.moved = len(self._sent)
        context = self.device.context
        self._buffers = {binding: context.buffer(own.tobytes()) for binding, own in self._sent.buffers.items()}
        # where all sides have equally many points, those that are one curve have equal ones: each patch's own will do
        self._finds_sides = sides is None and self._sent.shape.nu != self._sent.shape.nv
        if self._finds_sides:
            sides = sides_of(patches)
        if sides is not None:
            self._buffers[_OWNERS] = context.buffer(owner_records(sides, self._count))
        self._target: tuple[tuple[int, int], Any] | None = None
        self._drawn: tuple[View, Pieces, bool] | None = None
        self._arrays: dict[str, Any] = {}
        self._pieces: Any = None
        self._numbers: Any = None
        self._room = 0
        self._make_room(self._count)

    def __reduce__(self) -> NoReturn:
        raise TypeError(
            "a Renderer cannot be pickled or copied: what it holds lies on the OpenGL device of its own thread; make"
            " another one of the same patches"
        )

    def move(self, patches: Any, tangents: Any = None) -> None:
        """Other control points for the same patches, of which only those that differ are sent (``moved``).

        tangents : other tangent patches, needed where normals are theirs; only those that differ are sent

        Raises InputError if there are more or fewer patches, or other tangents than the renderer was made with.
        """
        self.device.check_thread()
        found = sent(patches, self._sent, self.normals, tangents)
        before, now = self._sent.buffers, found.buffers
        if found.shape != self._sent.shape or any(own.shape != before[k].shape for k, own in now.items()):
            raise InputError(f"patches that move keep their number and degree: {self._sent}, not {found}")
        written = {k: write_changed(self._buffers[k], own, before[k]) for k, own in now.items()}
        self.moved = written[0]
        self._drawn = None
        self._sent = found
        if self._finds_sides:
            self._buffers[_OWNERS].write(owner_records(sides_of(patches), self._count))

    def draw(self, view: View, inner: Inner, outer: Outer) -> GBuffer:
        """Draw and read back. Levels as in ``submit``."""
        self.submit(view, inner, outer)
        return self.read(view)

    def submit(self, view: View, inner: Inner, outer: Outer) -> None:
        """Draw the patches and wait until that is done.

        inner : ``(patches, 2)`` levels along u and v, whole numbers unless the spacing is fractional
        outer : ``(patches, 4)`` levels at u=0, v=0, u=1, v=1; 0 leaves the patch out
        Past 64 levels must be multiples of the number of pieces; those of ``Factors`` are, ``with_pieces`` makes others
        so. Raises InputError for levels of the wrong shape, or that cannot be drawn.
        """
        parts, in_pieces = self._parts(view, inner, outer)
        target = self._framebuffer(view)
        target.use()
        self.device.context.enable_only(moderngl.DEPTH_TEST)
        target.clear(0.0, 0.0, -1.0, 1.0, depth=1.0)  # normals are not read there
        self._render("draw", view, parts, in_pieces)
        self._drawn = (view, parts, in_pieces)
        self.device.context.finish()
        self.device.check_error("drawing patches")

    def read(self, view: View) -> GBuffer:
        """The picture that was drawn last. Raises InputError if there is none, or if the patches have moved since."""
        if self._drawn is None:
            raise InputError("nothing was drawn since the renderer was made or its patches moved: draw, then read")
        target = self._framebuffer(view)
        parts = {
            name: np.frombuffer(target.read(attachment=k, components=n, dtype="f4"), np.float32).reshape(
                *target.size[::-1], n
            )
            for k, (name, n) in enumerate(self._components.items())
        }
        self.device.check_error("reading the G-buffer")
        strays, at = Strays.of(parts["sample"], parts["drawn"])
        if len(strays.patch):
            for name, own in self._settled(strays, parts["sample"][at], *self._drawn).items():
                parts[name] = parts[name].copy()
                parts[name][at] = own
        return GBuffer.of(parts)

    def capture(self, view: View, inner: Inner, outer: Outer) -> Triangles:
        """The triangles that the tessellator makes for these levels, with their clip-space positions.

        As when drawing, without pieces of patches that are off the screen.
        """
        return self._captured(view, *self._parts(view, inner, outer))

    def release(self) -> None:
        """Free what lies on the device; the renderer cannot draw any more.

        What a renderer that nobody holds any more has left is freed when the next one is made.
        """
        self._release_arrays()
        for buffer in self._buffers.values():
            buffer.release()
        self._release_target()

    def _to_clip(self, view: View) -> np.ndarray:
        return np.asarray(view.world_to_clip, np.float64) @ self._sent.to_world

    def _settled(
        self, strays: Strays, samples: np.ndarray, view: View, parts: Pieces, in_pieces: bool
    ) -> dict[str, np.ndarray]:
        """Their parts of the G-buffer: of the nearest points of their triangles, and where these are drawn."""
        corners, clip, normals = strays.triangles(parts, lambda some: self._captured(view, some, in_pieces))
        place = nearest_drawn(corners, clip, strays.place).astype(np.float32)
        screen = drawn_at(corners, clip, place.astype(float)) * [0.5 * view.width, 0.5 * view.height]
        sample = np.column_stack([place, strays.patch, samples[:, 3]])
        found = {"sample": sample, "drawn": screen - strays.centre}
        if normals is not None:
            normal = normals_at(corners, normals, place.astype(float))
            found["normal"] = np.column_stack([normal, np.zeros(len(normal))])
        return found

    def _captured(self, view: View, parts: Pieces, in_pieces: bool) -> Triangles:
        """Triangles of pieces, their vertices placed as in a picture that has cut patches in it, or none."""
        context = self.device.context
        expected = int(triangle_counts(parts.inner, parts.outer, self.spacing).sum())
        counter = context.buffer(np.zeros(1, np.uint32).tobytes())
        size = _RECORD + (_NORMALS if self.normals else 0)
        records = context.buffer(reserve=4 * size * max(1, expected))
        counter.bind_to_storage_buffer(2)
        records.bind_to_storage_buffer(3)
        self._framebuffer(view).use()
        context.enable_only(moderngl.RASTERIZER_DISCARD)
        self._render("capture", view, parts, in_pieces)
        context.enable_only(moderngl.NOTHING)
        count = int(np.frombuffer(counter.read(), np.uint32)[0])
        self.device.check_error("capturing triangles")
        if count != expected:
            raise OpenGLError(f"{self.device.renderer} made {count} triangles where OpenGL prescribes {expected}")
        data = np.frombuffer(records.read(), np.float32).reshape(-1, size)[:count]
        counter.release()
        records.release()
        vertices = data[:, :18].reshape(-1, 3, 6)
        normal = data[:, _RECORD:].reshape(-1, 3, 3) if self.normals else None
        return Triangles(data[:, 18].astype(np.int32), vertices[..., :2], vertices[..., 2:], normal)

    def _parts(self, view: View, inner: Inner, outer: Outer) -> tuple[Pieces, bool]:
        """What is to be drawn, and whether patches are cut, seen or not: then all vertices are placed at k/n."""
        self.device.check_thread()
        inner, outer = self._checked_levels(inner, outer)
        parts = Pieces.of(inner, outer, self.spacing)
        in_pieces = bool(np.any(parts.along > 1))
        return without_unseen(parts, self._sent.patches, self._to_clip(view)), in_pieces

    def _render(self, name: str, view: View, parts: Pieces, in_pieces: bool) -> None:
        self._make_room(len(parts.patch))
        array = self._array(name)
        array.program["to_clip"].write(self._to_clip(view).astype(np.float32).T.tobytes())
        array.program["in_pieces"] = in_pieces
        if name == "draw":
            array.program["half_picture"] = (0.5 * view.width, 0.5 * view.height)
        records = np.zeros((len(parts.patch), _PIECE), np.float32)
        records[:, :11] = np.column_stack(parts)
        self._pieces.write(records.tobytes())
        self._pieces.bind_to_storage_buffer(1)
        for binding, buffer in self._buffers.items():
            buffer.bind_to_storage_buffer(binding)
        self.device.context.patch_vertices = 1
        for first, count in draw_ranges(segments(parts.inner, self.spacing), segments(parts.outer, self.spacing)):
            array.render(moderngl.PATCHES, vertices=count, first=first)

    def _make_room(self, count: int) -> None:
        """Buffers for so many pieces."""
        if count > self._room:
            self._release_arrays()
            context = self.device.context
            self._pieces = context.buffer(reserve=4 * _PIECE * count)
            self._numbers = context.buffer(np.arange(count, dtype=np.int32).tobytes())
            self._room = count

    def _release_arrays(self) -> None:
        arrays, self._arrays, self._room = self._arrays, {}, 0
        for thing in (*arrays.values(), self._pieces, self._numbers):
            if thing is not None:
                thing.release()
        self._pieces = self._numbers = None

    def _array(self, name: str) -> Any:
        if name not in self._arrays:
            options = Options(self.spacing, _OWNERS in self._buffers, self.normals, self.wire)
            program = _PROGRAMS[name](self.device.context, self._sent.shape, options)
            self._arrays[name] = self.device.context.vertex_array(program, [(self._numbers, "i", "number")])
        return self._arrays[name]

    def _framebuffer(self, view: View) -> Any:
        size = (int(view.width), int(view.height))
        if self._target is None or self._target[0] != size:
            self._release_target()
            context = self.device.context
            if max(size) > self.device.largest_picture:
                raise InputError(
                    f"a picture of {size[0]} x {size[1]} pixels is too large for {self.device.renderer}:"
                    f" its limit is {self.device.largest_picture} pixels a side"
                )
            try:
                colours = [
                    context.renderbuffer(size, components, dtype="f4") for components in self._components.values()
                ]
                self._target = (size, context.framebuffer(colours, context.depth_renderbuffer(size)))
            except moderngl.Error:
                _ = context.error  # OpenGL remembers that it ran out of memory
                raise InputError(
                    f"{self.device.renderer} has no memory for a picture of {size[0]} x {size[1]} pixels:"
                    " make it smaller"
                ) from None
        return self._target[1]

    def _release_target(self) -> None:
        if self._target is not None:
            framebuffer = self._target[1]
            # moderngl binds the last framebuffer again whenever it makes a new one: that must not be a deleted one
            self.device.home.use()
            for attachment in (*framebuffer.color_attachments, framebuffer.depth_attachment, framebuffer):
                attachment.release()
            self._target = None

    def _checked_levels(self, inner: Inner, outer: Outer) -> tuple[Inner, Outer]:
        numbers = whole_numbers if self.spacing == "equal" else real_numbers
        inner, outer = numbers(inner, "levels"), numbers(outer, "levels")
        if inner.shape != (self._count, 2) or outer.shape != (self._count, 4):
            raise InputError(
                f"levels for {self._count} patches must have shapes ({self._count}, 2) and ({self._count}, 4),"
                f" not {inner.shape} and {outer.shape}"
            )
        if not min(inner.min(), outer.min()) >= 0:
            raise InputError("levels must be numbers and not negative: 0 leaves a patch out")
        levels = np.maximum(inner.max(axis=1), outer.max(axis=1))
        # vertices move with fractional spacing, as those of pieces could not
        limit = MOST_LEVEL if self.spacing == "equal" else highest_level(self.spacing, self.device.highest_level)
        check_levels(levels, limit)
        return inner, outer


def check_levels(levels: Real[np.ndarray, "patches"], highest: int = MOST_LEVEL) -> None:
    """Raise InputError if a patch's level is beyond what can be drawn."""
    beyond = np.flatnonzero(levels > highest)
    if beyond.size:
        worst = beyond[np.argmax(levels[beyond])]
        raise InputError(
            f"{beyond.size} of {len(levels)} patches need a tessellation factor above {highest}, the most that can be"
            f" drawn (patch {worst}, counted from 0: {levels[worst]:g}):"
            " move the camera away, shrink the picture or raise the tolerance"
        )


def draw_ranges(inner: Inner, outer: Outer) -> list[tuple[int, int]]:
    """(first patch, number of patches) of draws, none with more than VERTICES_A_DRAW vertices before sharing."""
    longest = np.maximum(inner.max(axis=1), outer.max(axis=1))
    ends = np.cumsum((longest + 1) ** 2)
    ranges, first = [], 0
    while first < len(ends):
        used = ends[first - 1] if first else 0
        last = int(np.searchsorted(ends, used + VERTICES_A_DRAW, side="right"))
        ranges.append((first, max(1, last - first)))
        first = max(first + 1, last)
    return ranges
