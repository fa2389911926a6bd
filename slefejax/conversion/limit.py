"""The limit surface of Catmull-Clark subdivision, exactly: bicubic patches nested around irregular vertices.

Where a face has only regular vertices (four faces around them, two at boundaries and creases, one at corners) the limit
surface is a bicubic B-spline. Any other face is divided in four, again and again; of its parts all but those at
irregular vertices are regular after a few steps:

        +-------+---+-+        the irregular vertex is at the lower right: a level has three patches a corner, and what
        |       |   +-+        is left over is a patch of ``acc``, which misses the limit by mu(n) of a step before
        |       +---+-+        [LS08]; .34 to .65 of it at valences 5 to 64
        |       |   | |
        +-------+---+-+

Steps use up sharpness, so semi-sharp creases are divided until theirs is gone. Boundaries and creases that are
infinitely sharp are B-splines from the start.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from slefejax.conversion.acc import Neighbourhood, acc_patches, pinched_last
from slefejax.conversion.catmull_clark import CORNER, CREASE, SMOOTH, refine
from slefejax.geometry.nearest import Surfaces
from slefejax.model.mesh import Mesh

LEVELS = 10
_DENSEST = 16  # samples along the side of a whole face, and of its quarters half of them, and again
_MOST_OPEN = 100_000  # faces that one more step would divide
# of a quad's corners: where they are, and how their half-edge and the one before run from there, as columns
CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
FRAMES = np.array([[[1, 0], [0, 1]], [[0, -1], [1, 0]], [[-1, 0], [0, -1]], [[0, 1], [-1, 0]]], float)


@dataclass(frozen=True, eq=False)
class LimitSurface:
    """Patches of the limit surface of a mesh. Make it with ``limit_surface``.

    net     : ``(patches, 4, 4, 3)``, bicubic; of Gaussian products ``(patches, 10, 10, 4)``
    face    : ``(patches,)``, the face of the mesh that each lies in, level : how often it was divided
    origin  : ``(patches, 2)``, frame ``(patches, 2, 2)``: (u, v) of the face = origin + frame (s, t) of the patch, if
              the face is a quad; u runs from its first vertex to its second
    regular : ``(faces,)``, which faces are one patch, exactly
    """

    net: Float[np.ndarray, "patches nu nv dim"]
    face: Int[np.ndarray, "patches"]
    level: Int[np.ndarray, "patches"]
    origin: Float[np.ndarray, "patches 2"]
    frame: Float[np.ndarray, "patches 2 2"]
    regular: Bool[np.ndarray, "faces"]

    @cached_property
    def surfaces(self) -> Surfaces:
        """All of it, to look for nearest points."""
        return Surfaces(self.net, np.maximum(_DENSEST >> np.minimum(self.level, 2), _DENSEST >> 2))

    @cached_property
    def _keys(self) -> tuple[np.ndarray, np.ndarray]:
        """Sorted keys of all patches, and whose they are."""
        middle = self.origin + 0.5 * self.frame.sum(axis=2)
        keys = _key(self.face, self.level, middle)
        order = np.argsort(keys)
        return keys[order], order

    def at(
        self, face: Int[np.ndarray, "points"], parameters: Float[np.ndarray, "points 2"]
    ) -> Float[np.ndarray, "points 3"]:
        """Limit points at the natural parameters (u, v) of quads.

        >>> square = Mesh.of([[0, 0, 0], [3, 0, 0], [3, 3, 0], [0, 3, 0]], [(0, 1, 2, 3)])
        >>> limit_surface(square).at(np.array([0]), np.array([[0.5, 0.25]])).tolist()
        [[1.5, 0.75, 0.0]]
        """
        return self.surfaces.at(*self.places(face, parameters))

    def places(
        self, face: Int[np.ndarray, "points"], parameters: Float[np.ndarray, "points 2"]
    ) -> tuple[Int[np.ndarray, "points"], Float[np.ndarray, "points 2"]]:
        """The patches at the natural parameters of quads, and the parameters there; -1 for faces that are no quads."""
        keys, order = self._keys
        patch = np.full(len(face), -1)
        inside = np.clip(parameters, 0.0, 1.0 - 1e-12)
        for level in range(int(self.level.max(initial=0)) + 1):
            wanted = _key(face, np.full(len(face), level), inside)
            place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            patch = np.where(keys[place] == wanted, order[place], patch)
        local = parameters - self.origin[patch]
        # frames are turns times a power of 1/2
        scale = 4.0 ** self.level[patch].astype(float)
        return patch, scale[:, None] * np.einsum("pij,pi->pj", self.frame[patch], local)


def _key(
    face: Int[np.ndarray, "n"], level: Int[np.ndarray, "n"], parameters: Float[np.ndarray, "n 2"]
) -> Int[np.ndarray, "n"]:
    """A number for a face, a level, and the square of that level that holds a point. Levels below 16."""
    across = np.floor(parameters * 2.0 ** level[:, None].astype(float)).astype(np.int64)
    return ((face * 16 + level) << 30) + (across[:, 0] << 15) + across[:, 1]


def limit_surface(mesh: Mesh, levels: int = LEVELS) -> LimitSurface:
    """The limit surface of a manifold mesh, with its tagged sharpness.

    levels : how often at most faces at irregular vertices are divided, up to 15

    >>> square = Mesh.of([[0, 0, 0], [3, 0, 0], [3, 3, 0], [0, 3, 0]], [(0, 1, 2, 3)])
    >>> found = limit_surface(square)
    >>> found.net.shape, found.regular.tolist(), found.net[0, 1, 0].tolist()
    ((1, 4, 4, 3), [True], [1.0, 0.0, 0.0])
    """
    parts, first = [], None
    part = _Part(mesh, np.ones(mesh.face_count, bool), np.arange(mesh.face_count), *_whole(mesh.face_count))
    for level in range(levels + 1):
        # n-gons have no patch of their own
        done = regular_faces(part.mesh) if part.mesh.sizes.max() <= 4 else np.zeros(part.mesh.face_count, bool)
        first = done if first is None else first
        rest = part.wanted & ~done
        last = level == levels or (level > 0 and rest.sum() > _MOST_OPEN)
        taken = np.flatnonzero(part.wanted if last else part.wanted & done)
        if taken.size:
            net = acc_patches(part.mesh).on_host(part.mesh.vertices)[taken]
            of = part.root[taken], np.full(len(taken), level), part.origin[taken], part.frame[taken]
            parts.append((net, *of))
        if last or not rest.any():
            break
        part = part.divided(rest)
    assert first is not None
    return LimitSurface(*(np.concatenate(column) for column in zip(*parts, strict=True)), first)  # type: ignore[arg-type]


def limit_of_q(mesh: Mesh, q: Float[np.ndarray, "vertices 9"], levels: int = LEVELS) -> LimitSurface:
    """The same of q of Gaussian products: ``net`` is ``(patches, 4, 4, 9)``, not yet rational patches."""
    # subdivision is linear: three of the nine coordinates at a time
    parts = [limit_surface(replace(mesh, vertices=q[:, k : k + 3]), levels) for k in (0, 3, 6)]
    return replace(parts[0], net=np.concatenate([part.net for part in parts], axis=3))


def _whole(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Origins and frames of whole faces."""
    return np.zeros((count, 2)), np.broadcast_to(np.eye(2), (count, 2, 2))


