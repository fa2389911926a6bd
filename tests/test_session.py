"""Sessions: the same factors as without one, nothing computed twice, and nothing that a scene does not need."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slefejax import (
    Camera,
    InputError,
    Pose,
    Session,
    View,
    convert,
    dual_quaternion_blend,
    load,
    tessellation_factors,
)
from slefejax.model.rig import Rig, Skeleton
from slefejax.model.skinning import Influences, rotation_matrices
from slefejax.predict.cells import Pictures
from slefejax.scene import Scene
from slefejax.session import PARTS
from tests.meshes import cube

BOX: dict[str, Any] = {"method": "slefe"}


@pytest.fixture(scope="module")
def walker() -> Scene:
    return load("walker")


@pytest.fixture(scope="module")
def view(walker) -> View:
    return View(walker.default_camera(), 1440, 900)


def turned(view: View, degrees: float) -> View:
    """The camera carried around the z axis."""
    angle = np.deg2rad(degrees)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    camera = view.camera
    return replace(view, camera=replace(camera, eye=turn @ camera.eye, target=turn @ camera.target))


@pytest.mark.parametrize(
    ("options", "deform"),
    [
        ({"tiles": 1}, None),
        pytest.param(BOX, dual_quaternion_blend, marks=pytest.mark.slow),
        pytest.param({"method": "slefe", "segments": 2, "depth_tolerance": 1e-3}, None, marks=pytest.mark.slow),
        ({"method": "edge-length"}, None),
    ],
)
def test_the_same_factors_as_without_a_session(walker, view, options, deform):
    more: dict[str, Any] = {} if deform is None else {"deform": deform}
    session = Session(walker, **options, **more)
    for time in (None, 0.0, 7.3):
        found = session.factors(view, time)
        patches = walker.patches() if time is None else np.asarray(walker.pose(time, **more))
        np.testing.assert_allclose(session.patches, patches, atol=1e-14)
        wanted = tessellation_factors(patches, view, edge_numbers=walker.edge_numbers, **options)
        np.testing.assert_allclose(found.factor, wanted.factor, rtol=1e-9)
        if options == BOX:
            assert np.array_equal(found.edges, wanted.edges)
            assert np.array_equal(found.inner, wanted.inner)


def test_only_what_changed_is_computed_again(walker, view):
    session = Session(walker, method="slefe")
    first = session.factors(view, 0.0)
    assert session.recomputed == ("pose", "view")
    assert min(session.seconds.values()) > 0
    assert session.factors(View(view.camera, 1440, 900), 0) is first
    assert session.recomputed == ()
    assert set(session.seconds.values()) == {0.0}
    session.factors(turned(view, 10.0), 0.0)
    assert session.recomputed == ("view",)
    assert [name for name in PARTS if session.seconds[name] > 0] == ["view"]
    session.factors(turned(view, 10.0), 1.0)
    assert session.recomputed == ("pose", "view")
    pose = walker.rig.pose(1.0)
    same = session.factors(turned(view, 10.0), pose)
    assert session.recomputed == ("pose", "view")  # the same place by another way
    assert session.factors(turned(view, 10.0), Pose(np.array(pose.local), np.array(pose.keys))) is same
    assert session.recomputed == ()


def test_a_scene_that_does_not_move_has_one_pose(teapot, main_view):
    session = Session(teapot, method="slefe")
    session.factors(main_view, 0.0)
    for time in (0.5, None, 100.0):
        session.factors(turned(main_view, 1.0 + (time or 0.0)), time)
        assert session.recomputed == ("view",)
        assert session.seconds[PARTS[0]] == session.seconds[PARTS[1]] == 0.0


def test_one_compilation_a_pass(walker, view):
    session = Session(walker, method="slefe")
    with jax.log_compiles(False):
        for k in range(3):
            session.factors(turned(view, float(k)), 0.5 * k)
    passes: Any = session._pose_pass
    assert passes._cache_size() == 1
    session.factors(view, walker.rig.pose(0.5))
    assert passes._cache_size() == 2  # a pose and a time are two programs


def equations(jaxpr: Any) -> list[Any]:
    """All operations of a program, those inside of others in their place."""
    found = []
    for equation in jaxpr.eqns:
        inner = jax.tree.leaves(equation.params, is_leaf=lambda x: hasattr(x, "eqns") or hasattr(x, "jaxpr"))
        programs = [getattr(x, "jaxpr", x) for x in inner if hasattr(x, "eqns") or hasattr(x, "jaxpr")]
        found += [e for program in programs for e in equations(program)] or [equation]
    return found


def primitives(jaxpr: Any) -> list[str]:
    return [equation.primitive.name for equation in equations(jaxpr)]


def work(programs: dict[str, Any]) -> int:
    """How many numbers the programs compute, each loop's body once."""
    return sum(
        int(np.prod(out.aval.shape))
        for program in programs.values()
        for equation in equations(program.jaxpr)
        for out in equation.outvars
    )


