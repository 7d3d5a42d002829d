"""What goes into a push and what comes out, for every model of it: arguments checked and broadcast, records.

Signs: eps = phi - nu- is the pushing direction off the inner normal, delta = phi - psi the angle from the
force on the beam to the push; on the way out delta - pi has the sign of eps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contour.errors import UsageError

__all__ = ["CycleResponse", "PushRequest", "PushResponse", "as_asked", "refine", "request", "request_tip"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Number = TypeVar("Number", bound=np.generic)

ONSET = (0.3,)
"""Where to stop within the first step after a turn back: there friction swings through its whole cone."""
MAX_ANGLE = 1.2
"""Largest push that the models take [rad]."""
MAX_TILT = 1.4
"""Largest tilt of a tip's surface out of the sensing plane [rad]."""
LEAST_ANGLE = 1e-5
"""A push is never followed at less than this angle [rad]: its slips, of the order theta^2/100, drown in
rounding, and its directions have their limits by then."""
SHARPEST = 1e-9
"""Profile radii below this share of s are corners, on which the contact stays."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PushResponse:
    """Answer of the contact to single pushes out; all arrays have the broadcast shape of the arguments."""

    delta: FloatArray
    """phi - psi [rad], 0 .. 2 pi; pi without lateral slip."""
    compliance_ratio: FloatArray
    """C/c0: theta/|M| over s/(3 EI)."""
    slipped_off: BoolArray
    """The contact ran round the body and left it; the other fields are finite, for a contact held where it
    last was."""
    slide: FloatArray
    """a [m], slide along the profile, positive a quarter turn past the outer normal."""
    arc_length: FloatArray
    """l [m], from the centre of rotation to the contact, along the bent beam."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CycleResponse:
    """Answer along a path of angles; arrays (..., k)."""

    delta: FloatArray
    """phi - psi [rad], 0 .. 2 pi; pi without lateral slip."""
    moment_angle: FloatArray
    """|M| s/(3 EI) [rad]: the angle at which an edge would answer with this moment."""
    slipped_off: BoolArray
    """The contact has left the body by this angle; the other fields are finite, for a contact held where it
    last was."""
    slide: FloatArray
    """a [m], slide along the profile, positive a quarter turn past the outer normal."""
    arc_length: FloatArray
    """l [m], from the centre of rotation to the contact, along the bent beam."""


class PushRequest(NamedTuple):
    """Arguments of n pushes along k angles, checked, broadcast and in units of s."""

    eps: FloatArray
    """(n,), rad."""
    angles: FloatArray
    """(k, n), rad, none below the least angle."""
    share: FloatArray
    """(k, n), the angles asked for over these; 1 but near zero, where moments are proportional."""
    friction: FloatArray
    """mu, (n,)."""
    along: FloatArray
    """R/s, (n,)."""
    bend: FloatArray
    """s/R_l, (n,)."""
    distance: FloatArray
    """s [m], in the shape of the answer without its angles."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the answer."""
        return (*self.distance.shape, self.angles.shape[0])


