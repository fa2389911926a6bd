"""What moves meshes of USD: rest poses, animated transforms, deformations, blend shapes, against usd-core."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
import pytest

from slefejax import InputError, Session, View, dual_quaternion_blend, linear_blend, load, save
from tests.test_io import write
from tests.test_usd_skel import baked, size

pytest.importorskip("pxr", reason="usd-core is not installed")

STILL = "((1,0,0,0),(0,1,0,0),(0,0,1,0),(0,0,0,1))"
BESIDE = "((1,0,0,0),(0,1,0,0),(0,0,1,0),(1,0,0,1))"
QUAD = """int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(0,0,0), (1,0,0), (1,1,0), (0,1,0)]"""
SWING = """uniform token[] joints = ["a", "a/b"]
      quatf[] rotations.timeSamples = {0: [(1,0,0,0), (1,0,0,0)], 10: [(1,0,0,0), (0.70710678,0,0,0.70710678)]}
      float3[] translations.timeSamples = {0: [(0,0,0), (1,0,0)], 10: [(0,0,2), (1,0,0)]}
      half3[] scales = [(1,1,1), (1,1,1)]"""
DUAL = 'uniform token primvars:skel:skinningMethod = "dualQuaternion"'
SLIDE = """double3 xformOp:translate.timeSamples = {0: (0,0,0), 10: (0,5,0)}
  uniform token[] xformOpOrder = ["xformOp:translate"]"""
SPIN = """double3 xformOp:translate:pivot = (3,0,0)
  float xformOp:rotateZ.timeSamples = {0: 0, 10: 360}
  uniform token[] xformOpOrder = ["xformOp:translate:pivot", "xformOp:rotateZ", "!invert!xformOp:translate:pivot"]"""
MIRROR = """float3 xformOp:scale = (-1,1,1)
  uniform token[] xformOpOrder = ["xformOp:scale"]"""
GROW = """float3 xformOp:scale.timeSamples = {0: (0,0,0), 10: (1,2,1)}
  uniform token[] xformOpOrder = ["xformOp:scale"]"""


def mesh(name: str = "M", inside: str = "", weights: str = "1,0, 0.5,0.5, 0.25,0.75, 1,0") -> str:
    """A quad that two joints move."""
    return f"""def Mesh "{name}" (prepend apiSchemas = ["SkelBindingAPI"]) {{
    {QUAD}
    rel skel:skeleton = </R/S>
    int[] primvars:skel:jointIndices = [0,1, 0,1, 0,1, 0,1] (interpolation = "vertex"; elementSize = 2)
    float[] primvars:skel:jointWeights = [{weights}] (interpolation = "vertex"; elementSize = 2)
    {inside}
  }}"""


def stage(meshes: str = "", motion: str = SWING, rest: str | None = f"[{STILL}, {BESIDE}]", **inside: str) -> str:
    """Meshes below a root and its skeleton of two joints; ``root`` and ``skeleton`` are what else stands in these."""
    said = f"uniform matrix4d[] restTransforms = {rest}" if rest else ""
    source = "rel skel:animationSource = </R/S/An>" if motion else ""
    return f"""#usda 1.0
(
  upAxis = "Z"
  timeCodesPerSecond = 24
)
def SkelRoot "R" (prepend apiSchemas = ["SkelBindingAPI"]) {{
  {inside.get("root", "")}
  def Skeleton "S" (prepend apiSchemas = ["SkelBindingAPI"]) {{
    uniform token[] joints = ["a", "a/b"]
    uniform matrix4d[] bindTransforms = [{STILL}, {BESIDE}]
    {said}
    {source}
    {inside.get("skeleton", "")}
    def SkelAnimation "An" {{
      {motion}
    }}
  }}
  {meshes or mesh()}
}}
"""


def check(path, times, wanted=None, rest: float | None = None) -> Any:
    """The scene of a file, whose vertices at these times, and at rest, are usd-core's."""
    scene: Any = load(path)
    for time, points in zip(times, wanted or baked(path, times), strict=True):
        there = np.concatenate(points)
        np.testing.assert_allclose(scene.vertices(time), there, atol=1e-6 * max(1.0, size(there)))
    if rest is not None:
        there = np.concatenate(next(baked(path, [rest])))
        np.testing.assert_allclose(scene.vertices(), there, atol=1e-6 * max(1.0, size(there)))
        np.testing.assert_allclose(scene.patches(), scene.pose(), atol=1e-12)
    return scene


