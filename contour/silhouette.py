"""The body's profile in the sensing plane: the curve on which a contact slides.

Axes at touch: e_n the outer normal, e_t a quarter turn past it in the sense of the plane's angles (from +x_s
to +z_s). A profile point is c_t e_t + c_n e_n, its normal sin(omega) e_t + cos(omega) e_n, omega the turn of
the normal (its sense is that of e_t on a convex profile), its curvature d omega/da positive where convex.
Each profile has its own parameter b, zero at touch; all arrays hold one value per push, or have more axes in
front. Lengths are in s.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contour.errors import UsageError

__all__ = ["ArcProfile", "Frame", "Profile", "SampledProfile", "sampled"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

MAX_TURN = 2.6
"""Turn of the normal along the profile beyond which the contact has left the body [rad]."""
SHARPEST = 1e8
"""Curvature, in 1/s, above which a profile is a corner."""
LEAST_SAMPLES = 4
"""Fewest samples of a profile: a parabola's slopes at both ends."""


class Frame(NamedTuple):
    """A point of a profile and the directions there."""

    along: FloatArray
    """c_t."""
    out: FloatArray
    """c_n."""
    cos: FloatArray
    """cos omega."""
    sin: FloatArray
    """sin omega."""
    curvature: FloatArray
    """d omega/da."""
    speed: FloatArray
    """db/da."""


class Profile(Protocol):
    """A silhouette curve in the sensing plane, n of them at once, each with its own parameter b (0 at
    touch).
    """

    def at(self, b: FloatArray) -> Frame:
        """Point and directions at b; the arrays are the caller's to change."""
        ...

    def chord(self, b: FloatArray, start: FloatArray) -> FloatArray:
        """da, the signed length of the slide from ``start`` to b."""
        ...

    def arc(self, b: FloatArray) -> FloatArray:
        """Arc length from touch to b."""
        ...

    def within(self, b: FloatArray) -> BoolArray:
        """Whether b is still on the profile."""
        ...

    def reach(self) -> FloatArray:
        """Longest bracket in b that resolves the profile."""
        ...

    def held(self) -> BoolArray:
        """Where the contact cannot slide: on a corner."""
        ...

    def rows(self, index: NDArray[np.int64]) -> Profile:
        """The same for a selection."""
        ...


class ArcProfile:
    """Circular arcs of curvature kappa (0 flat, < 0 concave), by the tangent of the half angle.

    b = (2/kappa) tan(kappa a/2) has no trigonometry in it and no special case for a flat profile:
    with tau = kappa b/2, c_t = b/(1 + tau^2), c_n = -tau c_t, cos omega = (1 - tau^2)/(1 + tau^2).
    Arcs sharper than SHARPEST are corners, on which a contact stays.
    """

    def __init__(self, curvature: FloatArray) -> None:
        self.corner = np.abs(curvature) > SHARPEST
        self.curvature = np.where(self.corner, 0.0, curvature)
        self.half = 0.5 * self.curvature

    def at(self, b: FloatArray) -> Frame:
        """Point and directions at b."""
        tau = self.half * b
        speed = tau * tau
        speed += 1.0
        q = 1.0 / speed
        along = b * q
        out = tau * along
        np.negative(out, out=out)
        q += q
        sin = tau * q
        q -= 1.0
        return Frame(along, out, q, sin, self.curvature, speed)

    def chord(self, b: FloatArray, start: FloatArray) -> FloatArray:
        """Signed length of the slide from ``start`` to b."""
        # 2/kappa tan(turn/2): the arc to third order in the turn of one step, and exact on a flat profile.
        da = b - start
        tau = self.half * b
        tau *= self.half
        tau *= start
        tau += 1.0
        da /= tau
        return da

    def arc(self, b: FloatArray) -> FloatArray:
        """Arc length from touch to b."""
        # tan^-1(tau)/tau is even and smooth; below 1e-4 its series has only its first term left in a double.
        tau = np.abs(self.half * b)
        return np.asarray(
            b * np.where(tau < 1e-4, 1.0 - tau * tau / 3.0, np.arctan(tau) / np.maximum(tau, 1e-5))
        )

    def within(self, b: FloatArray) -> BoolArray:
        """Whether the normal has not turned right round."""
        return np.asarray(np.abs(self.half * b) < np.tan(0.5 * MAX_TURN))

    def reach(self) -> FloatArray:
        """A tenth of the radius, at most half of s."""
        return 0.1 / (np.abs(self.curvature) + 0.2)

    def held(self) -> BoolArray:
        """Where the arc is a corner."""
        return self.corner

    def rows(self, index: NDArray[np.int64]) -> ArcProfile:
        """The same for a selection."""
        part = object.__new__(ArcProfile)
        part.curvature, part.half, part.corner = self.curvature[index], self.half[index], self.corner[index]
        return part


