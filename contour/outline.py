"""The contacts of many contours as polylines in Pi: which were passed, and what lies on them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["Outlines", "quarter_turn", "unit"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

NEAR = 0.35
"""A contact was passed by a step if it lies within this share of the step's length of it."""
RECENT = 3
"""So many last contacts cannot have been come back to."""
SAME_SIDE = 0.3
"""Least cosine between normals of contacts on one stretch of an outline: the two sides of a fin have -1."""


def quarter_turn(vector: FloatArray) -> FloatArray:
    """(n, 2) vectors of Pi turned by +90 deg, from +x_s towards +z_s."""
    return np.stack((-vector[..., 1], vector[..., 0]), axis=-1)


def unit(vector: FloatArray) -> FloatArray:
    """(n, k) vectors at length one; zero stays zero."""
    norm = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.asarray(vector / np.where(norm > 0.0, norm, 1.0))


class Outlines:
    """Touches and normals of n contours, in the order of localising."""

    def __init__(self, contours: int) -> None:
        self.count = np.zeros(contours, dtype=np.int64)
        """(n,) contacts added."""
        self.felt = np.zeros(contours, dtype=np.int64)
        """(n,) of them those that were really there."""
        self._split = np.full(contours, -1, dtype=np.int64)
        # Missing contacts are NaN: every comparison with them is false.
        self._touch = np.full((contours, 16, 2), np.nan)
        self._normal = np.full((contours, 16, 2), np.nan)

    def add(self, which: IntArray, touch: FloatArray, normal: FloatArray, felt: BoolArray) -> None:
        """Append one contact (k, 2) m with its normal (k, 2) to each of ``which``; unfelt ones keep their number only."""
        at = self.count[which]
        if at.size and int(at.max()) >= self._touch.shape[1]:
            more = np.full_like(self._touch, np.nan)
            self._touch = np.concatenate((self._touch, more), axis=1)
            self._normal = np.concatenate((self._normal, more), axis=1)
        self._touch[which, at] = np.where(felt[:, None], touch, np.nan)
        self._normal[which, at] = normal
        self.count[which] += 1
        self.felt[which] += felt

    def turn_round(self, which: IntArray) -> None:
        """From here on contacts are on the other side of the first one."""
        self._split[which] = self.count[which]

    def first(self, which: IntArray) -> tuple[FloatArray, FloatArray]:
        """(k, 2) m and (k, 2): the first contact that was felt, and its normal."""
        at = np.argmax(np.isfinite(self._touch[which, :, 0]), axis=1)
        return self._touch[which, at], self._normal[which, at]

    def place(self, which: IntArray, order: IntArray) -> IntArray:
        """(m,) places along the contours of the contacts that were localised as number ``order``."""
        split, count = self._split[which], self.count[which]
        turned = np.where(order >= split, count - 1 - order, order + count - split)
        return np.where(split >= 0, turned, order)

    def passed(
        self, which: IntArray, start: FloatArray, start_normal: FloatArray, end: FloatArray, end_normal: FloatArray
    ) -> tuple[BoolArray, BoolArray]:
        """Whether the steps ``start`` to ``end`` (k, 2) m pass each contour's first contact, or any but its recent ones.

        The end itself is already among the contacts. Passing means to come within a share of the step's length, on
        the same side of the body.
        """
        along = end - start
        length = np.maximum(np.linalg.norm(along, axis=1), 1e-12)
        along = along / length[:, None]
        width = int(self.count[which].max())
        away = self._touch[which, :width] - start[:, None, :]
        ahead = np.einsum("nck,nk->nc", away, along) / length[:, None]
        aside = np.abs(away[..., 0] * along[:, None, 1] - away[..., 1] * along[:, None, 0]) / length[:, None]
        normal = self._normal[which, :width]
        side = np.maximum(np.einsum("nck,nk->nc", normal, start_normal), np.einsum("nck,nk->nc", normal, end_normal))
        # One slightly beyond the end would only be touched again by the next step.
        near = (ahead > 0.0) & (ahead < 1.0 + NEAR) & (aside < NEAR) & (side > SAME_SIDE)
        near &= np.arange(width) < (self.count[which] - RECENT)[:, None]
        first = np.argmax(np.isfinite(self._touch[which, :width, 0]), axis=1)
        return near[np.arange(which.size), first], near.any(axis=1)

    def lies_on(self, point: FloatArray, which: IntArray, closed: BoolArray) -> BoolArray:
        """(k,) whether ``point`` (k, 2) m lies on the polyline of the contour ``which`` (k,)."""
        width = int(self.count[which].max(initial=0))
        touch = self._touch[which, :width]
        # Both ways from the first contact make one polyline; the last contact of a closed one meets the first.
        order = np.argsort(np.where(np.arange(width) < self.count[which][:, None], self._places(which, width), width), axis=1)
        chain = np.take_along_axis(touch, order[..., None], axis=1)
        following = np.roll(chain, -1, axis=1)
        final = np.arange(width) == (self.count[which] - 1)[:, None]
        following = np.where(final[..., None], np.where(closed[:, None, None], chain[:, :1], np.nan), following)
        along = following - chain
        square = np.maximum((along**2).sum(axis=2), 1e-24)
        share = np.clip(np.einsum("nck,nck->nc", point[:, None, :] - chain, along) / square, 0.0, 1.0)
        foot = chain + share[..., None] * along
        distance = np.linalg.norm(foot - point[:, None, :], axis=2)
        return np.asarray((distance < NEAR * np.sqrt(square)).any(axis=1))

    def _places(self, which: IntArray, width: int) -> IntArray:
        order = np.broadcast_to(np.arange(width), (which.size, width))
        return self.place(np.repeat(which, width), order.ravel()).reshape(which.size, width)
