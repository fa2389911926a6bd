"""BVH: a hierarchy of joints at rest, and their motion, as plain text.

Rest offsets are from the parent, with no rotation: at rest all joints are turned as the file's axes are. In a frame a
joint's local transform is its offset plus its position channels, and the product of its rotation channels (degrees) as
they are listed.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from slefejax.io.numbers import Numbers
from slefejax.late import one_at_a_time
from slefejax.rig import Motion

_CHANNELS = {f"{axis}{kind}": (kind, k) for kind in ("position", "rotation") for k, axis in enumerate("XYZ")}


@dataclass(frozen=True, eq=False)
class Bvh:
    """A hierarchy and its motion. ``times`` of the motion are seconds.

    names   : of the joints
    parents : ``(joints,)``, -1 for a root
    offsets : ``(joints, 3)``, from the parent at rest
    """

    names: tuple[str, ...]
    parents: Int[np.ndarray, "joints"]
    offsets: Float[np.ndarray, "joints 3"]
    motion: Motion


@dataclass
class _Joint:
    name: str
    parent: int
    offset: np.ndarray
    channels: list[tuple[str, int]]


def read_bvh(path: Path) -> Bvh:
    """The joints and the motion of a file. Raises InputError, with the file and the line, for what is none."""
    numbers = Numbers(path)
    _expect(numbers, "HIERARCHY")
    joints: list[_Joint] = []
    while (word := numbers.next("ROOT or MOTION")) == "ROOT":
        _joint(numbers, joints, -1)
    if word != "MOTION" or not joints:
        raise numbers.fail(f"{word[:40]!r} stands where {'MOTION' if joints else 'ROOT'} should be")
    frames, interval = _frames(numbers)
    channels = sum(len(joint.channels) for joint in joints)
    values = np.array(
        [
            [numbers.real(f"a channel of frame {frame} (counted from 0)") for _ in range(channels)]
            for frame in range(frames)
        ]
    )
    if (item := numbers.rest()) is not None:
        raise numbers.fail(f"{item[:40]!r} follows the last of {frames} frames with {channels} channels")
    parents = np.array([joint.parent for joint in joints])
    offsets = np.array([joint.offset for joint in joints])
    return Bvh(tuple(j.name for j in joints), parents, offsets, _motion(joints, offsets, values, interval))


def _expect(numbers: Numbers, word: str) -> None:
    found = numbers.next(word)
    if found != word:
        raise numbers.fail(f"{found[:40]!r} stands where {word} should be")


def _joint(numbers: Numbers, joints: list[_Joint], parent: int) -> None:
    """A joint and, one after the other, those below it."""
    number = len(joints)
    joint = _Joint(numbers.next("the name of a joint"), parent, np.zeros(3), [])
    joints.append(joint)
    _expect(numbers, "{")
    while (word := numbers.next("OFFSET, CHANNELS, JOINT, End or }")) != "}":
        if word == "OFFSET":
            joint.offset = numbers.points((3,), f"the offset of joint {joint.name!r}")
        elif word == "CHANNELS":
            count = numbers.whole(f"the number of channels of joint {joint.name!r}", 0, 6)
            joint.channels = [_channel(numbers) for _ in range(count)]
        elif word == "JOINT":
            _joint(numbers, joints, number)
        elif word == "End":
            _end_site(numbers)
        else:
            raise numbers.fail(f"{word[:40]!r} stands where OFFSET, CHANNELS, JOINT, End or }} should be")


def _channel(numbers: Numbers) -> tuple[str, int]:
    word = numbers.next("a channel")
    if word not in _CHANNELS:
        raise numbers.fail(f"{word[:40]!r} is no channel: {', '.join(_CHANNELS)} are")
    return _CHANNELS[word]


def _end_site(numbers: Numbers) -> None:
    _expect(numbers, "Site")
    _expect(numbers, "{")
    _expect(numbers, "OFFSET")
    numbers.points((3,), "the offset of an end site")
    _expect(numbers, "}")


def _frames(numbers: Numbers) -> tuple[int, float]:
    _expect(numbers, "Frames:")
    frames = numbers.whole("the number of frames", 1, 10**7)
    _expect(numbers, "Frame")
    _expect(numbers, "Time:")
    interval = numbers.real("the time of a frame")
    if interval <= 0:
        raise numbers.fail(f"the time of a frame must be positive, not {interval:g}")
    return frames, interval


def _motion(joints: list[_Joint], offsets: np.ndarray, values: np.ndarray, interval: float) -> Motion:
    with one_at_a_time:
        from scipy.spatial.transform import Rotation

    translations = np.repeat(offsets[None], len(values), axis=0)
    rotations = np.zeros((len(values), len(joints), 4))
    at = 0
    for number, joint in enumerate(joints):
        turn = Rotation.identity(len(values))
        for kind, axis in joint.channels:
            if kind == "position":
                translations[:, number, axis] += values[:, at]
            else:
                turn = turn * Rotation.from_euler("xyz"[axis], values[:, at : at + 1], degrees=True)
            at += 1
        rotations[:, number] = turn.as_quat()[:, [3, 0, 1, 2]]
    return Motion(interval * np.arange(len(values)), translations, rotations)
