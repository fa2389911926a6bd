"""BVH: a hierarchy of joints at rest, and their motion, as plain text.

Rest offsets are from the parent, with no rotation: at rest all joints are turned as the file's axes are. In a frame a
joint's local transform is its offset plus its position channels, and the product of its rotation channels (degrees) as
they are listed. Keywords are read in any case, labels such as ``Frame Time:`` with any blanks.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from slefejax.io.limits import check_numbers
from slefejax.io.numbers import Numbers
from slefejax.late import one_at_a_time
from slefejax.model.rig import Motion

_CHANNELS = {f"{axis}{kind}": (kind, k) for kind in ("position", "rotation") for k, axis in enumerate("XYZ")}
_BY_LOWER = {name.lower(): channel for name, channel in _CHANNELS.items()}


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


@dataclass(slots=True)
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
    while (word := numbers.next("ROOT or MOTION")).upper() == "ROOT":
        _tree(numbers, joints)
    if word.upper() != "MOTION" or not joints:
        raise numbers.fail(f"{word[:40]!r} stands where {'MOTION' if joints else 'ROOT'} should be")
    frames, interval = _frames(numbers)
    check_numbers(path, f"{len(joints)} joints in {frames} frames", 7 * frames * len(joints))
    channels = sum(len(joint.channels) for joint in joints)
    values = array("d")
    for frame in range(frames if channels else 0):
        values.extend([numbers.real(f"a channel of frame {frame} (counted from 0)") for _ in range(channels)])
    if (item := numbers.rest()) is not None:
        raise numbers.fail(f"{item[:40]!r} follows the last of {frames} frames with {channels} channels")
    parents = np.array([joint.parent for joint in joints])
    offsets = np.array([joint.offset for joint in joints])
    motion = _motion(joints, offsets, np.array(values).reshape(frames, channels), interval)
    return Bvh(tuple(j.name for j in joints), parents, offsets, motion)


def _expect(numbers: Numbers, word: str) -> None:
    found = numbers.next(word)
    if found.upper() != word.upper():
        raise numbers.fail(f"{found[:40]!r} stands where {word} should be")


def _tree(numbers: Numbers, joints: list[_Joint]) -> None:
    """A root and all joints below it."""
    open_joints = [_begin(numbers, joints, -1)]
    while open_joints:
        joint = joints[open_joints[-1]]
        word = numbers.next("OFFSET, CHANNELS, JOINT, End or }")
        match word.upper():
            case "}":
                open_joints.pop()
            case "OFFSET":
                joint.offset = numbers.points((3,), f"the offset of joint {joint.name!r}")
            case "CHANNELS":
                count = numbers.whole(f"the number of channels of joint {joint.name!r}", 0, 6)
                joint.channels = [_channel(numbers) for _ in range(count)]
            case "JOINT":
                open_joints.append(_begin(numbers, joints, open_joints[-1]))
            case "END":
                _end_site(numbers)
            case _:
                raise numbers.fail(f"{word[:40]!r} stands where OFFSET, CHANNELS, JOINT, End or }} should be")


def _begin(numbers: Numbers, joints: list[_Joint], parent: int) -> int:
    """The number of a joint that begins."""
    joints.append(_Joint(numbers.next("the name of a joint"), parent, np.zeros(3), []))
    _expect(numbers, "{")
    return len(joints) - 1


def _channel(numbers: Numbers) -> tuple[str, int]:
    word = numbers.next("a channel")
    if word.lower() not in _BY_LOWER:
        raise numbers.fail(f"{word[:40]!r} is no channel: {', '.join(_CHANNELS)} are")
    return _BY_LOWER[word.lower()]


def _end_site(numbers: Numbers) -> None:
    _expect(numbers, "Site")
    _expect(numbers, "{")
    _expect(numbers, "OFFSET")
    numbers.points((3,), "the offset of an end site")
    _expect(numbers, "}")


def _label(numbers: Numbers, label: str) -> None:
    """A label with blanks or none between its words and before its colon, and a value that may follow it at once."""
    wanted, found, item = label.replace(" ", "").upper(), "", ""
    while len(found) < len(wanted):
        item = numbers.next(label)
        found += item.upper()
        if found[: len(wanted)] != wanted[: len(found)]:
            raise numbers.fail(f"{item[:40]!r} stands where {label} should be")
    if len(found) > len(wanted):
        numbers.keep(item[len(wanted) - len(found) :])


def _frames(numbers: Numbers) -> tuple[int, float]:
    _label(numbers, "Frames:")
    frames = numbers.whole("the number of frames", 1, 10**7)
    _label(numbers, "Frame Time:")
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
