"""Skinning and rigs against plain loops."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slefejax import InputError
from slefejax.model.rig import Motion, Pose, Rig, Skeleton
from slefejax.model.skinning import (
    Influences,
    Key,
    ShapeKeys,
    dual_quaternion_blend,
    linear_blend,
    multiply,
    polar_rotations,
    quaternions,
    rotation_matrices,
)

VERTICES, BONES = 40, 7
ROUNDING = 500  # in eps: of a few dozen operations each on numbers of up to about 5


def rigid(rng, *shape):
    """Random rotations and translations ``(*shape, 3, 4)``."""
    turn = np.asarray(rotation_matrices(rng.normal(size=(*shape, 4))))
    return np.concatenate([turn, rng.normal(size=(*shape, 3, 1))], axis=-1)


def random_influences(rng, most=5):
    indices = np.array([rng.choice(BONES, most, replace=False) for _ in range(VERTICES)])
    weights = rng.uniform(0.1, 1.0, indices.shape) * (np.arange(most) < rng.integers(1, most + 1, (VERTICES, 1)))
    return indices, weights


def test_linear_blend_is_the_loop(rng, precision):
    rest, transforms = rng.normal(size=(VERTICES, 3)), rng.normal(size=(BONES, 3, 4))
    indices, weights = random_influences(rng)
    wanted = np.zeros((VERTICES, 3))
    for v in range(VERTICES):
        for bone, weight in zip(indices[v], weights[v] / weights[v].sum(), strict=True):
            wanted[v] += weight * (transforms[bone, :, :3] @ rest[v] + transforms[bone, :, 3])
    influences = Influences.of(indices, weights, BONES)
    found = linear_blend(rest.astype(precision), transforms.astype(precision), influences)
    assert found.dtype == precision
    np.testing.assert_allclose(found, wanted, rtol=0, atol=ROUNDING * np.finfo(precision).eps)


def as_dual_quaternion(matrix):
    """By the matrix's rotation vector, another way than the module's."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(matrix[:, :3]).as_quat()
    real = np.array([w, x, y, z])
    return real, 0.5 * np.asarray(multiply(np.array([0.0, *matrix[:, 3]]), real))


def test_dual_quaternions_are_the_loop(rng, precision):
    rest, transforms = rng.normal(size=(VERTICES, 3)), rigid(rng, BONES)
    indices, weights = random_influences(rng)
    influences = Influences.of(indices, weights, BONES)
    wanted = np.zeros((VERTICES, 3))
    for v in range(VERTICES):
        pivot = as_dual_quaternion(transforms[indices[v, np.argmax(weights[v])]])[0]
        real, dual = np.zeros(4), np.zeros(4)
        for bone, weight in zip(indices[v], weights[v], strict=True):
            q, d = as_dual_quaternion(transforms[bone])
            sign = -1.0 if q @ pivot < 0 else 1.0
            real, dual = real + sign * weight * q, dual + sign * weight * d
        norm = np.linalg.norm(real)
        real, dual = real / norm, dual / norm
        back = real * [1, -1, -1, -1]
        turned = np.asarray(multiply(multiply(real, np.array([0.0, *rest[v]])), back))[1:]
        wanted[v] = turned + 2 * np.asarray(multiply(dual, back))[1:]
    found = dual_quaternion_blend(rest.astype(precision), transforms.astype(precision), influences)
    assert found.dtype == precision
    np.testing.assert_allclose(found, wanted, rtol=0, atol=ROUNDING * np.finfo(precision).eps)


def general(rng, *shape):
    """Transforms that scale and shear too, the first of which mirrors ``(*shape, 3, 4)``."""
    found = rigid(rng, *shape)
    found[..., :3] = found[..., :3] @ (np.eye(3) + 0.2 * rng.normal(size=(*shape, 3, 3)))
    found[0, :, 0] *= -1.5
    return found


