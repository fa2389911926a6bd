"""Patches of one form: all rational or all polynomial, all of one bi-degree; their shape stays as it is.

Patches come as blocks ``(patches, du+1, dv+1, dim)``, each of one bi-degree and dimension.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from slefejax.geometry.bezier import elevate

Block = np.ndarray


def blocks_of(patches: Sequence[np.ndarray]) -> list[Block]:
    """Patches of any shapes, as blocks of those of one shape that follow each other.

    >>> [block.shape for block in blocks_of([np.zeros((2, 2, 3)), np.ones((2, 2, 3)), np.zeros((4, 4, 3))])]
    [(2, 2, 2, 3), (1, 4, 4, 3)]
    """
    return [np.stack(list(alike)) for _, alike in groupby(patches, key=lambda patch: patch.shape)]


def patches_of(blocks: list[Block]) -> list[np.ndarray]:
    """Patch by patch, without a copy.

    >>> len(patches_of([np.zeros((2, 4, 4, 3)), np.zeros((3, 2, 2, 3))]))
    5
    """
    return [patch for block in blocks for patch in block]


def common_weights(blocks: list[Block]) -> tuple[list[Block], tuple[str, ...]]:
    """Blocks that are all rational or all polynomial, and what that took.

    >>> blocks, notes = common_weights([np.zeros((1, 2, 2, 3)), np.ones((2, 2, 2, 4))])
    >>> blocks[0][..., 3].tolist(), notes
    ([[[1.0, 1.0], [1.0, 1.0]]], ('1 of 3 patches got weights of 1, as others are rational',))
    """
    plain = [block.shape[3] == 3 for block in blocks]
    if all(plain) or not any(plain):
        return blocks, ()
    same = [
        np.concatenate([block, np.ones_like(block[..., :1])], axis=3) if without else block
        for block, without in zip(blocks, plain, strict=True)
    ]
    changed = sum(len(block) for block, without in zip(blocks, plain, strict=True) if without)
    whole = sum(len(block) for block in blocks)
    return same, (f"{changed} of {whole} patches got weights of 1, as others are rational",)


def common_degree(blocks: list[Block]) -> tuple[Block, tuple[str, ...]]:
    """Patches raised to the highest degrees along u and along v, as one array, and what that took.

    >>> whole, notes = common_degree([np.zeros((1, 2, 2, 3)), np.zeros((2, 4, 3, 3))])
    >>> whole.shape, notes
    ((3, 4, 3, 3), ('1 of 3 patches were raised to bi-degree 3 x 2, the highest here',))
    """
    du, dv = (max(block.shape[axis] for block in blocks) - 1 for axis in (1, 2))
    raised = sum(len(block) for block in blocks if block.shape[1:3] != (du + 1, dv + 1))
    whole = np.concatenate([_raised(block, du, dv) for block in blocks]) if len(blocks) > 1 else blocks[0]
    if raised == 0:
        return whole, ()
    return whole, (f"{raised} of {len(whole)} patches were raised to bi-degree {du} x {dv}, the highest here",)


def _raised(block: Block, du: int, dv: int) -> Block:
    for axis, degree in ((1, du), (2, dv)):
        block = np.swapaxes(elevate(np.swapaxes(block, 0, axis), degree), 0, axis)
    return block
