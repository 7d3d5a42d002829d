"""Mechanics of one push, forward and inverse, both strokes, in closed form; vectorised over pushes.

The forward model is the reduced rod (contour.slip); the paper's laws (contour.laws) are offered here beside
it. Signs: eps = phi - nu- is the pushing direction off the inner normal, delta = phi - psi the angle from the
force on the beam to the push; on the way out delta - pi has the sign of eps. Theory: docs/derivations.md,
section Mechanics.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contour.errors import UsageError
from contour.laws import (
    SLIP_RATES,
    SLIP_TOTALS,
    OnePush,
    Slip,
    SoftBody,
    compliance,
    compliance_on_soft_body,
    distance_from_compliance,
    finite_angle,
    force_direction,
    k_of_h,
    k_of_h_printed,
    one_push,
    return_onset,
    slip_law,
    soft_body,
    softening,
)
from contour.response import (
    LEAST_ANGLE,
    CycleResponse,
    PushRequest,
    PushResponse,
    as_asked,
    refine,
    request,
    request_tip,
)
from contour.silhouette import ArcProfile, Profile, sampled
from contour.slip import follow
from contour.tip import follow_tip

__all__ = [
    "SLIP_RATES",
    "SLIP_TOTALS",
    "CycleResponse",
    "OnePush",
    "PushResponse",
    "Slip",
    "SoftBody",
    "compliance",
    "compliance_on_soft_body",
    "distance_from_compliance",
    "finite_angle",
    "force_direction",
    "k_of_h",
    "k_of_h_printed",
    "one_push",
    "push_cycle",
    "push_cycle_mixed",
    "push_cycle_profile",
    "push_cycle_tip",
    "push_response",
    "return_onset",
    "slip_law",
    "soft_body",
    "softening",
]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

STEPS_OUT = 8
"""Steps a push out is followed in, at least; twice as many move delta by 0.01 deg rms."""


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
        theta: angle that the base turns [rad]; at zero the answer is the limit.
        distance: s, centre of rotation to contact [m].
        friction: coefficient mu, the tangent of the friction angle.
        radius_along: R of the body along the beam [m], 0 for an edge.
        radius_across: R_l of the profile in the sensing plane [m], inf flat, below 0 concave, 0 a corner, on
            which the contact stays: where the faces beside it let it slide off is for the caller to know.

    >>> push = push_response(0.1, 0.05, distance=0.1, friction=0.18, radius_along=0.0, radius_across=np.inf)
    >>> round(float(push.compliance_ratio), 4), round(float(push.delta), 3)
    (0.9994, 3.145)
    """
    angle = np.asarray(theta, dtype=np.float64)[..., None]
    angle = np.where((angle >= 0.0) & (angle < LEAST_ANGLE), LEAST_ANGLE, angle)
    cycle = push_cycle(
        eps,
        angle,
        distance=distance,
        friction=friction,
        radius_along=radius_along,
        radius_across=radius_across,
    )
    return PushResponse(
        delta=cycle.delta[..., 0],
        compliance_ratio=(angle / cycle.moment_angle)[..., 0],
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
    steps: int = STEPS_OUT,
) -> CycleResponse:
    """What pushes along a path of angles, out and back, are answered with, with the memory of friction.

    Args:
        eps: pushing direction off the inner normal [rad], (...).
        thetas: angles of the base from touch, in their order [rad], (..., k).
        distance: s [m], (...).
        friction: mu, (...).
        radius_along: R [m], as for :func:`push_response`, (...).
        radius_across: R_l [m], as for :func:`push_response`, (...).
        steps: a stroke is followed in no fewer.
    """
    asked = request(eps, thetas, distance, friction, radius_along, radius_across)
    return _answer(asked, ArcProfile(asked.bend), steps)


def push_cycle_profile(
    eps: ArrayLike,
    thetas: ArrayLike,
    *,
    distance: ArrayLike,
    friction: ArrayLike,
    radius_along: ArrayLike,
    profile: tuple[ArrayLike, ArrayLike],
) -> CycleResponse:
    """The same on an arbitrary silhouette.

    Args:
        eps: pushing direction off the inner normal at touch [rad], (...).
        thetas: angles of the base from touch, in their order [rad], (..., k).
        distance: s [m], (...).
        friction: mu, (...).
        radius_along: R [m], as for :func:`push_response`, (...).
        profile: (offsets, heights) [m], each (m,) or (..., m): heights above the tangent at touch along the
            outer normal, at rising offsets along that tangent, positive a quarter turn past the outer normal
            in the sense of the sensing plane's angles (with the beam along d and the outer normal n, along n
            x d). Below zero on a convex body; not a number where the body has ended. A contact that leaves
            the samples has slipped off.
    """
    asked = request(eps, thetas, distance, friction, radius_along, np.inf)
    return _answer(asked, sampled(*profile, asked.distance))


