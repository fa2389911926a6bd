"""Wrong arguments of every public function: one sentence, an InputError, whatever is given."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from jaxtyping import TypeCheckError

import slefejax as sj
from slefejax.gpu import Renderer

PATCHES = np.random.default_rng(1).normal(size=(3, 4, 4, 3))
CAMERA = sj.Camera.look_at((0, -9, 2), (0, 0, 0))
VIEW = sj.View(CAMERA, 160, 100)
LEVELS = np.full(3, 4)
TRIANGLES = type("T", (), {"patch": np.zeros(1, int), "parameters": np.array([[[0, 0], [1, 0], [0, 1]]], np.float32)})
NEEDED = np.exp(np.random.default_rng(2).normal(2.0, 0.3, 60))
SAMPLES = sj.Samples(
    np.repeat([0, 1, 2], 20), np.zeros(60, int), np.ceil(NEEDED).astype(int), NEEDED, {"slefe 3": NEEDED**2}, 0.5
)
MESH = sj.Mesh.of(np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float), [[0, 1, 2, 3]])

CALLS: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "slefe_table": (sj.slefe_table, {"degree": 3, "segments": 3}),
    "slefe": (sj.slefe, {"coefficients": PATCHES, "segments": 3, "axis": 1}),
    "slefe_boxes": (sj.slefe_boxes, {"patches": PATCHES, "segments": 2}),
    "slefe_tiles": (sj.slefe_tiles, {"patches": PATCHES, "segments": 2}),
    "bspline_slefe": (sj.bspline_slefe, {"coefficients": PATCHES, "degree": 2, "segments": 2, "axis": 1}),
    "bspline_slefe_boxes": (sj.bspline_slefe_boxes, {"net": PATCHES[0], "degree": 2, "segments": 2}),
    "Camera.look_at": (
        sj.Camera.look_at,
        {"eye": (0, -9, 2), "target": (0, 0, 0), "up": (0, 0, 1), "fov_y": 45.0, "near": 0.1, "far": 100.0},
    ),
    "Camera.orthographic": (
        sj.Camera.orthographic,
        {"eye": (0, -9, 2), "target": (0, 0, 0), "up": (0, 0, 1), "height": 2.0, "near": 0.1, "far": 100.0},
    ),
    "View": (sj.View, {"camera": CAMERA, "width": 160, "height": 100}),
    "tessellation_factors": (
        sj.tessellation_factors,
        {"patches": PATCHES, "view": VIEW, "method": "slefe", "segments": 3, "tolerance": 0.5, "k": 1.0}
        | {"depth_tolerance": 0.1, "smooth": None},
    ),
    "certified": (
        sj.tessellation_factors,
        {"patches": PATCHES, "view": VIEW, "tiles": 2, "tolerance": 0.5, "depth_tolerance": 0.1, "smooth": None}
        | {"anisotropic": False, "verify": False, "setting": None, "pattern": None, "edge_numbers": None},
    ),
    "screen_widths": (sj.screen_widths, {"patches": PATCHES, "view": VIEW, "segments": 3, "smooth": 0.01}),
    "screen_twists": (sj.screen_twists, {"patches": PATCHES, "view": VIEW}),
    "sampled_error": (sj.sampled_error, {"patches": PATCHES, "factors": LEVELS, "view": VIEW}),
    "worst_points": (sj.worst_points, {"patches": PATCHES, "factors": LEVELS, "view": VIEW}),
    "triangle_error": (sj.triangle_error, {"patches": PATCHES, "triangles": TRIANGLES, "view": VIEW}),
    "sampled_normal_error": (
        sj.sampled_normal_error,
        {"patches": PATCHES, "factors": LEVELS, "view": VIEW, "normals": "surface", "tangents": None},
    ),
    "worst_normal_points": (
        sj.worst_normal_points,
        {"patches": PATCHES, "factors": LEVELS, "view": VIEW, "normals": "tangents"}
        | {"tangents": (PATCHES[:, 1:], PATCHES[:, :, 1:])},
    ),
    "triangle_normal_error": (
        sj.triangle_normal_error,
        {"patches": PATCHES, "triangles": TRIANGLES, "view": VIEW, "normals": "surface"},
    ),
    "minimal_factors": (
        sj.minimal_factors,
        {"patches": 0.01 * PATCHES, "view": VIEW, "tolerance": 0.5, "normal_tolerance": None, "limit": 64},
    ),
    "minimal_pairs": (sj.minimal_pairs, {"patches": 0.01 * PATCHES, "view": VIEW, "tolerance": 0.5, "limit": 64}),
    "with_pieces": (
        sj.with_pieces,
        {"inner": np.full((3, 2), 70), "outer": np.full((3, 4), 70), "numbers": np.arange(12).reshape(3, 4)},
    ),
    "triangle_counts": (
        sj.triangle_counts,
        {"inner": np.full((3, 2), 4), "outer": np.full((3, 4), 4), "spacing": "equal"},
    ),
    "evaluate_patches": (sj.evaluate_patches, {"patches": PATCHES, "parameters": np.full((5, 2), 0.5)}),
    "cameras_around": (
        sj.cameras_around,
        {"scene": sj.load("steep-patch"), "width": 160, "height": 100, "count": 3, "seed": 1},
    ),
    "fit_km": (sj.fit_km, {"samples": SAMPLES, "segments": 3, "target": 0.9, "estimator": "quantile", "more": ()}),
    "bootstrap_km": (sj.bootstrap_km, {"samples": SAMPLES, "segments": 3, "target": 0.9}),
    "curve_constant": (sj.curve_constant, {"degree": 3, "segments": 2}),
    "surface_distance": (sj.surface_distance, {"patches": PATCHES, "given": PATCHES, "places": 3}),
    "side_turns": (sj.side_turns, {"patches": PATCHES, "given": PATCHES}),
    "edge_turns": (sj.edge_turns, {"patches": PATCHES, "edge_numbers": np.arange(12).reshape(3, 4)}),
    "convert": (sj.convert, {"mesh": MESH, "scheme": "acc", "alpha": 2.5, "steps": None}),
    "Mesh.of": (sj.Mesh.of, {"vertices": MESH.vertices, "faces": [[0, 1, 2, 3]]}),
    "load": (sj.load, {"path": "teapot"}),
    "save": (sj.save, {"scene": None, "path": None}),
    "Session": (sj.Session, {"scene": sj.load("steep-patch"), "dtype": None}),
    "tolerance_for_budget": (sj.tolerance_for_budget, {"patches": PATCHES, "view": VIEW, "triangles": 100}),
    "measure_factors": (
        sj.measure_factors,
        {"patches": 0.01 * PATCHES, "views": [VIEW], "segments": (3,), "tolerance": 0.5},
    ),
}
NASTY: list[Any] = [
    *(None, "text", b"bytes", True, -1, 0, 1.5, float("nan"), float("inf"), -(10**30), 1e308, 3 + 4j, object()),
    *([], {}, (1, 2), [[1], [2, 3]], [None], ["a"], np.zeros(0), np.float64(2.5), np.zeros(3)),
    *(np.zeros((0, 4, 4, 3)), np.zeros((3, 1, 4, 3)), np.zeros((3, 4, 4, 7)), np.zeros((4, 4, 3))),
    *(np.full((3, 4, 4, 3), np.nan), np.full((3, 4, 4, 3), np.inf), np.full((3, 4, 4, 3), 1e300)),
    *(np.zeros((3, 4, 4, 3), object), np.zeros((3, 4, 4, 3), complex), np.zeros((3, 4, 4, 3), "U4")),
    *(np.zeros((3, 4, 4, 3), bool), np.zeros((3, 4, 4, 3), np.int8), np.full((3, 4, 4, 4), -1.0)),
    *(np.array(["2026-01-01"], "datetime64[D]"), np.full(3, -1), np.full((3, 2), 10**12), np.arange(12).reshape(3, 4)),
]


def outcome(function: Callable[..., Any], *values: Any, **named: Any) -> str:
    """What came of a call: fine, refused, or what was raised instead."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            function(*values, **named)
        except sj.InputError as error:
            return "refused" if len(str(error)) > 15 else f"says too little: {error}"
        except TypeCheckError:
            return "refused"  # not of the class that the signature names: a View, a Mesh, a path
        except Exception as error:
            return f"{type(error).__name__}: {error}"
    return "fine"


