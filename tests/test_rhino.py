"""Rhino's .3dm: surfaces, meshes, blocks, and what is hidden."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from slefejax import InputError, load
from slefejax.geometry.bezier import evaluate_patch
from slefejax.io.rhino import blocks as rhino_blocks
from slefejax.io.rhino.blocks import Blocks
from slefejax.loading import read
from tests.meshes import cube
from tests.test_io import faces, polygons, write


def test_3dm(tmp_path):
    rhino = pytest.importorskip("rhino3dm", reason="rhino3dm is not installed")
    model = rhino.File3dm()
    model.Objects.AddSurface(rhino.NurbsSurface.CreateFromSphere(rhino.Sphere(rhino.Point3d(1, 2, 3), 2.0)))
    shape = rhino.Mesh()
    for place in cube().vertices.tolist():
        shape.Vertices.Add(*place)
    for face in faces(cube()):
        shape.Faces.AddFace(*face)
    model.Objects.AddMesh(shape)
    model.Objects.AddPoint(rhino.Point3d(0, 0, 0))
    model.Objects.AddMesh(rhino.Mesh())
    path = tmp_path / "a.3dm"
    model.Write(str(path), 8)
    content = read(path)
    assert faces(polygons(content)) == faces(cube())
    assert content.notes == ("objects of other kinds were left out: 1 Point, 1 empty Mesh",)
    scene = load(path)
    sphere = scene.patches()[6:]
    assert sphere.shape == (8, 4, 4, 4)
    for patch in sphere:
        u, v = np.random.default_rng(1).random((2, 20))
        point = evaluate_patch(patch[..., None], u, v)
        np.testing.assert_allclose(np.linalg.norm((point[:3] / point[3]).T - [1, 2, 3], axis=1), 2.0, atol=1e-14)
    # the meridians are shared, around the sphere as well; the poles are points
    uses = np.bincount(scene.edge_numbers[6:].ravel())
    assert np.count_nonzero(uses == 2) == 12


def test_trimmed_and_broken_3dm_files(tmp_path):
    rhino = pytest.importorskip("rhino3dm", reason="rhino3dm is not installed")
    model = rhino.File3dm()
    model.Objects.AddBrep(rhino.Brep.CreateFromCylinder(rhino.Cylinder(rhino.Circle(2.0), 3.0), True, True))
    path = tmp_path / "a.3dm"
    model.Write(str(path), 8)
    with pytest.raises(InputError, match=r"object 0 .*, face 1 is trimmed"):
        load(path)
    with pytest.raises(InputError, match=r"no 3DM file that can be read"):
        load(write(tmp_path, "b.3dm", path.read_bytes()[:200]))
    rhino.File3dm().Write(str(tmp_path / "c.3dm"), 8)
    with pytest.raises(InputError, match="shows no surface and no mesh"):
        load(tmp_path / "c.3dm")


def rhino3dm():
    return pytest.importorskip("rhino3dm", reason="rhino3dm is not installed")


def quad(rhino):
    mesh = rhino.Mesh()
    for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)):
        mesh.Vertices.Add(float(x), float(y), 0.0)
    mesh.Faces.AddFace(0, 1, 2, 3)
    return mesh


def saddle(rhino, rational=False):
    """A bilinear patch with z = u v, of degree 2 along u; weights 1, 2, 1 along u if rational."""
    surface = rhino.NurbsSurface.Create(3, rational, 3, 2, 3, 2)
    for k, knot in enumerate((0.0, 0.0, 1.0, 1.0)):
        surface.KnotsU[k] = knot
    for k, knot in enumerate((0.0, 1.0)):
        surface.KnotsV[k] = knot
    for i in range(3):
        for j in range(2):
            w = 2.0 if rational and i == 1 else 1.0
            surface.Points[i, j] = rhino.Point4d(w * i / 2, w * j, w * i * j / 2, w)
    return surface


def block(rhino, model, name, *shapes, attributes=None):
    own = tuple(attributes or [rhino.ObjectAttributes() for _ in shapes])
    at = model.InstanceDefinitions.Add(name, "", "", "", rhino.Point3d(0, 0, 0), tuple(shapes), own)
    return model.InstanceDefinitions[at].Id


def saved(tmp_path, model):
    path = tmp_path / "a.3dm"
    model.Write(str(path), 8)
    return path


def test_blocks_stand_where_their_instances_are(tmp_path):
    rhino = rhino3dm()
    model = rhino.File3dm()
    own = block(rhino, model, "quad", quad(rhino))
    for x in (10, 20):
        model.Objects.AddInstanceObject(rhino.InstanceReference(own, rhino.Transform.Translation(x, 0, 0)))
    scene = load(saved(tmp_path, model))
    assert scene.patches()[..., 0].min(axis=(1, 2)).tolist() == [10, 20]
    assert scene.patches()[..., 0].max(axis=(1, 2)).tolist() == [11, 21]
    assert scene.notes == ()


def normals(mesh):
    first = mesh.corners.reshape(-1, 4)
    a, b, c = (mesh.vertices[first[:, k]] for k in range(3))
    return np.cross(b - a, c - b)


def test_nested_and_mirrored_blocks(tmp_path, rng):
    """Against the product of the transforms, applied to the corners; the front turns as a normal does, not with z."""
    rhino = rhino3dm()
    model = rhino.File3dm()
    inner = block(rhino, model, "inner", quad(rhino))
    matrices = rng.normal(size=(3, 4, 4))
    matrices[:, 3] = [0, 0, 0, 1]

    def reference(which, matrix):
        transform = rhino.Transform(1.0)
        for i in range(4):
            for j in range(4):
                setattr(transform, f"M{i}{j}", float(matrix[i, j]))
        return rhino.InstanceReference(which, transform)

    outer = block(rhino, model, "outer", reference(inner, matrices[0]), reference(inner, matrices[1]), quad(rhino))
    model.Objects.AddInstanceObject(reference(outer, matrices[2]))
    model.Objects.AddInstanceObject(reference(inner, np.diag([-1.0, 1, 1, 1])))
    mesh = polygons(read(saved(tmp_path, model)))
    corners = np.array([[0, 0, 0, 1], [1, 0, 0, 1], [1, 1, 0, 1], [0, 1, 0, 1]], float)
    places = [matrices[2] @ matrices[0], matrices[2] @ matrices[1], matrices[2], np.diag([-1.0, 1, 1, 1])]
    wanted = np.concatenate([(corners @ place.T)[:, :3] for place in places])
    np.testing.assert_allclose(mesh.vertices, wanted, atol=1e-14)
    for found, place in zip(normals(mesh), places, strict=True):
        front = np.linalg.inv(place[:3, :3]).T[:, 2]  # how planes turn, mirrored or not
        assert found @ front > 0
    assert {np.sign(np.linalg.det(place[:3, :3])) for place in places} == {-1.0, 1.0}


@pytest.mark.parametrize("rational", [False, True])
def test_mirrored_surfaces(tmp_path, rational):
    rhino = rhino3dm()
    model = rhino.File3dm()
    own = block(rhino, model, "saddle", saddle(rhino, rational))
    model.Objects.AddInstanceObject(rhino.InstanceReference(own, rhino.Transform.Translation(0, 5, 7)))
    mirror = rhino.Transform(1.0)
    mirror.M00, mirror.M03 = -1.0, 30.0
    model.Objects.AddInstanceObject(rhino.InstanceReference(own, mirror))
    straight, mirrored = read(saved(tmp_path, model)).splines
    assert (straight.degrees, mirrored.degrees) == ((2, 1), (1, 2))
    assert [len(k) for k in mirrored.knots] == [4, 6]
    places = [spline.control[..., :3] / (spline.control[..., 3:] if rational else 1) for spline in (straight, mirrored)]
    u, v = np.meshgrid([0, 0.5, 1], [0, 1], indexing="ij")
    np.testing.assert_allclose(places[0], np.stack([u, v + 5, u * v + 7], axis=-1), atol=1e-15)
    np.testing.assert_allclose(places[1], np.stack([30 - u, v, u * v], axis=-1).swapaxes(0, 1), atol=1e-15)
    if rational:
        assert mirrored.control[..., 3].tolist() == [[1, 2, 1]] * 2
    for place in places:  # both look up
        assert np.cross(place[1, 0] - place[0, 0], place[0, 1] - place[0, 0])[2] > 0
    assert load(tmp_path / "a.3dm").patches().shape == (2, 3, 3, 4 if rational else 3)


def test_what_is_hidden_is_left_out(tmp_path):
    rhino = rhino3dm()
    model = rhino.File3dm()
    off, below, on = rhino.Layer(), rhino.Layer(), rhino.Layer()
    off.Name, off.Visible = "off", False
    at = [model.Layers.Add(off)]
    below.Name, below.ParentLayerId = "below", model.Layers[at[0]].Id
    on.Name = "on"
    at += [model.Layers.Add(below), model.Layers.Add(on)]
    attributes = [rhino.ObjectAttributes() for _ in range(4)]
    for own, layer in zip(attributes, at, strict=False):
        own.LayerIndex = layer
    attributes[3].LayerIndex, attributes[3].Visible = at[2], False
    for own in attributes:
        model.Objects.AddMesh(quad(rhino), own)
    half = block(rhino, model, "half", quad(rhino), quad(rhino), attributes=[attributes[2], attributes[1]])
    block(rhino, model, "nowhere", quad(rhino))
    model.Objects.AddInstanceObject(rhino.InstanceReference(half, rhino.Transform.Translation(5, 0, 0)))
    model.Objects.AddInstanceObject(rhino.InstanceReference(half, rhino.Transform.Translation(9, 0, 0)), attributes[3])
    content = read(saved(tmp_path, model))
    assert polygons(content).vertices[:, 0].tolist() == [0, 1, 1, 0, 5, 6, 6, 5]
    assert content.notes == (
        "left out: 1 blocks that nothing places, 3 objects on layers that are off, 2 objects that are hidden",
    )
    alone = rhino.File3dm()
    hidden = rhino.ObjectAttributes()
    hidden.Visible = False
    alone.Objects.AddMesh(quad(rhino), hidden)
    with pytest.raises(InputError, match=r"a\.3dm shows no surface and no mesh; left out: 1 objects that are hidden"):
        load(saved(tmp_path, alone))


def test_blocks_of_blocks_of_blocks(tmp_path, monkeypatch):
    """Ten of ten of ten …: refused when too many are placed; deeper than is followed; and a transform to nowhere."""
    rhino = rhino3dm()
    model = rhino.File3dm()
    own = block(rhino, model, "0", quad(rhino))
    for level in range(1, 9):
        ten = [rhino.InstanceReference(own, rhino.Transform.Translation(0, 0, 10.0**k)) for k in range(10)]
        own = block(rhino, model, str(level), *ten)
    model.Objects.AddInstanceObject(rhino.InstanceReference(own, rhino.Transform(1.0)))
    monkeypatch.setattr(rhino_blocks, "_MOST", 1000)
    with pytest.raises(InputError, match=r"a\.3dm places more than 1,000 objects by its blocks"):
        load(saved(tmp_path, model))
    model = rhino.File3dm()
    own = block(rhino, model, "0", quad(rhino))
    for level in range(1, 70):
        own = block(rhino, model, str(level), rhino.InstanceReference(own, rhino.Transform.Translation(0, 0, 1)))
    model.Objects.AddInstanceObject(rhino.InstanceReference(own, rhino.Transform(1.0)))
    with pytest.raises(InputError, match=r"the block '5' is more than 64 blocks deep"):
        load(saved(tmp_path, model))
    odd = rhino.Transform(1.0)
    odd.M30 = 1.0
    model = rhino.File3dm()
    model.Objects.AddInstanceObject(rhino.InstanceReference(block(rhino, model, "0", quad(rhino)), odd))
    with pytest.raises(InputError, match=r"object 1 .* places the block '0' by no affine transform"):
        load(saved(tmp_path, model))


def test_a_block_in_itself():
    """No library writes one, but a file may hold it."""

    def thing(number, shape, inside):
        attributes = SimpleNamespace(Id=number, IsInstanceDefinitionObject=inside, Visible=True, LayerIndex=0)
        return SimpleNamespace(Geometry=shape, Attributes=attributes)

    xform = SimpleNamespace(**{f"M{i}{j}": float(i == j) for i in range(4) for j in range(4)})
    instances = [SimpleNamespace(ParentIdefId=which, Xform=xform) for which in ("a", "b", "c")]
    blocks = [("a", [1]), ("b", [0])]
    model = SimpleNamespace(
        Objects=[thing(k, instance, k < 2) for k, instance in enumerate([*instances[:2], instances[0], instances[2]])],
        InstanceDefinitions=[SimpleNamespace(Id=i, Name=i, GetObjectIds=lambda m=m: m) for i, m in blocks],
        Layers=[],
    )
    with pytest.raises(InputError, match=r"some\.3dm: the block 'a' is in itself"):
        list(Blocks(Path("some.3dm"), model).shown())
    del model.Objects[2]
    found = Blocks(Path("some.3dm"), model)
    assert list(found.shown()) == []
    assert found.left_out["instances of blocks that are not in the file"] == 1