def skinned(path, time):
    """Points of all skinned meshes at any time, in the coordinates of the stage: BakeSkinning knows samples only."""
    from pxr import Usd, UsdGeom, UsdSkel, Vt  # type: ignore[attr-defined]

    usd: Any = Usd
    skel: Any = UsdSkel
    geometry: Any = UsdGeom
    arrays: Any = Vt
    opened, cache, found = usd.Stage.Open(str(path)), skel.Cache(), []
    root = skel.Root(opened.GetPrimAtPath("/R"))
    cache.Populate(root, usd.PrimDefaultPredicate)
    for binding in cache.ComputeSkelBindings(root, usd.PrimDefaultPredicate):
        query = cache.GetSkelQuery(binding.GetSkeleton())
        place = np.array(geometry.XformCache(time).GetLocalToWorldTransform(query.GetPrim()))
        for target in binding.GetSkinningTargets():
            points = arrays.Vec3fArray(target.GetPrim().GetAttribute("points").Get(time))
            assert target.ComputeSkinnedPoints(query.ComputeSkinningTransforms(time), points, time)
            found.append(np.array(points, float) @ place[:3, :3] + place[3, :3])
    return found


def test_rest_transforms_that_are_not_the_bind_pose(tmp_path):
    raised = f"[{STILL.replace('(0,0,0,1)', '(0,0,3,1)')}, {BESIDE}]"
    path = write(tmp_path, "a.usda", stage(motion="", rest=raised))
    scene = check(path, [], rest=0.0)
    np.testing.assert_allclose(scene.patches()[..., 2], 3.0, atol=1e-15)
    save(scene, tmp_path / "a.json")
    assert np.array_equal(load(tmp_path / "a.json").patches(), scene.patches())
    np.testing.assert_allclose(load(path, copies=2).patches()[..., 2], 3.0, atol=1e-15)


def test_an_animated_scene_rests_as_it_is_at_its_earliest_time(tmp_path):
    turned = SWING.replace("0: [(0,0,0)", "0: [(0,7,0)")
    check(write(tmp_path, "a.usda", stage(motion=turned)), [0.0, 10.0], rest=0.0)
    scene: Any = load(write(tmp_path, "b.usda", stage()))
    assert scene.rig.rest.local is None, "the bind pose: nothing is to be computed"


@pytest.mark.parametrize(
    "inside",
    [
        {"root": SLIDE},
        {"skeleton": SLIDE},
        {"root": SPIN, "skeleton": SLIDE},
        {"root": SLIDE, "meshes": mesh(inside=SPIN + "\n" + f"matrix4d primvars:skel:geomBindTransform = {BESIDE}")},
        {"root": GROW},
    ],
)  # fmt: skip
def test_animated_transforms_of_roots_and_skeletons(tmp_path, inside):
    """At samples and elsewhere; the transform of a skinned mesh itself does not count, as UsdSkel has it."""
    path = write(tmp_path, "a.usda", stage(**inside))
    check(path, [0.0, 10.0], rest=0.0)
    scene: Any = load(path)
    for time in (2.0, 5.0) if SPIN in inside.values() else (2.5, 6.2):  # a turn about a pivot is right at every frame
        wanted = np.concatenate(skinned(path, time))
        np.testing.assert_allclose(scene.vertices(time), wanted, atol=1e-6 * max(1.0, size(wanted)))