class SampledProfile:
    """Silhouettes given by heights at offsets along the tangent at touch: C1 piecewise cubics through the
    samples.

    The parameter b is the offset itself. The cubics take their slopes from the parabola through three
    neighbouring samples; the heights are shifted so that the curve passes through the touch point. A height
    that is not a number ends the profile.
    """

    def __init__(self, offsets: FloatArray, heights: FloatArray) -> None:
        """Take (n, m) offsets, rising and around zero, and (n, m) heights."""
        self.offsets = offsets
        seen = np.isfinite(heights)
        self.first = np.max(np.where(seen | (offsets > 0.0), offsets[:, :1], offsets), axis=-1)
        self.last = np.min(np.where(seen | (offsets < 0.0), offsets[:, -1:], offsets), axis=-1)
        heights = np.where(seen, heights, 0.0)
        self.cell = np.diff(offsets, axis=-1)
        chord = np.diff(heights, axis=-1) / self.cell
        left, right = self.cell[:, :-1], self.cell[:, 1:]
        inner = (chord[:, :-1] * right + chord[:, 1:] * left) / (left + right)
        first, last = 2.0 * chord[:, :1] - inner[:, :1], 2.0 * chord[:, -1:] - inner[:, -1:]
        self.slopes = np.concatenate((first, inner, last), axis=-1)
        self.heights = heights
        self.heights = heights - self._cubic(np.zeros(len(offsets)))[0][:, None]
        # Simpson's rule over each cell.
        middle = 1.5 * chord - 0.25 * (self.slopes[:, :-1] + self.slopes[:, 1:])
        ends = np.hypot(1.0, self.slopes)
        cells = self.cell * (ends[:, :-1] + 4.0 * np.hypot(1.0, middle) + ends[:, 1:]) / 6.0
        self.arcs = np.concatenate((np.zeros((len(offsets), 1)), np.cumsum(cells, axis=-1)), axis=-1)
        self.arcs -= self.arc(np.zeros(len(offsets)))[:, None]

    def _cell(self, b: FloatArray) -> tuple[FloatArray, tuple[NDArray[np.int64], ...]]:
        """b kept on the profile, and the index of its cell."""
        b = np.clip(np.nan_to_num(b), self.offsets[:, 0], self.offsets[:, -1])
        cell = (b[..., None] >= self.offsets[:, 1:-1]).sum(axis=-1)
        return b, (np.broadcast_to(np.arange(b.shape[-1]), b.shape), cell)

    def _cubic(self, b: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Height, slope and second derivative."""
        b, at = self._cell(b)
        after = (at[0], at[1] + 1)
        width = self.cell[at]
        t = (b - self.offsets[at]) / width
        low, slope = self.heights[at], self.slopes[at]
        chord = (self.heights[after] - low) / width
        bend, twist = 3.0 * chord - 2.0 * slope - self.slopes[after], slope + self.slopes[after] - 2.0 * chord
        height = low + width * t * (slope + t * (bend + t * twist))
        return height, slope + t * (2.0 * bend + 3.0 * t * twist), (2.0 * bend + 6.0 * t * twist) / width

    def at(self, b: FloatArray) -> Frame:
        """Point and directions at b."""
        height, slope, second = self._cubic(b)
        cos = 1.0 / np.sqrt(1.0 + slope * slope)
        return Frame(b.copy(), height, cos, -slope * cos, -second * cos**3, cos)

    def arc(self, b: FloatArray) -> FloatArray:
        """Arc length from touch to b."""
        b, at = self._cell(b)
        start = self.offsets[at]
        _, slope, _ = self._cubic(b)
        _, middle, _ = self._cubic(0.5 * (start + b))
        ends = np.hypot(1.0, self.slopes[at]) + np.hypot(1.0, slope)
        return np.asarray(self.arcs[at] + (b - start) * (ends + 4.0 * np.hypot(1.0, middle)) / 6.0)

    def chord(self, b: FloatArray, start: FloatArray) -> FloatArray:
        """Arc length from ``start`` to b."""
        return self.arc(b) - self.arc(start)

    def within(self, b: FloatArray) -> BoolArray:
        """Whether b is still on the profile."""
        return np.asarray((b > self.first) & (b < self.last))

    def reach(self) -> FloatArray:
        """Half the shortest cell."""
        return np.asarray(0.5 * self.cell.min(axis=-1))

    def held(self) -> BoolArray:
        """Nowhere: samples show no corner."""
        return np.zeros(self.offsets.shape[0], dtype=np.bool_)

    def rows(self, index: NDArray[np.int64]) -> SampledProfile:
        """The same for a selection."""
        part = object.__new__(SampledProfile)
        for name in ("offsets", "first", "last", "cell", "slopes", "heights", "arcs"):
            setattr(part, name, getattr(self, name)[index])
        return part


def sampled(offsets: ArrayLike, heights: ArrayLike, distance: FloatArray) -> SampledProfile:
    """Profiles (n) of pushes at ``distance`` (their shape) from samples in metres, (m,) or (..., m),
    checked.
    """
    x, h = np.asarray(offsets, dtype=np.float64), np.asarray(heights, dtype=np.float64)
    try:
        shape = np.broadcast_shapes(x.shape, h.shape, (*distance.shape, 1))
    except ValueError as error:
        raise UsageError(
            f"profile offsets {x.shape} and heights {h.shape} do not fit pushes {distance.shape}: "
            "give (m,) or (..., m)"
        ) from error
    if shape[:-1] != distance.shape:
        raise UsageError(
            f"profile is given for {shape[:-1]} pushes but there are {distance.shape}: give one for each"
        )
    if shape[-1] < LEAST_SAMPLES:
        raise UsageError(f"profile has {shape[-1]} samples: give at least {LEAST_SAMPLES}")
    x, h = (np.broadcast_to(v, shape).reshape(-1, shape[-1]) / distance.reshape(-1, 1) for v in (x, h))
    if not (np.all(np.diff(x, axis=-1) > 0.0) and np.all(x[:, 0] < 0.0) and np.all(x[:, -1] > 0.0)):
        raise UsageError("profile offsets must rise and lie on both sides of the touch point at 0, in metres")
    beside = (x[:, 1:] >= 0.0) & (x[:, :-1] <= 0.0)
    if not np.all(np.isfinite(h[:, 1:][beside]) & np.isfinite(h[:, :-1][beside])):
        raise UsageError(
            "profile heights beside the touch point are not finite: sample more closely around it"
        )
    return SampledProfile(x, h)
