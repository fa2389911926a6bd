"""The assertions that users get: they pass where they should, and their messages name the worst offender."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from slefejax import Camera, View, slefe, slefe_boxes
from slefejax.geometry.bezier import evaluate_curve, evaluate_patch
from slefejax.testing import assert_encloses, assert_pixel_accurate

CURVE = np.array([0.0, -1.0, 1.0, 0.0])


def test_enclosures_of_curves_and_patches_pass(rng):
    assert_encloses(*slefe(CURVE, 3), lambda t: evaluate_curve(CURVE, t))
    many = rng.normal(size=(5, 2, 3))
    assert_encloses(*slefe(many, 4, axis=0), lambda t: evaluate_curve(many, t))
    patch = rng.normal(size=(4, 4, 3))
    boxes = slefe_boxes(patch[None], (2, 3))
    assert_encloses(boxes.lower[0], boxes.upper[0], lambda u, v: evaluate_patch(patch, u, v), parameters=2, samples=21)


def test_worst_offender_is_named():
    lower, upper = slefe(CURVE, 3)
    with pytest.raises(AssertionError, match=r"value -?0[.\d]* at \([.\d]+\) lies 0\.\d+ above upper"):
        assert_encloses(lower, np.asarray(upper) - 0.2, lambda t: evaluate_curve(CURVE, t))
    with pytest.raises(AssertionError, match=r"entry \(1,\) lies 1 below lower"):
        assert_encloses(np.ones((2, 2)), np.ones((2, 2)), lambda t: np.array([1.0, 0.0]))
    with pytest.raises(AssertionError, match="not enclosed"):
        assert_encloses(lower, upper, lambda t: np.nan)
    with pytest.raises(AssertionError, match="shape"):
        assert_encloses(np.ones(3), np.ones(4), lambda t: 1.0)
    assert_encloses(lower, np.asarray(upper) - 0.2, lambda t: evaluate_curve(CURVE, t), slack=0.2)


def test_pixels():
    square = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], float)[None]
    view = View(Camera.orthographic((0.5, 0.5, 5), (0.5, 0.5, 0), up=(0, 1, 0), height=1.0), 4, 4)
    u, v = np.meshgrid((np.arange(4) + 0.5) / 4, (np.arange(4) + 0.5) / 4)
    seen = SimpleNamespace(u=u, v=v, patch=np.zeros((4, 4), int))
    assert_pixel_accurate(square, view, seen)
    u[2, 1] += 0.2
    with pytest.raises(
        AssertionError, match=r"1 of 16 .* worst is pixel \(1, 2\), 0\.8 px off, from patch 0 at u = 0\.575"
    ):
        assert_pixel_accurate(square, view, seen)
    assert_pixel_accurate(square, view, seen, share=0.1)
    assert_pixel_accurate(square, view, seen, tolerance=0.9)
    seen.drawn = np.zeros((4, 4, 2))
    seen.drawn[2, 1] = 0.8, 0
    assert_pixel_accurate(square, view, seen)
    with pytest.raises(AssertionError, match="empty"):
        assert_pixel_accurate(square, view, SimpleNamespace(u=u, v=v, patch=np.full((4, 4), -1)))
