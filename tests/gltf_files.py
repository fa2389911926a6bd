"""Small glTF files in the making, for tests."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

KINDS = {np.dtype(f"<{kind}"): 5120 + k for k, kind in enumerate(("i1", "u1", "i2", "u2", "i4", "u4", "f4"))}
SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Writer:
    """A small glTF file in the making."""

    def __init__(self) -> None:
        self.data = b""
        self.views: list[dict] = []
        self.accessors: list[dict] = []

    def array(self, values: Any, dtype: str = "<f4", **more: Any) -> int:
        values = np.asarray(values, dtype)
        values = values.reshape(len(values), -1 if values.ndim == 1 else values.shape[1])
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": values.nbytes})
        self.data += values.tobytes() + bytes(-values.nbytes % 4)
        kind, shape = KINDS[values.dtype], SHAPES[values.shape[1]]
        self.accessors.append(
            {"bufferView": len(self.views) - 1, "componentType": kind, "count": len(values), "type": shape, **more}
        )
        return len(self.accessors) - 1

    def content(self, **parts: Any) -> dict:
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        buffers = [{"byteLength": len(self.data), "uri": uri}]
        own = {"bufferViews": self.views, "accessors": self.accessors, "buffers": buffers}
        return {"asset": {"version": "2.0"}, **own, **parts}


def primitive_of(writer: Writer, places: Any, faces: Any, **more: Any) -> dict:
    """Triangles with vertices of their own."""
    index = writer.array(np.asarray(faces).reshape(-1, 1), "<u2")
    return {"attributes": {"POSITION": writer.array(places)}, "indices": index, **more}


def save(folder: Path, content: dict, name: str = "a.gltf") -> Path:
    """Under that name."""
    path = folder / name
    path.write_text(json.dumps(content))
    return path


TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def figure(rng, step="LINEAR") -> tuple[Writer, dict]:
    """A tetrahedron with split corners, two bones, two targets; everything animated."""
    writer = Writer()
    corner = FACES.ravel()
    positions = writer.array(TETRAHEDRON[corner])
    targets = [rng.normal(size=(4, 3))[corner] for _ in range(2)]
    joints = np.tile([0, 1, 0, 0], (12, 1))
    weights = np.repeat(rng.uniform(0.1, 0.9, (4, 1)), 4, axis=1)[corner] * [1, 0, 0, 0]
    weights[:, 1] = 1.0 - weights[:, 0]
    binds = np.array([np.eye(4), np.eye(4)])
    binds[:, :3, :3] = Rotation.random(2, rng=rng).as_matrix()
    binds[:, :3, 3] = rng.normal(size=(2, 3))
    attributes = {
        "POSITION": positions,
        "JOINTS_0": writer.array(joints, "<u1"),
        "WEIGHTS_0": writer.array(weights),
    }
    primitive = {"attributes": attributes, "targets": [{"POSITION": writer.array(t)} for t in targets]}
    times = np.array([0.5, 1.0, 2.0])
    when = writer.array(times)
    parts = 3 if step == "CUBICSPLINE" else 1
    turns = rng.normal(size=(3 * parts, 4))
    if parts == 3:
        turns[[0, 2, 3, 5, 6, 8]] *= 0.2
        turns[1::3] = [[0, 0, 0, 1], [0.3, 0, 0, 1], [0.4, 0.2, 0, 1]]
    else:
        turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    outputs = {
        "rotation": (1, turns),
        "translation": (2, rng.normal(size=(3 * parts, 3))),
        "scale": (2, rng.uniform(0.5, 2.0, (3 * parts, 3))),
        "weights": (3, rng.normal(size=(6 * parts, 1))),
    }
    samplers = [{"input": when, "output": writer.array(v), "interpolation": step} for _, v in outputs.values()]
    channels = [{"sampler": k, "target": {"node": n, "path": p}} for k, (p, (n, _)) in enumerate(outputs.items())]
    nodes = [
        {"name": "root", "children": [1, 3], "translation": [0.0, 2.0, 0.0], "scale": [2.0, 2.0, 2.0]},
        {"name": "hip", "children": [2], "rotation": [0.0, 0.6, 0.0, 0.8]},
        {"name": "leg", "translation": [1.0, 0.0, 0.0]},
        {"name": "body", "mesh": 0, "skin": 0, "translation": [9.0, 9.0, 9.0]},  # of a skinned mesh this is ignored
    ]
    skins = [{"joints": [1, 2], "inverseBindMatrices": writer.array(binds.swapaxes(1, 2).reshape(2, 16))}]
    mesh = {"primitives": [primitive], "extras": {"targetNames": ["up", "down"]}, "weights": [0.25, 0.5]}
    animations = [{"name": "go", "samplers": samplers, "channels": channels}]
    content = writer.content(nodes=nodes, meshes=[mesh], skins=skins, animations=animations, scenes=[{"nodes": [0]}])
    return writer, content


def stored(writer: Writer, number: int) -> np.ndarray:
    """An accessor's numbers, as float32 became of them."""
    a = writer.accessors[number]
    view = writer.views[a["bufferView"]]
    dtype = {v: k for k, v in KINDS.items()}[a["componentType"]]
    data = writer.data[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
    values = np.frombuffer(data, dtype).reshape(a["count"], -1)
    return values.astype(float) if dtype.kind == "f" else values
