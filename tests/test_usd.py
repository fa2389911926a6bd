"""USD stages: meshes, NURBS patches, and what of a stage is not read."""

from __future__ import annotations

import numpy as np
import pytest

from slefejax import InputError, load
from slefejax.loading import read
from tests.meshes import cube
from tests.test_io import faces, polygons, write


def usd():
    return pytest.importorskip("pxr", reason="usd-core is not installed")


@pytest.fixture(autouse=True)
def installed():
    usd()


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
    assert content.notes == ("left out: 1 of Sphere (the first is /ball)",)


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
    assert content.notes == (
        "left out: 1 of Sphere (the first is /ball), 1 of what is invisible (the first is /again/cube)",
    )
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


QUAD = """int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(0,0,0), (1,0,0), (1,1,0), (0,1,0)]"""


def quad(name, inside=""):
    return f'def Mesh "{name}" {{\n    {QUAD}\n    {inside}\n}}\n'


def xform(name, inside):
    return f'def Xform "{name}" {{\n{inside}\n}}\n'


def usda(*prims, head=""):
    return "#usda 1.0\n" + head + "".join(prims)


def purpose(name):
    return f'uniform token purpose = "{name}"'


INVISIBLE = 'token visibility = "invisible"'


def test_purposes(tmp_path):
    """Render and default are read, also where what is above them is a guide; the others are said."""
    both = usda(quad("hi", purpose("render")), quad("lo", purpose("proxy")), quad("plain"))
    content = read(write(tmp_path, "a.usda", both))
    assert polygons(content).face_count == 2
    assert content.notes == ("left out: 1 of purpose 'proxy' (the first is /lo)",)
    nested = usda(
        xform("A", purpose("guide") + "\n" + quad("own", purpose("render")) + quad("as_above") + quad("more"))
    )
    content = read(write(tmp_path, "b.usda", nested))
    assert polygons(content).face_count == 1
    assert content.notes == ("left out: 2 of purpose 'guide' (the first is /A/as_above)",)
    with pytest.raises(
        InputError, match=r"c\.usda holds no mesh .*: left out: 1 of purpose 'proxy' \(the first is /lo\)"
    ):
        read(write(tmp_path, "c.usda", usda(quad("lo", purpose("proxy")))))


def test_what_is_invisible(tmp_path):
    """At the earliest time, and below what is invisible."""
    later = 'token visibility.timeSamples = {1: "invisible", 5: "inherited"}'
    until = 'token visibility.timeSamples = {1: "inherited", 5: "invisible"}'
    hidden = usda(xform("A", INVISIBLE + "\n" + quad("a") + quad("b")), quad("c", later), quad("d", until))
    content = read(write(tmp_path, "a.usda", hidden))
    assert polygons(content).face_count == 1
    assert content.notes == (
        "/d has visibility over time: the first is used",
        "left out: 3 of what is invisible (the first is /A/a)",
    )


KINDS = (
    "BasisCurves",
    "Points",
    "Cube",
    "Sphere",
    "Cylinder",
    "Capsule",
    "Cone",
    "Plane",
    "TetMesh",
    "NurbsCurves",
    "Volume",
)


@pytest.mark.parametrize("kind", [*KINDS, "PointInstancer"])
def test_what_else_is_drawn_is_said(tmp_path, kind):
    """Also where there is nothing else. What stands below a point instancer is drawn by it only."""
    others = f'def {kind} "a" {{\n{quad("inner") if kind == "PointInstancer" else ""}}}\ndef {kind} "b" {{\n}}\n'
    said = rf"left out: 2 of {kind} \(the first is /a\)"
    with pytest.raises(InputError, match=r"a\.usda holds no mesh and no NURBS patch that is drawn: " + said):
        read(write(tmp_path, "a.usda", usda(others)))
    content = read(write(tmp_path, "b.usda", usda(others, quad("c"))))
    assert polygons(content).face_count == 1
    assert content.notes == (said.replace("\\", ""),)


def test_what_does_not_draw_is_not_said(tmp_path):
    lights = 'def SphereLight "l" {\n}\ndef Camera "c" {\n}\ndef Scope "s" {\n}\ndef "untyped" {\n}\nover "o" {\n}\n'
    assert read(write(tmp_path, "a.usda", usda(lights, quad("q")))).notes == ()
    strange = usda('def Blob "b" {\n}\n', quad("q"))
    assert read(write(tmp_path, "b.usda", strange)).notes == ("left out: 1 of the unknown type Blob (the first is /b)",)


