"""Normals of tangent patches as they are drawn: T_u x T_v, which agrees along the edges where the surface's jumps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import slefejax.gpu.sent
from slefejax import Camera, InputError, View, convert, load, normal_error
from slefejax.conversion.gaussian.published import published
from slefejax.geometry.bezier import derivative, evaluate_patch
from slefejax.geometry.gregory import GregoryPatches
from slefejax.geometry.normals import TangentNets, collapsed_sides, crossed, still_sides, without_collapsed
from slefejax.gpu.renderer import Renderer
from slefejax.measure.jumps import normal_jumps
from tests.meshes import cube, disc, grid, triangle_fan
from tests.test_gaussian import torus
from tests.test_normals import REDUCED, VIEW, apart, degrees, levels, with_points

pytestmark = pytest.mark.gl

JUMP = 1e-4  # degrees, across edges: single precision has some tenth of it
RATIONAL = r"is for polynomial Bézier patches: rational and Gregory patches and nested nets have normals='surface'"


def with_tangents(mesh, scheme="acc"):
    """Conversion, patches and tangents of a mesh."""
    conversion = convert(mesh, scheme)
    own = np.asarray(conversion.patchwork.on_host(mesh.vertices))
    return conversion, own, tuple(np.asarray(net) for net in conversion.tangents(mesh.vertices))


def own_tangents(patches):
    """The derivatives of polynomial patches, as tangent patches."""
    along_u, along_v = derivative(np.moveaxis(patches, 0, -1)), derivative(np.moveaxis(patches, (0, 2), (-1, 0)))
    return np.moveaxis(along_u, -1, 0), np.moveaxis(along_v, (-1, 0), (0, 2))


def captured(device, patches, level, tangents, view=VIEW) -> Any:
    renderer = Renderer(patches, device, normals="surface" if tangents is None else "tangents", tangents=tangents)
    found = renderer.capture(view, *levels(len(patches), level))
    renderer.release()
    return found


def vertices(found):
    u, v = found.parameters.reshape(-1, 2).T.astype(float)
    return np.repeat(found.patch, 3), u, v, found.normal.reshape(-1, 3).astype(float)


def tangent_normals(tangents, patch, u, v):
    """Over the distances from sides along which tangents are 0, as polynomials."""
    net = crossed(*(np.moveaxis(own, 0, -1) for own in tangents))
    net = without_collapsed(net, still_sides(TangentNets(*tangents)).T)
    return evaluate_patch(net[..., patch], u, v).T


def jumps(found, level, sides):
    """Degrees between the normals of both sides of edges, at all their vertices."""
    patch, u, v, normal = vertices(found)
    along = np.full((patch.max() + 1, 4, level + 1, 3), np.nan)
    for side, (t, on) in enumerate([(v, u == 0), (u, v == 0), (v, u == 1), (u, v == 1)]):
        along[patch[on], side, np.rint(t[on] * level).astype(int)] = normal[on]
    one, other = (along[patch, side] for patch, side in sides.transpose(1, 2, 0))
    # parameters run along the half-edges of v=0 and u=1 and against the others, and half-edges against each other
    forwards = np.isin(sides[..., 1], (1, 2))
    other = np.where((forwards[:, 0] == forwards[:, 1])[:, None, None], other[:, ::-1], other)
    return degrees(one.reshape(-1, 3), other.reshape(-1, 3))


def between_quads(mesh, sides):
    """Of edges those where tangents promise to agree: no vertex touches a triangle or has valence 2."""
    touched = np.zeros(mesh.vertex_count, bool)
    touched[mesh.corners[mesh.sizes[mesh.face] != 4]] = True
    odd = touched | (mesh.valence == 2)
    face, side = sides[:, 0].T
    first = mesh.offsets[face] + np.array([3, 0, 1, 2])[side]
    return sides[(mesh.sizes[face] == 4) & ~odd[mesh.corners[first]] & ~odd[mesh.ends[first]]]


@pytest.mark.parametrize("mesh", [cube(), disc(5, rng=np.random.default_rng(4)), disc(7, rng=np.random.default_rng(5))])
def test_normals_of_tangents_agree_along_edges(device, mesh):
    conversion, patches, tangents = with_tangents(mesh)
    sides = between_quads(mesh, conversion.smooth_sides)
    assert len(sides) > 5
    found = captured(device, patches, 8, tangents)
    assert apart(vertices(found)[0], vertices(found)[3], tangent_normals(tangents, *vertices(found)[:3])) < REDUCED
    assert jumps(found, 8, sides).max() < JUMP
    assert jumps(captured(device, patches, 8, None), 8, sides).max() > 1.0
    assert normal_jumps(patches, sides, tangents).max() < 1e-9, "exactly"


@pytest.mark.parametrize("name", ["bigguy", "spot_control_mesh", "monsterfrog"])
def test_normals_of_tangents_agree_along_edges_of_models(device, models, name):
    scene: Any = load(models / f"{name}.obj")
    sides = between_quads(scene.conversion.finer, scene.conversion.smooth_sides)
    assert len(sides) > 1400
    view = View(scene.default_camera(), 240, 150)
    assert jumps(captured(device, scene.patches(), 4, scene.tangents(), view), 4, sides).max() < JUMP
    assert jumps(captured(device, scene.patches(), 4, None, view), 4, sides).max() > 20.0


def test_tangents_beside_triangles(device):
    """They are the patch's own: at the points of pinched triangles normals are the surface's."""
    mesh = triangle_fan(5, np.random.default_rng(4))
    _, patches, tangents = with_tangents(mesh, "pinched")
    assert np.array_equal(still_sides(TangentNets(*tangents)), collapsed_sides(patches))
    assert still_sides(TangentNets(*tangents)).any()
    patch, u, v, normal = vertices(captured(device, patches, 6, tangents))
    assert apart(patch, normal, tangent_normals(tangents, patch, u, v)) < REDUCED
    points = collapsed_sides(patches)[patch, 2] & (u == 1)
    surface = vertices(captured(device, patches, 6, None))
    assert degrees(normal[points], surface[3][points]).max() < 0.01


@pytest.mark.parametrize("shape", [(2, 2, 3), (3, 5, 3)])
@pytest.mark.parametrize("sides", [(), (0, 2), (3,)])
def test_derivatives_as_tangents_are_the_surface(device, rng, shape, sides):
    """Of any degrees, at sides that are points too, but for single precision, and in the scene's units."""
    patches = 1e3 * with_points(rng, shape, sides) + 5e4
    patch, *_, normal = vertices(captured(device, patches, 7, own_tangents(patches)))
    surface = vertices(captured(device, patches, 7, None))[3]
    if np.any(surface):
        assert apart(patch, normal, surface) < REDUCED
        assert np.abs(normal).max() < 1e3


