"""Cameras all around a scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slefejax.arguments import check_whole
from slefejax.errors import InputError
from slefejax.framing import clipping_planes
from slefejax.geometry.view import View, bounding_sphere, frame
from slefejax.scene import Scene


def cameras_around(scene: Scene, width: int, height: int, count: int, seed: int = 0) -> list[View]:
    """The scene's own view, and others that hold all of it, spread over a sphere around it; the same for one seed.

    scene         : as ``load`` gives it; of one that moves, as it stands at rest
    width, height : of the pictures, pixels
    count         : how many views
    seed          : of where on the sphere the others start, and how far each is from the middle of its share

    The first is ``scene.default_camera`` with clipping planes that hold the scene between them, the others look at the
    centre of its box, with a field of view of 45 degrees and the scene's own direction up.

    Raises InputError for what is no scene, for one with points that are not finite, and unless sizes and count are
    whole numbers of at least 1, the seed of at least 0.

    >>> from slefejax import load
    >>> views = cameras_around(load("teapot"), 320, 200, 5)
    >>> len(views), views[0].camera.eye.tolist()
    (5, [4.5, -6.0, 4.0])
    """
    if not isinstance(scene, Scene):
        raise InputError(f"cameras look at a slefejax.Scene, as load gives it, not at {type(scene).__name__}")
    for name, value, lowest in (("width", width, 1), ("height", height, 1), ("count", count, 1), ("seed", seed, 0)):
        check_whole(name, value, lowest)
    points = scene.points()
    sphere = bounding_sphere(points)  # says what is wrong with the scene before anything is framed
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0.0, 2.0 * np.pi)
    golden = np.pi * (3.0 - np.sqrt(5.0))
    own = scene.default_camera(width / height)
    near, far = clipping_planes(sphere, own, own.eye)
    views = [View(replace(own, near=float(near), far=float(far)), width, height)]
    for k in range(1, count):
        z = 0.95 * (1.0 - 2.0 * (k - rng.uniform()) / max(1, count - 1))
        angle, r = turn + golden * k, np.sqrt(1.0 - z * z)
        direction = (r * np.cos(angle), r * np.sin(angle), z)
        camera = frame(points, direction, aspect=width / height, up=scene.up)
        views.append(View(camera, width, height))
    return views
