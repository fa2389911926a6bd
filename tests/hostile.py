"""Control nets and cameras that are meant to break a bound: seeded, so that every case can be made again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slefejax.view import Camera, View

KINDS = ("smooth", "rough", "twisted", "collapsed", "repeated", "flat", "straight", "folded")
VIEWS = ("around", "close", "inside", "oblique", "far-off-centre", "orthographic", "wide")


@dataclass(frozen=True)
class Case:
    """Patches of one bi-degree in one view."""

    name: str
    patches: np.ndarray
    view: View


def case(seed: int, count: int, *, scale_decades: float = 6.0, weight_decades: float = 6.0) -> Case:
    """A case of its own for every seed: bi-degrees 1 to 5, every other seed rational, scales, weights over decades."""
    rng = np.random.default_rng(seed)
    degrees = (int(rng.integers(1, 6)), int(rng.integers(1, 6)))
    rational = bool(seed % 2)
    looks = VIEWS[seed % len(VIEWS)]
    nets = np.stack([_net(rng, degrees, KINDS[k % len(KINDS)]) for k in range(count)])
    if rational:
        weights = 10.0 ** (rng.uniform(-0.5, 0.5, nets.shape[:3]) * rng.uniform(0.0, weight_decades, (count, 1, 1)))
        nets = np.concatenate([nets * weights[..., None], weights[..., None]], axis=3)
    scale = 10.0 ** rng.uniform(-0.5 * scale_decades, 0.5 * scale_decades)
    nets[..., :3] *= scale
    name = f"seed {seed}: bi-degree {degrees}, {'rational' if rational else 'polynomial'}, {looks}, scale {scale:.3g}"
    return Case(name, nets, View(_camera(rng, looks, scale), 800, 600))


def _net(rng: np.random.Generator, degrees: tuple[int, int], kind: str) -> np.ndarray:
    du, dv = degrees
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, du + 1), np.linspace(-0.5, 0.5, dv + 1), indexing="ij")
    net = np.stack([u, v, np.zeros_like(u)], axis=2) @ rng.normal(size=(3, 3)) + rng.normal(size=3) * 0.3
    if kind == "flat":
        net[..., 2] = 0.0
    elif kind != "straight":
        size = {"smooth": 0.1, "rough": 0.6, "folded": 1.5}.get(kind, 0.3)
        net = net + size * rng.normal(size=net.shape)
    if kind == "twisted":
        net[-1, -1] += rng.normal(size=3)
    elif kind == "collapsed":
        edge = [(0, slice(None)), (slice(None), 0), (-1, slice(None)), (slice(None), -1)][rng.integers(4)]
        net[edge] = net[edge][:1]
    elif kind == "repeated":
        for _ in range(3):
            a, b = ((rng.integers(du + 1), rng.integers(dv + 1)) for _ in range(2))
            net[a] = net[b]
    return net


def _camera(rng: np.random.Generator, looks: str, scale: float) -> Camera:
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    distance = {"close": 1.2, "inside": 0.2, "wide": 0.8, "far-off-centre": 4.0}.get(looks, 3.0)
    target = rng.normal(size=3) * {"oblique": 0.8, "far-off-centre": 1.5}.get(looks, 0.2)
    eye, target = scale * (target + distance * direction), scale * target
    near, far = 0.02 * scale, 50.0 * scale
    if looks == "orthographic":
        return Camera.orthographic(eye, target, height=2.5 * scale, near=near, far=far)
    fov = {"wide": 140.0, "inside": 100.0, "oblique": 70.0}.get(looks, 45.0)
    return Camera.look_at(eye, target, fov_y=fov, near=near, far=far)