def test_rootxf_moves_five_along_y(tmp_path):
    scene: Any = load(write(tmp_path, "a.usda", stage(root=SLIDE)))
    low = np.asarray(scene.vertices(0.0))
    still: Any = load(write(tmp_path, "b.usda", stage()))
    np.testing.assert_allclose(
        scene.vertices(10.0) - still.vertices(10.0), np.tile([0.0, 5.0, 0.0], (4, 1)), atol=1e-14
    )
    np.testing.assert_allclose(low, still.vertices(0.0), atol=1e-14)
    save(scene, tmp_path / "again.json")
    np.testing.assert_allclose(load(tmp_path / "again.json").vertices(7.0), scene.vertices(7.0), atol=1e-14)
    both = np.asarray(load(tmp_path / "a.usda", copies=2).vertices(7.0))
    np.testing.assert_allclose(both[4:] - both[:4], np.tile(both[4] - both[0], (4, 1)), atol=1e-14)


def test_plain_meshes_move_with_the_transforms_above_them(tmp_path):
    """No skeleton at all; one mesh is flat at first, one stays."""
    text = f"""#usda 1.0
def Xform "A" {{
  {SPIN}
  def Mesh "B" {{
    {QUAD}
    {SLIDE}
  }}
  def Mesh "C" {{
    {QUAD}
  }}
}}
def Mesh "D" {{
  {QUAD}
}}
def Mesh "E" {{
  {QUAD}
  {GROW}
}}
"""
    path = write(tmp_path, "a.usda", text)
    scene: Any = load(path)
    assert scene.notes == ()
    assert scene.rig.skeleton.names == ("(fixed)", "/A/B", "/A", "/E")
    for time in (0.0, 2.0, 5.0, 10.0):
        np.testing.assert_allclose(scene.vertices(time), np.concatenate(next(baked(path, [time]))), atol=1e-6)
    np.testing.assert_allclose(scene.vertices(), np.concatenate(next(baked(path, [0.0]))), atol=1e-15)


def test_the_skinning_method_of_a_file_is_followed(tmp_path):
    """Of one mesh, of one among two, and inherited from the root."""
    dual: Any = check(write(tmp_path, "a.usda", stage(mesh(inside=DUAL))), [0.0, 10.0], rest=0.0)
    both: Any = check(write(tmp_path, "b.usda", stage(mesh(inside=DUAL) + "\n" + mesh("N"))), [0.0, 10.0], rest=0.0)
    check(write(tmp_path, "c.usda", stage(root=DUAL)), [0.0, 10.0])
    linear, rigid = (np.asarray(dual.vertices(10.0, way)) for way in (linear_blend, dual_quaternion_blend))
    assert np.abs(linear - rigid).max() > 0.1
    np.testing.assert_allclose(both.vertices(10.0), np.concatenate([rigid, linear]), atol=1e-15)
    save(both, tmp_path / "b.json")
    np.testing.assert_allclose(load(tmp_path / "b.json").vertices(10.0), both.vertices(10.0), atol=1e-14)
    session = Session(both, method="filip", dtype=np.float32)
    session.factors(View(both.default_camera(), 320, 200), 10.0)
    np.testing.assert_allclose(session.patches, both.pose(10.0), atol=1e-5)


def test_joints_that_scale_with_dual_quaternions(tmp_path):
    """Scale goes first: what both joints leave alone stays."""
    grown = """uniform token[] joints = ["a", "a/b"]
      quatf[] rotations = [(1,0,0,0), (1,0,0,0)]
      float3[] translations = [(0,0,0), (1,0,0)]
      half3[] scales = [(1,1,1), (2,2,2)]"""
    scene: Any = check(write(tmp_path, "a.usda", stage(mesh(inside=DUAL), grown)), [0.0], rest=0.0)
    np.testing.assert_allclose(scene.vertices(0.0)[1], [1, 0, 0], atol=1e-15)


@pytest.mark.parametrize("deform", [linear_blend, pytest.param(dual_quaternion_blend, marks=pytest.mark.slow)])
def test_a_joint_that_is_scaled_to_nothing_has_derivatives(tmp_path, deform):
    """By time, and by the joints themselves."""
    gone = SWING.replace("scales = [(1,1,1), (1,1,1)]", "scales = [(1,1,1), (0,0,0)]")
    scene: Any = load(write(tmp_path, "a.usda", stage(motion=gone)))
    assert np.isfinite(jax.grad(lambda time: scene.vertices(time, deform).sum())(5.0)).all()
    pose = scene.rig.pose(5.0)
    assert np.isfinite(
        jax.grad(lambda local: scene.vertices(pose._replace(local=local), deform).sum())(pose.local)
    ).all()


