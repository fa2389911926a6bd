"""What single precision adds to what is drawn: the bound against captured vertices, and what commands say of it."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from slefejax import Camera, GregoryPatches, InputError, View, rounding_error
from slefejax.experiments import options
from slefejax.experiments.attack.families.nets import nets
from slefejax.experiments.attack.judge.screen import Look, Screen
from slefejax.experiments.options import rounding_notes
from slefejax.gpu import Renderer
from slefejax.measure import rounding
from tests.test_cli import run_json
from tests.test_gaussian import scene_of, torus

VIEWS = {
    "around": Look((7.0, -8.0, 5.0), (0.0, 0.0, 0.5), (0.0, 0.0, 1.0), 45.0, 0.5, 50.0, True, 320, 200),
    "beside": Look((3.6, -0.5, 0.6), (2.0, 0.0, 0.5), (0.0, 0.0, 1.0), 60.0, 0.01, 50.0, True, 320, 200),
    "from afar": Look((7e4, -8e4, 5e4), (0.0, 0.0, 0.5), (0.0, 0.0, 1.0), 0.004, 1e4, 2e5, True, 320, 200),
    "orthographic": Look((7.0, -8.0, 5.0), (0.0, 0.0, 0.5), (0.0, 0.0, 1.0), 8.0, 0.5, 50.0, False, 320, 200),
}
FLAT = np.array([[[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]]], float)
ABOVE = View(Camera.look_at((0.5, 0.5, 3.0), (0.5, 0.5, 0.0), (0.0, 1.0, 0.0)), 1440, 900)


def view_of(look: Look) -> View:
    make = Camera.look_at if look.perspective else Camera.orthographic
    return View(make(look.eye, look.target, look.up, look.extent, look.near, look.far), look.width, look.height)


def measured(patches: Any, look: Look, device: Any, level: int = 4) -> np.ndarray:
    """How far captured vertices that are seen lie from exact ones in long double, pixels, the largest of each patch."""
    count = len(patches)
    levels = np.full((count, 2), level), np.full((count, 4), level)
    made = Renderer(patches, device).capture(view_of(look), *levels)
    screen = Screen.of(patches, look, 1.0)
    own = screen.surface.only(made.patch)
    u, v = np.moveaxis(made.parameters.astype(np.longdouble), 2, 0)
    exact = own.at(u, v)
    half = np.array([0.5 * look.width, 0.5 * look.height])
    drawn = made.clip[..., :2] / made.clip[..., 3:].astype(np.longdouble) * half
    apart = np.abs(drawn - exact[..., :2] / exact[..., 3:]).max(axis=2)
    seen = np.all(np.abs(exact[..., :3]) <= screen.half[0] * exact[..., 3:], axis=2)
    found = np.zeros(count)
    np.maximum.at(found, np.broadcast_to(made.patch[:, None], seen.shape)[seen], apart[seen].astype(float))
    return found


@pytest.mark.gl
@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("kind", ["teapot", "torus", "gregory", "gregory-triangle", "far from the origin"])
def test_it_is_never_below_what_is_drawn(kind, view, device, teapot, rng):
    if kind == "torus":
        patches = scene_of(torus(1e4)).patches()
    elif kind.startswith("gregory"):
        patches = nets(kind, rng, (3, 3), np.full(8, 0.3))
        patches = GregoryPatches(patches.net * 5.0, patches.twists * 5.0)
    else:
        patches = teapot.patches()
    look = VIEWS[view]
    if kind == "far from the origin":
        away = np.array([3e6, -1e6, 2e5])
        patches, eye, target = patches + away, np.array(look.eye) + away, np.array(look.target) + away
        look = look._replace(eye=tuple(eye.tolist()), target=tuple(target.tolist()))
    bound, found = rounding_error(patches, view_of(look)), measured(patches, look, device)
    assert np.all(bound >= found)
    assert found.max() > 0.0
    if view != "beside":  # where W comes near 0 the largest error is over the smallest W
        assert bound.max() < 400 * found.max(), "not by orders of magnitude"


def test_flat_patches_in_the_middle_of_the_picture():
    found = rounding_error(FLAT, ABOVE)
    assert 1e-5 < found[0] < 2e-3
    assert rounding_error(np.repeat(FLAT, 1200, axis=0), ABOVE).tolist() == [found[0]] * 1200
    twice = View(ABOVE.camera, 2880, 1800)
    assert rounding_error(FLAT, twice)[0] == pytest.approx(2 * found[0])


def test_size_does_not_matter():
    camera = Camera.look_at((512.0, 512.0, 3072.0), (512.0, 512.0, 0.0), (0.0, 1.0, 0.0), near=102.4, far=1e5)
    large = rounding_error(1024.0 * FLAT, View(camera, 1440, 900))
    assert large[0] == pytest.approx(rounding_error(FLAT, ABOVE)[0])


def test_a_weight_for_all_changes_little():
    """W is rounded too, of rational patches."""
    rational = np.concatenate([3.0 * FLAT, np.full((1, 2, 2, 1), 3.0)], axis=3)
    plain = rounding_error(FLAT, ABOVE)[0]
    assert plain < rounding_error(rational, ABOVE)[0] < 4 * plain


def test_a_patch_in_a_large_scene_is_drawn_worse():
    scene = np.concatenate([FLAT, FLAT + [1e4, 0.0, 0.0]])
    found = rounding_error(scene, ABOVE)
    assert found[0] > 1000 * rounding_error(FLAT, ABOVE)[0]
    assert found[1] == 0.0, "it lies beside the picture"


def test_without_a_bound_on_w_there_is_none():
    near = Camera.look_at((0.5, 0.5, 1e-4), (0.5, 1.0, 0.0), (0.0, 0.0, 1.0), near=1e-12)
    scene = np.concatenate([FLAT, FLAT + [1e6, 0.0, 0.0]])
    assert rounding_error(scene, View(near, 1440, 900))[0] == np.inf


def test_of_no_view_and_no_patches():
    with pytest.raises(InputError, match="view"):
        rounding_error(FLAT, "front")  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="no patches"):
        rounding_error(FLAT[:0], ABOVE)


@pytest.mark.parametrize("degree", range(1, 25))
def test_roundings_of_a_sum_are_those_of_the_shader(degree):
    """The shader's sum with every rounding a factor of its own: no term of it has more of them than are counted."""

    def power(n):
        return max(0, n - 1)

    counted = []
    for j in range(degree + 1):
        binomial = 0 if degree <= 23 else 2 * min(j, degree - j)
        factor = power(j) + power(degree - j) + (0 < j < degree)
        polynomial = binomial + factor + (0 < j < degree)
        middle = degree % 2 == 0 and 2 * j == degree
        pairs = (degree + 1) // 2
        place = min(j, degree - j)
        later = 0 if middle else pairs - 1 - place  # sums that its pair is still added to
        adds = 1 if middle else 1 + (place > 0) + later + (degree % 2 == 0)
        counted.append(polynomial + 1 + adds)
    assert max(counted) <= rounding._of_sum(degree)


