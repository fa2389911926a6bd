"""Rigs of USD files, against usd-core's own skinning."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from slefejax import InputError, dual_quaternion_blend, load
from tests.test_io import write

pytest.importorskip("pxr", reason="usd-core is not installed")

ARM = """#usda 1.0
(
    timeCodesPerSecond = 30
)
def SkelRoot "actor"
{
    double3 xformOp:translate = (5, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Skeleton "bones" (prepend apiSchemas = ["SkelBindingAPI"])
    {
        uniform token[] joints = ["upper", "upper/lower"]
        uniform matrix4d[] bindTransforms = [
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)),
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (2, 0, 0, 1))]
        uniform matrix4d[] restTransforms = [
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)),
            ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (2, 0, 0, 1))]
        rel skel:animationSource = </actor/bones/walk>
        def SkelAnimation "walk"
        {
            uniform token[] joints = ["upper/lower"]
            quatf[] rotations.timeSamples = {0: [(1, 0, 0, 0)], 10: [(0.7071067811865476, 0, 0, 0.7071067811865476)]}
            half3[] scales = [(1, 1, 1)]
            float3[] translations.timeSamples = {0: [(2, 0, 0)], 10: [(2, 0, 1)]}
            uniform token[] blendShapes = ["wide"]
            float[] blendShapeWeights.timeSamples = {0: [0], 10: [1]}
        }
    }
    def Mesh "skin" (prepend apiSchemas = ["SkelBindingAPI"])
    {
        int[] faceVertexCounts = [4, 4]
        int[] faceVertexIndices = [0, 1, 2, 3, 1, 4, 5, 2]
        point3f[] points = [(0, -1, 0), (2, -1, 0), (2, 1, 0), (0, 1, 0), (4, -1, 0), (4, 1, 0)]
        int[] primvars:skel:jointIndices = [0, 0, 0, 1, 0, 1, 0, 0, 1, 1, 1, 1] (
            elementSize = 2
            interpolation = "vertex"
        )
        float[] primvars:skel:jointWeights = [1, 0, 0.5, 0.5, 0.5, 0.5, 1, 0, 1, 0, 1, 0] (
            elementSize = 2
            interpolation = "vertex"
        )
        matrix4d primvars:skel:geomBindTransform = ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
        rel skel:skeleton = </actor/bones>
        uniform token[] skel:blendShapes = ["wide"]
        rel skel:blendShapeTargets = </actor/skin/wide>
        def BlendShape "wide"
        {
            uniform vector3f[] offsets = [(0, 1, 0)] (
            )
            uniform vector3f[] inbetweens:half = [(0, 0, 2)] (
                weight = 0.5
            )
            uniform int[] pointIndices = [5]
        }
    }
    def Mesh "still"
    {
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(0, 5, 0), (1, 5, 0), (1, 6, 0), (0, 6, 0)]
    }
}
"""


def baked(path, times):
    """Points of all meshes at the times, in the coordinates of the stage, as usd-core's skinning makes them."""
    from pxr import Gf, Usd, UsdGeom, UsdSkel  # type: ignore[attr-defined]

    stage = Usd.Stage.Open(str(path))  # type: ignore[attr-defined]
    for prim in stage.Traverse():
        if prim.IsA(UsdSkel.Root):  # type: ignore[attr-defined]
            UsdSkel.BakeSkinning(UsdSkel.Root(prim), Gf.Interval.GetFullInterval())  # type: ignore[attr-defined]
    for time in times:
        places = UsdGeom.XformCache(time)  # type: ignore[attr-defined]
        points = []
        for prim in stage.Traverse():
            if prim.IsA(UsdGeom.Mesh):  # type: ignore[attr-defined]
                own = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(time), float)  # type: ignore[attr-defined]
                matrix = np.array(places.GetLocalToWorldTransform(prim), float)
                points.append(own @ matrix[:3, :3] + matrix[3, :3])
        yield points


def size(points):
    return float(np.ptp(points, axis=0).max())


