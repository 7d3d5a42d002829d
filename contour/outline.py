"""The contacts of many contours as polylines in Pi: which were passed, and what lies on them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contour.frames import wrap_angle

__all__ = ["Outlines", "predicted_normal", "quarter_turn", "unit"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

NEAR = 0.35
"""A contact was passed by a step if it lies within this share of the step's length of it."""
RECENT = 3
"""So many last contacts cannot have been come back to."""
SAME_SIDE = 0.3
"""Least cosine between normals of contacts on one stretch of an outline: the two sides of a fin have -1."""
CHANGE_GAIN = 3.0
"""Expected deviation of the normal over what two extrapolations of it differ by more than their noise."""

UNKNOWN_SHARE = 0.3
"""That difference as share of the turn from chord to chord, where the last normal is not known."""


def quarter_turn(vector: FloatArray) -> FloatArray:
    """(n, 2) vectors of Pi turned by +90 deg, from +x_s towards +z_s."""
    return np.stack((-vector[..., 1], vector[..., 0]), axis=-1)


def unit(vector: FloatArray) -> FloatArray:
    """(n, k) vectors at length one; zero stays zero."""
    norm = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.asarray(vector / np.where(norm > 0.0, norm, 1.0))


def predicted_normal(
    here: FloatArray,
    last: FloatArray,
    before: FloatArray,
    measured: FloatArray,
    sigma: FloatArray,
    *,
    sense: FloatArray,
    three: BoolArray,
    touch_sigma: float,
) -> tuple[FloatArray, FloatArray]:
    """Outer normal (k,) rad at the newest touch ``here`` (k, 2) m and its sigma (k,) rad, from touches.

    Args:
        here: newest touch.
        last: the one before.
        before: the one before that; means something where ``three``.
        measured: (k,) rad, normal at ``last``.
        sigma: (k,) rad, its standard deviation; infinite where it was not measured.
        sense: (k,) 1 where the contour goes along the normal turned by +90 deg, -1 the other way.
        three: (k,) whether the three touches lie on one smooth stretch.
        touch_sigma: standard deviation of a touch [m].
    """
    side = -0.5 * np.pi * sense  # from tangent to outer normal
    d2 = np.maximum(np.linalg.norm(here - last, axis=1), 1e-9)
    d1 = np.maximum(np.linalg.norm(last - before, axis=1), 1e-9)
    chord = np.arctan2(here[:, 1] - last[:, 1], here[:, 0] - last[:, 0]) + side
    earlier = np.arctan2(last[:, 1] - before[:, 1], last[:, 0] - before[:, 0]) + side
    # The chord's normal is halfway between those of its ends: the normal at the last touch gives the new one,
    # and so does, without that normal's error, the turn from chord to chord.
    mirrored = chord + wrap_angle(chord - measured)
    lean = d2 / (d1 + d2)
    parabola = chord + lean * wrap_angle(chord - earlier)
    noise = touch_sigma * np.sqrt(
        ((1.0 + lean) / d2) ** 2 + ((1.0 + lean) / d2 + lean / d1) ** 2 + (lean / d1) ** 2
    )
    # Where the curvature changes the two disagree beyond their noise. The change may have begun anywhere in
    # the last step; from its middle on the normal has turned more by five times what the two differ by.
    known = np.isfinite(sigma)
    spread = np.where(known, sigma, 0.0)
    change = np.where(known, wrap_angle(parabola - mirrored), UNKNOWN_SHARE * wrap_angle(chord - earlier))
    excess = np.sqrt(np.maximum(change**2 - noise**2 - spread**2, 0.0))
    alone = np.hypot(wrap_angle(chord - measured), spread)
    outward = np.where(three, parabola, mirrored)
    return outward, np.hypot(noise, np.where(three, CHANGE_GAIN * excess, alone))


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
        """Append one contact (k, 2) m with its normal (k, 2) to each of ``which``; unfelt ones keep their
        number only.
        """
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
        self,
        which: IntArray,
        start: FloatArray,
        start_normal: FloatArray,
        end: FloatArray,
        end_normal: FloatArray,
    ) -> tuple[BoolArray, BoolArray]:
        """Whether the steps ``start`` to ``end`` (k, 2) m pass each contour's first contact, or any but its
        recent ones.

        The end itself is already among the contacts. Passing means to come within a share of the step's
        length, on the same side of the body.
        """
        along = end - start
        length = np.maximum(np.linalg.norm(along, axis=1), 1e-12)
        along = along / length[:, None]
        width = int(self.count[which].max())
        away = self._touch[which, :width] - start[:, None, :]
        ahead = np.einsum("nck,nk->nc", away, along) / length[:, None]
        aside = np.abs(away[..., 0] * along[:, None, 1] - away[..., 1] * along[:, None, 0]) / length[:, None]
        normal = self._normal[which, :width]
        side = np.maximum(
            np.einsum("nck,nk->nc", normal, start_normal), np.einsum("nck,nk->nc", normal, end_normal)
        )
        # One slightly beyond the end would only be touched again by the next step.
        near = (ahead > 0.0) & (ahead < 1.0 + NEAR) & (aside < NEAR) & (side > SAME_SIDE)
        near &= np.arange(width) < (self.count[which] - RECENT)[:, None]
        first = np.argmax(np.isfinite(self._touch[which, :width, 0]), axis=1)
        return near[np.arange(which.size), first], near.any(axis=1)

    def lies_on(self, point: FloatArray, which: IntArray, closed: BoolArray) -> BoolArray:
        """(k,) whether ``point`` (k, 2) m lies on the polyline of the contour ``which`` (k,)."""
        width = int(self.count[which].max(initial=0))
        touch = self._touch[which, :width]
        # Both ways from the first contact make one polyline; the last contact of a closed one meets the
        # first.
        order = np.argsort(
            np.where(np.arange(width) < self.count[which][:, None], self._places(which, width), width), axis=1
        )
        chain = np.take_along_axis(touch, order[..., None], axis=1)
        following = np.roll(chain, -1, axis=1)
        final = np.arange(width) == (self.count[which] - 1)[:, None]
        following = np.where(
            final[..., None], np.where(closed[:, None, None], chain[:, :1], np.nan), following
        )
        along = following - chain
        square = np.maximum((along**2).sum(axis=2), 1e-24)
        share = np.clip(np.einsum("nck,nck->nc", point[:, None, :] - chain, along) / square, 0.0, 1.0)
        foot = chain + share[..., None] * along
        distance = np.linalg.norm(foot - point[:, None, :], axis=2)
        return np.asarray((distance < NEAR * np.sqrt(square)).any(axis=1))

    def _places(self, which: IntArray, width: int) -> IntArray:
        order = np.broadcast_to(np.arange(width), (which.size, width))
        return self.place(np.repeat(which, width), order.ravel()).reshape(which.size, width)