def test_binomials_are_made_of_whole_numbers_that_float32_holds():
    """Up to the degree where nothing is counted for them."""
    for n in range(rounding._WHOLE + 1):
        for k in range(n + 1):
            result = Fraction(1)
            for i in range(1, min(k, n - k) + 1):
                result *= n - i + 1
                assert result < 2**24
                result /= i
                assert result.denominator == 1


def test_twists_are_multiplied_by_less_than_is_counted():
    s, t = np.meshgrid(*2 * [np.linspace(0.0, 1.0, 401)])
    assert np.max(9 * s * t * ((1 - s) * (1 - t)) ** 2 / 2) <= rounding._TWIST_SIZE
    a, b = (1 - s) * (1 - t), (1 - s) * t
    assert np.max(6 * a * a * b * s) <= rounding._TWIST_SIZE


def test_notes(teapot):
    """Nothing where it is no more than a tenth of the tolerance; where it is more, what is claimed does not hold."""
    look = View(Camera.look_at((4.5, -6.0, 4.0), (0.0, 0.0, 1.2)), 1440, 900)
    bound = rounding_error(teapot.patches(), look)
    assert rounding_notes(teapot, look, 0.5) == ()
    (note,) = rounding_notes(teapot, look, 2.0 * bound.max())
    assert note == f"single precision adds up to {bound.max():.2g} px in {np.sum(bound > 0.2 * bound.max())} patches"
    (note,) = rounding_notes(teapot, look, 0.99 * bound.max())
    assert note.endswith(
        f"what is claimed does not hold in 1 of them, the first is patch {np.argmax(bound)} (counted from 0)"
    )
    inside = View(Camera.look_at((0.0, 0.0, 1e-3), (0.0, 1.0, 0.0), near=1e-9), 1440, 900)
    (note,) = rounding_notes(teapot, inside, 0.5)
    assert "adds more than can be told" in note


def test_a_command_says_what_it_adds(monkeypatch, capsys):
    monkeypatch.setattr(options, "_MUCH", 1e-9)
    found = run_json(capsys, "factors", "twisted-quad", "--size", "160x100", "--tiles", "1")
    assert any("single precision" in note for note in found["notes"])
    estimate = run_json(capsys, "factors", "twisted-quad", "--size", "160x100", "--method", "fixed")
    assert not any("single precision" in note for note in estimate["notes"]), "it claims nothing"