@pytest.mark.parametrize("method", ["certified", "slefe"])
def test_what_is_not_needed_is_not_traced(teapot, main_view, method):
    """A static polynomial scene: no skinning (nothing is gathered), no weights (no fourth coordinate), no depth."""
    plain = Session(teapot, method=method)
    programs = plain.programs(main_view)
    assert PARTS[0] not in programs
    assert (PARTS[1] in programs) == (method == "slefe")
    assert "gather" not in [name for program in programs.values() for name in primitives(program.jaxpr)]
    shapes = [v.aval.shape for program in programs.values() for v in program.jaxpr.invars]
    assert all(4 not in shape[3:4] for shape in shapes if len(shape) == 5)
    said = " ".join(plain.left_out())
    for what in ("skinning and shape keys", "weights", "depth widths"):
        assert what in said
    rational = replace(teapot, control=np.concatenate([teapot.control, np.ones((32, 4, 4, 1))], axis=3))
    assert work(Session(rational, method=method).programs(main_view)) > 1.1 * work(programs)
    deep = Session(teapot, method=method, depth_tolerance=1e-3)
    assert work(deep.programs(main_view)) > 1.05 * work(programs)
    assert "depth" not in " ".join(deep.left_out())


def test_parts_of_a_rig_that_are_not_there_are_not_traced(walker, view):
    """Boneless, keyless and quad-only scenes have shorter programs, and say what they do without."""
    whole = primitives(Session(walker, **BOX).programs(view, 0.0)[PARTS[0]].jaxpr)
    boneless = replace(walker, rig=replace(walker.rig, skeleton=None, influences=None))
    keyless = replace(walker, rig=replace(walker.rig, keys=None))
    for scene, what in ((boneless, "skinning"), (keyless, "shape keys")):
        session = Session(scene, **BOX)
        own = primitives(session.programs(view, 0.0)[PARTS[0]].jaxpr)
        assert len(own) < len(whole)
        assert own.count("gather") < whole.count("gather")
        assert any(line.startswith(what) for line in session.left_out())
    still = replace(walker, rig=None)
    assert PARTS[0] not in Session(still, **BOX).programs(view)


def rigid(rng) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = np.asarray(rotation_matrices(rng.normal(size=4)))
    matrix[:3, 3] = rng.normal(size=3)
    return matrix


@pytest.mark.parametrize("deform", [None, dual_quaternion_blend])
@pytest.mark.parametrize("options", [BOX, {"tiles": 1}])
def test_a_rigid_pose_is_a_camera_that_moves(walker, view, rng, options, deform):
    """All bones moved by one motion, and the camera with them: the same factors, to 1e-9.

    Slefe boxes have sides along the axes of the world, so that they turn along only by quarter turns.
    """
    session = Session(walker, **{**options, **({} if deform is None else {"deform": deform})})
    at_rest = walker.rig.skeleton.rest
    before = np.asarray(session.factors(view, Pose(at_rest)).factor)
    for _ in range(3):
        motion = rigid(rng)
        if options == BOX:
            motion[:3, :3] = np.eye(3)[[2, 0, 1]] * rng.choice([[1, 1, 1], [-1, -1, 1]])
        local = np.where((walker.rig.skeleton.parents < 0)[:, None, None], motion @ at_rest, at_rest)
        c = view.camera
        eye, target = (motion[:3, :3] @ p + motion[:3, 3] for p in (c.eye, c.target))
        moved = Camera.look_at(eye, target, motion[:3, :3] @ c.up, c.extent, c.near, c.far)
        after = np.asarray(session.factors(View(moved, 1440, 900), Pose(local)).factor)
        assert session.recomputed == ("pose", "view")
        np.testing.assert_allclose(after, before, rtol=1e-9)


