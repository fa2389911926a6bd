"""glTF against loops over its own JSON, by the formulas of its specification."""

from __future__ import annotations

import base64
import json
import struct
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from slefejax import InputError, load
from slefejax.io.gltf import read_gltf

KINDS = {np.dtype("<f4"): 5126, np.dtype("<u2"): 5123, np.dtype("<u1"): 5121, np.dtype("<u4"): 5125}
SHAPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Writer:
    """A small glTF file in the making."""

    def __init__(self) -> None:
        self.data = b""
        self.views: list[dict] = []
        self.accessors: list[dict] = []

    def array(self, values: Any, dtype: str = "<f4", **more: Any) -> int:
        values = np.asarray(values, dtype)
        values = values.reshape(len(values), -1)
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


def save(tmp_path, content, name="a.gltf"):
    path = tmp_path / name
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


def value(times, values, kind, path, t):
    """One channel at a time: the specification's formulas, by SciPy where it has them."""
    t = np.clip(t, times[0], times[-1])
    if kind == "CUBICSPLINE":
        shaped = values.reshape(len(times), 3, -1)
        left, right = np.searchsorted(times, t, side="right") - 1, 0
        left = min(left, len(times) - 2)
        right = left + 1
        spline = CubicHermiteSpline(times[[left, right]], shaped[[left, right], 1], [shaped[left, 2], shaped[right, 0]])
        found = spline(t)
        return found / np.linalg.norm(found) if path == "rotation" else found
    if kind == "STEP":
        return values[np.searchsorted(times, t, side="right") - 1]
    if path == "rotation":
        return Slerp(times, Rotation.from_quat(values))(t).as_quat()
    return np.array([np.interp(t, times, column) for column in values.T])


def by_the_specification(writer, content, t):
    """Positions of the twelve corners."""
    nodes = [dict(n) for n in content["nodes"]]
    animation = content["animations"][0]
    weights = np.array(content["meshes"][0]["weights"])
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        path = channel["target"]["path"]
        times, values = stored(writer, sampler["input"]).ravel(), stored(writer, sampler["output"])
        if path == "weights":
            values = values.reshape(-1, 2)
        found = value(times, values, sampler["interpolation"], path, t)
        if path == "weights":
            weights = found
        else:
            nodes[channel["target"]["node"]][path] = found

    def local(n):
        m = np.eye(4)
        m[:3, :3] = Rotation.from_quat(n.get("rotation", [0, 0, 0, 1])).as_matrix() * n.get("scale", [1, 1, 1])
        m[:3, 3] = n.get("translation", [0, 0, 0])
        return m

    root = local(nodes[0])
    world = [root, root @ local(nodes[1]), root @ local(nodes[1]) @ local(nodes[2])]
    primitive, skin = content["meshes"][0]["primitives"][0], content["skins"][0]
    inverse = stored(writer, skin["inverseBindMatrices"]).reshape(-1, 4, 4).swapaxes(1, 2)
    points = stored(writer, primitive["attributes"]["POSITION"])
    for w, target in zip(weights, primitive["targets"], strict=True):
        points = points + w * stored(writer, target["POSITION"])
    shares = stored(writer, primitive["attributes"]["WEIGHTS_0"])
    found = np.zeros_like(points)
    for j in range(2):
        m = world[1 + j] @ inverse[j]
        found += shares[:, j : j + 1] / shares.sum(axis=1, keepdims=True) * (points @ m[:3, :3].T + m[:3, 3])
    return found


@pytest.mark.parametrize("step", ["LINEAR", "STEP", "CUBICSPLINE"])
def test_skins_and_targets_against_the_specification(tmp_path, rng, step):
    """At samples to rounding; between the samples of a cubic curve, which becomes straight pieces, nearly."""
    writer, content = figure(rng, step)
    scene = load(save(tmp_path, content))
    assert scene.rig is not None
    assert scene.rig.keys is not None
    assert scene.rig.keys.names == ("up", "down")
    assert scene.conversion is not None
    mesh = scene.conversion.mesh
    assert (mesh.vertex_count, mesh.face_count) == (4, 4)
    exact = [0.5, 1.0, 2.0]
    between = [0.0, 0.6, 0.83, 1.7, 3.0] if step != "CUBICSPLINE" else [0.5625, 1.875]
    for t in (*exact, *between):
        inside = float(np.clip(t, 0.5, 2.0))
        found = np.asarray(scene.vertices(inside))[mesh.corners]
        wanted = by_the_specification(writer, content, t)
        order = [np.argmin(np.abs(wanted - p).sum(axis=1)) for p in found]
        np.testing.assert_allclose(found, wanted[order], atol=1e-12)
    for t in (0.53, 1.3, 1.99) if step == "CUBICSPLINE" else ():
        found, wanted = np.asarray(scene.vertices(t))[mesh.corners], by_the_specification(writer, content, t)
        order = [np.argmin(np.abs(wanted - p).sum(axis=1)) for p in found]
        np.testing.assert_allclose(found, wanted[order], atol=0.05)


