"""PLY: text and binary, strips, rows with more than the header tells."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from slefejax import InputError, load
from slefejax.io.ply.read import read_ply
from tests.meshes import cube, mixed
from tests.test_io import faces, polygons, write


def ply(mesh, form, extra=False):
    lines = ["ply", f"format {form} 1.0", "comment made here", f"element vertex {mesh.vertex_count}"]
    lines += ["property double x", "property double y", "property float z"] + ["property uchar red"] * extra
    lines += [f"element face {mesh.face_count}"] + ["property list uchar float weights"] * extra
    lines += ["property list uchar int vertex_indices"] + ["element edge 1", "property int vertex1"] * extra
    head = "\n".join([*lines, "end_header", ""]).encode()
    if form == "ascii":
        rows = [f"{x!r} {y!r} {np.float32(z)!r}{' 7' * extra}" for x, y, z in mesh.vertices.tolist()]
        rows = [row.replace("np.float32(", "").replace(")", "") for row in rows]
        rows += [("1 0.5 " * extra) + f"{len(face)} " + " ".join(map(str, face)) for face in faces(mesh)]
        return head + "\n".join([*rows, *["3"] * extra, ""]).encode()
    order = "<" if "little" in form else ">"
    body = b"".join(struct.pack(order + "ddf" + "B" * extra, *p, *[7] * extra) for p in mesh.vertices.tolist())
    for face in faces(mesh):
        body += struct.pack(order + "Bf", 1, 0.5) if extra else b""
        body += struct.pack(order + f"B{len(face)}i", len(face), *face)
    return head + body + (struct.pack(order + "i", 3) if extra else b"")


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("extra", [False, True])
def test_ply(tmp_path, rng, form, extra):
    mesh = mixed(rng)
    found = polygons(read_ply(write(tmp_path, "a.ply", ply(mesh, form, extra))))
    assert faces(found) == faces(mesh)
    assert np.array_equal(found.vertices[:, :2], mesh.vertices[:, :2])
    np.testing.assert_allclose(found.vertices[:, 2], mesh.vertices[:, 2], rtol=1e-7, atol=1e-12)  # written as float32


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_every_cut_of_a_ply_file_is_refused(tmp_path, form):
    whole = ply(cube(), form).rstrip(b"\n") if form == "ascii" else ply(cube(), form)
    for end in range(0, len(whole), 3 if form == "ascii" else 1):
        if form == "ascii" and end > len(whole) - 3:
            continue
        with pytest.raises(InputError):
            load(write(tmp_path, "a.ply", whole[:end]))


def test_a_ply_comment_does_not_end_the_header(tmp_path):
    text = ply(cube(), "ascii").replace(b"comment made here", b"comment end_header follows")
    assert read_ply(write(tmp_path, "a.ply", text)).mesh is not None


@pytest.mark.parametrize("length", [np.nan, np.inf, -1.0, 2.5, 1e10])
def test_lengths_of_ply_lists_that_are_none(tmp_path, length):
    head = b"ply\nformat binary_little_endian 1.0\nelement face 1\nproperty list float int vertex_indices\nend_header\n"
    with pytest.raises(InputError, match="has the length"):
        read_ply(write(tmp_path, "a.ply", head + struct.pack("<f3i", length, 0, 1, 2)))


def test_other_ply_files_are_refused(tmp_path):
    text = ply(cube(), "ascii").decode()
    for old, new, says in (
        ("format ascii 1.0\n", "", "does not say its format"),
        ("ascii", "text", "line 2: .* no line of a PLY header"),
        ("double x", "double a", "no number 'x' of its vertices"),
        ("vertex_indices", "indices", "no list 'vertex_indices'"),
        ("element face 6", "element faces 6", "no element 'face'"),
        ("property double y", "property complex y", "line 6: .* no line of a PLY header"),
        ("0.0 0.0 1.0", "0.0 0.0 top", "'top' among the elements 'vertex' is not a number"),
        ("4 0 1 3 2", "4 0 1 3 20", "face 0 .* has a vertex 20"),
        ("4 0 1 3 2", "4 0 1 3 0.5", "face 0 .* names vertex 0.5, which is no whole number"),
        ("4 0 1 3 2", "-4 0 1 3 2", "has the length -4"),
        ("element vertex 8", "element vertex -8", "tells of -8 elements 'vertex', but has 156 bytes"),
        ("property double x", "property list uchar double x", "no number 'x' of its vertices"),
        ("property list uchar int vertex_indices", "property int vertex_indices", "no list 'vertex_indices'"),
        ("property double y", "property double x", "properties with different names"),
        ("element face 6", "element other 3\nelement face 6", "element 'other' needs properties"),
    ):
        assert old in text
        with pytest.raises(InputError, match=says):
            read_ply(write(tmp_path, "a.ply", text.replace(old, new, 1)))
    with pytest.raises(InputError, match="no PLY header"):
        read_ply(write(tmp_path, "a.ply", "v 0 0 0"))


HEAD = """ply
format ascii 1.0
element vertex 5
property float x
property float y
property float z
{elements}
end_header
0 0 0
1 0 0
0 1 0
1 1 0
0 2 0
"""
LIST = "property list int int vertex_indices"
STRIPS = HEAD.format(elements=f"element tristrips 2\n{LIST}") + "5 0 1 2 3 -1\n7 -1 2 2 2 3 4 -1\n"


def test_strips(tmp_path):
    """The triangles by hand: every second one runs the other way round, and each strip begins anew."""
    content = read_ply(write(tmp_path, "a.ply", STRIPS))
    assert faces(polygons(content)) == [[0, 1, 2], [2, 1, 3], [2, 3, 4]]
    assert content.notes == ("2 triangles that only join parts of a strip were left out",)
    scene = load(write(tmp_path, "a.ply", STRIPS))
    assert len(scene.patches()) == 3


def test_strips_run_as_their_triangles(tmp_path, rng):
    """Strips of any lengths, between restarts and rows, against a loop over the definition; binary as well as text."""
    rows = [rng.permutation(40)[: rng.integers(0, 20)].tolist() for _ in range(30)]
    for row in rows:
        for place in rng.integers(0, len(row) + 1, 2):
            row.insert(place, -1)
    wanted = []
    for row in rows:
        strip: list[int] = []
        for number in row:
            strip = [] if number == -1 else [*strip, number]
            if len(strip) >= 3:
                a, b, c = strip[-3:]
                wanted.append([a, b, c] if len(strip) % 2 else [b, a, c])
    head = f"ply\nformat %s 1.0\nelement tristrips 30\n{LIST}\nelement vertex 40\n"
    head += "property double x\nproperty double y\nproperty double z\nend_header\n"
    points = rng.normal(size=(40, 3))
    text = head % "ascii" + "".join(" ".join(map(str, [len(row), *row])) + "\n" for row in rows)
    text += "".join(" ".join(map(repr, point)) + "\n" for point in points.tolist())
    body = b"".join(struct.pack(f">{len(row) + 1}i", len(row), *row) for row in rows) + points.astype(">f8").tobytes()
    for data in (text.encode(), (head % "binary_big_endian").encode() + body):
        mesh = polygons(read_ply(write(tmp_path, "a.ply", data)))
        assert faces(mesh) == wanted
        assert np.array_equal(mesh.vertices, points)


def test_faces_and_strips_together(tmp_path):
    both = HEAD.format(elements=f"element face 1\n{LIST}\nelement tristrips 1\n{LIST}")
    mesh = polygons(read_ply(write(tmp_path, "a.ply", both + "3 0 1 2\n3 2 1 3\n")))
    assert faces(mesh) == [[0, 1, 2], [2, 1, 3]]
    with pytest.raises(InputError, match=r"tristrips 0 .* names vertex 1\.5, which is no whole number"):
        read_ply(write(tmp_path, "a.ply", both + "3 0 1 2\n3 2 1.5 3\n"))
    with pytest.raises(InputError, match=r"face 1 .* has a vertex -2"):
        read_ply(write(tmp_path, "a.ply", both + "3 0 1 2\n3 2 -2 3\n"))
    with pytest.raises(InputError, match="at least one face"):
        read_ply(write(tmp_path, "a.ply", HEAD.format(elements=f"element tristrips 1\n{LIST}") + "2 2 1\n"))


FACES = HEAD.format(elements=f"element face 2\n{LIST}") + "4 0 1 3 2\n3 2 3 4\n"
BOTH = [[0, 1, 3, 2], [2, 3, 4]]


@pytest.mark.parametrize(
    ("change", "notes"),
    [
        (lambda text: text, ()),
        (lambda text: text.replace("\n", "\r\n"), ()),
        (lambda text: text.replace("\n", "\r"), ()),
        (lambda text: text.replace("0 1 0\n", "0\n1   0\n"), ()),
        (lambda text: text.replace("0 1 0\n1 1 0\n", "0 1 0 1 1 0\n"), ()),
        (lambda text: text.replace("4 0 1 3 2\n3 2 3 4\n", "4 0 1 3 2 3 2 3 4"), ()),
        (lambda text: text.replace("0 1 0\n", "0 1 0 255 255 0 .5\n"), (("1 rows hold more numbers"),)),
        (lambda text: text.replace("3 2\n", "3 2 0 0 1\n").replace("3 4\n", "3 4 9"), (("2 rows hold more numbers"),)),
        (lambda text: text.replace("0 1 0\n", "\n\n0 1 0 # a comment\n\n"), (("1 rows hold more numbers"),)),
        (lambda text: text + "\n3 0 1 2\n\n3 1 2 3\n", ("2 lines behind the last row",)),
        (lambda text: text.encode().replace(b"3 4", b"3 4 \xff"), ("1 rows hold more numbers",)),
    ],
)
def test_rows_of_text_in_other_clothes(tmp_path, change, notes):
    text = change(FACES)
    content = read_ply(write(tmp_path, "a.ply", text))
    assert faces(polygons(content)) == BOTH
    assert polygons(content).vertices[[2, 4]].tolist() == [[0, 1, 0], [0, 2, 0]]
    assert len(content.notes) == len(notes)
    for note, wanted in zip(content.notes, notes, strict=True):
        assert note.startswith(wanted)


def test_binary_files_with_lone_carriage_returns(tmp_path):
    """A header that ends so may be followed by a number whose first byte is a line feed."""
    whole = ply(cube(), "binary_little_endian")
    head, body = whole.split(b"end_header\n")
    vertices = b"\n" + body[1:]
    text = head.replace(b"\n", b"\r") + b"end_header\r" + vertices
    assert faces(polygons(read_ply(write(tmp_path, "a.ply", text)))) == faces(cube())
    content = read_ply(write(tmp_path, "a.ply", whole + b"abc"))
    assert content.notes == ("3 bytes behind the last row were left out",)


def test_errors_of_text_name_the_line(tmp_path):
    for old, new, says in (
        ("1 1 0", "1 one 0", "line 13: 'one' among the elements 'vertex' is not a number"),
        ("3 2 3 4", "3 2 3", "line 16: the file ends within its 2 elements 'face'"),
        ("4 0 1 3 2", "-1 0 1 3 2", "line 15: a list of elements 'face' has the length -1"),
        ("element vertex 5", "element vertex 5000", "tells of 5,000 elements 'vertex', but has 48 bytes for them"),
        ("element vertex 5", "element vertex " + "9" * 5000, "line 3: .* is no line of a PLY header"),
        ("element face 2", "element vertex 2", "two elements 'vertex'"),
    ):
        assert old in FACES
        with pytest.raises(InputError, match=says):
            read_ply(write(tmp_path, "a.ply", FACES.replace(old, new)))


@pytest.mark.parametrize("small", ["0", "1 3", "2 0 1"])
def test_faces_of_fewer_than_three_vertices(tmp_path, small):
    path = write(tmp_path, "a.ply", FACES.replace("element face 2", "element face 3") + small + "\n")
    with pytest.raises(InputError, match=rf"a\.ply: face 2 has {small[0]} vertices, and needs three"):
        load(path)
    scene = load(path, drop_defects=True)
    assert scene.conversion is not None
    assert faces(scene.conversion.mesh) == BOTH
    assert scene.notes[0] == f"face 2 has {small[0]} vertices, and needs three: 1 faces were dropped (2)"