@dataclass(frozen=True, eq=False)
class _Part:
    """Faces of some level that are wanted, and those around them, on which they depend.

    root : the face of the first mesh;  origin, frame : as in ``LimitSurface``
    """

    mesh: Mesh
    wanted: Bool[np.ndarray, "faces"]
    root: Int[np.ndarray, "faces"]
    origin: Float[np.ndarray, "faces 2"]
    frame: Float[np.ndarray, "faces 2 2"]

    def divided(self, rest: Bool[np.ndarray, "faces"]) -> _Part:
        """The quarters of some of the faces, and of those around them."""
        mesh = self.mesh
        touched = np.zeros(mesh.vertex_count, bool)
        touched[mesh.corners[rest[mesh.face]]] = True
        kept = np.zeros(mesh.face_count, bool)
        kept[mesh.face[touched[mesh.corners]]] = True
        smaller = _compact(mesh.keep(kept))
        finer, _, parents = refine(smaller)
        old = np.flatnonzero(kept)[parents]
        corner = (np.arange(len(smaller.corners)) - smaller.offsets[parents]) % 4
        origin = self.origin[old] + np.einsum("fij,fj->fi", self.frame[old], CORNERS[corner])
        frame = 0.5 * self.frame[old] @ FRAMES[corner]
        return _Part(finer, rest[old], self.root[old], origin, frame)


def _compact(mesh: Mesh) -> Mesh:
    """Without the vertices that no face uses."""
    used, corners = np.unique(mesh.corners, return_inverse=True)
    place = np.full(mesh.vertex_count, -1)
    place[used] = np.arange(len(used))
    points = np.isin(mesh.points, used)
    return replace(
        mesh,
        vertices=mesh.vertices[used],
        corners=corners.ravel(),
        creases=place[mesh.creases],
        points=place[mesh.points[points]],
        point_sharpness=mesh.point_sharpness[points],
    )


def regular_faces(mesh: Mesh) -> Bool[np.ndarray, "faces"]:
    """Which faces of a manifold mesh have a bicubic limit, the patch that ``acc`` makes of them.

    >>> square = Mesh.of([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [(0, 1, 2, 3)])
    >>> regular_faces(square).tolist()
    [True]
    """
    return np.bincount(mesh.face, irregular(mesh), minlength=mesh.face_count) == 0