def test_errors_of_tangents_fall_with_the_square_of_the_level(device):
    _, patches, tangents = with_tangents(disc(5, rng=np.random.default_rng(4)))
    view = View(Camera.look_at((1.0, -6.0, 9.0), (0.0, 0.0, 0.0)), 240, 150)
    found = []
    for level in (16, 64):
        renderer = Renderer(patches, device, normals="tangents", tangents=tangents)
        seen = renderer.draw(view, *levels(len(patches), level))
        renderer.release()
        found.append(normal_error(patches, view, seen, "tangents", tangents))
    there = ~np.isnan(found[0]) & ~np.isnan(found[1])
    assert there.sum() > 2000
    assert np.median(found[0][there]) / np.median(found[1][there]) == pytest.approx(16.0, rel=0.15)
    assert found[1][there].max() < 0.3
    assert np.nanmax(normal_error(patches, view, seen)) > 5.0, "the surface's are others"


def test_pictures_are_the_same_with_tangents(device):
    _, patches, tangents = with_tangents(cube())
    pictures = []
    for options in ({}, {"normals": "tangents", "tangents": tangents}):
        renderer = Renderer(patches, device, **options)
        pictures.append(renderer.draw(VIEW, *levels(6, 9)))
        renderer.release()
    for name in ("u", "v", "patch", "depth", "drawn"):
        assert np.array_equal(*(getattr(seen, name) for seen in pictures)), name


