from __future__ import annotations

import sys
from types import SimpleNamespace as Buffer

import numpy as np
import pytest

from slefejax import InputError, View, tessellation_factors
from slefejax.measure.covering import covering_error


def plain(height=8, width=10, k=2):
    """A picture of patch 0 at depth .5 everywhere, and its reference."""
    seen = Buffer(patch=np.zeros((height, width), int), depth=np.full((height, width), 0.5))
    fine = Buffer(patch=np.zeros((k * height, k * width), int), depth=np.full((k * height, k * width), 0.5))
    return seen, fine


def test_the_same_is_right():
    for k in (2, 3, 4):
        found = covering_error(*plain(k=k))
        assert not found.wrong.any()
        assert found.covered.all()
        assert not found.silhouette.any()


def test_wrong_patch_and_wrong_depth_are_told_apart():
    seen, fine = plain()
    seen.patch[2, 3] = 7
    seen.depth[5, 5] = 0.6
    seen.patch[6, 1:4] = -1
    seen.depth[6, 1:4] = 1.0
    found = covering_error(seen, fine)
    assert np.argwhere(found.wrong_patch).tolist() == [[2, 3], [6, 1], [6, 2], [6, 3]]
    assert np.argwhere(found.wrong_depth).tolist() == [[5, 5]]
    assert found.regions(found.wrong).tolist() == [3, 1, 1]
    assert found.summary()["largest_wrong_region_px"] == 3
    assert found.summary()["share_wrong_patch_inside"] == pytest.approx(4 / 80)


def test_any_sample_in_the_pixel_will_do():
    seen, fine = plain()
    fine.patch[4, 6] = 3
    seen.patch[2, 3] = 3
    assert not covering_error(seen, fine).wrong.any()


def test_silhouettes_are_apart():
    seen, fine = plain()
    fine.patch[:, 10:], fine.depth[:, 10:] = -1, 1.0
    seen.patch[:, 5:], seen.depth[:, 5:] = -1, 1.0
    seen.patch[3, 5], seen.depth[3, 5] = 0, 0.5
    found = covering_error(seen, fine)
    assert found.wrong_patch[3, 5]
    assert found.silhouette[3, 5]
    assert found.summary()["share_wrong_patch_inside"] == 0.0
    assert found.summary()["share_wrong_silhouette"] == pytest.approx(1 / 40)
    assert not found.silhouette[:, 0].any()


def test_bad_sizes():
    seen, fine = plain()
    with pytest.raises(InputError, match="k >= 2"):
        covering_error(seen, seen)
    with pytest.raises(InputError, match="no such multiple"):
        covering_error(seen, Buffer(patch=fine.patch[:, :-1], depth=fine.depth[:, :-1]))


@pytest.mark.gl
def test_teapot_gets_better_with_factors(device, teapot):
    from slefejax.gpu import Renderer

    small, large = (View(teapot.default_camera(), 360 * k, 225 * k) for k in (1, 2))
    renderer = Renderer(teapot.patches(), device)
    finest = np.full((32, 6), 64)
    reference = renderer.draw(large, finest[:, :2], finest[:, 2:])
    factors = tessellation_factors(teapot.patches(), small, "slefe")
    wrong = []
    for scale in (0.15, 0.4, 1.0):
        scaled = factors.scaled(scale)
        found = covering_error(renderer.draw(small, scaled.inner, scaled.edges), reference).summary()
        wrong.append(found["share_wrong_silhouette"] + found["share_wrong_patch_inside"])
    assert wrong == sorted(wrong, reverse=True)
    assert wrong[0] > 0.01
    assert wrong[-1] < 0.003


def test_a_missing_library_is_one_sentence(monkeypatch):
    monkeypatch.setitem(sys.modules, "skimage", None)
    with pytest.raises(InputError, match=r"install scikit-image \(pip install 'slefejax\[app\]'\)"):
        covering_error(*plain())