def test_shape_keys_of_ones_own(walker, view):
    session = Session(walker, method="slefe")
    pose = walker.rig.pose(6.0, keys={"belly": 1.0})
    assert np.asarray(pose.keys)[4] == 1.0
    assert np.array_equal(np.delete(pose.keys, 4), np.delete(walker.rig.motion.weights(6.0), 4))
    plain = np.asarray(session.factors(view, 6.0).factor)
    assert np.abs(np.asarray(session.factors(view, pose).factor) - plain).max() > 0.05
    at_rest = walker.rig.pose(keys=np.eye(6)[0])
    assert at_rest.local is None
    session.factors(view, at_rest)
    moved = np.any(np.abs(session.patches - walker.patches()) > 1e-12, axis=(1, 2, 3))
    assert 0 < moved.sum() < 500  # a smile is at the head
    with pytest.raises(InputError, match=r"no shape key 'grin': choose one of smile, brows"):
        walker.rig.pose(keys={"grin": 1.0})
    with pytest.raises(InputError, match=r"there are 6 shape keys, so weights must be \(6,\), not \(5,\)"):
        walker.rig.pose(keys=np.zeros(5))


def test_arrays_that_change_under_its_hands(walker, view):
    """The caller's own arrays of camera and pose, changed in place, are seen to have changed; the patches cannot be."""
    session = Session(walker, **BOX)
    eye = np.array(view.camera.eye)
    own = replace(view, camera=replace(view.camera, eye=eye))
    pose = Pose(np.array(walker.rig.pose(1.0).local), np.zeros(6))
    first = np.asarray(session.factors(own, pose).factor)
    eye += 0.1
    assert np.abs(np.asarray(session.factors(own, pose).factor) - first).max() > 0
    assert session.recomputed == ("view",)
    pose.keys[4] = 1.0
    session.factors(own, pose)
    assert session.recomputed == ("pose", "view")
    with pytest.raises(ValueError, match="read-only"):
        session.patches[0] = 0.0


def test_factors_of_a_pose_that_is_gone():
    """Levels are found when they are asked for: of the pose that the factors are of."""
    scene, joints = caged_cube()
    view = View(Camera.look_at((3, -4, 3), (0.5, 0.5, 0.5)), 320, 200)
    session = Session(scene)
    taller = joints * np.where(np.arange(4) == 3, [[1], [1], [2.5], [1]], 1.0)
    first = session.factors(view, Pose(taller))
    session.factors(view, Pose(joints))
    wanted = tessellation_factors(np.asarray(scene.pose(Pose(taller))), view, edge_numbers=scene.edge_numbers)
    assert np.array_equal(first.edges, wanted.edges)
    assert np.array_equal(first.inner, wanted.inner)
    assert not np.array_equal(first.edges, session.factors(view, Pose(joints)).edges)


SLOW = pytest.param({"anisotropic": True, "levels": "fewest"}, marks=pytest.mark.slow)


