"""Every control mesh of the folder of models: loads, converts, renders without a crack, keeps the tolerance."""

from __future__ import annotations

import numpy as np
import pytest

from slefejax import InputError, View, load, sampled_error, tessellation_factors, triangle_error
from slefejax.cameras import cameras_around
from slefejax.conversion.acc import acc_patches
from slefejax.conversion.tangents import tangent_tables
from slefejax.measure.error import SLIPPED, drawn_error, slip
from slefejax.tessellator.edges import edge_maxima
from slefejax.tessellator.levels import HIGHEST_LEVEL

pytestmark = pytest.mark.gl
MESHES = [
    *(f"catmark_{name}" for name in ("bishop", "car", "gregory_test2", "gregory_test8", "helmet", "lefthanded")),
    *(f"catmark_{name}" for name in ("nonquads", "pole64", "torus", "xord_boundary")),
    *("kenney_character_frame4", "kenney_character_frame9"),
    *("bigguy", "monsterfrog", "spot_control_mesh", "suzanne", "makehuman/base"),
]
GREGORY = ("suzanne", "catmark_gregory_test8", "catmark_pole64")  # pinched, n-gons, valence 64
SPLINES = ("usd_bendy_nurbs.usda", "rational_torus.bv", "teapot.bpt")
FLOOR = 1e-3  # pixels: what float32 on the device puts under the error of what is drawn


def open_triangle_edges(found, free):
    """Triangle edges that no other triangle runs along the other way, off the free edges of the surface.

    found : captured triangles; free : ``(patches, 4)``, edges at u=0, v=0, u=1, v=1 that no other patch has
    """
    start = found.clip.reshape(-1, 4)
    end = found.clip[:, [1, 2, 0]].reshape(-1, 4)
    _, number = np.unique(np.concatenate([start, end]) + np.float32(0), axis=0, return_inverse=True)
    a, b = number.reshape(2, -1)
    key = np.minimum(a, b) * (number.max() + 1) + np.maximum(a, b)
    _, edge = np.unique(key, return_inverse=True)
    balance = np.bincount(edge.ravel(), np.sign(b - a))
    u0, u1 = found.parameters.reshape(-1, 2), found.parameters[:, [1, 2, 0]].reshape(-1, 2)
    patch = np.repeat(found.patch, 3)
    lies_on = np.zeros(len(patch), bool)
    for side, (axis, value) in enumerate(((0, 0.0), (1, 0.0), (0, 1.0), (1, 1.0))):
        lies_on |= (u0[:, axis] == value) & (u1[:, axis] == value) & free[patch, side]
    return np.flatnonzero((balance[edge.ravel()] != 0) & ~lies_on)


def free_edges(scene):
    return np.bincount(scene.edge_numbers.ravel())[scene.edge_numbers] == 1


def check_view(scene, view, renderer):
    factors = tessellation_factors(scene.patches(), view, edge_numbers=scene.edge_numbers)
    inner, edges = factors.inner, factors.edges
    assert np.max(inner, initial=1) <= HIGHEST_LEVEL
    seen = renderer.draw(view, inner, edges)
    found = renderer.capture(view, inner, edges)
    error = drawn_error(scene.patches(), view, seen)
    assert np.count_nonzero(np.isfinite(error)) > 100
    assert np.nanmax(error) <= 0.5 + FLOOR
    assert np.count_nonzero(slip(seen) > SLIPPED) < 50
    if np.all(np.asarray(factors.factor) > 0):  # else the surface ends where patches are left out
        assert not open_triangle_edges(found, free_edges(scene)).size
    assert triangle_error(scene.patches(), found, view).max() <= 0.5
    assert sampled_error(scene.patches(), factors.levels, view).max() <= 0.5


@pytest.mark.parametrize(
    ("name", "scheme"),
    [
        *((name, "auto") for name in MESHES),
        *((name, "gregory") for name in GREGORY),
        *(pytest.param(name, "gregory", marks=pytest.mark.slow) for name in MESHES if name not in GREGORY),
    ],
)
def test_meshes_draw_without_a_crack(models, device, name, scheme, rng):
    """Neighbours cut differently, edges at the larger level: the tessellator's triangles fit together bit for bit."""
    from slefejax.gpu import Renderer

    scene = load(models / f"{name}.obj", scheme=scheme)
    numbers = rng.integers(1, 10 if len(scene.patches()) < 5000 else 4, len(scene.patches()))
    renderer = Renderer(scene.patches(), device)
    view = View(scene.default_camera(), 480, 300)
    found = renderer.capture(view, np.repeat(numbers[:, None], 2, axis=1), edge_maxima(numbers, scene.edge_numbers))
    assert not open_triangle_edges(found, free_edges(scene)).size
    renderer.release()


