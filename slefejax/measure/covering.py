"""Covering accuracy: does the right piece of surface control each pixel? (docs/math.md, 4; [YBP12], section 3)

A picture is compared with a reference of the same view: the scene cut far finer, with several samples in each pixel.
A pixel is right if what it shows is among what the reference's samples in it show, and in the same depth. It is wrong
by

- *patch*: its patch, or the background, is in none of the samples;
- *depth*: its patch is there, but at another depth than any sample, by more than the samples differ among themselves.

Pixels on silhouettes, next to the background or to a jump in the reference's depth, are counted apart: there a shift
of a hair's breadth changes what is seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from slefejax.errors import InputError
from slefejax.late import one_at_a_time

Mask = Bool[np.ndarray, "height width"]


@dataclass(frozen=True)
class Covering:
    """Which pixels are wrong; masks ``(height, width)``, row 0 at the bottom.

    wrong_patch, wrong_depth : as in the module's docstring; no pixel is both
    silhouette               : pixels next to the background or to a jump in depth, in the reference
    covered                  : pixels that the reference covers, wholly or in part
    """

    wrong_patch: Mask
    wrong_depth: Mask
    silhouette: Mask
    covered: Mask

    @property
    def wrong(self) -> Mask:
        """Wrong by patch or by depth."""
        return self.wrong_patch | self.wrong_depth

    def regions(self, mask: Mask) -> Int[np.ndarray, "regions"]:
        """Sizes in pixels of the connected regions of a mask, the largest first."""
        measure, _ = _libraries()
        found = measure.regionprops(measure.label(mask, connectivity=2))
        return np.array(sorted((int(region.area) for region in found), reverse=True), int)

    def summary(self) -> dict[str, Any]:
        """Shares of the covered pixels and sizes of regions, for a table."""
        count = max(1, int(np.count_nonzero(self.covered)))
        inside = self.wrong & ~self.silhouette
        sizes = self.regions(inside)
        return {
            "share_wrong_silhouette": float(np.count_nonzero(self.wrong & self.silhouette) / count),
            "share_wrong_patch_inside": float(np.count_nonzero(self.wrong_patch & ~self.silhouette) / count),
            "share_wrong_depth_inside": float(np.count_nonzero(self.wrong_depth & ~self.silhouette) / count),
            "wrong_regions_inside": len(sizes),
            "largest_wrong_region_px": int(sizes[0]) if len(sizes) else 0,
        }


def covering_error(seen: Any, reference: Any, jump: float = 1e-3) -> Covering:
    """Compare a picture with a reference of the same view and k x k times as many pixels.

    seen, reference : with ``.patch`` and ``.depth``, ``(height, width)`` and ``(k height, k width)``, k >= 2
                      (``slefejax.gpu.GBuffer``); patch -1 and depth 1 for the background
    jump            : difference of window depth between samples of a pixel that makes it a silhouette

    Raises InputError if the reference's size is no multiple, at least the double, of the picture's, and where
    scikit-image (extra ``app``) is not installed.

    >>> from types import SimpleNamespace as Buffer
    >>> fine = Buffer(patch=np.zeros((8, 8), int), depth=np.full((8, 8), 0.5))
    >>> shown = Buffer(patch=np.zeros((4, 4), int), depth=np.full((4, 4), 0.5))
    >>> shown.patch[1, 2] = 1
    >>> covering_error(shown, fine).summary()["share_wrong_patch_inside"]
    0.0625
    """
    height, width = seen.patch.shape
    k, rest = divmod(reference.patch.shape[0], height)
    if rest or k < 2 or reference.patch.shape != (k * height, k * width):
        raise InputError(
            f"the reference must have k x k samples a pixel, k >= 2: {reference.patch.shape} is no such multiple of"
            f" {seen.patch.shape}"
        )
    patches, depths = (_samples(array, k) for array in (reference.patch, reference.depth))
    same = patches == seen.patch
    wrong_patch = ~same.any(axis=0)
    low = np.min(np.where(same, depths, np.inf), axis=0)
    high = np.max(np.where(same, depths, -np.inf), axis=0)
    with np.errstate(invalid="ignore"):  # where no sample shows the patch
        # a pixel's centre lies between its samples, but the surface may bulge by as much as they differ
        margin = np.maximum(high - low, jump)
        wrong_depth = ~wrong_patch & (seen.patch >= 0) & ((seen.depth < low - margin) | (seen.depth > high + margin))
    partly = (patches < 0).any(axis=0) & (patches >= 0).any(axis=0)
    jumps = (np.ptp(depths, axis=0) > jump) & (patches >= 0).all(axis=0)
    border = _changes(patches.max(axis=0) < 0)
    _, morphology = _libraries()
    silhouette = morphology.dilation(partly | jumps | border, np.ones((3, 3)))
    return Covering(wrong_patch, wrong_depth, silhouette.astype(bool), np.asarray((patches >= 0).any(axis=0)))


def _libraries() -> tuple[Any, Any]:
    """``skimage.measure`` and ``skimage.morphology``."""
    try:
        with one_at_a_time:
            from skimage import measure, morphology
    except ImportError:
        raise InputError("to compare pictures, install scikit-image (pip install 'slefejax[app]')") from None
    return measure, morphology


def _samples(array: np.ndarray, k: int) -> np.ndarray:
    """``(k*k, height, width)``: the samples of every pixel."""
    height, width = (n // k for n in array.shape)
    return array.reshape(height, k, width, k).transpose(1, 3, 0, 2).reshape(k * k, height, width)


def _changes(mask: Mask) -> Mask:
    """Pixels with a neighbour that differs."""
    found = np.zeros_like(mask)
    for axis in (0, 1):
        differ = np.diff(mask, axis=axis)
        found |= np.pad(differ, [(1, 0) if a == axis else (0, 0) for a in (0, 1)])
        found |= np.pad(differ, [(0, 1) if a == axis else (0, 0) for a in (0, 1)])
    return found