@pytest.mark.parametrize("method", [{}, SLOW])
def test_levels_of_patches_that_stand_still_are_kept(walker, view, method, monkeypatch):
    """The same levels as without a session, and fewer cells and triangles to look at; all of them in another view."""
    looked = []
    errors = Pictures.errors
    monkeypatch.setattr(
        Pictures, "errors", lambda own, kind, patch, *rest: looked.append(len(patch)) or errors(own, kind, patch, *rest)
    )

    def work(found):
        looked.clear()
        levels = found.inner, found.edges
        return sum(looked), levels

    session = Session(walker, **method)
    local = np.array(walker.rig.pose(2.0).local)
    work(session.factors(view, Pose(local)))
    local[-1, :3, :3] = local[-1, :3, :3] @ [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    for _ in range(2):
        count, levels = work(session.factors(view, Pose(local)))
        assert session.recomputed == ("pose", "view")
        wanted = tessellation_factors(session.patches, view, edge_numbers=walker.edge_numbers, **method)
        anew, others = work(wanted)
        assert 0 < count < 0.5 * anew
        assert all(np.array_equal(a, b) for a, b in zip(levels, others, strict=True))
        local[-1, :3, 3] += 0.01
    nearer = replace(view, camera=replace(view.camera, extent=0.9 * view.camera.extent))
    found = work(session.factors(nearer, Pose(local)))[0]
    assert found == work(tessellation_factors(session.patches, nearer, edge_numbers=walker.edge_numbers, **method))[0]


def test_float32(walker, view):
    single, double = Session(walker, dtype=np.float32, **BOX), Session(walker, **BOX)
    found, wanted = (session.factors(view, 3.0).factor for session in (single, double))
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, wanted, rtol=2e-3)
    assert sum(single.memory().values()) < sum(double.memory().values())


def test_bad_poses_and_options(walker, teapot, view):
    session = Session(walker, **BOX)
    kept = session.factors(view, 1.0)
    for pose, says in (
        (25.0, r"time 25 lies outside of the motion, 0 to 24"),
        (np.nan, r"time nan lies outside"),
        (Pose(local=np.zeros((3, 4, 4))), r"a pose of 20 joints needs transforms \(20, 4, 4\), not \(3, 4, 4\)"),
        (Pose(keys=np.zeros(2)), r"a pose of 6 shape keys needs weights \(6,\), not \(2,\)"),
    ):
        with pytest.raises(InputError, match=says):
            session.factors(view, pose)
    assert session.factors(view, 1.0) is kept
    with pytest.raises(InputError, match=r"patch 0 and 2495 more .* control points that are not finite"):
        session.factors(view, Pose(local=np.full((20, 4, 4), np.nan)))
    with pytest.raises(InputError, match=r"inside of jit and grad call Scene.pose"):
        jax.jit(lambda t: session.factors(view, t).factor)(1.0)
    with pytest.raises(InputError, match=r"the view must be a slefejax.View"):
        session.factors(3, 1.0)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="there is no method 'magic'"):
        Session(walker, method="magic")
    with pytest.raises(InputError, match=r"a session is of a slefejax.Scene"):
        Session(np.zeros((1, 4, 4, 3)))  # type: ignore[arg-type]


def test_scenes_in_a_pose_are_scenes(walker, teapot):
    still = walker.posed(6.0)
    assert still.rig is None
    np.testing.assert_allclose(still.patches(), walker.pose(6.0), atol=1e-14)
    np.testing.assert_allclose(still.vertices(None), walker.vertices(6.0), atol=0)
    assert np.array_equal(still.edge_numbers, walker.edge_numbers)
    with pytest.raises(InputError, match="teapot does not move"):
        teapot.posed(0.0)


def caged_cube() -> tuple[Any, np.ndarray]:
    """A cube with a joint at every corner, and the bind transforms of these."""
    box = cube()
    conversion = convert(box)
    joints = np.tile(np.eye(4), (8, 1, 1))
    joints[:, :3, 3] = box.vertices
    influences = Influences.of(np.arange(8)[:, None], np.ones((8, 1)), 8)
    rig = Rig(Skeleton.of([f"corner{k}" for k in range(8)], [-1] * 8, joints), influences)
    return Scene("cage", conversion.patchwork.on_host(box.vertices), conversion=conversion, rig=rig), joints


