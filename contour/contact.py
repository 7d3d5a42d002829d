"""Mechanics of one push, forward and inverse, both strokes, in closed form; vectorised over pushes.

The forward model is the reduced rod (contour.slip); the paper's laws stand beside it. Signs: eps = phi - nu- is the
pushing direction off the inner normal, delta = phi - psi the angle from the force on the beam to the push; on the way
out delta - pi has the sign of eps. Theory: docs/derivations.md, section Mechanics.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contour.errors import UsageError
from contour.slip import ArcProfile, Path, follow

__all__ = ["CycleResponse", "PushResponse", "k_of_h", "push_cycle", "push_response"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

STEPS_OUT = 8
"""Steps a push out is followed in, at least; doubling them moves delta by less than 0.002 deg rms."""
LEAST_ANGLE = 1e-7
"""A push is never followed at less than this angle [rad]; its directions have their limits by then."""
SHARPEST = 1e-9
"""Profile radii below this share of s are corners, on which the contact stays."""
MAX_ANGLE = 1.2
"""Largest push that the model takes [rad]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PushResponse:
    """Answer of the contact to single pushes out; all arrays have the broadcast shape of the arguments."""

    delta: FloatArray
    """phi - psi [rad], 0 .. 2 pi; pi without lateral slip."""
    compliance_ratio: FloatArray
    """C/c0: theta/|M| over s/(3 EI)."""
    slipped_off: BoolArray
    """The contact ran round the body and left it; the other fields are then those of the last contact."""
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
    """The contact has left the body at or before this angle; the other fields are then those of the last contact."""
    slide: FloatArray
    """a [m], slide along the profile, positive a quarter turn past the outer normal."""
    arc_length: FloatArray
    """l [m], from the centre of rotation to the contact, along the bent beam."""


def k_of_h(h: ArrayLike) -> FloatArray:
    """Share k of the edge's compliance that is left on a round body, h = s/(R theta), for small angles.

    (23), (31) and (32) of Kaneko1998 solved without linearising in 1/h; to first order k = 1 - 3/(8h).

    >>> round(float(k_of_h(10.0)), 4)
    0.9635
    """
    return _softening(1.0 / np.asarray(h, dtype=np.float64))


def _softening(u: FloatArray) -> FloatArray:
    """k(u = 1/h), u >= 0."""
    # zeta/theta = ((2 + u) - sqrt((2 + u)^2 - 2u))/u, without its cancellation.
    zeta = u + 2.0
    zeta += np.sqrt(u * zeta + 4.0)
    np.divide(2.0, zeta, out=zeta)
    return np.asarray(1.5 * (1.0 - u * zeta) / (1.0 + zeta))


def push_response(
    eps: ArrayLike,
    theta: ArrayLike,
    *,
    distance: ArrayLike,
    friction: ArrayLike,
    radius_along: ArrayLike,
    radius_across: ArrayLike,
) -> PushResponse:
    """What single pushes out, from touch and with no friction memory, are answered with. Arguments broadcast.

    Args:
        eps: pushing direction off the inner normal [rad].
        theta: angle that the base turns [rad], above zero.
        distance: s, centre of rotation to contact [m].
        friction: coefficient mu, the tangent of the friction angle.
        radius_along: R of the body along the beam [m], 0 for an edge.
        radius_across: R_l of the profile in the sensing plane [m], inf flat, below 0 concave, 0 a corner.

    >>> push = push_response(0.1, 0.05, distance=0.1, friction=0.18, radius_along=0.0, radius_across=np.inf)
    >>> round(float(push.compliance_ratio), 4), round(float(push.delta), 3)
    (0.9987, 3.144)
    """
    values = np.broadcast_arrays(*_floats(eps, theta, distance, friction, radius_along, radius_across))
    cycle = push_cycle(
        values[0],
        values[1][..., None],
        distance=values[2],
        friction=values[3],
        radius_along=values[4],
        radius_across=values[5],
    )
    moment = cycle.moment_angle[..., 0]
    angle = np.maximum(values[1], LEAST_ANGLE)
    return PushResponse(
        delta=cycle.delta[..., 0],
        compliance_ratio=np.asarray(angle / moment),
        slipped_off=cycle.slipped_off[..., 0],
        slide=cycle.slide[..., 0],
        arc_length=cycle.arc_length[..., 0],
    )


def push_cycle(
    eps: ArrayLike,
    thetas: ArrayLike,
    *,
    distance: ArrayLike,
    friction: ArrayLike,
    radius_along: ArrayLike,
    radius_across: ArrayLike,
) -> CycleResponse:
    """What pushes along a path of angles, out and back, are answered with, with the memory of friction.

    Args:
        eps: pushing direction off the inner normal [rad], (...).
        thetas: angles of the base from touch, in their order [rad], (..., k).
        distance, friction, radius_along, radius_across: as for :func:`push_response`, (...).
    """
    angles, scale, (eps_row, mu, along, across) = _rows(eps, thetas, distance, friction, radius_along, radius_across)
    shape = angles.shape
    angles = np.maximum(angles.reshape(-1, shape[-1]).T, LEAST_ANGLE)
    path_angles, wanted = refine(angles)
    corner = np.abs(across) < SHARPEST
    profile = ArcProfile(1.0 / np.where(corner, SHARPEST, across))
    path = follow(eps_row, path_angles, mu, profile)
    moment = _moment_angle(path, mu, along)
    return _cycle(path, moment, wanted, shape, scale)


