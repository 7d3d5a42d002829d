"""Normals smoothed along contours after the scan, from sensed normals and neighbours' touches, not across corners.

The outline is developed along its chords: with s the length along it, alpha(s) the angle of its normal and
y(s) the developed offset, both from the contact in question,

    alpha(s) = theta + kappa s + gamma s^2 / 2 + what else kappa changes by,        y(s) = y0 + int_0^s alpha,

since a chord points where the tangent does on average. Sensed normals are readings of alpha, developed touches
are readings of y, of up to two neighbours on each side. How curvature changes is not known: beside its trend
gamma it drifts (a Wiener process, calm or lively); on a link between neighbours it may jump (by as much as the
outline turns hereabouts), or there may be a corner (a jump of alpha); a sensed normal may be wrong. Every
choice of at most two such events is a hypothesis: a linear Gaussian model, whose evidence weighs it.
The normal is the mean over all of them, its sigma that of their mixture's central 95 %, wider where none of
them explains the readings. Where neighbours say nothing, the sensed normal stands.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from contour.contacts import Contacts, Flag, Kind
from contour.errors import UsageError
from contour.frames import wrap_angle

__all__ = ["SmoothedNormals", "smooth_normals"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

SIDE = 2
"""Neighbours to each side that take part."""
SEEN = 2 * SIDE + 1
"""Contacts of a window."""
TREND = (0.3, 0.01)
"""Sigma of what the turn changes by from step to step all along: a share of the turn, and what is left on a
line [rad].
"""
DRIFT = (0.05, 0.003)
"""The same of what each step adds at random, on calm outlines."""
LIVELY_DRIFT = (0.4, 0.01)
"""The same on lively ones."""
JUMP_LEFT = 0.02
"""A jump's sigma is the largest turn of the window and this [rad per step]."""
CORNER = 1.0
"""Sigma of a corner's angle [rad]."""
WRONG = 0.15
"""Sigma of what a wrong sensed normal is off [rad]."""
CHANCE = {"lively": 0.25, "jump": 0.1, "corner": 0.05, "wrong": 0.005}
"""How much rarer than none each event is: drift of the lively kind over the window, a jump of curvature or a
corner on one link, one wrong sensed normal.
"""
EVENTS = 2
"""Most events of a hypothesis."""
FREE = 1.0
"""Sigma of offset and angle before any reading [steps, rad]."""
GENTLE = float(np.deg2rad(10.0))
"""Only where no chord turns by more than this from the next may neighbours overrule a sensed normal [rad]."""
OVERRULED = 0.05
"""Below this chance of being wrong, a sensed normal that is sharper than the mixture stands."""
SILENT = float(np.deg2rad(30.0))
"""A mixture wider than this says nothing [rad]."""
ABSENT = 1e4
"""Variance of readings that are not there [steps^2, rad^2]."""
HALF_WIDTH = 1.959963984540054
"""Half width of a normal distribution's central 95 % in sigmas."""
HALVINGS = 24
"""Of the bracket [0, 3] rad of the half width: to 2e-7 rad."""
GAUSS = ((0.5 - np.sqrt(0.15), 5.0 / 18.0), (0.5, 8.0 / 18.0), (0.5 + np.sqrt(0.15), 5.0 / 18.0))
"""Places and weights on a link; exact for the quartics that are integrated."""
FLOOR = float(np.deg2rad(0.05))
"""No smoothed normal is claimed to be better than this, no sensed one taken to be [rad]."""
TOUCH_SIGMA = 20e-6
"""Standard deviation of a touch across the outline, if nothing is said [m]."""
CHUNK = 1024
"""Contacts smoothed at a time."""

Event = tuple[str, int]
"""``jump`` or ``corner`` and its link, ``wrong`` and its contact, counted along the window; ``lively`` and 0."""


def _hypotheses() -> tuple[tuple[Event, ...], ...]:
    """All sets of at most EVENTS events, no two of them on one link."""
    links: list[Event] = [(name, link) for name in ("jump", "corner") for link in range(SEEN - 1)]
    events: list[Event] = [("lively", 0), *links, *(("wrong", contact) for contact in range(SEEN))]
    sets = (chosen for count in range(EVENTS + 1) for chosen in combinations(events, count))
    return tuple(
        chosen
        for chosen in sets
        if not any(a in links and b in links and a[1] == b[1] for a, b in combinations(chosen, 2))
    )