@pytest.mark.slow
def test_scale_goes_before_the_rigid_blend(rng):
    """Against SciPy's polar decomposition: what stretches is blended linearly, what is left as dual quaternions."""
    from scipy.linalg import polar

    rest, transforms = rng.normal(size=(VERTICES, 3)), general(rng, BONES)
    influences = Influences.of(*random_influences(rng), BONES)
    mirrored = np.sign(np.linalg.det(transforms[:, :, :3]))
    assert mirrored[0] == -1
    rotations, stretches = (np.array(p) for p in zip(*(polar(m) for m in transforms[:, :, :3]), strict=True))
    rotations, stretches = (part * mirrored[:, None, None] for part in (rotations, stretches))
    stretched = np.einsum("vb,bij,vj->vi", influences.table.matrix.toarray(), stretches, rest)
    moves = np.concatenate([rotations, transforms[:, :, 3:]], axis=2)
    wanted = dual_quaternion_blend(stretched, moves, influences)
    np.testing.assert_allclose(dual_quaternion_blend(rest, transforms, influences), wanted, atol=1e-13)


def test_dual_quaternions_with_scale_are_usd_cores(rng):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    from pxr import Gf, UsdSkel, Vt  # type: ignore[attr-defined]

    rest, transforms = rng.normal(size=(VERTICES, 3)), general(rng, BONES)
    indices, weights = random_influences(rng)
    weights /= weights.sum(axis=1, keepdims=True)
    points = Vt.Vec3fArray([Gf.Vec3f(*p) for p in rest.tolist()])  # type: ignore[attr-defined]
    joints = [Gf.Matrix4d(np.vstack([m, [0, 0, 0, 1]]).T.tolist()) for m in transforms]  # type: ignore[attr-defined]
    done = UsdSkel.SkinPoints(  # type: ignore[attr-defined]
        UsdSkel.Tokens.dualQuaternion,  # type: ignore[attr-defined]
        Gf.Matrix4d(1),  # type: ignore[attr-defined]
        Vt.Matrix4dArray(joints),  # type: ignore[attr-defined]
        Vt.IntArray(indices.ravel().tolist()),  # type: ignore[attr-defined]
        Vt.FloatArray(weights.ravel().tolist()),  # type: ignore[attr-defined]
        indices.shape[1],
        points,
    )
    assert done
    found = dual_quaternion_blend(rest, transforms, Influences.of(indices, weights, BONES))
    np.testing.assert_allclose(found, np.array(points), atol=1e-5)  # its points are in single precision


@pytest.mark.slow
@pytest.mark.parametrize("sizes", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1), (-2, 1, 0), (1e-30, 1e-30, 1e-30)])
def test_rotations_of_what_flattens_space(sizes):
    """Whatever is scaled to nothing: rotations all the same, and derivatives that are finite."""
    matrix = np.diag(np.array(sizes, float))
    found = np.asarray(polar_rotations(matrix))
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(found) > 0
    assert np.isfinite(jax.jacrev(polar_rotations)(matrix)).all()
    assert np.isfinite(jax.jacfwd(jax.jacfwd(polar_rotations))(matrix)).all()


def test_derivatives_of_polar_rotations(rng):
    matrices, direction = general(rng, 9)[:, :, :3], rng.normal(size=(9, 3, 3))
    rate = jax.jvp(polar_rotations, (matrices,), (direction,))[1]
    there, back = (polar_rotations(matrices + s * direction) for s in (1e-6, -1e-6))
    np.testing.assert_allclose(rate, (there - back) / 2e-6, atol=1e-7)


def test_each_vertex_has_the_deformation_that_its_file_asks_for(rng):
    rest, transforms = rng.normal(size=(VERTICES, 3)), rigid(rng, BONES)
    influences = Influences.of(*random_influences(rng), BONES)
    local = np.concatenate([transforms, np.broadcast_to([[[0, 0, 0, 1.0]]], (BONES, 1, 4))], axis=1)
    skeleton = Skeleton.of([str(k) for k in range(BONES)], [-1] * BONES, np.broadcast_to(np.eye(4), (BONES, 4, 4)))
    dual = rng.random(VERTICES) < 0.5
    for asked in (None, np.zeros(VERTICES, bool), np.ones(VERTICES, bool), dual):
        found = Rig(skeleton, influences, dual_quaternions=asked).posed(rest, Pose(local))
        both = [blend(rest, transforms, influences) for blend in (linear_blend, dual_quaternion_blend)]
        wanted = both[0] if asked is None else np.where(asked[:, None], both[1], both[0])
        np.testing.assert_allclose(found, wanted, atol=1e-14)
    with pytest.raises(InputError, match="dual_quaternions must say it of 40 vertices"):
        Rig(skeleton, influences, dual_quaternions=dual[1:])