@pytest.mark.parametrize(
    ("inside", "says"),
    [
        ('(references = @none.usda@) {\n}', "Could not open asset @none.usda@ for reference"),
        ('(payload = @none.usdc@) {\n}', "Could not open asset @none.usdc@ for payload"),
        ("(references = </nowhere>) {\n}", "Unresolved reference prim path"),
    ],
)  # fmt: skip
def test_references_that_are_missing(tmp_path, inside, says):
    missing = f'def Xform "m" {inside}\n'
    content = read(write(tmp_path, "a.usda", usda(missing, quad("q"))))
    assert len(content.notes) == 1
    assert content.notes[0].startswith("what the file refers to is not all there: ")
    assert says in content.notes[0]
    with pytest.raises(
        InputError, match=r"b\.usda holds no mesh .*what the file refers to is not all there: "
    ) as raised:
        read(write(tmp_path, "b.usda", usda(missing)))
    assert "\n" not in str(raised.value)


def test_rules_of_subdivision_that_are_not_followed(tmp_path):
    triangle = quad("q").replace("[4]", "[3, 3]").replace("[0, 1, 2, 3]", "[0, 1, 2, 0, 2, 3]")
    for rule, says in (
        ('uniform token subdivisionScheme = "none"', "scheme 'none'"),
        ('uniform token subdivisionScheme = "bilinear"', "scheme 'bilinear'"),
        ('uniform token interpolateBoundary = "none"', "boundary rule 'none'"),
        ('uniform token triangleSubdivisionRule = "smooth"', "triangle subdivision rule 'smooth'"),
    ):
        (note,) = read(write(tmp_path, "a.usda", usda(triangle.replace("point3f[]", rule + "\n point3f[]")))).notes
        assert note.startswith(f"/q says {'subdivision ' if 'scheme' in says else ''}{says}: it was taken as ")
    quads = usda(quad("q", 'uniform token triangleSubdivisionRule = "smooth"'))
    assert read(write(tmp_path, "b.usda", quads)).notes == ()  # there is no triangle


def test_what_changes_over_time_is_said(tmp_path):
    points = "[(0,0,0), (1,0,0), (1,1,0), (0,1,0)]"
    moving = quad("q").replace(f"points = {points}", f"points.timeSamples = {{1: {points}, 2: {points}}}")
    content = read(write(tmp_path, "a.usda", usda(moving)))
    assert content.notes == ("/q has points over time: the first is used",)
    slide = """double3 xformOp:translate.timeSamples = {0: (1,0,0), 10: (0,5,0)}
    uniform token[] xformOpOrder = ["xformOp:translate"]"""
    content = read(write(tmp_path, "b.usda", nurbs_usd(slide)))
    assert content.notes == ("/patch moves over time: it stays where it is at first",)
    assert content.splines[0].control[0, 0].tolist() == [1, 0, 0]


MIRROR = """double3 xformOp:scale = (-1,1,1)
    uniform token[] xformOpOrder = ["xformOp:scale"]"""
LEFT = 'uniform token orientation = "leftHanded"'


@pytest.mark.parametrize(
    ("own", "above", "upwards"),
    [("", "", True), (MIRROR, "", True), (MIRROR, MIRROR, True), (LEFT, "", False), (LEFT, MIRROR, False)],
)
def test_mirrored_parts_keep_their_front(tmp_path, own, above, upwards):
    """A quad and a surface that face +z, mirrored along x: they face +z still. Left-handed ones face down."""
    mesh = polygons(read(write(tmp_path, "a.usda", usda(xform("A", above + "\n" + quad("q", own))))))
    a, b, _, d = mesh.vertices[mesh.corners]
    assert (np.cross(b - a, d - a)[2] > 0) == upwards
    surface = nurbs_usd(own).replace("#usda 1.0\n", "")
    patch = load(write(tmp_path, "b.usda", usda(xform("A", above + "\n" + surface)))).patches()[0]
    assert (np.cross(patch[1, 0] - patch[0, 0], patch[0, 1] - patch[0, 0])[2] > 0) == upwards
    plain = load(write(tmp_path, "c.usda", usda(xform("A", above + "\n" + nurbs_usd().replace("#usda 1.0\n", "")))))
    mirrored = -1 if (MIRROR in own) != (MIRROR in above) else 1
    wanted = np.unique(load(write(tmp_path, "d.usda", nurbs_usd())).points() * [mirrored, 1, 1], axis=0)
    found = np.unique(load(tmp_path / "b.usda").points(), axis=0)
    np.testing.assert_allclose(found, wanted, atol=1e-15)  # it is the same surface
    assert len(plain.patches()) == 3