HYPOTHESES = _hypotheses()
"""All that may have happened within a window, the first of them nothing."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SmoothedNormals:
    """Normals of n contacts, in the order of the contacts given."""

    outward: FloatArray
    """(n,) rad, angle of the outer normal in Pi."""
    sigma: FloatArray
    """(n,) rad, one standard deviation: the half width of the central 95 % over 1.96."""
    neighbours: IntArray
    """(n,) other contacts that took part; 0 where the sensed normal stands."""


@dataclass(frozen=True, slots=True, eq=False)
class _Readings:
    """Windows of SEEN contacts around each of m contacts, lengths in units of the local step."""

    place: FloatArray  # (m, SEEN) s
    value: FloatArray  # (m, 2 SEEN) y, then alpha
    variance: FloatArray  # (m, 2 SEEN) of each, ABSENT where there is none
    turn: FloatArray  # (m,) rad, how much the outline turns per step here
    sharpest: FloatArray  # (m,) rad, the largest turn per step of the window
    linked: IntArray  # (m,) neighbours that chords lead to
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
        get their normal from them; those that felt nothing take no part. Contacts with the beam's end and with
        its side lie on different curves and take no part in each other's normals.
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
        turned, error, wrong = _mixture(readings)
        at = chain[rows]
        sharper = (contacts.flags[at] == 0) & (wrong < OVERRULED) & (error >= contacts.sigma_normal[at])
        stands = sharper | (readings.linked == 0) | (error > SILENT)
        outward[at] = np.where(stands, outward[at], wrap_angle(contacts.outward[at] + turned))
        sigma[at] = np.where(stands, sigma[at], error)
        used[at] = np.where(stands, 0, readings.linked)
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
    end = contacts.kind[index] == Kind.TIP
    joined = there[:, 1:] & there[:, :-1] & (length > 0.0) & (end[:, 1:] == end[:, :-1])
    reached = _reached(joined)
    reference = sensed[:, SIDE : SIDE + 1]
    chord = wrap_angle(np.arctan2(link[..., 1], link[..., 0]) + side[:, None] - reference)
    near = slice(SIDE - 1, SIDE + 1)
    step = np.where(joined, length, 0.0)[:, near].sum(axis=1) / np.maximum(joined[:, near].sum(axis=1), 1)
    unit = np.where(step > 0.0, step, 1.0)[:, None]
    reach = np.where(joined, length, 0.0) / unit
    bend = np.where(joined[:, 1:] & joined[:, :-1], wrap_angle(chord[:, 1:] - chord[:, :-1]), 0.0)
    # Each chord within half a turn of the next one inwards.
    unwrapped = chord.copy()
    unwrapped[:, SIDE + 1 :] = chord[:, SIDE, None] + np.cumsum(bend[:, SIDE:], axis=1)
    unwrapped[:, : SIDE - 1] = chord[:, SIDE - 1, None] - np.cumsum(bend[:, SIDE - 2 :: -1], axis=1)[:, ::-1]
    rise = reach * np.where(joined, unwrapped, 0.0)
    place, lateral = _developed(reach), _developed(rise)
    angle = np.where(reached, wrap_angle(sensed - reference), 0.0)
    good = reached & (contacts.flags[index] == 0)
    # At an end there is one chord alone: what it turns from the sensed normal, twice.
    lone = 2.0 * np.where(joined[:, SIDE], chord[:, SIDE], -chord[:, SIDE - 1])
    both = joined[:, SIDE] & joined[:, SIDE - 1]
    turn = np.where(both, bend[:, SIDE - 1], np.where(joined[:, near].any(axis=1), lone, 0.0))
    return _Readings(
        place,
        np.concatenate((lateral, angle), axis=1),
        np.concatenate(
            (
                np.where(reached, (spread[index] / unit) ** 2, ABSENT),
                np.where(good, np.maximum(contacts.sigma_normal[index], FLOOR) ** 2, ABSENT),
            ),
            axis=1,
        ),
        turn,
        np.maximum(np.abs(bend).max(axis=1), np.where(both, 0.0, np.abs(turn))),
        np.count_nonzero(reached, axis=1) - 1,
        joined.all(axis=1) & (np.abs(bend).max(axis=1) < GENTLE),
    )


def _reached(joined: BoolArray) -> BoolArray:
    """(m, SEEN): whether links (m, SEEN - 1) lead to a contact from the middle."""
    ahead = np.logical_and.accumulate(joined[:, SIDE:], axis=1)
    back = np.logical_and.accumulate(joined[:, SIDE - 1 :: -1], axis=1)[:, ::-1]
    return np.concatenate((back, np.ones((len(joined), 1), dtype=np.bool_), ahead), axis=1)


def _developed(links: FloatArray) -> FloatArray:
    """(m, SEEN): ``links`` (m, SEEN - 1) summed from the middle outwards, negative on the way back."""
    ahead = np.cumsum(links[:, SIDE:], axis=1)
    back = -np.cumsum(links[:, SIDE - 1 :: -1], axis=1)[:, ::-1]
    return np.concatenate((back, np.zeros((len(links), 1)), ahead), axis=1)


def _kernels(place: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Covariances (m, SEEN - 1, 2 SEEN, 2 SEEN) of readings per unit variance of jump and of corner, by link.

    Either may be anywhere on its link. A jump at u turns what lies beyond by s - u and offsets it by
    (s - u)^2 / 2, a corner by 1 and s - u.
    """
    m = len(place)
    jump = np.zeros((m, SEEN - 1, 2 * SEEN, 2 * SEEN))
    corner = np.zeros_like(jump)
    for link in range(SEEN - 1):
        beyond = np.arange(SEEN) > link if link >= SIDE else np.arange(SEEN) <= link
        for share, weight in GAUSS:
            u = place[:, link] + share * (place[:, link + 1] - place[:, link])
            past = np.where(beyond, place - u[:, None], 0.0)
            whole = np.broadcast_to(beyond.astype(np.float64), past.shape)
            for kernel, parts in ((jump, (past**2 / 2.0, past)), (corner, (past, whole))):
                effect = np.concatenate(parts, axis=1)
                kernel[:, link] += weight * effect[:, :, None] * effect[:, None, :]
    return jump, corner