def test_tangents_move_with_the_patches(device, monkeypatch):
    _, patches, tangents = with_tangents(grid(5, 5, rng=np.random.default_rng(4)))
    moved = tangents[0].copy(), tangents[1]
    moved[0][3] *= -2.0
    renderer = Renderer(patches, device, normals="tangents", tangents=tangents)
    written = []
    write = slefejax.gpu.sent.runs
    monkeypatch.setattr(slefejax.gpu.sent, "runs", lambda changed: written.append(changed.sum()) or write(changed))
    renderer.move(patches, moved)
    assert (renderer.moved, written) == (0, [0, 0, 1]), "control points, sides that are points, tangents"
    found = vertices(renderer.capture(VIEW, *levels(16, 4)))
    assert apart(found[0], found[3], tangent_normals(moved, *found[:3])) < REDUCED
    with pytest.raises(InputError, match="needs tangents=, a pair of nets such as"):
        renderer.move(patches)
    renderer.release()
    plain = Renderer(patches, device)
    with pytest.raises(InputError, match="tangents= is for normals='tangents'"):
        plain.move(patches, tangents)
    plain.release()


def test_sides_become_points_as_patches_move(device, rng):
    whole, pointed = with_points(rng, (4, 4, 3), ()), with_points(rng, (4, 4, 3), (1,))
    renderer = Renderer(whole, device, normals=True)
    renderer.move(pointed)
    found = vertices(renderer.capture(VIEW, *levels(3, 4)))
    renderer.release()
    assert np.array_equal(np.sort(found[3], axis=0), np.sort(vertices(captured(device, pointed, 4, None))[3], axis=0))


@pytest.mark.parametrize(
    ("tangents", "said"),
    [
        (None, "needs tangents=, a pair of nets such as scene"),
        (np.zeros((6, 3, 4, 3)), "must be a pair of nets"),
        ((np.zeros((6, 3, 4, 3)),) * 2, r"must have shapes \(6, 3, 4, 3\) and \(6, 4, 3, 3\), not \(6, 3, 4, 3\) and"),
        ((np.zeros((5, 3, 4, 3)), np.zeros((5, 4, 3, 3))), r"of patches \(6, 4, 4, 3\) must have shapes"),
        ((np.full((6, 3, 4, 3), np.nan), np.zeros((6, 4, 3, 3))), r"patch 0 \(counted from 0\) has tangents that are"),
    ],
)
def test_wrong_tangents(device, tangents, said):
    _, patches, _ = with_tangents(cube())
    with pytest.raises(InputError, match=said):
        Renderer(patches, device, normals="tangents", tangents=tangents)
    renderer = Renderer(patches, device, normals=True)
    seen = renderer.draw(VIEW, *levels(len(patches), 2))
    renderer.release()
    with pytest.raises(InputError, match=said):
        normal_error(patches, VIEW, seen, "tangents", tangents)


def test_patches_without_tangents(device, rng):
    tangents = np.zeros((3, 3, 4, 3)), np.zeros((3, 4, 3, 3))
    others = with_points(rng, (4, 4, 4), ()), GregoryPatches(np.zeros((3, 4, 4, 3)), np.zeros((3, 4, 3)))
    for patches in (*others, published(torus(20.0)).nets):
        with pytest.raises(InputError, match=RATIONAL):
            Renderer(patches, device, normals="tangents", tangents=tangents)
    with pytest.raises(InputError, match=r"there is no kind of normals 'tangent' \(did you mean tangents\?\)"):
        Renderer(np.zeros((3, 4, 4, 3)), device, normals="tangent", tangents=tangents)
    with pytest.raises(InputError, match="with others there is nothing to use them for"):
        Renderer(np.zeros((3, 4, 4, 3)), device, normals=True, tangents=tangents)