def check_all(name: str, nasty: list[Any]) -> None:
    """One argument wrong at a time, the others right."""
    function, good = CALLS[name]
    found = {
        f"{argument}={value!r}": outcome(function, **{**good, argument: value}) for argument in good for value in nasty
    }
    wrong = [f"{name}({call}): {what}" for call, what in found.items() if what not in ("fine", "refused")]
    assert not wrong, "\n".join(wrong)
    assert "refused" in found.values()


# a budget is met by many calls of another of these functions
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if n == "tolerance_for_budget" else n for n in CALLS]
)
def test_a_wrong_argument(name):
    """Some of them, others for every function."""
    check_all(name, NASTY[list(CALLS).index(name) % 6 :: 6])


@pytest.mark.slow
@pytest.mark.parametrize("name", CALLS)
def test_every_wrong_argument(name):
    check_all(name, NASTY)


# a budget is met by many calls of another of these functions
@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [n for n, (_, good) in CALLS.items() if "patches" in good and n != "tolerance_for_budget"]
)
def test_other_memory_layouts_and_types_give_the_same(name):
    """Not contiguous, read-only, Fortran's order, single precision, lists: taken as they are."""
    function, good = CALLS[name]
    patches = np.asarray(good["patches"])
    strided = np.zeros((*patches.shape[:3], 6))[..., ::2]
    strided[...] = patches
    frozen = patches.copy()
    frozen.flags.writeable = False
    wanted = function(**good)
    for other in (strided, frozen, np.asfortranarray(patches), patches.astype(">f8"), patches.tolist()):
        found = function(**{**good, "patches": other})
        for one, two in zip(*(np.atleast_1d(_numbers(x)) for x in (wanted, found)), strict=True):
            np.testing.assert_array_equal(one, two)


def _numbers(found: Any) -> Any:
    if isinstance(found, sj.Factors):
        return np.asarray(found.factor)
    if isinstance(found, sj.Samples):
        return found.needed
    if isinstance(found, sj.Budget):
        return np.asarray(found.factors.factor)
    return np.stack([np.asarray(part, float) for part in found]) if isinstance(found, tuple) else np.asarray(found)


@pytest.mark.gl
def test_wrong_arguments_of_the_renderer(device):
    good = {"view": VIEW, "inner": np.full((3, 2), 4), "outer": np.full((3, 4), 4)}
    renderer = Renderer(PATCHES, device)
    for value in NASTY:
        found = [outcome(renderer.draw, **{**good, argument: value}) for argument in good]
        found += [outcome(Renderer, value, device), outcome(renderer.move, value)]
        assert set(found) <= {"fine", "refused"}, (value, found)