def test_the_fox_against_the_specification(models):
    """24 bones, by a loop over the file; 1e-6 of its size, as its numbers are float32."""
    data = (models / "fox.glb").read_bytes()
    length = struct.unpack("<I", data[12:16])[0]
    content = json.loads(data[20 : 20 + length])
    binary = data[20 + length + 8 :]

    def numbers(k, size):
        a = content["accessors"][k]
        view = content["bufferViews"][a["bufferView"]]
        kind = {5126: "<f4", 5123: "<u2", 5121: "<u1"}[a["componentType"]]
        start = view.get("byteOffset", 0) + a.get("byteOffset", 0)
        stride = view.get("byteStride", 0) or np.dtype(kind).itemsize * size
        return np.array([np.frombuffer(binary, kind, size, start + i * stride) for i in range(a["count"])])

    attributes = content["meshes"][0]["primitives"][0]["attributes"]
    points = numbers(attributes["POSITION"], 3).astype(float)
    joints, weights = numbers(attributes["JOINTS_0"], 4), numbers(attributes["WEIGHTS_0"], 4).astype(float)
    skin = content["skins"][0]
    inverse = numbers(skin["inverseBindMatrices"], 16).reshape(-1, 4, 4).swapaxes(1, 2).astype(float)
    walk = content["animations"][1]
    scene = load(models / "fox.glb", animation="Walk")
    assert scene.conversion is not None
    mesh = scene.conversion.mesh
    assert (mesh.vertex_count, mesh.face_count, mesh.boundary.sum()) == (290, 576, 0)
    for t in (0.0, 0.2, 0.7083):
        nodes = [dict(n) for n in content["nodes"]]
        for channel in walk["channels"]:
            sampler, path = walk["samplers"][channel["sampler"]], channel["target"]["path"]
            times = numbers(sampler["input"], 1).ravel().astype(float)
            values = numbers(sampler["output"], 4 if path == "rotation" else 3).astype(float)
            nodes[channel["target"]["node"]][path] = value(times, values, "LINEAR", path, t)
        world = {}

        def place(k, above, world=world, nodes=nodes):
            n, m = nodes[k], np.eye(4)
            m[:3, :3] = Rotation.from_quat(n.get("rotation", [0, 0, 0, 1])).as_matrix() * n.get("scale", [1, 1, 1])
            m[:3, 3] = n.get("translation", [0, 0, 0])
            world[k] = above @ m
            for child in n.get("children", []):
                place(child, world[k])

        for root in content["scenes"][0]["nodes"]:
            place(root, np.eye(4))
        moved = np.array([world[k] for k in skin["joints"]]) @ inverse
        share = weights / weights.sum(axis=1, keepdims=True)
        wanted = np.einsum("vk,vkab,vb->va", share, moved[joints][..., :3, :3], points)
        wanted += np.einsum("vk,vka->va", share, moved[joints][..., :3, 3])
        found = np.asarray(scene.vertices(t))
        apart = np.abs(wanted[:, None] - found).max(axis=2).min(axis=1)
        assert apart.max() < 1e-6 * np.ptp(wanted, axis=0).max()


def test_morph_targets_of_a_real_file(models):
    scene = load(models / "morph_stress_test.gltf", animation="TheWave")
    assert scene.rig is not None
    assert scene.rig.skeleton is None
    assert scene.rig.keys is not None
    assert scene.rig.keys.names[2] == "Key 3"
    assert scene.patches().shape == (2412, 4, 4, 3)
    rest, lifted = (np.asarray(scene.vertices(scene.rig.pose(keys={"Key 3": w}))) for w in (0.0, 1.0))
    moved = np.any(lifted != rest, axis=1)
    assert 0 < moved.sum() < 400
    assert np.asarray(scene.vertices(1.0)).shape == rest.shape
    with pytest.raises(InputError, match=r"no animation 'Run': it has Individuals, Pulse, TheWave"):
        load(models / "morph_stress_test.gltf", animation="Run")