def _mixture(readings: _Readings) -> tuple[FloatArray, FloatArray, FloatArray]:
    """theta (m,) rad, its sigma (m,) and the chance (m,) that the sensed normal in the middle is wrong."""
    s = readings.place
    one, zero = np.ones_like(s), np.zeros_like(s)
    design = np.concatenate(
        (np.stack((one, s, s**2 / 2.0, s**3 / 6.0), axis=2), np.stack((zero, one, s, s**2 / 2.0), axis=2)),
        axis=1,
    )  # (m, 2 SEEN, 4) for (y0, theta, kappa_0, gamma)
    widest = (readings.sharpest + JUMP_LEFT) ** 2
    turn = np.abs(readings.turn)
    prior = np.column_stack((np.full((len(s), 2), FREE**2), widest, _variance(TREND, turn)))
    jump, corner = _kernels(s)
    calm, lively = _variance(DRIFT, turn), _variance(LIVELY_DRIFT, turn)
    plain = np.einsum("mki,mi,mji->mkj", design, prior, design)
    drifting = jump.sum(axis=1)
    plain += calm[:, None, None] * drifting + readings.variance[:, :, None] * np.eye(2 * SEEN)
    sought = FREE**2 * design[:, :, 1]  # covariance of theta and readings
    right = np.stack((readings.value, sought), axis=2)
    mean = np.zeros((len(s), len(HYPOTHESES)))
    variance, evidence, square = np.zeros_like(mean), np.zeros_like(mean), np.zeros_like(mean)
    own = np.zeros(len(HYPOTHESES), dtype=np.bool_)
    for h, events in enumerate(HYPOTHESES):
        covariance = plain.copy()
        for name, where in events:
            if name == "lively":
                covariance += (lively - calm)[:, None, None] * drifting
            elif name == "jump":
                covariance += widest[:, None, None] * jump[:, where]
            elif name == "corner":
                covariance += CORNER**2 * corner[:, where]
            else:
                covariance[:, SEEN + where, SEEN + where] += WRONG**2
        root = np.linalg.cholesky(covariance)
        solved = np.linalg.solve(root, right)
        square[:, h] = np.sum(solved[:, :, 0] ** 2, axis=1)
        mean[:, h] = np.sum(solved[:, :, 0] * solved[:, :, 1], axis=1)
        variance[:, h] = FREE**2 - np.sum(solved[:, :, 1] ** 2, axis=1)
        evidence[:, h] = -0.5 * np.sum(solved[:, :, 0] ** 2, axis=1) + sum(
            np.log(CHANCE[name]) for name, _ in events
        )
        evidence[:, h] -= np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
        own[h] = ("wrong", SIDE) in events
    evidence[:, own] = np.where(readings.gentle[:, None], evidence[:, own], -np.inf)
    weight = np.exp(evidence - evidence.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    # What no hypothesis explains widens sigma. Offset and angle are free, which takes two readings.
    freedom = np.maximum(np.count_nonzero(readings.variance < ABSENT, axis=1) - 2, 1)
    stretch = np.sqrt(np.maximum(np.sum(weight * square, axis=1) / freedom, 1.0))
    theta, sigma = _central(weight, mean, np.sqrt(np.maximum(variance, 0.0)) + 1e-9)
    return theta, np.maximum(sigma * stretch, FLOOR), weight[:, own].sum(axis=1)


def _variance(sigma: tuple[float, float], turn: FloatArray) -> FloatArray:
    """(m,) rad^2, of changes of the turn whose sigma is a share of ``turn`` (m,) and a rest."""
    return np.asarray((sigma[0] * turn + sigma[1]) ** 2)


def _central(weight: FloatArray, mean: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (m,) of mixtures of normal distributions (m, h), and the half width of 95 % about it over 1.96."""
    middle = np.sum(weight * mean, axis=1)
    offset = (middle[:, None] - mean) / sigma
    low, high = np.zeros(len(middle)), np.full(len(middle), 3.0)
    for _ in range(HALVINGS):
        half = 0.5 * (low + high)
        reach = half[:, None] / sigma
        inside = np.sum(weight * (ndtr(offset + reach) - ndtr(offset - reach)), axis=1)
        low, high = np.where(inside < 0.95, half, low), np.where(inside < 0.95, high, half)
    return middle, high / HALF_WIDTH
