"""glTF that is not whole, lies about itself, or leads elsewhere: one sentence that names the file."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from slefejax import InputError, load
from slefejax.io.gltf.file import GltfFile
from tests.gltf_files import FACES, TETRAHEDRON, Writer, figure, primitive_of, save, stored


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
        (
            put("accessors", 0, {"componentType": 5126, "count": 10**7, "type": "VEC3"}),
            "numbers that are not in the file",
        ),
        (put("meshes", 0, "primitives", 0, "attributes", "JOINTS_0", 2), "whole numbers without a sign"),
        (
            put("nodes", 0, {"matrix": [1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1], "children": [1, 3]}),
            "has a shear",
        ),
        (put("buffers", 0, "uri", "a\0b"), "which is no file in this one's folder or below"),
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


@pytest.mark.parametrize("case", range(28))
def test_broken_files(tmp_path, rng, case):
    change, says = broken(rng)[case]
    _, content = figure(rng)
    change(content)
    with pytest.raises(InputError, match=says) as caught:
        load(save(tmp_path, content))
    said = str(caught.value)
    assert "a.gltf" in said
    assert "InputError" not in said


def test_long_chains_and_long_animations(tmp_path, rng):
    """A chain of 300 nodes is posed in a few steps; what would take gigabytes is refused."""
    writer = Writer()
    primitive = primitive_of(writer, TETRAHEDRON, FACES)
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


def plain(folder: Path, uri: str) -> dict:
    """A tetrahedron whose buffer has that name; ``inside.bin`` holds it, in the file's folder and one above."""
    writer = Writer()
    content = writer.content(nodes=[{"mesh": 0}], meshes=[{"primitives": [primitive_of(writer, TETRAHEDRON, FACES)]}])
    content["buffers"] = [{"byteLength": len(writer.data), "uri": uri}]
    for place in (folder, folder.parent):
        (place / "inside.bin").write_bytes(writer.data)
    return content


@pytest.mark.parametrize(
    "uri",
    [
        *("../inside.bin", "%2e%2e/inside.bin", "sub/../../inside.bin", "..%2finside.bin", "link.bin", "up/inside.bin"),
        *(
            "ABSOLUTE",
            "file://ABSOLUTE",
            "http://localhost/a.bin",
            "c:inside.bin",
            "/dev/zero",
            ".",
            "round.bin",
            "a" * 5000,
        ),
    ],
)
def test_buffers_that_lead_out_of_the_folder(tmp_path, uri):
    folder = tmp_path / "model"
    (folder / "sub").mkdir(parents=True)
    content = plain(folder, uri.replace("ABSOLUTE", str(tmp_path / "inside.bin")))
    (folder / "link.bin").symlink_to(tmp_path / "inside.bin")
    (folder / "up").symlink_to(tmp_path)
    (folder / "round.bin").symlink_to(folder / "round.bin")
    with pytest.raises(InputError, match=r"a\.gltf: buffer 0 is to be read from .* no file in this one's folder"):
        load(save(folder, content))


@pytest.mark.parametrize(
    "uri", ["inside.bin", "./inside.bin", "sub/../inside.bin", "in%73ide.bin", "sub/own%20%C3%A4.bin", "near.bin"]
)
def test_buffers_beside_the_file(tmp_path, monkeypatch, uri):
    folder = tmp_path / "model"
    (folder / "sub").mkdir(parents=True)
    content = plain(folder, uri)
    (folder / "near.bin").symlink_to(folder / "inside.bin")
    (folder / "sub" / "own ä.bin").write_bytes((folder / "inside.bin").read_bytes())
    assert len(load(save(folder, content)).patches()) == 4
    monkeypatch.chdir(folder)
    assert len(load("a.gltf").patches()) == 4


def test_what_many_parts_ask_for_together(tmp_path, monkeypatch):
    """The same numbers again and again are as many as they are asked for; so are copies."""
    writer = Writer()
    many = writer.array(np.arange(3.0 * 1000).reshape(-1, 3))
    content = writer.content(nodes=[{"mesh": 0}] * 12, meshes=[{"primitives": [{"attributes": {"POSITION": many}}]}])
    content["accessors"][0]["count"] = 999
    path = save(tmp_path, content)
    assert len(load(path, drop_defects=True).patches()) == 12 * 333
    monkeypatch.setattr("slefejax.io.gltf.file._MOST_IN_ALL", 30_000)
    with pytest.raises(InputError, match=r"a\.gltf: its meshes have more than 30,000 numbers in all"):
        load(path)
    places = writer.array(np.zeros((100, 3)))
    copies = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": places}}}
    content = writer.content(nodes=[{"mesh": 0, "extensions": copies}], meshes=content["meshes"])
    with pytest.raises(InputError, match="more than 30,000 numbers in all"):
        load(save(tmp_path, content))


def test_only_the_first_buffer_is_the_binary_chunk(tmp_path):
    writer = Writer()
    content = writer.content(nodes=[{"mesh": 0}], meshes=[{"primitives": [primitive_of(writer, TETRAHEDRON, FACES)]}])
    whole: dict = {"byteLength": len(writer.data)}
    content["buffers"] = [whole]

    def packed(content):
        text = json.dumps(content).encode()
        text += b" " * (-len(text) % 4)
        body = (
            struct.pack("<I4s", len(text), b"JSON")
            + text
            + struct.pack("<I4s", len(writer.data), b"BIN\0")
            + writer.data
        )
        (tmp_path / "a.glb").write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body)
        return tmp_path / "a.glb"

    assert len(load(packed(content)).patches()) == 4
    content["buffers"] = [whole, whole]
    for view in content["bufferViews"]:
        view["buffer"] = 1
    with pytest.raises(InputError, match="buffer 1 has 0 of its"):
        load(packed(content))
    whole["extensions"] = {"EXT_meshopt_compression": {"fallback": True}}
    with pytest.raises(InputError, match=r"a\.glb: buffer 1 is compressed \(meshopt\), .* export without compression"):
        load(packed(content))


def test_files_of_many_names_are_read_once(tmp_path):
    content = plain(tmp_path / "a", "inside.bin") if (tmp_path / "a").mkdir() is None else {}
    content["buffers"] += [{**content["buffers"][0], "uri": "./inside.bin"}]
    content["bufferViews"][1]["buffer"] = 1
    file = GltfFile.of(save(tmp_path / "a", content))
    first, second = file.array(0, 1, "indices", whole=True), file.array(1, 3, "positions")
    assert (first.shape, second.shape, len(file._files)) == ((12, 1), (4, 3), 1)


def test_broken_containers(tmp_path, models):
    data = (models / "fox.glb").read_bytes()
    for name, content, says in (
        ("a.glb", data[: len(data) // 2], "has 81,426 of the 162,852 bytes that it should have: is it complete"),
        ("b.glb", data[:8] + struct.pack("<I", 12), "has no JSON chunk"),
        ("g.glb", data[:8] + bytes(4) + data[12:-2], "ends in the middle of a chunk"),
        ("h.glb", data[:4] + struct.pack("<I", 1) + data[8:], r"is a \.glb file of version 1"),
        ("i.glb", data[:7], "has no JSON chunk"),
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