@pytest.mark.parametrize("blend", [linear_blend, dual_quaternion_blend])
def test_one_motion_of_all_bones_is_that_motion(rng, blend):
    rest, motion = rng.normal(size=(VERTICES, 3)), rigid(rng)
    influences = Influences.of(*random_influences(rng), BONES)
    found = blend(rest, np.broadcast_to(motion, (BONES, 3, 4)), influences)
    np.testing.assert_allclose(found, rest @ motion[:, :3].T + motion[:, 3], atol=1e-13)


@pytest.mark.parametrize("blend", [linear_blend, pytest.param(dual_quaternion_blend, marks=pytest.mark.slow)])
def test_frames_in_a_batch_are_frames_one_by_one(rng, blend):
    rest, transforms = rng.normal(size=(4, VERTICES, 3)), rigid(rng, 4, BONES)
    influences = Influences.of(*random_influences(rng), BONES)
    single = [blend(r, t, influences) for r, t in zip(rest, transforms, strict=True)]
    np.testing.assert_allclose(blend(rest, transforms, influences), single, atol=1e-14)
    same = [blend(rest[0], t, influences) for t in transforms]
    np.testing.assert_allclose(blend(rest[0], transforms, influences), same, atol=1e-14)


@pytest.mark.parametrize("blend", [linear_blend, pytest.param(dual_quaternion_blend, marks=pytest.mark.slow)])
def test_gradients_against_differences(rng, blend):
    rest, transforms = rng.normal(size=(VERTICES, 3)), rigid(rng, BONES)
    influences = Influences.of(*random_influences(rng), BONES)
    pull = rng.normal(size=(VERTICES, 3))
    number = lambda r, q, t: jnp.sum(pull * blend(r, jnp.concatenate([rotation_matrices(q), t], axis=-1), influences))  # noqa: E731
    arguments = (rest, np.asarray(quaternions(transforms[:, :, :3])), transforms[:, :, 3:])
    gradients = jax.grad(number, (0, 1, 2))(*arguments)
    for k in range(3):
        direction = rng.normal(size=arguments[k].shape)
        there, back = ([a + s * 1e-6 * direction if i == k else a for i, a in enumerate(arguments)] for s in (1, -1))
        numeric = (number(*there) - number(*back)) / 2e-6
        np.testing.assert_allclose(np.sum(gradients[k] * direction), numeric, rtol=1e-6, atol=1e-7)


def test_quaternions_of_all_rotations(rng):
    q = rng.normal(size=(500, 4))
    q[:8] = np.concatenate([np.eye(4), -np.eye(4)])
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    found = np.asarray(quaternions(rotation_matrices(q)))
    np.testing.assert_allclose(np.abs(np.sum(found * q, axis=1)), 1.0, atol=1e-14)
    np.testing.assert_allclose(quaternions(2.5 * rotation_matrices(q)), found, atol=1e-14)


def test_twisting_keeps_volume_with_dual_quaternions():
    """A half turn of one of two bones: linear blending shrinks what lies between to the axis, the other does not."""
    ring = np.stack([np.zeros(8), *(f(2 * np.pi * np.arange(8) / 8) for f in (np.cos, np.sin))], axis=1)
    half_turn = np.diag([1.0, -1.0, -1.0])
    transforms = np.zeros((2, 3, 4))
    transforms[:, :, :3] = np.eye(3), half_turn
    both = Influences.of(np.tile([0, 1], (8, 1)), np.full((8, 2), 0.5), 2)
    assert np.abs(linear_blend(ring, transforms, both)).max() < 1e-15
    np.testing.assert_allclose(np.linalg.norm(dual_quaternion_blend(ring, transforms, both), axis=1), 1.0, atol=1e-15)


@pytest.mark.parametrize(
    ("indices", "weights", "says"),
    [
        ([[0, 2]], [[1.0, 1.0]], "vertex 0 has a weight for bone 2, but there are 2"),
        ([[0, 1], [-1, 0]], [[1.0, 1.0], [0.5, 0.5]], "vertex 1 has a weight for bone -1"),
        ([[0, 1], [0, 1]], [[1.0, 1.0], [0.0, 0.0]], r"the weights of vertex 1 are all zero \(1 such"),
        ([[0, 1]], [[1.0, -0.5]], "vertex 0 has the weight -0.5"),
        ([[0, 1]], [[1.0, np.nan]], "vertex 0 has the weight nan"),
        ([[0, 1]], [[1.0]], "both \\(vertices, k\\)"),
    ],
)
def test_influences_that_are_none(indices, weights, says):
    with pytest.raises(InputError, match=says):
        Influences.of(indices, weights, 2)