def test_sparse_animation_without_rest_transforms(tmp_path):
    sparse = """uniform token[] joints = ["a/b"]
      quatf[] rotations.timeSamples = {0: [(1,0,0,0)], 10: [(0.70710678,0,0,0.70710678)]}
      float3[] translations = [(1,0,0)]
      half3[] scales = [(1,1,1)]"""
    says = (
        r"a\.usda: skeleton /R/S has no restTransforms of its 2 joints, and its animation /R/S/An moves 1 of them only"
    )
    for rest in (None, f"[{STILL}]"):
        with pytest.raises(InputError, match=says):
            load(write(tmp_path, "a.usda", stage(motion=sparse, rest=rest)))
    check(write(tmp_path, "b.usda", stage(motion=sparse)), [0.0, 10.0], rest=0.0)
    check(write(tmp_path, "c.usda", stage(rest=None)), [0.0, 10.0], rest=0.0)  # all joints are animated
    scene = load(write(tmp_path, "d.usda", stage(motion="", rest=None)))
    assert scene.notes == ("skeleton /R/S has no restTransforms of its 2 joints: they rest as they are bound",)
    np.testing.assert_allclose(scene.patches()[0, [0, 3], [0, 3]], [[0, 0, 0], [1, 1, 0]], atol=1e-15)


def test_weights_that_are_not_one(tmp_path):
    """None at all: the point moves with the skeleton; other sums are divided, and both is said."""
    odd = mesh(weights="1,0, 0.25,0.25, 0,0, 1,0")
    scene: Any = load(write(tmp_path, "a.usda", stage(odd, root=SLIDE)))
    assert scene.notes == (
        "/R/M: the weights of 1 points do not add up to 1, and were divided by their sum",
        "1 points of skinned meshes have no weight: they move with their skeletons",
    )
    plain: Any = load(write(tmp_path, "b.usda", stage(root=SLIDE)))
    found, wanted = (np.asarray(scene.vertices(10.0)) for scene in (scene, plain))
    np.testing.assert_allclose(found[[0, 1, 3]], wanted[[0, 1, 3]], atol=1e-14)
    np.testing.assert_allclose(found[2], [1, 6, 0], atol=1e-14)


@pytest.mark.parametrize(
    ("inside", "upwards"),
    [
        ({}, True),
        ({"skeleton": MIRROR}, True),
        ({"root": MIRROR}, True),
        ({"meshes": mesh(inside=MIRROR)}, True),  # which does not count
        ({"meshes": mesh(inside='uniform token orientation = "leftHanded"')}, False),
        ({"root": MIRROR, "meshes": mesh(inside='uniform token orientation = "leftHanded"')}, False),
        ({"motion": SWING.replace("scales = [(1,1,1)", "scales = [(-1,1,1)")}, True),
    ],
)  # fmt: skip
def test_mirrored_skins_keep_their_front(tmp_path, inside, upwards):
    """A quad that faces +z, mirrored along x: it faces +z all the same."""
    path = write(tmp_path, "a.usda", stage(**inside))
    scene: Any = load(path)
    corners = np.asarray(scene.vertices())[scene.conversion.mesh.corners]
    normal = np.cross(corners[1] - corners[0], corners[3] - corners[0])
    assert (normal[2] > 0) == upwards
    there = np.concatenate(next(baked(path, [0.0])))
    np.testing.assert_allclose(scene.vertices(), there, atol=1e-6)