def test_an_arm_with_a_blend_shape(tmp_path):
    path = write(tmp_path, "arm.usda", ARM)
    scene = load(path)
    assert scene.rig is not None
    assert scene.rig.skeleton is not None
    assert scene.rig.skeleton.names == ("(fixed)", "upper", "upper/lower")
    assert scene.rig.keys is not None
    assert scene.rig.keys.places == ((0.0, 1.0, 0.5),)
    assert scene.rig.motion is not None
    assert (scene.rig.motion.span, scene.rig.rate) == ((0.0, 10.0), 30.0)
    times = [0.0, 10.0]  # usd-core's own are joined by straight lines in between
    for time, points in zip(times, baked(path, times), strict=True):
        wanted = np.concatenate(points)
        np.testing.assert_allclose(scene.vertices(time), wanted, atol=1e-6 * size(wanted))  # usd-core's is float32
    rest = [[5, -1, 0], [7, -1, 0], [7, 1, 0], [5, 1, 0], [9, -1, 0], [9, 1, 0]]
    np.testing.assert_allclose(scene.vertices(0.0)[:6], rest, atol=1e-15)


@pytest.mark.slow
def test_patches_follow_the_pose(tmp_path):
    scene = load(write(tmp_path, "arm.usda", ARM))
    assert scene.conversion is not None
    posed = np.asarray(scene.pose(10.0))
    wanted = scene.conversion.patchwork.on_host(np.asarray(scene.vertices(10.0)))
    np.testing.assert_allclose(posed, wanted, atol=1e-14)
    np.testing.assert_allclose(scene.pose(0.0), scene.patches(), atol=1e-14)
    stiff = np.asarray(scene.pose(10.0, dual_quaternion_blend))
    assert np.abs(stiff - posed).max() > 0.01
    np.testing.assert_allclose(stiff[2], posed[2], atol=1e-14)  # of the mesh that stays
    rate = jax.jacfwd(scene.vertices)(4.0)
    there, back = (np.asarray(scene.vertices(4.0 + s)) for s in (1e-6, -1e-6))
    np.testing.assert_allclose(rate, (there - back) / 2e-6, atol=1e-7)
    for time in (-0.1, 10.1):
        with pytest.raises(InputError, match=f"time {time:g} lies outside of the motion, 0 to 10"):
            scene.pose(time)


def test_scenes_that_do_not_move(tmp_path, teapot):
    assert teapot.pose(3.0) is teapot.patches()
    with pytest.raises(InputError, match="teapot is no control mesh: there are no vertices"):
        teapot.vertices(0.0)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('/lower"]\n        uniform matrix4d[]', '/lower", "hand"]\n uniform matrix4d[]', "no bind transform of each"),
        ("Indices = [0, 0, 0, 1", "Indices = [0, 0, 0, 7", "/actor/skin has a weight for joint 7, but is bound to 2"),
        ("jointWeights = [1, 0, 0.5", "jointWeights = [1, 0.5", "do not fit its 6 points|elements"),
        ("pointIndices = [5]", "pointIndices = [6]", "/actor/skin: blend shape 'wide' moves point 6"),
        ("pointIndices = [5]", "pointIndices = [5, 4]", "'wide' needs 2 offsets, not 1"),
        ('skel:blendShapes = ["wide"]', 'skel:blendShapes = ["wide", "tall"]', "names 2 blend shapes, but has 1"),
    ],
)  # fmt: skip
def test_rigs_that_are_none(tmp_path, old, new, says):
    assert old in ARM
    with pytest.raises(InputError, match=says):
        load(write(tmp_path, "bad.usda", ARM.replace(old, new)))


def test_models_against_usd_core(models):
    """Two bent cylinders, and six keys with in-betweens over 131 frames; usd-core computes in float32."""
    for name, last, own in (("usdskel_two_bends", 0.0, slice(None)), ("usdskel_blendshapes", 131.0, slice(121, None))):
        path = models / f"{name}.usda"
        scene = load(path)
        times = np.linspace(1.0, last, 27).round() if last else [0.0]
        for time, points in zip(times, baked(path, times), strict=True):
            wanted = np.concatenate(points)[own]
            found = np.asarray(scene.vertices(time))[own]
            np.testing.assert_allclose(found, wanted, atol=1e-6 * size(wanted))