def irregular(mesh: Mesh) -> Bool[np.ndarray, "corners"]:
    """Corners at vertices whose surroundings are not a B-spline's.

    >>> square = Mesh.of([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [(0, 1, 2, 3)])
    >>> irregular(square).any().tolist()
    False
    """
    around = Neighbourhood.of(mesh)
    return ~_plain(around) | ~_sound(around)


def irregular_corner(mesh: Mesh) -> tuple[Int[np.ndarray, "faces"], Int[np.ndarray, "faces"]]:
    """Of faces of which one corner is irregular, a smooth inner vertex: which, 0 to 3, and its valence; else -1 and 0.

    Not of those at vertices of valence 2, where subdivision has no two tangents.

    >>> cells = Mesh.of([[x, y, 0] for x in range(4) for y in range(4)],
    ...                 [(4 * x + y, 4 * x + y + 4, 4 * x + y + 5, 4 * x + y + 1) for x in range(3) for y in range(3)])
    >>> set(irregular_corner(cells)[0].tolist())
    {-1}
    """
    around = Neighbourhood.of(mesh)
    fans, bad = around.fans, ~_plain(around) | ~_sound(around)
    inner = _plain(around) & (fans.closed & (around.rule[fans.vertex] == SMOOTH))[fans.fan]
    count = np.bincount(mesh.face, bad, minlength=mesh.face_count)
    own = np.flatnonzero(bad & inner & (count[mesh.face] == 1) & (fans.size[fans.fan] > 2))
    which, valence = np.full(mesh.face_count, -1), np.zeros(mesh.face_count, np.int64)
    which[mesh.face[own]] = own - mesh.offsets[mesh.face[own]]
    valence[mesh.face[own]] = fans.size[fans.fan[own]]
    return which, valence


def _plain(around: Neighbourhood) -> Bool[np.ndarray, "corners"]:
    """Corners at vertices with quads only, of no sharpness that fades and at the end of no crease."""
    mesh = around.mesh
    odd = np.zeros(mesh.vertex_count, bool)
    odd[mesh.corners[mesh.sizes[mesh.face] != 4]] = True
    odd |= (mesh.vertex_sharpness > 0) & np.isfinite(mesh.vertex_sharpness)
    fading = ~mesh.boundary & (mesh.edge_sharpness > 0) & np.isfinite(mesh.edge_sharpness)
    odd[mesh.edge_vertices[fading]] = True
    ends = mesh.edge_vertices[around.sharp]
    odd[ends[around.rule[ends] == SMOOTH]] = True
    return ~odd[mesh.corners]


def _sound(around: Neighbourhood) -> Bool[np.ndarray, "corners"]:
    """Whether the fan of every corner is a B-spline's: four faces, two at creases and boundaries, one at corners."""
    fans = around.fans
    kind = around.rule[fans.vertex]
    sound = (kind == SMOOTH) & fans.closed & (fans.size == 4)
    sound |= ~fans.closed & (fans.size == np.where(kind == CREASE, 2, np.where(kind == CORNER, 1, 0)))
    return sound[fans.fan]


def smooth_sides(mesh: Mesh) -> Int[np.ndarray, "edges 2 2"]:
    """Where patches should have one tangent plane: (patch, side) on both sides of every such edge.

    Sides are u=0, v=0, u=1, v=1. Of a manifold mesh of quads and triangles, its patches one a face in their order:
    edges that have two faces, are not sharp, and end at no vertex that stays where it is.

    >>> cells = Mesh.of([[x, y, 0] for x in range(4) for y in range(4)],
    ...                 [(4 * x + y, 4 * x + y + 4, 4 * x + y + 5, 4 * x + y + 1) for x in range(3) for y in range(3)])
    >>> len(smooth_sides(cells)), smooth_sides(cells)[0].tolist()
    (12, [[0, 2], [3, 0]])
    """
    around = Neighbourhood.of(mesh)
    side = np.zeros(len(mesh.corners), np.int64)
    quads, triangles = (np.flatnonzero(mesh.sizes == n) for n in (4, 3))
    for k, name in enumerate((1, 2, 3, 0)):
        side[mesh.offsets[:-1][quads] + k] = name
    for corner, name in zip(pinched_last(mesh, triangles), (0, 1, 3), strict=True):
        side[corner] = name
    corner_rule = around.rule == CORNER
    own = np.flatnonzero(
        (mesh.twin > np.arange(len(mesh.twin)))
        & ~around.sharp[mesh.edge]
        & ~corner_rule[mesh.corners]
        & ~corner_rule[mesh.ends]
    )
    both = np.stack([own, mesh.twin[own]], axis=1)
    return np.stack([mesh.face[both], side[both]], axis=2)