def test_creases_that_are_no_edges_are_left_out(tmp_path):
    inside = """int[] creaseIndices = [1, 2, 0, 1, 3]
    int[] creaseLengths = [2, 3]
    float[] creaseSharpnesses = [10, 4]"""
    content = read(write(tmp_path, "a.usda", usda(quad("q", inside))))
    assert polygons(content).creases.tolist() == [[1, 2], [0, 1]]
    assert polygons(content).crease_sharpness.tolist() == [10, 4]
    assert content.notes == (
        "/q: 1 of 3 creases join vertices that share no edge, and were left out"
        " (the first joins 1 and 3, counted from 0)",
    )


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (b"#usda 1.0\n(\n    upAxis = \n)\n", "line 3, column "),
        (b"#usda 1.0\r\n(\r\n    upAxis = \r\n)\r\n", "line 3, column "),
        (b'#usda 1.0\n\ndef Xform "1 a" {\n}\n', "line 3, column .*'1 a' is not a valid prim name"),
        (b'#usda 1.0\ndef Mesh "a" {\n int[] x = [1, 2,\n}\n', "line 4, column "),
        (b'#usda 1.0\ndef Xform "a\xcf" {\n}\n', "line 2, column "),
        (b"", "is not a valid usda layer"),
    ],
)
def test_syntax_errors_are_told_with_the_line(tmp_path, text, says):
    path = write(tmp_path, "a.usda", text)
    with pytest.raises(InputError, match=r"a\.usda is no USD file that can be read: .*" + says) as raised:
        load(path)
    assert "\n" not in str(raised.value)
    assert "pxrInternal" not in str(raised.value)


def usdz(tmp_path, text):
    from pxr import UsdUtils  # type: ignore[attr-defined]

    whole = write(tmp_path, "inner.usda", usda(quad("q")))
    assert UsdUtils.CreateNewUsdzPackage(str(whole), str(tmp_path / "whole.usdz"))  # type: ignore[attr-defined]
    return (tmp_path / "whole.usdz").read_bytes().replace(*text)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda data: data.replace(b"def Mesh", b"def Me!h"), "inner.usda, line 2, column "),
        (lambda data: data[:40], "is it complete"),
        (lambda data: data[: len(data) // 2], "is it complete"),
        (lambda data: data[:18] + b"\xff\xff\xff\x7f" * 2 + data[26:], "is it complete"),
        (lambda data: data[:18] + b"\xf0\xff\xff\xff" * 2 + data[26:], "is it complete"),
    ],
)
def test_packages_that_lie_or_are_broken(tmp_path, change, says):
    """Sizes of two and four gigabytes in the header of a small package among them."""
    data = usdz(tmp_path, (b"", b""))
    assert len(load(tmp_path / "whole.usdz").patches()) == 1
    path = write(tmp_path, "a.usdz", change(data))
    with pytest.raises(InputError, match=r"a\.usdz is no USD file that can be read: .*" + says) as raised:
        load(path)
    assert "\n" not in str(raised.value)


def test_a_text_that_names_a_broken_binary_file(tmp_path):
    """It is read within limits too."""
    from pxr import Usd  # type: ignore[attr-defined]

    whole = write(tmp_path, "inner.usda", usda(quad("q")))
    Usd.Stage.Open(str(whole)).Export(str(tmp_path / "inner.usdc"))  # type: ignore[attr-defined]
    names = usda('def Mesh "a" (references = @./inner.usdc@</q>) {\n}\n', quad("b"))
    assert polygons(read(write(tmp_path, "a.usda", names))).face_count == 2
    data = (tmp_path / "inner.usdc").read_bytes()
    write(tmp_path, "inner.usdc", data[: len(data) // 2])
    content = read(write(tmp_path, "b.usda", names))
    assert polygons(content).face_count == 1
    assert "possibly truncated" in content.notes[0]


def test_up_is_what_the_stage_says(tmp_path):
    for head, up in (("", (0, 1, 0)), ('(\n upAxis = "Z"\n)\n', (0, 0, 1)), ('(\n upAxis = "Y"\n)\n', (0, 1, 0))):
        assert read(write(tmp_path, "a.usda", usda(quad("q"), head=head))).up == up


def test_deep_stages(tmp_path):
    """Four hundred prims one below the other, one of which moves."""
    slide = """double3 xformOp:translate.timeSamples = {0: (0,0,0), 10: (0,5,0)}
    uniform token[] xformOpOrder = ["xformOp:translate"]"""
    text = xform("top", slide + "\n" + 'def Xform "a" {\n' * 400 + quad("q") + "}\n" * 400)
    scene = load(write(tmp_path, "a.usda", usda(text)))
    np.testing.assert_allclose(scene.vertices(10.0)[0], [0, 5, 0], atol=1e-15)


def test_a_file_that_was_changed_is_read_again(tmp_path):
    """While another stage, or the traceback of an error, still holds what it was."""
    pxr = pytest.importorskip("pxr.Usd")
    path = write(tmp_path, "a.usda", nurbs_usd())
    held = pxr.Stage.Open(str(path))
    before = load(path).patches()
    path.write_text(path.read_text().replace("(2, 3, 6)", "(2, 3, 9)"))
    after = load(path).patches()
    assert held is not None
    assert before.max() == 6
    assert after.max() == 9