def refine(angles: FloatArray, least: int = STEPS_OUT) -> tuple[FloatArray, NDArray[np.int64]]:
    """Put angles between those asked for, so that no step exceeds 1/STEPS_OUT of a push's largest angle.

    Args:
        angles: (k, n).

    Returns:
        The finer path (k', n), and which of its rows were asked for (k,).
    """
    steps = np.diff(angles, axis=0, prepend=np.zeros((1, angles.shape[1])))
    share = np.abs(steps) / angles.max(axis=0, initial=LEAST_ANGLE)
    counts = np.maximum(np.ceil(share.max(axis=1, initial=0.0) * least - 1e-6), 1.0).astype(np.int64)
    wanted = np.cumsum(counts) - 1
    if wanted[-1] == len(counts) - 1:
        return angles, wanted
    finer = np.zeros((int(wanted[-1]) + 1, angles.shape[1]))
    before = np.zeros(angles.shape[1])
    row = 0
    for angle, count in zip(angles, counts, strict=True):
        for part in range(1, count + 1):
            finer[row] = angle if part == count else before + (angle - before) * (part / count)
            row += 1
        before = angle
    return finer, wanted


def _moment_angle(path: Path, friction: FloatArray, along: FloatArray) -> FloatArray:
    """|M| s/(3 EI) along the path [rad]: lever over k(u), finite angle and friction along the beam."""
    r = path.slope
    stiff = 1.0 + (15.0 / 14.0) * r * r
    stiff -= (0.2 * friction) * path.along * r
    stiff *= _softening(along * r)
    return np.asarray(path.lever / stiff)


def _cycle(
    path: Path, moment: FloatArray, wanted: NDArray[np.int64], shape: tuple[int, ...], scale: FloatArray
) -> CycleResponse:
    def take(values: FloatArray) -> FloatArray:
        return np.ascontiguousarray(values[wanted].T).reshape(shape)

    return CycleResponse(
        delta=take(path.delta),
        moment_angle=take(moment),
        slipped_off=np.ascontiguousarray(path.slipped_off[wanted].T).reshape(shape),
        slide=take(path.slide) * scale[..., None],
        arc_length=take(path.arc_length) * scale[..., None],
    )


def _floats(*values: ArrayLike) -> list[FloatArray]:
    return [np.asarray(value, dtype=np.float64) for value in values]


def _rows(
    eps: ArrayLike,
    thetas: ArrayLike,
    distance: ArrayLike,
    friction: ArrayLike,
    radius_along: ArrayLike,
    radius_across: ArrayLike,
) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
    """Validated and broadcast: angles (..., k), s (...), and flat (eps, mu, R/s, R_l/s)."""
    angles = np.asarray(thetas, dtype=np.float64)
    if angles.ndim == 0 or angles.shape[-1] == 0:
        raise UsageError("thetas holds no angle along its last axis: give (..., k) with k of 1 or more")
    e, s, mu, r, r_l = _floats(eps, distance, friction, radius_along, radius_across)
    if not (np.all(angles >= 0.0) and np.all(angles <= MAX_ANGLE)):
        raise UsageError(f"thetas must lie between 0 and {MAX_ANGLE} rad; a push beyond is no push")
    if not np.all(np.isfinite(e)):
        raise UsageError("eps holds a value that is not finite: give the pushing direction in rad")
    if not (np.all(s > 0.0) and np.all(np.isfinite(s))):
        raise UsageError("distance must be finite and above zero, in metres")
    if not (np.all(mu >= 0.0) and np.all(np.isfinite(mu))):
        raise UsageError("friction must be zero or more: the coefficient, not the angle")
    if not (np.all(r >= 0.0) and np.all(np.isfinite(r))):
        raise UsageError("radius_along must be finite and zero (an edge) or more, in metres")
    if np.any(np.isnan(r_l)):
        raise UsageError("radius_across is not a number: give metres, inf for a flat profile")
    shape = np.broadcast_shapes(angles.shape[:-1], e.shape, s.shape, mu.shape, r.shape, r_l.shape)
    angles = np.broadcast_to(angles, (*shape, angles.shape[-1]))
    s = np.broadcast_to(s, shape)
    with np.errstate(invalid="ignore"):
        flat = tuple(np.broadcast_to(v, shape).ravel() for v in (e, mu, r / s, r_l / s))
    return angles, s, (flat[0], flat[1], flat[2], flat[3])
