"""glTF 2.0 (.gltf, .glb): triangles as a control mesh, skins, morph targets, one of the animations.

Exporters split vertices where texture coordinates or normals differ. Here those are one vertex that agree bit for bit
in place, influences and morph targets, where that is sound (``slefejax.io.welding``). At rest all stands as a viewer
shows it: a skinned mesh where the nodes put it, morph targets with their own weights, mirrored parts with their front
to the outside.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from slefejax.errors import InputError, naming
from slefejax.io.content import Y_UP, Content
from slefejax.io.gltf.extensions import extension_notes
from slefejax.io.gltf.file import GltfFile
from slefejax.io.gltf.motion import channels_of, chosen_animation, motion_of
from slefejax.io.gltf.nodes import read_nodes, shown_nodes, world_transforms
from slefejax.io.gltf.parts import read_part
from slefejax.io.gltf.rig import Joints, Part, influences_of, key_weights, keys_of
from slefejax.model.mesh import Mesh
from slefejax.model.rig import Pose, Rig
from slefejax.model.skinning import ShapeKeys
from slefejax.model.texture import together


def read_gltf(path: Path, animation: Any = None) -> Content:
    """The triangles of a file's scene with what moves them.

    animation : the name or the number of one of the file's; the first if not given

    Raises InputError for what is no such file or is not whole, naming the part.
    """
    file = GltfFile.of(path)
    try:
        with naming(path), np.errstate(over="ignore", invalid="ignore"):  # what is not finite in the end is refused
            return _content(file, animation)
    except InputError:
        raise
    except (KeyError, TypeError, IndexError, AttributeError, ValueError, OverflowError, MemoryError) as error:
        raise file.fail(f"it is not glTF as it should be ({type(error).__name__}: {error})") from None


def _content(file: GltfFile, animation: Any) -> Content:
    notes = extension_notes(file.content.get("extensionsUsed"))
    nodes = read_nodes(file)
    shown = [k for k in shown_nodes(file, nodes, notes) if nodes[k].mesh is not None]
    joints = Joints(nodes, world_transforms(file, nodes))
    chosen = chosen_animation(file, animation, notes)
    channels = channels_of(file, chosen, notes)
    bones = any(nodes[k].skin is not None for k in shown) or any(path != "weights" for _, path, _ in channels)
    parts = [part for k in shown if (part := read_part(file, joints, k, bones, notes))]
    if not parts:
        raise file.fail("there are no triangles in it" + "".join(f"; {note}" for note in notes))
    mesh = _joined(parts)
    keys, owners = keys_of(parts)
    skeleton = joints.skeleton() if bones else None
    influences = influences_of(parts, len(skeleton.names)) if skeleton is not None else None
    shapes = ShapeKeys.of(keys, mesh.vertex_count) if keys else None
    if skeleton is None and shapes is None:
        return Content(mesh, up=Y_UP, notes=tuple(notes))
    weights = key_weights(file, nodes, owners)
    rest = Pose(joints.rest() if bones else None, weights if np.any(weights) else None)
    rig = Rig(skeleton, influences, shapes, rate=1.0, rest=rest)
    if chosen is not None:
        more = len(joints.more) if bones else None
        rig = replace(rig, motion=motion_of(file, channels, nodes, more, owners, weights))
    return Content(mesh, up=Y_UP, notes=tuple(notes), rig=rig)


def _joined(parts: list[Part]) -> Mesh:
    starts = np.cumsum([0, *(len(part.places) for part in parts[:-1])])
    corners = np.concatenate([(part.triangles + start).ravel() for part, start in zip(parts, starts, strict=True)])
    texture = together([part.texture for part in parts], [part.triangles.size for part in parts])
    return Mesh.packed(
        np.concatenate([p.places for p in parts]), corners, np.full(len(corners) // 3, 3), texture=texture
    )
