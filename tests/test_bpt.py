from __future__ import annotations

import numpy as np
import pytest

from slefejax import InputError, load
from slefejax.geometry.bezier import evaluate_patch

PATCH = "1 1\n0 0 0\n0 1 0\n1 0 0\n1 1 0\n"


def write(tmp_path, text, name="some.bpt"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_reads_the_model(models):
    scene = load(models / "teapot.bpt")
    assert scene.name == "teapot"
    assert scene.patches().shape == (32, 4, 4, 3)
    assert scene.patches()[0, 0, 1].tolist() == [1.4, -0.784, 2.4]
    assert scene.notes == ()


def test_blanks_and_line_ends_do_not_matter(tmp_path):
    plain = load(write(tmp_path, "1\n" + PATCH)).patches()
    odd = load(write(tmp_path, "  1 " + PATCH.replace("\n", "\r\n\r\n") + "\t\n")).patches()
    assert np.array_equal(plain, odd)


def test_byte_order_mark_is_no_number(tmp_path):
    assert len(load(write(tmp_path, b"\xef\xbb\xbf1\n" + PATCH.encode())).patches()) == 1


def test_different_degrees_are_raised_to_the_highest(tmp_path, rng):
    bump = rng.normal(size=(3, 4, 3))
    text = "2\n" + PATCH + "2 3\n" + "\n".join(" ".join(map(repr, p)) for p in bump.reshape(-1, 3).tolist())
    scene = load(write(tmp_path, text))
    assert scene.patches().shape == (2, 3, 4, 3)
    assert scene.notes == ("1 of 2 patches were raised to bi-degree 2 x 3, the highest here",)
    assert np.array_equal(scene.patches()[1], bump)
    flat = np.moveaxis(scene.patches()[0], -1, 0)[..., None]
    for u, v in rng.random((9, 2)):
        point = [evaluate_patch(c, u, v)[0] for c in flat]
        np.testing.assert_allclose(point, [u, v, 0], atol=1e-15)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", r"line 1: the file ends where the number of patches should be"),
        ("0\n", r"line 1: .*no patches"),
        ("2\n" + PATCH, r"line 6: the file ends where degree u of patch 1"),
        ("1\n1 1\n0 0 0\n0 1", r"line 4: the file ends where a coordinate of patch 0"),
        ("1\n1 1\n0 0 0\n0 1 x\n", r"line 4: a coordinate of patch 0 .* not 'x'"),
        ("1\n1 1\n0 0 0\n0 nan 0\n1 0 0\n1 1 0\n", r"line 4: a coordinate of patch 0 .* not a finite number \(nan\)"),
        ("1\n1 1\n0 0 0\n0 1e999 0\n", r"line 4: .* not a finite number"),
        ("1\n0 1\n", r"line 2: degree u of patch 0 .* from 1 to 64, not '0'"),
        ("1\n1 65\n", r"line 2: degree v"),
        ("-1\n", r"line 1: the number of patches"),
        ("1.5\n", r"line 1: the number of patches"),
        ("9999999999\n", r"line 1: the number of patches"),
        ("999999999\n" + PATCH, r"line 6: the file ends"),
        ("1\n" + PATCH + "1 1\n", r"line 7: '1' follows the last of the 1 patches"),
        ("1\n1 1\n0 0 1_0\n", r"line 3: a coordinate of patch 0 .* not '1_0'"),
        (b"\x00\xff\xfe\x80 1 2 3", "not a text file"),
    ],
)
def test_bad_files_are_named_with_the_line(tmp_path, text, says):
    path = write(tmp_path, text)
    with pytest.raises(InputError, match=says) as raised:
        load(path)
    assert str(path) in str(raised.value)
    assert "\n" not in str(raised.value)


def test_files_that_are_not_there_or_unknown(tmp_path):
    with pytest.raises(InputError, match="there is no file"):
        load(tmp_path / "no.bpt")
    with pytest.raises(InputError, match=r"not read; give a file ending in \.obj, .*\.bpt"):
        load(tmp_path / "some.xyz")
    folder = tmp_path / "folder.bpt"
    folder.mkdir()
    with pytest.raises(InputError, match="cannot be read"):
        load(folder)


@pytest.mark.parametrize("size", [0, 1, 7, 100, 700, 1500])
def test_every_cut_of_a_file_is_refused(tmp_path, size):
    whole = ("3\n" + PATCH * 3).encode()
    for end in range(size % len(whole), len(whole) - 1, 11):
        with pytest.raises(InputError):
            load(write(tmp_path, whole[:end]))
