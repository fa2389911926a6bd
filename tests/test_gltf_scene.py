"""What of a glTF file is drawn, how often, and which way round."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slefejax import InputError, load
from slefejax.io.gltf.read import read_gltf
from tests.gltf_files import FACES, TETRAHEDRON, Writer, figure, primitive_of, save


def volume(vertices, corners):
    """Of a closed surface; negative if its front is inside."""
    a, b, c = np.moveaxis(np.asarray(vertices)[np.asarray(corners).reshape(-1, 3)], 1, 0)
    return float(np.sum(a * np.cross(b, c))) / 6.0


def tetrahedron(tmp_path, nodes, **parts):
    """A file with that as its only mesh."""
    writer = parts.pop("writer", None) or Writer()
    primitive = {**primitive_of(writer, TETRAHEDRON, FACES), **parts.pop("primitive", {})}
    return save(tmp_path, writer.content(nodes=nodes, meshes=[{"primitives": [primitive]}], **parts))


MIRROR = np.diag([1.0, 1.0, -2.0, 1.0]).ravel().tolist()


@pytest.mark.parametrize(
    ("nodes", "size"),
    [
        ([{"mesh": 0, "scale": [-1, 1, 1]}], 1.0),
        ([{"mesh": 0, "scale": [-1, -2, -1]}], 2.0),
        ([{"mesh": 0, "matrix": MIRROR}], 2.0),
        ([{"children": [1], "scale": [1, -3, 1]}, {"mesh": 0, "rotation": [0, 0.6, 0, 0.8]}], 3.0),
        ([{"children": [1], "scale": [1, -3, 1]}, {"mesh": 0, "matrix": MIRROR}], 6.0),
        ([{"mesh": 0, "scale": [-1, -1, 1]}], 1.0),
    ],
)
def test_mirrored_parts_show_their_front(tmp_path, nodes, size):
    found: Any = read_gltf(tetrahedron(tmp_path, nodes)).mesh
    np.testing.assert_allclose(volume(found.vertices, found.corners), size / 6, rtol=1e-12)


@pytest.mark.parametrize("mirrored", [True, False])
def test_skins_mirrored_by_their_joints(tmp_path, rng, mirrored):
    """The node of the mesh, which a skin ignores, has no part in it."""
    _, content = figure(rng)
    content["nodes"][0]["scale"] = [-2.0, 2.0, 2.0] if mirrored else [2.0, 2.0, 2.0]
    content["nodes"][3]["scale"] = [-1.0, 1.0, 1.0]
    content["meshes"][0]["weights"] = [0.0, 0.0]
    content["skins"][0].pop("inverseBindMatrices")
    content["nodes"][2] = {"name": "leg"}
    scene: Any = load(save(tmp_path, content))
    np.testing.assert_allclose(volume(scene.vertices(), scene.conversion.mesh.corners), 8 / 6, rtol=1e-6)


def test_copies_of_a_mesh_stand_at_their_places(tmp_path, rng):
    """Whole numbers for rotations, a mirrored copy, targets; all follow the node, which is turned and moves."""
    writer = Writer()
    turns = np.round(Rotation.random(3, rng=rng).as_quat() * 32767)
    shifts, scales = rng.normal(size=(3, 3)).astype(np.float32), np.array([[1, 1, 1], [2, 1, 1], [1, -1, 1]], float)
    target = rng.normal(size=(4, 3)).astype(np.float32)
    attributes = {
        "TRANSLATION": writer.array(shifts),
        "ROTATION": writer.array(turns, "<i2", normalized=True),
        "SCALE": writer.array(scales),
    }
    move = [{"input": writer.array([0.0, 1.0]), "output": writer.array([[0, 0, 0], [5, 0, 0]])}]
    channels = [{"sampler": 0, "target": {"node": 0, "path": "translation"}}]
    path = tetrahedron(
        tmp_path,
        [
            {"children": [1]},
            {
                "mesh": 0,
                "scale": [1, 1, 3],
                "weights": [0.5],
                "extensions": {"EXT_mesh_gpu_instancing": {"attributes": attributes}},
            },
        ],
        writer=writer,
        primitive={"targets": [{"POSITION": writer.array(target)}]},
        animations=[{"samplers": move, "channels": channels}],
        extensionsUsed=["EXT_mesh_gpu_instancing"],
        extensionsRequired=["EXT_mesh_gpu_instancing"],
    )
    scene: Any = load(path)
    assert scene.notes == ("node 1: its mesh stands there 3 times",)
    assert scene.conversion.mesh.components[0] == 3
    for key, found in ((0.0, scene.conversion.mesh.vertices), (0.5, scene.vertices())):
        base = TETRAHEDRON + key * target
        wanted = [
            (Rotation.from_quat(q).apply(base * s) + t) * [1, 1, 3]
            for q, s, t in zip(turns, scales, shifts, strict=True)
        ]
        apart = np.abs(np.asarray(found)[:, None] - np.concatenate(wanted)).max(axis=2)
        assert apart.min(axis=1).max() < 1e-12
        assert sorted(np.argmin(apart, axis=1)) == list(range(12))
    for corners in scene.conversion.mesh.corners.reshape(3, 12):
        assert volume(scene.conversion.mesh.vertices, corners) > 0
    np.testing.assert_allclose(scene.vertices(1.0), np.asarray(scene.vertices()) + [5, 0, 0], atol=1e-12)


def test_copies_that_are_none(tmp_path):
    def made(**attributes):
        writer = Writer()
        own = {name: writer.array(values) for name, values in attributes.items()}
        extensions = {"EXT_mesh_gpu_instancing": {"attributes": own}}
        return tetrahedron(tmp_path, [{"mesh": 0, "extensions": extensions}, {"mesh": 0}], writer=writer)

    assert load(made()).notes == ()
    assert load(made(TRANSLATION=np.zeros((0, 3)))).notes == ("node 0: its mesh stands there 0 times",)
    for attributes, says in (
        (
            {"TRANSLATION": np.zeros((2, 3)), "SCALE": np.ones((3, 3))},
            "have 2 translations, 3 scales: there must be as many",
        ),
        ({"ROTATION": np.zeros((1, 4))}, "rotation 0 is a quaternion of no length"),
        ({"TRANSLATION": np.zeros((2, 4))}, r"translation \(accessor 0\) must have 3 components"),
        ({"SCALE": [[np.nan, 1, 1]]}, "not finite"),
    ):
        with pytest.raises(InputError, match=rf"a\.gltf: the copies of node 0.*{says}"):
            load(made(**attributes))


def test_invisible_nodes_are_left_out_with_what_hangs_on_them(tmp_path):
    hide = {"KHR_node_visibility": {"visible": False}}
    show = {"KHR_node_visibility": {"visible": True}}
    nodes = [
        {"name": "off", "children": [1], "extensions": hide},
        {"name": "below", "mesh": 0, "extensions": show},
        {"mesh": 0, "extensions": show},
        {"name": "too", "mesh": 0, "extensions": hide},
    ]
    said = "2 meshes are invisible and were left out (the first at node 'below')"
    for scenes in ({}, {"scenes": [{"nodes": [0, 2, 3]}]}):
        found: Any = read_gltf(tetrahedron(tmp_path, nodes, extensionsUsed=["KHR_node_visibility"], **scenes))
        assert found.mesh.face_count == 4
        assert found.notes == (said,)
    with pytest.raises(InputError, match=r"there are no triangles in it; 1 meshes are invisible"):
        load(tetrahedron(tmp_path, nodes[:2]))


def test_of_several_scenes_one_is_taken(tmp_path):
    found: Any = read_gltf(
        tetrahedron(
            tmp_path, [{"mesh": 0}, {"mesh": 0, "scale": [2, 2, 2]}], scenes=[{"nodes": [0]}, {"nodes": [1]}], scene=1
        )
    )
    assert found.mesh.vertices.max() == 2.0
    assert found.notes == ("scene 1 of 2 (counted from 0) was taken",)


def test_pointers_of_animations(tmp_path):
    """Those that name a node are as good as its own channels; others are noted, unless they are of no matter here."""
    writer = Writer()
    samplers = [{"input": writer.array([0.0, 1.0]), "output": writer.array([[0, 0, 0], [0, 4, 0]])}]

    def pointer(text):
        extension = {"KHR_animation_pointer": {"pointer": text}}
        return {"sampler": 0, "target": {"path": "pointer", "extensions": extension}}

    def made(*pointers):
        animations = [{"samplers": samplers, "channels": [pointer(text) for text in pointers]}]
        return load(
            tetrahedron(
                tmp_path, [{"mesh": 0}], writer=writer, animations=animations, extensionsUsed=["KHR_animation_pointer"]
            )
        )

    scene = made("/nodes/0/translation", "/materials/0/emissiveFactor", "/cameras/0/perspective/yfov")
    assert scene.notes == ()
    np.testing.assert_allclose(scene.vertices(0.5), np.asarray(scene.vertices()) + [0, 2, 0], atol=1e-15)
    scene = made("/meshes/0/weights/0", "/nodes/0/extensions/KHR_node_visibility/visible")
    assert scene.notes == ("the animation also moves /meshes/0/weights/0 (2 such pointers), which is not followed",)
    with pytest.raises(InputError, match="nodes 7 does not exist"):
        made("/nodes/7/translation")


def test_extensions_that_are_used(tmp_path):
    names = [
        "KHR_materials_clearcoat",
        "KHR_texture_transform",
        "KHR_lights_punctual",
        "KHR_mesh_quantization",
        "VENDOR_warp",
    ]
    found = load(
        tetrahedron(tmp_path, [{"mesh": 0}], extensionsUsed=[*names, "VENDOR_warp"], extensionsRequired=names[:4])
    )
    assert found.notes == ("the extension VENDOR_warp is not known here: whatever it does to shapes was left out",)
    for name, says in (
        ("VENDOR_warp", "requires the extension VENDOR_warp, which is not read: export without it"),
        ("KHR_draco_mesh_compression", r"_compression \(Draco\), which is not read: export without compression"),
        ("EXT_meshopt_compression", "EXT_meshopt_compression, which is not read: export without compression"),
    ):
        with pytest.raises(InputError, match=rf"a\.gltf .*{says}"):
            load(tetrahedron(tmp_path, [{"mesh": 0}], extensionsRequired=[name]))


def test_draco_with_and_without_a_plain_copy(tmp_path):
    hidden = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
    path = tetrahedron(tmp_path, [{"mesh": 0}], primitive={"extensions": hidden}, extensionsUsed=list(hidden))
    assert load(path).notes == ()
    content = json.loads(path.read_text())
    for accessor in content["accessors"]:
        accessor.pop("bufferView")
    with pytest.raises(InputError, match=r"a\.gltf: mesh 0 is compressed with Draco .* export without compression"):
        load(save(tmp_path, content))


def test_quantised_positions(tmp_path):
    """Whole numbers, normalised or not: the node scales them back."""
    for kind, more, size in (("<i2", {"normalized": True}, 1.0), ("<u1", {}, 255.0)):
        writer = Writer()
        unit = 32767 if kind == "<i2" else 255
        path = tetrahedron(
            tmp_path,
            [{"mesh": 0}],
            writer=writer,
            primitive={"attributes": {"POSITION": writer.array(TETRAHEDRON * unit, kind, **more)}},
            extensionsRequired=["KHR_mesh_quantization"],
        )
        found: Any = read_gltf(path).mesh
        np.testing.assert_allclose(sorted(found.vertices.tolist()), sorted((size * TETRAHEDRON).tolist()), rtol=1e-15)


def skinned(tmp_path, weights, more=None):
    """Two triangles, each a primitive with two joints, the second with four more influences; joint 1 is 3 higher."""
    writer = Writer()
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    own = {"JOINTS_0": writer.array([[0, 1, 0, 0]] * 3, "<u1"), "WEIGHTS_0": writer.array(weights)}
    primitives = []
    for k in range(2):
        attributes = {"POSITION": writer.array(triangle + [2 * k, 0, 0]), **own}
        if k and more is not None:
            attributes |= {"JOINTS_1": writer.array([[1, 0, 0, 0]] * 3, "<u1"), "WEIGHTS_1": writer.array(more)}
        primitives.append({"attributes": attributes})
    nodes = [{"mesh": 0, "skin": 0, "translation": [0, 50, 0]}, {"children": [2]}, {"translation": [0, 0, 3]}]
    scene: Any = load(
        save(tmp_path, writer.content(nodes=nodes, meshes=[{"primitives": primitives}], skins=[{"joints": [1, 2]}]))
    )
    return scene


def test_vertices_without_weights_follow_the_node_of_their_mesh(tmp_path):
    scene = skinned(tmp_path, [[1, 0, 0, 0], [0, 0, 0, 0], [0, 2, 0, 0]])
    wanted = [[0, 0, 0], [1, 50, 0], [0, 1, 3], [2, 0, 0], [3, 50, 0], [2, 1, 3]]
    assert sorted(np.asarray(scene.vertices()).round(12).tolist()) == sorted(np.array(wanted, float).tolist())
    assert len(scene.notes) == 2
    assert (
        "all weights of 1 vertices are 0 (the first is 1, counted from 0): they follow node 'node 0'" in scene.notes[0]
    )


def test_more_influences_on_one_primitive_only(tmp_path):
    scene = skinned(tmp_path, [[1, 0, 0, 0], [1, 1, 0, 0], [0, 1, 0, 0]], [[1, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]])
    wanted = [[0, 0, 0], [1, 0, 1.5], [0, 1, 3], [2, 0, 1.5], [3, 0, 1.5], [2, 1, 3]]
    assert sorted(np.asarray(scene.vertices()).round(12).tolist()) == sorted(np.array(wanted, float).tolist())
    assert scene.notes == ()


def test_meshes_that_are_scaled_to_nothing(tmp_path):
    """Left out where they have no area and nothing moves them; flat where they are flat."""
    found: Any = read_gltf(tetrahedron(tmp_path, [{"mesh": 0}, {"name": "gone", "mesh": 0, "scale": [0, 2, 0]}]))
    assert (found.mesh.face_count, found.notes) == (4, ("node 'gone' is scaled to nothing: its mesh was left out",))
    flat: Any = read_gltf(tetrahedron(tmp_path, [{"mesh": 0, "scale": [2, 1, 0]}])).mesh
    assert flat.vertices.max(axis=0).tolist() == [2.0, 1.0, 0.0]


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