SHAPES = f"""def Mesh "M" (prepend apiSchemas = ["SkelBindingAPI"]) {{
    {QUAD}
    double xformOp:rotateZ = 90
    uniform token[] xformOpOrder = ["xformOp:rotateZ"]
    rel skel:skeleton = </R/S>
    uniform token[] skel:blendShapes = ["up", "side"]
    rel skel:blendShapeTargets = [</R/M/up>, </R/M/side>]
    def BlendShape "up" {{
      uniform int[] pointIndices = [1, 2]
      uniform vector3f[] normalOffsets = [(0,0,0), (0,0,0)]
      uniform vector3f[] inbetweens:half = [(0,0,1), (0,0,2)] (weight = 0.5)
      uniform vector3f[] inbetweens:half:normalOffsets = [(1,0,0), (1,0,0)]
    }}
    def BlendShape "side" {{
      uniform vector3f[] offsets = [(1,0,0), (0,0,0), (0,0,0), (0,3,0)]
    }}
  }}"""
WEIGHTS = """uniform token[] blendShapes = ["side", "up"]
      float[] blendShapeWeights.timeSamples = {0: [0.5, 0], 4: [0, 0.5], 6: [1, 0.75], 10: [2, 1]}"""


def test_blend_shapes_with_offsets_of_normals_only(tmp_path):
    """And a mesh that no joint moves, and is turned: offsets are in its own coordinates."""
    path = write(tmp_path, "a.usda", stage(SHAPES, WEIGHTS))
    scene = check(path, [0.0, 4.0, 6.0, 10.0], rest=0.0)
    assert scene.rig.skeleton is None
    assert scene.notes == ()
    np.testing.assert_allclose(scene.vertices(4.0)[2], [-1, 1, 2], atol=1e-7)  # turned in single precision
    spun = SHAPES.replace("double xformOp:rotateZ = 90", "double xformOp:rotateZ.timeSamples = {0: 90, 10: 180}")
    check(write(tmp_path, "b.usda", stage(spun, WEIGHTS)), [0.0, 10.0], rest=0.0)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("weight = 0.5", "weight = 1", "half is in between at weight 1, which is none: it was left out"),
        ("(weight = 0.5)", "", "half is in between at weight 0, which is none: it was left out"),
    ],
)
def test_shapes_in_between_that_are_none(tmp_path, old, new, says):
    scene = load(write(tmp_path, "a.usda", stage(SHAPES.replace(old, new), WEIGHTS)))
    assert any(says in note for note in scene.notes), scene.notes
    check(tmp_path / "a.usda", [0.0, 10.0])


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("def BlendShape \"side\"", "def Scope \"side\"", "the target of blend shape 'side' is none"),
        ("offsets = [(1,0,0), ", "offsets = [", "blend shape 'side' needs 4 offsets, not 3"),
        ("pointIndices = [1, 2]", "pointIndices = [1, -1]", "blend shape 'up' moves point -1"),
        ("(weight = 0.5)", "(weight = 0.5)\n uniform vector3f[] inbetweens:z = [(0,0,1), (0,0,2)] (weight = 0.5)",
         "another shape in between has the same weight 0.5"),
    ],
)  # fmt: skip
def test_blend_shapes_that_are_none(tmp_path, old, new, says):
    assert old in SHAPES
    path = write(tmp_path, "a.usda", stage(SHAPES.replace(old, new), WEIGHTS))
    with pytest.raises(InputError, match=says) as raised:
        load(path)
    assert str(path) in str(raised.value)


def test_two_characters_with_keys_of_one_name(tmp_path):
    """Each has its own weights."""
    one = stage(SHAPES, WEIGHTS)
    other = one[one.index("def SkelRoot") :].replace("/R/", "/Q/").replace('"R"', '"Q"')
    path = write(tmp_path, "a.usda", one + other.replace("4: [0, 0.5]", "4: [0, 0.1]"))
    scene = check(path, [0.0, 4.0, 10.0], rest=0.0)
    assert scene.rig.keys.names == ("up", "side", "up 2", "side 2")


def test_joints_without_a_skeleton_are_said(tmp_path):
    path = write(tmp_path, "a.usda", stage().replace("rel skel:skeleton = </R/S>", ""))
    scene = load(path)
    assert scene.notes == ("/R/M has joints, but no skeleton below one root with it: it was not skinned",)
    assert scene.rig is None