def test_any_function_can_deform(view):
    """A cage: joints are its corners, a vertex goes where the weighted mean of their moves takes it."""
    scene, joints = caged_cube()
    box = cube()

    def cage(rest, transforms, influences):
        corners = jnp.asarray(box.vertices)
        moves = jnp.einsum("jab,jb->ja", transforms[:, :, :3], corners) + transforms[:, :, 3] - corners
        return rest + influences.table(moves)

    lifted = joints.copy()
    lifted[:, 2, 3] += box.vertices[:, 0]  # a shear
    camera = Camera.look_at((3, -4, 3), (0.5, 0.5, 0.5))
    session = Session(scene, deform=cage, **BOX)
    session.factors(View(camera, 320, 200), Pose(lifted))
    sheared = box.vertices + box.vertices[:, :1] * [0, 0, 1]
    np.testing.assert_allclose(session.patches, scene.conversion.patchwork.on_host(sheared), atol=1e-14)


@pytest.mark.slow
def test_gradients_by_pose_and_keys(walker, rng):
    """Of the control points, by central differences."""
    pull = rng.normal(size=walker.patches().shape)
    number = lambda pose: jnp.sum(pull * walker.pose(pose))  # noqa: E731
    pose = walker.rig.pose(4.2)
    gradient = jax.grad(number)(pose)
    way = Pose(rng.normal(size=pose.local.shape) * [[1.0], [1.0], [1.0], [0.0]], rng.normal(size=pose.keys.shape))
    there, back = (number(Pose(*(a + s * b for a, b in zip(pose, way, strict=True)))) for s in (1e-6, -1e-6))
    along = sum(np.sum(np.asarray(g) * w) for g, w in zip(gradient, way, strict=True))
    np.testing.assert_allclose(along, (there - back) / 2e-6, rtol=1e-7)


def test_inside_of_jit_is_refused_and_harms_nothing(walker, view):
    session = Session(walker, **BOX)

    def total(x):
        return session.factors(view, 0.0).factor.sum() + x

    with pytest.raises(InputError, match=r"inside of jit and grad call Scene\.pose"):
        jax.jit(total)(1.0)
    assert np.isfinite(np.asarray(session.factors(view, 0.0).factor)).all()


PLAIN = """
import jax, numpy as np, slefejax as sj
walker = sj.load("walker")
found = np.asarray(walker.pose(0.5))
assert found.dtype == np.float32 and np.isfinite(found).all()
assert np.isfinite(jax.jacfwd(lambda t: walker.rig.motion.local(t))(0.5)).all()
"""


def test_where_jax_has_no_float64():
    """JAX's default; motion between equal rotations too."""
    subprocess.run([sys.executable, "-c", PLAIN], check=True)


def test_lists_are_poses_and_other_things_are_none(walker, teapot, main_view, view):
    session = Session(walker, **BOX)
    pose = walker.rig.pose(2.0)
    wanted = np.asarray(session.factors(view, 2.0).factor)
    lists = Pose(np.asarray(pose.local).tolist(), tuple(np.asarray(pose.keys).tolist()))
    np.testing.assert_allclose(session.factors(view, lists).factor, wanted, rtol=1e-12)
    np.testing.assert_allclose(walker.pose(lists), walker.pose(2.0), atol=1e-14)
    for time in ("abc", "3", True, [1.0], {}, 1 + 2j, object(), np.zeros(2)):
        with pytest.raises(InputError, match="a time must be a number"):
            session.factors(view, time)
        with pytest.raises(InputError, match="a time must be a number"):
            Session(teapot, **BOX).factors(main_view, time)
    assert session.recomputed == ()
    for keys in ([None] * 6, ["a"] * 6, np.zeros(6) * 1j):
        with pytest.raises(InputError, match="an array of"):
            session.factors(view, Pose(None, keys))
    for deform in (3, "linear", ()):
        with pytest.raises(InputError, match="deform must be a function"):
            Session(walker, deform=deform)  # type: ignore[arg-type]
    for dtype in ("int32", np.complex64, "x", np.float16):
        with pytest.raises(InputError, match="dtype must be float32 or float64"):
            Session(walker, dtype=dtype)
    with pytest.raises(ValueError, match="read-only"):
        session.factors(view, 2.0).inner[:] = 7
