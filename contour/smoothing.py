"""Normals smoothed along contours after the scan, from sensed normals and neighbours' touches, not across corners.

Between neighbours the outline is developed by its chords: with s the length along it and alpha(s) the angle
of its normal, both from the contact in question,

    alpha(s) = theta + kappa s + gamma s^2 / 2,        y(s) = y0 + theta s + kappa s^2 / 2 + gamma s^3 / 6,

since a chord points where the tangent does on average. Sensed normals are readings of alpha, developed
touches are readings of y; (y0, theta, kappa, gamma) are fitted to those of a window by weighted least
squares, gamma with a prior as wide as curvatures are seen to change. Windows reach to both sides, to one, or
to the nearest neighbours alone; those that contradict their readings, as any across a corner does, are
dropped, and of the rest the one that knows theta best is taken. Where none is left the sensed normal stands.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contour.contacts import Contacts, Flag
from contour.errors import UsageError
from contour.frames import wrap_angle

__all__ = ["SmoothedNormals", "smooth_normals"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

SIDE = 2
"""Neighbours to each side that a window may reach."""
WINDOWS = np.array(
    [[1, 1, 1, 1, 1], [0, 1, 1, 1, 0], [1, 1, 1, 0, 0], [0, 0, 1, 1, 1], [0, 1, 1, 0, 0], [0, 0, 1, 1, 0]],
    dtype=np.bool_,
)
"""(windows, 2 SIDE + 1) contacts that each window takes."""
CHANGE = (0.3, 0.01)
"""Sigma of the change of turn from step to step: a share of the turn, and what is left on a straight line
[rad].
"""
OMITTED = 0.7
"""Sigma of the polynomial's next coefficient, as share of what the turn per step changes over the window."""
FREE = 10.0
"""Sigma of unknowns that no prior holds, in units of the step [-, rad]."""
SHARPEST = float(np.deg2rad(50.0))
"""A turn from one contact to the next above this is a corner, whatever else fits [rad]."""
GENTLE = float(np.deg2rad(10.0))
"""Turns from chord to chord below this are no corner's [rad]."""
LARGEST_MISFIT = 3.0
"""Windows are dropped if chi^2 exceeds its mean by more than this many of its standard deviations."""
FLOOR = float(np.deg2rad(0.05))
"""No smoothed normal is claimed to be better than this [rad]."""
TOUCH_SIGMA = 20e-6
"""Standard deviation of a touch across the outline, if nothing is said [m]."""
CHUNK = 2048
"""Contacts fitted at a time."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SmoothedNormals:
    """Normals of n contacts, in the order of the contacts given."""

    outward: FloatArray
    """(n,) rad, angle of the outer normal in Pi."""
    sigma: FloatArray
    """(n,) rad, one standard deviation."""
    neighbours: IntArray
    """(n,) other contacts that took part; 0 where the sensed normal stands."""


@dataclass(frozen=True, slots=True, eq=False)
class _Readings:
    """Windows of 2 SIDE + 1 contacts around each of m contacts, lengths in units of the local step."""

    place: FloatArray  # (m, k) s
    lateral: FloatArray  # (m, k) y
    angle: FloatArray  # (m, k) alpha
    lateral_weight: FloatArray  # (m, k) 1 / variance, 0 where there is no such contact
    angle_weight: FloatArray  # (m, k)
    turn: FloatArray  # (m,) rad, how much the outline turns per step
    broken: BoolArray  # (m, k - 1) links across a corner
    gentle: BoolArray  # (m,) all neighbours are there and no chord turns much


def smooth_normals(
    contacts: Contacts, *, closed: BoolArray | None = None, touch_sigma: ArrayLike = TOUCH_SIGMA
) -> SmoothedNormals:
    """Smooth the normals of ``contacts`` along each contour, in the order of ``sequence``.

    Args:
        contacts: of any number of contours; ``sequence`` is the place along each.
        closed: one value a contour (``contacts.which`` are its indices): whether its end meets its beginning.
        touch_sigma: standard deviation of ``contacts.touch`` across the outline [m], for all or (n,).

    Returns:
        Angle and sigma of the normal of each contact. Flagged contacts lend neighbours their touch only and
        get their normal from them; those that felt nothing take no part.
    """
    n = len(contacts)
    spread = np.broadcast_to(np.asarray(touch_sigma, dtype=np.float64), (n,))
    if not np.all(spread > 0.0):
        raise UsageError("touch_sigma must be above zero everywhere, in m")
    if closed is not None and n and closed.size <= int(contacts.which.max()):
        raise UsageError(
            f"closed has {closed.size} contours, but contacts name contour {int(contacts.which.max())}: "
            "give one value each"
        )
    outward, sigma = contacts.outward.copy(), contacts.sigma_normal.copy()
    used = np.zeros(n, dtype=np.int64)
    felt = np.flatnonzero((contacts.flags & Flag.LOST) == 0)
    chain = felt[np.lexsort((contacts.sequence[felt], contacts.which[felt]))]
    ring = np.zeros(chain.size, dtype=np.bool_) if closed is None else closed[contacts.which[chain]]
    neighbours = _neighbours(contacts.which[chain], ring)
    side = _sides(contacts, chain, neighbours)
    for begin in range(0, chain.size, CHUNK):
        rows = np.arange(begin, min(begin + CHUNK, chain.size))
        readings = _readings(contacts, spread, chain, neighbours[rows], side[rows])
        turned, error, count = _best(readings)
        at = chain[rows]
        fits = np.isfinite(error)
        outward[at] = np.where(fits, wrap_angle(contacts.outward[at] + turned), outward[at])
        sigma[at] = np.where(fits, np.maximum(error, FLOOR), sigma[at])
        used[at] = np.where(fits, count, 0)
    return SmoothedNormals(outward=outward, sigma=sigma, neighbours=used)


def _neighbours(contour: IntArray, ring: BoolArray) -> IntArray:
    """(m, 2 SIDE + 1) places of neighbours in the chain, each contact in the middle; -1 where there is none."""
    m = contour.size
    _, first, count = np.unique(contour, return_index=True, return_counts=True)
    start, size = np.repeat(first, count), np.repeat(count, count)
    place = np.arange(m) - start
    index = place[:, None] + np.arange(-SIDE, SIDE + 1)
    inside = (index >= 0) & (index < size[:, None])
    # Round a ring that is too short a window would meet itself.
    around = ring & (size > 2 * SIDE)
    index = np.where(around[:, None], index % np.maximum(size, 1)[:, None], index)
    return np.where(inside | around[:, None], start[:, None] + index, -1)


def _sides(contacts: Contacts, chain: IntArray, neighbours: IntArray) -> FloatArray:
    """(m,) rad from a chord to the outer normal: -90 or +90 deg, one for each contour."""
    contour = contacts.which[chain]
    ahead = neighbours[:, SIDE + 1]
    chord = contacts.touch[chain[np.maximum(ahead, 0)]] - contacts.touch[chain]
    outward = contacts.outward[chain]
    cross = chord[:, 0] * np.sin(outward) - chord[:, 1] * np.cos(outward)
    vote = np.where((ahead >= 0) & (contacts.flags[chain] == 0), cross, 0.0)
    total = np.bincount(contour, weights=vote, minlength=int(contour.max(initial=0)) + 1)
    return np.where(total[contour] > 0.0, 0.5 * np.pi, -0.5 * np.pi)


def _readings(
    contacts: Contacts, spread: FloatArray, chain: IntArray, neighbours: IntArray, side: FloatArray
) -> _Readings:
    there = neighbours >= 0
    index = chain[np.where(there, neighbours, neighbours[:, SIDE : SIDE + 1])]
    touch, sensed = contacts.touch[index], contacts.outward[index]
    link = touch[:, 1:] - touch[:, :-1]
    length = np.hypot(link[..., 0], link[..., 1])
    joined = there[:, 1:] & there[:, :-1] & (length > 0.0)
    reference = sensed[:, SIDE : SIDE + 1]
    chord = wrap_angle(np.arctan2(link[..., 1], link[..., 0]) + side[:, None] - reference)
    near = slice(SIDE - 1, SIDE + 1)
    step = np.where(joined, length, 0.0)[:, near].sum(axis=1) / np.maximum(joined[:, near].sum(axis=1), 1)
    unit = np.where(step > 0.0, step, 1.0)[:, None]
    reach = np.where(joined, length, 0.0) / unit
    rise = reach * np.where(joined, chord, 0.0)
    place, lateral = np.zeros(index.shape), np.zeros(index.shape)
    place[:, SIDE + 1 :] = np.cumsum(reach[:, SIDE:], axis=1)
    lateral[:, SIDE + 1 :] = np.cumsum(rise[:, SIDE:], axis=1)
    place[:, :SIDE] = -np.cumsum(reach[:, SIDE - 1 :: -1], axis=1)[:, ::-1]
    lateral[:, :SIDE] = -np.cumsum(rise[:, SIDE - 1 :: -1], axis=1)[:, ::-1]
    angle = wrap_angle(sensed - reference)
    good = there & (contacts.flags[index] == 0)
    # Turn per step between the two chords that meet here; from chord to sensed normal at an end.
    half = np.where(joined[:, SIDE], chord[:, SIDE], -chord[:, SIDE - 1])
    bend = wrap_angle(chord[:, 1:] - chord[:, :-1])
    pairs = joined[:, 1:] & joined[:, :-1]
    turn = np.where(pairs[:, SIDE - 1], bend[:, SIDE - 1], 2.0 * half)
    # What the polynomial leaves out grows with the change of the turn over the window.
    beside = np.where(pairs, np.abs(bend - turn[:, None]), 0.0).max(axis=1)
    left_out = OMITTED * beside[:, None]
    jump = np.abs(wrap_angle(sensed[:, 1:] - sensed[:, :-1]))
    broken = ~joined | ((jump > SHARPEST) & good[:, 1:] & good[:, :-1])
    return _Readings(
        place,
        lateral,
        angle,
        there / ((spread[index] / unit) ** 2 + (left_out * place**4 / 24.0) ** 2),
        good / (np.maximum(contacts.sigma_normal[index], FLOOR) ** 2 + (left_out * place**3 / 6.0) ** 2),
        turn,
        broken,
        joined.all(axis=1) & (np.abs(bend).max(axis=1) < GENTLE),
    )


def _best(readings: _Readings) -> tuple[FloatArray, FloatArray, IntArray]:
    """theta (m,) rad, its sigma (infinite where no window fits), and how many neighbours took part."""
    m = readings.turn.size
    theta, sigma, count = np.zeros(m), np.full(m, np.inf), np.zeros(m, dtype=np.int64)
    for window in WINDOWS:
        links = window[1:] & window[:-1]
        whole = ~(readings.broken & links).any(axis=1)
        fitted, error, misfit = _fit(readings, window)
        better = whole & (misfit < LARGEST_MISFIT) & (error < sigma)
        theta[better], sigma[better], count[better] = fitted[better], error[better], int(window.sum()) - 1
    # A sensed normal that is silently wrong contradicts every window. On a gentle stretch the others outvote it.
    fitted, error, misfit = _fit(_without_own(readings), WINDOWS[0])
    better = readings.gentle & (misfit < LARGEST_MISFIT) & (error < sigma)
    theta[better], sigma[better], count[better] = fitted[better], error[better], 2 * SIDE
    return theta, sigma, count


def _without_own(readings: _Readings) -> _Readings:
    """The same, the sensed normal in the middle left out."""
    weight = readings.angle_weight.copy()
    weight[:, SIDE] = 0.0
    return replace(readings, angle_weight=weight)


def _fit(readings: _Readings, window: BoolArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """theta (m,), its sigma (m,) and the misfit (m,) of the polynomial over one window."""
    s = readings.place[:, window]
    one, zero = np.ones_like(s), np.zeros_like(s)
    design = np.concatenate(
        (
            np.stack((one, s, s**2 / 2.0, s**3 / 6.0), axis=2),
            np.stack((zero, one, s, s**2 / 2.0), axis=2),
        ),
        axis=1,
    )  # (m, 2 k, 4) for (y0, theta, kappa, gamma)
    value = np.concatenate((readings.lateral[:, window], readings.angle[:, window]), axis=1)
    weight = np.concatenate((readings.lateral_weight[:, window], readings.angle_weight[:, window]), axis=1)
    change = CHANGE[0] * np.abs(readings.turn) + CHANGE[1]
    prior = np.column_stack((np.full((s.shape[0], 3), FREE**-2), change**-2.0))
    weighted = design * weight[..., None]
    normal = np.einsum("mki,mkj->mij", weighted, design) + prior[:, :, None] * np.eye(4)
    covariance = np.linalg.inv(normal)
    found = np.einsum("mij,mkj,mk->mi", covariance, weighted, value)
    residual = value - np.einsum("mki,mi->mk", design, found)
    square = np.sum(weight * residual**2, axis=1) + found[:, 3] ** 2 * prior[:, 3]
    # Of the four unknowns one has a prior that counts as a reading.
    freedom = np.maximum(np.count_nonzero(weight > 0.0, axis=1) - 3, 1)
    misfit = (square - freedom) / np.sqrt(2.0 * freedom)
    inflation = np.sqrt(np.maximum(square / freedom, 1.0))
    return found[:, 1], np.sqrt(covariance[:, 1, 1]) * inflation, misfit
