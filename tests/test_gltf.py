"""glTF against loops over its own JSON, by the formulas of its specification."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from slefejax import InputError, Session, load
from slefejax.io.gltf.read import read_gltf
from tests.gltf_files import FACES, TETRAHEDRON, Writer, figure, save, stored


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
    """Positions of the twelve corners at a time, or without the animation if that is None."""
    nodes = [dict(n) for n in content["nodes"]]
    animation = content["animations"][0]
    weights = np.array(content["meshes"][0]["weights"])
    for channel in animation["channels"] if t is not None else ():
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


@pytest.mark.parametrize("moving", [True, False])
def test_at_rest_it_stands_as_the_nodes_do(tmp_path, rng, moving):
    """Skinned by the nodes as they are, targets with the weights of the mesh, whether there is an animation or not."""
    writer, content = figure(rng)
    wanted = by_the_specification(writer, content, None)
    if not moving:
        del content["animations"]
    scene: Any = load(save(tmp_path, content))
    assert (scene.rig.motion is not None) == moving
    mesh = scene.conversion.mesh
    found = np.asarray(scene.vertices())[mesh.corners]
    order = [np.argmin(np.abs(wanted - p).sum(axis=1)) for p in found]
    np.testing.assert_allclose(found, wanted[order], atol=1e-12)
    corners = scene.patches()[:, [0, 3, 3], [0, 0, 3]]
    limits = scene.conversion.patchwork.on_host(np.asarray(scene.vertices()))[:, [0, 3, 3], [0, 0, 3]]
    np.testing.assert_allclose(corners, limits, atol=1e-13)
    np.testing.assert_allclose(Session(scene, method="filip").patches, scene.patches(), atol=1e-13)
    content["nodes"][3]["weights"] = [0.0, 1.0]  # the node's own come first
    content["meshes"][0]["weights"] = [0.0, 1.0]
    other: Any = load(save(tmp_path, content))
    assert other.rig.rest.keys.tolist() == [0.0, 1.0]
    if not moving:
        np.testing.assert_allclose(other.vertices(other.rig.pose(keys={"up": 0.25, "down": 0.5})), scene.vertices())


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
    with pytest.raises(InputError, match=r"no animation 'Run': choose one of Individuals, Pulse, TheWave"):
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
