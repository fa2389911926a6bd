"""USD stages: meshes, NURBS patches, and what of a stage is not read."""

from __future__ import annotations

import numpy as np
import pytest

from slefejax import InputError, load
from slefejax.scene import read
from tests.meshes import cube
from tests.test_io import faces, polygons, write

pytest.importorskip("pxr", reason="usd-core is not installed")

USD = """#usda 1.0
(
    upAxis = "Y"
)
def Xform "top"
{
    double3 xformOp:translate = (10, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Mesh "cube"
    {
        int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
        int[] faceVertexIndices = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]
        point3f[] points = [(0,0,0), (0,0,1), (0,1,0), (0,1,1), (1,0,0), (1,0,1), (1,1,0), (1,1,1)]
        int[] creaseIndices = [0, 1, 3, 4, 5]
        int[] creaseLengths = [3, 2]
        float[] creaseSharpnesses = [2, 5]
        int[] cornerIndices = [7]
        float[] cornerSharpnesses = [3]
    }
}
def Sphere "ball"
{
}
"""


def test_usd_meshes(tmp_path):
    content = read(write(tmp_path, "a.usda", USD))
    mesh = polygons(content)
    assert faces(mesh) == faces(cube())
    assert np.array_equal(mesh.vertices, cube().vertices + [10, 0, 0])
    assert mesh.creases.tolist() == [[0, 1], [1, 3], [4, 5]]
    assert mesh.crease_sharpness.tolist() == [2, 2, 5]
    assert (mesh.points.tolist(), mesh.point_sharpness.tolist()) == ([7], [3])
    assert content.up == (0, 1, 0)
    assert content.notes == ("geometry of other kinds was left out: 1 of Sphere",)


def test_usd_orientation_holes_and_schemes(tmp_path):
    odd = USD.replace(
        "int[] creaseIndices = [0, 1, 3, 4, 5]",
        'uniform token orientation = "leftHanded"\n uniform token subdivisionScheme = "loop"\n'
        " int[] holeIndices = [1]\n"
        ' uniform token interpolateBoundary = "edgeOnly"\n int[] creaseIndices = [0, 1, 3, 4, 5]',
    )
    content = read(write(tmp_path, "a.usda", odd))
    assert faces(polygons(content))[0] == [0, 2, 3, 1]
    assert polygons(content).face_count == 5
    said = " ".join(content.notes)
    assert "1 holes" in said
    assert "scheme 'loop'" in said
    assert "boundary rule 'edgeOnly'" in said


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("[4, 4, 4, 4, 4, 4]", "[4, 4, 4, 4, 4, 5]", "lists 24 corners, but its faces have 25"),
        ("creaseLengths = [3, 2]", "creaseLengths = [3, 3]", "creases of /top/cube do not fit"),
        ("creaseLengths = [3, 2]", "creaseLengths = [6, -1]", "creases of /top/cube do not fit"),
        ("Sharpnesses = [2, 5]", "Sharpnesses = [2, nan]", "/top/cube: crease 2 .* has the sharpness nan"),
        ("creaseIndices = [0, 1", "creaseIndices = [0, 8", "/top/cube: crease 0 .* names vertex 8"),
        ("cornerIndices = [7]", "cornerIndices = [99]", "/top/cube: sharp vertex 0 .* names vertex 99"),
        ("cornerIndices = [7]", "cornerIndices = [7, 1]", "every sharp vertex needs a sharpness"),
        ("0, 1, 3, 2, 4, 6", "0, 1, 3, 9, 4, 6", "/top/cube: face 0 .* has a vertex 9"),
        ("def Mesh", "def Cube", "holds no mesh and no NURBS patch"),
        ("#usda 1.0", "#usdb 1.0", "no USD file that can be read"),
        ("upAxis", "upAxis = ", "no USD file that can be read"),
    ],
)
def test_bad_usd_files(tmp_path, old, new, says):
    with pytest.raises(InputError, match=says):
        read(write(tmp_path, "a.usda", USD.replace(old, new)))


def test_usd_holes_instances_and_what_is_hidden(tmp_path):
    holes = USD.replace("int[] creaseIndices", "int[] holeIndices = [0, 1, 2, 3, 4, 5]\n int[] creaseIndices")
    with pytest.raises(InputError, match="holds no mesh"):
        read(write(tmp_path, "a.usda", holes))
    two = USD.replace('def Xform "top"', 'def Xform "again" (references = </top>)\n{\n}\ndef Xform "top"')
    assert polygons(read(write(tmp_path, "b.usda", two))).face_count == 12
    shared = two.replace("references = </top>", "instanceable = true\n references = </top>")
    assert polygons(read(write(tmp_path, "c.usda", shared))).face_count == 12
    one = two.replace("{\n}", '{\n token visibility = "invisible"\n}', 1)
    content = read(write(tmp_path, "d.usda", one))
    assert polygons(content).face_count == 6
    assert "1 of what is invisible or a guide" in content.notes[0]
    first = USD.replace("int[] creaseIndices", "int[] holeIndices = [0]\n int[] creaseIndices")
    scene = load(
        write(tmp_path, "e.usda", first.replace('def Sphere "ball"', 'def Xform "again" (references = </top>)'))
    )
    assert scene.faces is not None
    assert np.unique(scene.faces).tolist() == [1, 2, 3, 4, 5, 7, 8, 9, 10, 11]


def nurbs_usd(extra=""):
    points = ", ".join(f"({u}, {v}, {u * v})" for v in range(4) for u in range(3))
    return f"""#usda 1.0
def NurbsPatch "patch"
{{
    point3f[] points = [{points}]
    int uVertexCount = 3
    int vVertexCount = 4
    int uOrder = 3
    int vOrder = 2
    double[] uKnots = [0, 0, 0, 1, 1, 1]
    double[] vKnots = [0, 0, 1, 2, 3, 3]
    double2 uRange = (0, 1)
    double2 vRange = (0, 3)
    {extra}
}}
"""


def test_usd_nurbs(tmp_path):
    scene = load(write(tmp_path, "a.usda", nurbs_usd()))
    assert scene.patches().shape == (3, 3, 2, 3)
    assert scene.patches()[1].tolist() == [[[u, v, u * v] for v in (1, 2)] for u in range(3)]
    weights = ", ".join(["1", "2", "1"] * 4)
    rational = load(write(tmp_path, "a.usda", nurbs_usd(f"double[] pointWeights = [{weights}]"))).patches()
    assert rational[0, 1, 1].tolist() == [2, 2, 2, 2]
    for extra, says in (
        ("double[] pointWeights = [1, 2]", "2 weights for 12 points"),
        (
            "double[] pointWeights = [" + ", ".join(["inf"] * 12) + "]",
            "/patch has control points or weights that are not fin",
        ),
        ("int[] trimCurve:counts = [1]", "trimmed surface, which is not supported"),
        ("double[] pointWeights = [" + ", ".join(["1", "0", "1"] * 4) + "]", "a weight that is not positive"),
    ):
        with pytest.raises(InputError, match=says):
            load(write(tmp_path, "b.usda", nurbs_usd(extra)))
    with pytest.raises(InputError, match=r"/patch: the knots .* do not decrease"):
        load(write(tmp_path, "b.usda", nurbs_usd().replace("[0, 0, 1, 2, 3, 3]", "[0, 0, 2, 1, 3, 3]")))
