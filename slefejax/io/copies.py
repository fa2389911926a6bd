"""Several copies of what a file holds, side by side, as one control mesh with one rig."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.sparse import block_diag, csr_array

from slefejax.arguments import is_whole
from slefejax.errors import InputError
from slefejax.io.content import Content, joined
from slefejax.model.rig import Motion, Pose, Rig, Skeleton
from slefejax.model.skinning import Influences, ShapeKeys
from slefejax.model.stencils import StencilTable

_APART = 1.1  # of the width of one
_MOST = 1000


def with_copies(content: Content, copies: Any) -> Content:
    """That many copies in a row, each beside the one before, across what is up.

    All move alike; joints and keys of the second and later ones have its number behind their name.
    Raises InputError for a number that is none, or for content that is no control mesh.
    """
    if not is_whole(copies, 1) or copies > _MOST:
        raise InputError(f"copies must be a whole number from 1 to {_MOST}, not {copies!r}", options=("copies",))
    if content.mesh is None or content.splines or content.patches:
        raise InputError("copies are made of control meshes only")
    axis = 0 if content.up[0] == 0 else 1
    step = np.zeros(3)
    vertices = content.mesh.vertices
    step[axis] = _APART * np.ptp((vertices if content.rig is None else content.rig.at_rest(vertices))[:, axis])
    places = np.arange(copies)[:, None] * step
    meshes = [replace(content.mesh, vertices=vertices + place) for place in places]
    rig = None if content.rig is None else _rig(content.rig, places)
    return replace(content, mesh=joined(meshes), rig=rig)


def _rig(rig: Rig, places: np.ndarray) -> Rig:
    count = len(places)
    skeleton, influences, keys = None, None, None
    if rig.skeleton is not None and rig.influences is not None:
        own = rig.skeleton
        joints = len(own.names)
        parents = [np.where(own.parents < 0, -1, own.parents + k * joints) for k in range(count)]
        binds = np.tile(own.bind, (count, 1, 1))
        binds[:, :3, 3] += np.repeat(places, joints, axis=0)
        skeleton = Skeleton.of(_names(own.names, count), np.concatenate(parents), binds)
        influences = Influences(_blocks(rig.influences.table, count))
    if rig.keys is not None:
        table = _blocks(rig.keys.table, count)
        keys = ShapeKeys(_names(rig.keys.names, count), table, rig.keys.places * count)
    motion = None if rig.motion is None else _motion(rig, rig.motion, places)
    dual = None if rig.dual_quaternions is None else np.tile(rig.dual_quaternions, count)
    return Rig(skeleton, influences, keys, motion, rig.rate, _rest(rig, places), dual)


def _rest(rig: Rig, places: np.ndarray) -> Pose:
    own = rig.rest.local, rig.rest.keys
    local, keys = (None if part is None else np.concatenate([part] * len(places)) for part in own)
    if local is not None and rig.skeleton is not None:
        roots = np.tile(rig.skeleton.parents < 0, len(places))
        local[roots, :3, 3] += np.repeat(places, len(rig.skeleton.names), axis=0)[roots]
    return Pose(local, keys)


def _motion(rig: Rig, motion: Motion, places: np.ndarray) -> Motion:
    count = len(places)

    def tiled(values: Any) -> Any:
        return None if values is None else np.tile(values, (1, count, *(1,) * (values.ndim - 2)))

    translations = tiled(motion.translations)
    if translations is not None and rig.skeleton is not None:
        roots = np.tile(rig.skeleton.parents < 0, count)
        translations[:, roots] += np.repeat(places, len(rig.skeleton.names), axis=0)[roots]
    return Motion(motion.times, translations, tiled(motion.rotations), tiled(motion.scales), tiled(motion.keys))


def _names(names: tuple[str, ...], count: int) -> tuple[str, ...]:
    return tuple(name if k == 0 else f"{name} {k + 1}" for k in range(count) for name in names)


def _blocks(table: StencilTable, count: int) -> StencilTable:
    return StencilTable(csr_array(block_diag([table.matrix] * count, format="csr")))