def push_cycle_tip(
    eps: ArrayLike,
    thetas: ArrayLike,
    *,
    distance: ArrayLike,
    friction: ArrayLike,
    radius_along: ArrayLike,
    radius_across: ArrayLike,
    tilt: ArrayLike,
    steps: int = STEPS_OUT,
) -> CycleResponse:
    """What pushes with the tip are answered with: the rod is bent all along, and its end slides on the surface.

    Forces and slips are taken on the leaning surface itself (contour.tip).

    Args:
        eps: pushing direction off the inner normal's part in the sensing plane [rad], (...).
        thetas: angles of the base from touch, in their order [rad], (..., k).
        distance: L [m], centre of rotation to tip, (...).
        friction: mu, (...).
        radius_along: radius of the surface in the plane of the beam and the normal [m], inf flat, (...).
        radius_across: radius of the surface across it [m], inf flat, below 0 concave, (...).
        tilt: angle chi of the outer normal out of the sensing plane, positive towards the base [rad], (...).
        steps: a stroke is followed in no fewer.
    """
    asked, chi, ridge = request_tip(eps, thetas, distance, friction, radius_along, radius_across, tilt)
    return _answer_mixed(asked, (chi, ridge), np.ones(chi.shape, dtype=np.bool_), steps)


def push_cycle_mixed(
    eps: ArrayLike,
    thetas: ArrayLike,
    *,
    distance: ArrayLike,
    friction: ArrayLike,
    radius_along: ArrayLike,
    radius_across: ArrayLike,
    tilt: ArrayLike,
    tip: ArrayLike,
    ridge: ArrayLike = np.inf,
    steps: int = STEPS_OUT,
) -> CycleResponse:
    """:func:`push_cycle_tip` where ``tip`` (...) is true and :func:`push_cycle` elsewhere, in one call.

    The arguments are theirs; ``tilt`` and ``ridge``, a tip's ``radius_along`` [m], say nothing of sides, nor
    ``radius_along`` of tips.
    """
    end = np.asarray(tip, dtype=np.bool_)
    asked, chi, bend = request_tip(
        eps,
        thetas,
        distance,
        friction,
        np.where(end, ridge, np.inf),
        radius_across,
        np.where(end, tilt, 0.0),
    )
    radius = np.asarray(radius_along, dtype=np.float64)
    if not np.all(end | ((radius >= 0.0) & np.isfinite(radius))):
        raise UsageError("radius_along must be finite and zero (an edge) or more, in metres")
    shape = asked.distance.shape
    along = np.broadcast_to(np.where(end, 0.0, radius) / asked.distance, shape).ravel()
    flags = np.broadcast_to(end, shape).ravel()
    return _answer_mixed(asked._replace(along=along), (chi, bend), flags, steps)


def _answer_mixed(
    asked: PushRequest, surface: tuple[FloatArray, FloatArray], tip: BoolArray, steps: int
) -> CycleResponse:
    """Sides and tips, each kind followed together; ``surface`` holds tilt and curvature along of the tips'."""
    side, end = np.flatnonzero(~tip), np.flatnonzero(tip)
    if not end.size:
        return _answer(asked, ArcProfile(asked.bend), steps)
    path_angles, wanted = refine(asked.angles, steps)
    delta, moment, slide = (np.zeros(path_angles.shape) for _ in range(3))
    length, off = np.ones(path_angles.shape), np.zeros(path_angles.shape, dtype=np.bool_)
    tilt, ridge = surface
    rubbed, profile = asked.friction[end], ArcProfile(asked.bend[end])
    path = follow_tip(asked.eps[end], path_angles[:, end], rubbed, tilt[end], ridge[end], profile)
    delta[:, end], moment[:, end], slide[:, end] = path.delta, path.moment_angle, path.slide
    off[:, end] = path.slipped_off
    if side.size:
        rubbed, profile = asked.friction[side], ArcProfile(asked.bend[side])
        rest = follow(asked.eps[side], path_angles[:, side], rubbed, asked.along[side], profile)
        delta[:, side], moment[:, side], slide[:, side] = rest.delta, rest.moment_angle, rest.slide
        length[:, side], off[:, side] = rest.arc_length, rest.slipped_off
    scale, near = asked.distance[..., None], asked.share.T.reshape(asked.shape)
    return CycleResponse(
        delta=as_asked(asked, wanted, delta),
        moment_angle=as_asked(asked, wanted, moment) * near,
        slipped_off=as_asked(asked, wanted, off),
        slide=as_asked(asked, wanted, slide) * scale,
        arc_length=as_asked(asked, wanted, length) * scale,
    )


def _answer(asked: PushRequest, profile: Profile, steps: int = STEPS_OUT) -> CycleResponse:
    path_angles, wanted = refine(asked.angles, steps)
    path = follow(asked.eps, path_angles, asked.friction, asked.along, profile)
    scale, near = asked.distance[..., None], asked.share.T.reshape(asked.shape)
    return CycleResponse(
        delta=as_asked(asked, wanted, path.delta),
        moment_angle=as_asked(asked, wanted, path.moment_angle) * near,
        slipped_off=as_asked(asked, wanted, path.slipped_off),
        slide=as_asked(asked, wanted, path.slide) * scale,
        arc_length=as_asked(asked, wanted, path.arc_length) * scale,
    )