def refine(
    angles: FloatArray, least: int, onset: tuple[float, ...] = ONSET
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Put angles between those asked for, so that no step is too long for friction's memory.

    Args:
        angles: (k, n), rad, above zero.
        least: no step exceeds 1/least of a push's largest angle.
        onset: where to stop within the first of these steps after a turn back [shares of it].

    Returns:
        The finer path (k', n), and which of its rows were asked for (k,).
    """
    steps = np.diff(angles, axis=0, prepend=np.zeros((1, angles.shape[1])))
    share = np.abs(steps) / angles.max(axis=0, initial=LEAST_ANGLE)
    counts = np.maximum(np.ceil(share.max(axis=1, initial=0.0) * least - 1e-6), 1.0).astype(np.int64)
    turns = np.zeros(len(counts), dtype=np.bool_)
    turns[1:] = np.any(steps[1:] * steps[:-1] < 0.0, axis=1)
    parts = [
        np.concatenate((np.array(onset if turn else ()) / count, np.arange(1, count + 1) / count))
        for turn, count in zip(turns, counts, strict=True)
    ]
    wanted = np.cumsum([len(part) for part in parts]) - 1
    if wanted[-1] == len(counts) - 1:
        return angles, wanted
    start = angles - steps
    rows = [start[i] + steps[i] * p for i, part in enumerate(parts) for p in part[:, None]]
    finer = np.stack(rows)
    return finer, wanted


def request(
    eps: ArrayLike,
    thetas: ArrayLike,
    distance: ArrayLike,
    friction: ArrayLike,
    radius_along: ArrayLike,
    radius_across: ArrayLike,
    *,
    least: float = LEAST_ANGLE,
) -> PushRequest:
    """Check and broadcast the arguments of a push; angles below ``least`` are followed at it."""
    angles = np.asarray(thetas, dtype=np.float64)
    if angles.ndim == 0 or angles.shape[-1] == 0:
        raise UsageError("thetas holds no angle along its last axis: give (..., k) with k of 1 or more")
    e, s, mu, r, r_l = (
        np.asarray(v, dtype=np.float64) for v in (eps, distance, friction, radius_along, radius_across)
    )
    if not (np.all(angles >= 0.0) and np.all(angles <= MAX_ANGLE)):
        raise UsageError(
            f"thetas must lie between 0 and {MAX_ANGLE} rad: a push turns the base that far at most"
        )
    if not np.all(np.isfinite(e)):
        raise UsageError("eps holds a value that is not finite: give the pushing direction in rad")
    if not (np.all(s > 0.0) and np.all(np.isfinite(s))):
        raise UsageError("distance must be finite and above zero, in metres")
    if not (np.all(mu >= 0.0) and np.all(np.isfinite(mu))):
        raise UsageError("friction must be finite and zero or more: the coefficient mu, not the angle")
    if not (np.all(r >= 0.0) and np.all(np.isfinite(r))):
        raise UsageError("radius_along must be finite and zero (an edge) or more, in metres")
    if np.any(np.isnan(r_l)):
        raise UsageError("radius_across is not a number: give metres, inf for a flat profile")
    try:
        shape = np.broadcast_shapes(angles.shape[:-1], e.shape, s.shape, mu.shape, r.shape, r_l.shape)
    except ValueError as error:
        raise UsageError(
            f"eps {e.shape}, thetas {angles.shape}, distance {s.shape}, friction {mu.shape}, radii {r.shape} "
            f"and {r_l.shape} do not broadcast: give one value or one per push"
        ) from error
    s = np.broadcast_to(s, shape)
    path = np.broadcast_to(angles, (*shape, angles.shape[-1])).reshape(-1, angles.shape[-1])
    radius = np.where(np.abs(r_l) < SHARPEST * s, SHARPEST * s, r_l)
    angles = np.maximum(path.T, least)
    flat = [np.broadcast_to(v, shape).ravel() for v in (e, mu, r / s, s / radius)]
    return PushRequest(
        eps=flat[0],
        angles=angles,
        share=path.T / angles,
        friction=flat[1],
        along=flat[2],
        bend=flat[3],
        distance=s,
    )


def request_tip(
    eps: ArrayLike,
    thetas: ArrayLike,
    distance: ArrayLike,
    friction: ArrayLike,
    radius_along: ArrayLike,
    radius_across: ArrayLike,
    tilt: ArrayLike,
    *,
    least: float = LEAST_ANGLE,
) -> tuple[PushRequest, FloatArray, FloatArray]:
    """The same for a tip: the request (its ``along`` empty of meaning), tilt (n,) and s/radius_along (n,)."""
    chi, radius = np.asarray(tilt, dtype=np.float64), np.asarray(radius_along, dtype=np.float64)
    if not np.all(np.abs(chi) <= MAX_TILT):
        raise UsageError(
            f"tilt must lie within {MAX_TILT} rad: a tip pushed nearer to its axis is not felt; "
            "approach it aslant"
        )
    if np.any(np.isnan(radius)):
        raise UsageError("radius_along is not a number: give metres, inf for a flat surface")
    base = np.asarray(distance, dtype=np.float64) + 0.0 * chi
    asked = request(
        eps,
        thetas,
        base + 0.0 * np.where(np.isinf(radius), 0.0, radius),
        friction,
        0.0,
        radius_across,
        least=least,
    )
    shape = asked.distance.shape
    near = SHARPEST * asked.distance
    sharp = np.where(np.abs(radius) < near, near, radius)
    bend = np.broadcast_to(asked.distance / sharp, shape).ravel()
    return asked, np.broadcast_to(chi, shape).ravel(), bend


def as_asked(asked: PushRequest, wanted: NDArray[np.int64], values: NDArray[Number]) -> NDArray[Number]:
    """A field (k', n) of a followed path at the angles asked for, in the shape of the answer."""
    return np.ascontiguousarray(values[wanted].T).reshape(asked.shape)