def test_nodes_without_a_skin_carry_their_meshes(tmp_path):
    """Two instances of one mesh, one of them turned by an animation of its parent."""
    writer = Writer()
    primitive = {
        "attributes": {"POSITION": writer.array(TETRAHEDRON)},
        "indices": writer.array(FACES.reshape(-1, 1), "<u2"),
    }
    half = np.sqrt(0.5)
    samplers = [{"input": writer.array([0.0, 1.0]), "output": writer.array([[0, 0, 0, 1], [0, 0, half, half]])}]
    channels = [{"sampler": 0, "target": {"node": 0, "path": "rotation"}}]
    matrix = np.diag([2.0, 2.0, 2.0, 1.0])
    matrix[:3, 3] = (5, 0, 0)
    nodes = [{"children": [1]}, {"mesh": 0, "translation": [1, 0, 0]}, {"mesh": 0, "matrix": matrix.T.ravel().tolist()}]
    content = writer.content(
        nodes=nodes,
        meshes=[{"primitives": [primitive]}],
        animations=[{"samplers": samplers, "channels": channels}],
    )
    scene = load(save(tmp_path, content))
    assert scene.conversion is not None
    vertices = scene.conversion.mesh.vertices
    np.testing.assert_allclose(sorted(vertices[:4].tolist()), sorted((TETRAHEDRON + [1, 0, 0]).tolist()), atol=1e-15)
    np.testing.assert_allclose(
        sorted(vertices[4:].tolist()), sorted((2 * TETRAHEDRON + [5, 0, 0]).tolist()), atol=1e-15
    )
    turned = np.asarray(scene.vertices(1.0))
    np.testing.assert_allclose(turned[:4], vertices[:4] @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]), atol=1e-7)
    np.testing.assert_allclose(turned[4:], vertices[4:], atol=1e-15)


def test_strips_fans_sparse_and_interleaved(tmp_path):
    writer = Writer()
    grid = np.array([[x, y, 0] for x in range(3) for y in range(2)], float)
    both = np.concatenate([grid, -np.ones((6, 3))], axis=1)
    positions = writer.array(both.reshape(12, 3))
    writer.views[writer.accessors[positions]["bufferView"]]["byteStride"] = 24
    writer.accessors[positions]["count"] = 6
    replaced, at = writer.array([[2.0, 1.0, 7.0]]), writer.array([[5]], "<u2")
    writer.accessors[positions]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": writer.accessors[at]["bufferView"], "componentType": 5123},
        "values": {"bufferView": writer.accessors[replaced]["bufferView"]},
    }
    fan = writer.array([[4], [5], [3]], "<u1")
    primitives = [
        {"attributes": {"POSITION": positions}, "mode": 5, "indices": writer.array([[0], [2], [1], [3]], "<u4")},
        {"attributes": {"POSITION": positions}, "mode": 6, "indices": fan},
        {"attributes": {"POSITION": positions}, "mode": 1},
    ]
    content = writer.content(nodes=[{"mesh": 0}], meshes=[{"primitives": primitives}], scene=0, scenes=[{"nodes": [0]}])
    found = read_gltf(save(tmp_path, content))
    assert found.mesh is not None
    assert any("points and lines were left out" in note for note in found.notes)
    corners = found.mesh.vertices[found.mesh.corners].reshape(-1, 3, 3)
    wanted = [[grid[0], grid[2], grid[1]], [grid[2], grid[3], grid[1]], [grid[4], [2, 1, 7], grid[3]]]
    assert corners.tolist() == np.array(wanted).tolist()


def broken(rng):
    """(what is done to a whole file, what is said)."""

    def put(*path_and_value):
        *path, value = path_and_value

        def change(content):
            for key in path[:-1]:
                content = content[key]
            content[path[-1]] = value

        return change

    return [
        (put("asset", "version", "1.0"), "is glTF 1.0: only version 2"),
        (put("extensionsRequired", ["KHR_draco_mesh_compression"]), "requires the extension KHR_draco"),
        (put("nodes", 2, "children", [0]), r"(node . is its own ancestor|has two parents)"),
        (put("nodes", 2, "children", [7]), "nodes 7 does not exist: there are 4"),
        (put("nodes", 2, "children", [3]), "node 3 has two parents, 0 and 2"),
        (put("nodes", 3, "mesh", 4), "meshes 4 does not exist: there are 1"),
        (put("nodes", 3, "skin", "x"), "skins 'x' is no number"),
        (put("skins", 0, "joints", [1]), r"vertex 0 has a weight for joint 1, but there are 1"),
        (put("skins", 0, "inverseBindMatrices", 0), "must have 16 components"),
        (put("meshes", 0, "primitives", []), "there are no triangles in it"),
        (put("meshes", 0, "primitives", 0, "attributes", {}), r"not glTF as it should be \(KeyError: 'POSITION'\)"),
        (put("accessors", 0, "count", 10**6), "ends before its 1000000 elements do"),
        (put("accessors", 0, "count", 10**7), "has 30,000,000 numbers, more than 20,000,000"),
        (put("meshes", 0, "primitives", 0, "attributes", "JOINTS_0", 2), "whole numbers without a sign"),
        (
            put("nodes", 0, {"matrix": [1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1], "children": [1, 3]}),
            "has a shear",
        ),
        (put("buffers", 0, "uri", "a\0b"), "cannot be read"),
        (put("accessors", 0, "count", -1), "needs a whole number as its count, not -1"),
        (put("accessors", 0, "count", 11), "makes no whole|11 corners|has 12 rows for 11|12 offsets for 11"),
        (put("bufferViews", 0, "byteOffset", 10**9), "ends before its"),
        (put("buffers", 0, "byteLength", 10**9), "buffer 0 has .* of its 1000000000 bytes"),
        (put("buffers", 0, "uri", "data:,%%%"), "not in base 64"),
        (put("buffers", 0, "uri", "missing.bin"), "there is no file .*missing.bin"),
        (put("animations", 0, "samplers", 0, "interpolation", "SINE"), "goes by 'SINE', which is unknown"),
        (put("animations", 0, "channels", 0, "sampler", 9), "no sampler 9"),
        (put("animations", 0, "samplers", 0, "input", 0), "must have 1 components"),
        (put("nodes", 0, "translation", [1, 2]), "not glTF as it should be"),
        (put("nodes", 0, "scale", [1, 2, float("nan")]), "node 0 has a transform that is not finite"),
    ]