@pytest.mark.slow
def test_the_certified_factor_holds_on_a_mesh(models, device):
    """One view of a small mesh with boundaries of valence 3 to 7; all of them are among the slow tests."""
    from slefejax.gpu import Renderer

    scene = load(models / "catmark_xord_boundary.obj")
    check_view(scene, View(scene.default_camera(), 480, 300), Renderer(scene.patches(), device))


def test_cracks_would_be_found(models, device):
    from slefejax.gpu import Renderer

    scene = load(models / "catmark_torus.obj")
    renderer = Renderer(scene.patches(), device)
    view = View(scene.default_camera(), 480, 300)
    levels = np.full((32, 6), 5)
    free = np.zeros((32, 4), bool)
    found = renderer.capture(view, levels[:, :2], levels[:, 2:])
    assert not open_triangle_edges(found, free).size
    levels[3, 2:] = 6
    found = renderer.capture(view, levels[:, :2], levels[:, 2:])
    assert open_triangle_edges(found, free).size
    renderer.release()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options"),
    [
        *(pytest.param(f"{name}.obj", {}, id=name) for name in MESHES),
        *(pytest.param(name, {}, id=name) for name in SPLINES),
        *(pytest.param(f"{name}.obj", {"scheme": "gregory"}, id=f"{name}-gregory") for name in MESHES),
    ],
)
def test_the_certified_factor_holds_on_every_model(models, device, name, options):
    """Twenty cameras: pixels, captured triangles, uniform grids over the visible domain, and cracks."""
    from slefejax.gpu import Renderer

    scene = load(models / name, **options)
    renderer = Renderer(scene.patches(), device)
    for view in cameras_around(scene, 1440, 900, 20 if len(scene.patches()) < 5000 else 2, 3):
        check_view(scene, view, renderer)
    renderer.release()


def test_what_is_not_manifold_is_refused_with_its_number(models):
    path = models / "catmark_nonman_verts.obj"
    with pytest.raises(InputError, match="at vertex 1 2 fans of faces only touch, which is not manifold, and 3 more"):
        load(path)
    scene = load(path, drop_defects=True)
    assert len(scene.patches()) == 12
    assert "8 faces were dropped (2, 5, 6, 11, …)" in scene.notes[0]


@pytest.mark.parametrize("name", MESHES)
def test_tables_of_real_meshes(models, name):
    """Affine combinations; narrow classes; as many shared edges as the mesh has inner ones."""
    scene = load(models / f"{name}.obj")
    assert scene.conversion is not None
    table = scene.conversion.patchwork.points
    np.testing.assert_allclose(table.row_sums(), 1.0, atol=2e-15)
    assert table.padding < 0.15  # the smallest mesh has 9 vertices and 15 sizes of rows
    uses = np.bincount(scene.edge_numbers.ravel())
    assert np.count_nonzero(uses == 2) == np.count_nonzero(~scene.conversion.finer.boundary)
    assert scene.faces is not None
    assert np.array_equal(np.unique(scene.faces), np.arange(scene.conversion.mesh.face_count))


def test_normals_agree_on_a_real_mesh(models):
    """Of tangent patches at 5 places along every inner edge of the frog, valences 3 to 7."""
    mesh = load(models / "monsterfrog.obj").conversion.mesh  # type: ignore[union-attr]
    from slefejax.geometry.bezier import evaluate_patch

    work = acc_patches(mesh)
    du, dv = (table.on_host(mesh.vertices) for table in tangent_tables(mesh, work))
    du, dv = (
        np.moveaxis(du.reshape(-1, 3, 4, 3), 0, -1)[..., None],
        np.moveaxis(dv.reshape(-1, 4, 3, 3), 0, -1)[..., None],
    )
    t = np.linspace(0, 1, 5)
    zero, one = 0 * t, 0 * t + 1
    sides = []
    for u, v in ((t, zero), (one, t), (1 - t, one), (zero, 1 - t)):
        a, b = (np.moveaxis(evaluate_patch(field, u, v), 0, -1) for field in (du, dv))
        normal = np.cross(a, b)
        sides.append(normal / np.linalg.norm(normal, axis=-1, keepdims=True))
    normals = np.stack(sides, axis=1).reshape(-1, 5, 3)  # one row a half-edge
    difference = np.abs(normals - normals[mesh.twin][:, ::-1])
    assert difference.max() < 1e-9  # the shortest tangents are 1e-3 of the longest