def test_padding_may_name_any_bone():
    found = Influences.of([[1, 99], [0, -1]], [[2.0, 0.0], [3.0, 0.0]], 2)
    assert found.table.matrix.toarray().tolist() == [[0.0, 1.0], [1.0, 0.0]]
    assert found.strongest.tolist() == [1, 0]
    assert found.most == 1


def test_shape_keys_add_up(rng):
    offsets = [rng.normal(size=(5, 3)), rng.normal(size=(VERTICES, 3))]
    few = rng.choice(VERTICES, 5, replace=False)
    keys = ShapeKeys.of([Key("few", ((few, offsets[0]),)), Key("all", ((np.arange(VERTICES), offsets[1]),))], VERTICES)
    weights = rng.normal(size=2)
    wanted = weights[1] * offsets[1]
    wanted[few] += weights[0] * offsets[0]
    np.testing.assert_allclose(keys.offsets(weights), wanted, atol=1e-15)
    assert keys.table.matrix.nnz == 3 * (5 + VERTICES)
    gradient = jax.jacfwd(keys.offsets)(weights)
    np.testing.assert_allclose(gradient[..., 1], offsets[1], atol=1e-15)


@pytest.mark.parametrize("weight", [-1.0, 0.0, 0.1, 0.25, 0.6, 1.0, 1.7])
def test_in_betweens_are_piecewise_linear(rng, weight):
    """Shapes at .25 and 1, and one below 0; beyond the last one on along the last piece."""
    places = np.array([-0.5, 0.0, 0.25, 1.0])
    shapes = np.concatenate([rng.normal(size=(1, 3)), np.zeros((1, 3)), rng.normal(size=(2, 3))])
    own = tuple(([0], shapes[k : k + 1]) for k in (2, 3, 0))
    keys = ShapeKeys.of([Key("key", own, (0.25, 1.0, -0.5))], 1)
    k = min(max(int(np.searchsorted(places, weight, side="right")) - 1, 0), 2)
    share = (weight - places[k]) / (places[k + 1] - places[k])
    wanted = (1 - share) * shapes[k] + share * shapes[k + 1]
    np.testing.assert_allclose(keys.offsets(np.array([weight]))[0], wanted, atol=1e-15)


@pytest.mark.parametrize(
    ("indices", "offsets", "says"),
    [
        ([0, 4], np.zeros((2, 3)), "'smile' moves vertex 4, but there are 4"),
        ([-1], np.zeros((1, 3)), "'smile' moves vertex -1"),
        ([0, 1], np.zeros((1, 3)), r"'smile' needs offsets \(n, 3\) for its 2 vertices"),
        ([0], np.full((1, 3), np.inf), "'smile' has offsets that are not finite"),
    ],
)
def test_keys_that_are_none(indices, offsets, says):
    with pytest.raises(InputError, match=says):
        ShapeKeys.of([Key("smile", ((indices, offsets),))], 4)


PARENTS = [-1, 0, 1, 1, 0, -1, 5]


def to_square(matrices):
    last = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (*matrices.shape[:-2], 1, 4))
    return np.concatenate([matrices, last], axis=-2)


def random_skeleton(rng):
    return Skeleton.of([f"joint{k}" for k in range(BONES)], PARENTS, to_square(rigid(rng, BONES)))


def test_world_transforms_are_products_along_the_tree(rng):
    skeleton = random_skeleton(rng)
    assert skeleton.depth.tolist() == [0, 1, 2, 2, 1, 0, 1]
    local = to_square(rigid(rng, BONES))
    wanted = []
    for joint, parent in enumerate(PARENTS):
        wanted.append(local[joint] if parent < 0 else wanted[parent] @ local[joint])
    np.testing.assert_allclose(skeleton.world(local), wanted, atol=1e-13)
    found = np.einsum("jab,jbc->jac", wanted, np.linalg.inv(skeleton.bind))[:, :3]
    np.testing.assert_allclose(skeleton.transforms(local), found, atol=1e-12)