@pytest.mark.parametrize("case", range(27))
def test_broken_files(tmp_path, rng, case):
    change, says = broken(rng)[case]
    _, content = figure(rng)
    change(content)
    with pytest.raises(InputError, match=says) as caught:
        load(save(tmp_path, content))
    said = str(caught.value)
    assert any(name in said for name in ("a.gltf", "missing.bin", "a\0b"))
    assert "InputError" not in said


def test_long_chains_and_long_animations(tmp_path, rng):
    """A chain of 300 nodes is posed in a few steps; what would take gigabytes is refused."""
    writer = Writer()
    primitive = {
        "attributes": {"POSITION": writer.array(TETRAHEDRON)},
        "indices": writer.array(FACES.ravel()[:, None], "<u2"),
    }
    times = writer.array(np.arange(3000.0))
    samplers = [{"input": times, "output": writer.array(rng.normal(size=(3000, 3)))}]
    channels = [{"sampler": 0, "target": {"node": 0, "path": "translation"}}]
    animations = [{"samplers": samplers, "channels": channels}]
    nodes: list[dict] = [{"children": [k + 1], "translation": [0, 0, 1]} for k in range(299)] + [{"mesh": 0}]
    content = writer.content(nodes=nodes, meshes=[{"primitives": [primitive]}], animations=animations)
    scene = load(save(tmp_path, content))
    first = stored(writer, samplers[0]["output"])
    for t in (0.0, 7.0):
        found = np.asarray(scene.vertices(t))
        np.testing.assert_allclose(found.min(axis=0), first[int(t)] + [0, 0, 298], atol=1e-12)
    nodes[299:] = [{"children": [k + 1]} for k in range(299, 1999)] + [{"mesh": 0}]
    with pytest.raises(InputError, match=r"3,000 times of 2,000 nodes, more than"):
        load(save(tmp_path, content))


def test_a_node_of_no_size_hides_its_mesh(tmp_path):
    writer = Writer()
    primitive = {
        "attributes": {"POSITION": writer.array(TETRAHEDRON)},
        "indices": writer.array(FACES.ravel()[:, None], "<u2"),
    }
    samplers = [{"input": writer.array([0.0, 1.0]), "output": writer.array([[0, 0, 0], [2, 2, 2]])}]
    channels = [{"sampler": 0, "target": {"node": 0, "path": "scale"}}]
    animations = [{"samplers": samplers, "channels": channels}]
    nodes = [{"mesh": 0, "scale": [0, 0, 0]}]
    content = writer.content(nodes=nodes, meshes=[{"primitives": [primitive]}], animations=animations)
    scene = load(save(tmp_path, content))
    assert np.abs(scene.vertices(0.0)).max() == 0.0
    np.testing.assert_allclose(np.max(scene.vertices(1.0), axis=0), [2, 2, 2], atol=1e-15)


def test_broken_containers(tmp_path, models):
    data = (models / "fox.glb").read_bytes()
    for name, content, says in (
        ("a.glb", data[: len(data) // 2], "ends in the middle of a chunk"),
        ("b.glb", data[:12], "has no JSON chunk"),
        ("c.glb", b"", "JSON is not whole"),
        ("d.gltf", b"\xff\xfe{", "JSON is not whole"),
        ("e.gltf", b"[" * 10**5, "JSON is not whole"),
        ("f.gltf", b"3", "JSON is not whole"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=says):
            load(tmp_path / name)
    with pytest.raises(InputError, match=r"animation has a meaning for \.gltf and \.glb"):
        load(models / "spot_control_mesh.obj", animation="Run")
    with pytest.raises(InputError, match="walker is built in: animation has no meaning"):
        load("walker", animation="Run")
