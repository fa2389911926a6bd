"""Patches of one form: all rational or all polynomial, all of one bi-degree; their shape stays as it is."""

from __future__ import annotations

import numpy as np

from slefejax.geometry.bezier import elevate


def common_weights(patches: list[np.ndarray]) -> tuple[list[np.ndarray], tuple[str, ...]]:
    """Patches that are all rational or all polynomial, and what that took."""
    rational = [patch.shape[2] == 4 for patch in patches]
    if not any(rational) or all(rational):
        return patches, ()
    same = [
        p if r else np.concatenate([p, np.ones_like(p[..., :1])], axis=2)
        for p, r in zip(patches, rational, strict=True)
    ]
    return same, (f"{len(patches) - sum(rational)} of {len(patches)} patches got weights of 1, as others are rational",)


def common_degree(patches: list[np.ndarray]) -> tuple[np.ndarray, tuple[str, ...]]:
    """Patches raised to the highest degrees along u and along v, as one array, and what that took."""
    degrees = np.array([np.subtract(patch.shape[:2], 1) for patch in patches])
    du, dv = degrees.max(axis=0).tolist()
    raised = int(np.any(degrees != (du, dv), axis=1).sum())
    if raised == 0:
        return np.stack(patches), ()
    same = [np.swapaxes(elevate(np.swapaxes(elevate(p, du), 0, 1), dv), 0, 1) for p in patches]
    return np.stack(same), (
        f"{raised} of {len(patches)} patches were raised to bi-degree {du} x {dv}, the highest here",
    )