def test_the_rest_pose_moves_nothing(rng):
    skeleton = random_skeleton(rng)
    np.testing.assert_allclose(skeleton.transforms(skeleton.rest), np.tile(np.eye(3, 4), (BONES, 1, 1)), atol=1e-12)


@pytest.mark.parametrize(
    ("parents", "bind", "says"),
    [
        ([-1, 2, 1], np.tile(np.eye(4), (3, 1, 1)), "'b' is its own ancestor"),
        ([-1, 1, 0], np.tile(np.eye(4), (3, 1, 1)), "'b' is its own ancestor"),
        ([-1, 0, 3], np.tile(np.eye(4), (3, 1, 1)), "'c' has the parent 3, but there are 3"),
        ([-1, 0, 0], None, "needs a bind transform"),
        ([-1, 0, 0], np.tile(np.eye(4), (2, 1, 1)), "3 joints, 3 parents, 2 bind transforms"),
        (
            [-1, 0, 0],
            np.stack([np.eye(4), np.zeros((4, 4)), np.eye(4)]),
            "bind transform of joint 'b' cannot be inverted",
        ),
    ],
)
def test_skeletons_that_are_none(parents, bind, says):
    with pytest.raises(InputError, match=says):
        Skeleton.of("abc", parents, bind)


def test_motion_between_its_samples(rng):
    """Against SciPy's Slerp, and linear interpolation."""
    from scipy.spatial.transform import Rotation, Slerp

    times = np.array([1.0, 2.0, 4.0])
    moves, turns, scales = rng.normal(size=(3, 2, 3)), rng.normal(size=(3, 2, 4)), rng.uniform(1, 2, (3, 2, 3))
    turns /= np.linalg.norm(turns, axis=2, keepdims=True)
    motion = Motion(times, moves, turns, scales, keys=np.array([[0.0], [1.0], [3.0]]))
    for time in (0.0, 1.0, 1.3, 2.0, 3.5, 4.0, 9.0):
        at = np.clip(time, 1.0, 4.0)
        found = np.asarray(motion.local(time))
        for joint in range(2):
            rotation = Slerp(times, Rotation.from_quat(turns[:, joint, [1, 2, 3, 0]]))(at).as_matrix()
            scale = [np.interp(at, times, scales[:, joint, k]) for k in range(3)]
            move = [np.interp(at, times, moves[:, joint, k]) for k in range(3)]
            np.testing.assert_allclose(found[joint, :3, :3], rotation * scale, atol=1e-12)
            np.testing.assert_allclose(found[joint, :3, 3], move, atol=1e-14)
        np.testing.assert_allclose(motion.weights(time), [np.interp(at, times, [0.0, 1.0, 3.0])], atol=1e-15)
    assert motion.span == (1.0, 4.0)
    gradient = jax.jacfwd(motion.local)(1.3)
    difference = (motion.local(1.3 + 1e-6) - motion.local(1.3 - 1e-6)) / 2e-6
    np.testing.assert_allclose(gradient, difference, atol=1e-8)


def test_equal_rotations_have_finite_derivatives():
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (2, 3, 1))
    motion = Motion(np.array([0.0, 1.0]), np.zeros((2, 3, 3)), turns)
    assert np.isfinite(jax.jacfwd(motion.local)(0.5)).all()
    single = Motion(np.array([2.0]), np.ones((1, 3, 3)), turns[:1])
    assert np.asarray(single.local(7.0))[:, :3, 3].tolist() == [[1.0] * 3] * 3


def test_motions_and_rigs_that_are_none(rng):
    for times in ([], [1.0, 1.0], [2.0, 1.0], [np.nan]):
        with pytest.raises(InputError, match="times of a motion must be"):
            Motion(np.array(times, float))
    with pytest.raises(InputError, match="2 times but 3 keys"):
        Motion(np.array([0.0, 1.0]), keys=np.zeros((3, 1)))
    with pytest.raises(InputError, match="both a skeleton and the influences"):
        Rig(skeleton=random_skeleton(rng))
    with pytest.raises(InputError, match="influences are of 2 joints, the skeleton has 7"):
        Rig(random_skeleton(rng), Influences.of([[0, 1]], [[1.0, 1.0]], 2))
