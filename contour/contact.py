"""Mechanics of one push, forward and inverse, both strokes, in closed form; vectorised over pushes.

The forward model is the reduced rod (contour.slip); the paper's laws (contour.laws) are offered here beside
it. Signs: eps = phi - nu- is the pushing direction off the inner normal, delta = phi - psi the angle from the
force on the beam to the push; on the way out delta - pi has the sign of eps. Theory: docs/derivations.md,
section Mechanics.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
    """What pushes with the tip are answered with, to first order in theta tan(tilt).

    The tip is drawn in by r^2/10 and so climbs or sinks on its tilted surface, whose force is tilted too;
    across the beam it slides as a side contact with the friction mu/cos(tilt).

    Args:
        eps: pushing direction off the inner normal's part in the sensing plane [rad], (...).
        thetas: angles of the base from touch, in their order [rad], (..., k).
        distance: L [m], centre of rotation to tip, (...).
        friction: mu, (...).
        radius_along: radius of the surface in the plane of the beam and the normal [m]; it matters in the
            next order.
        radius_across: radius of the surface across it [m], inf flat, below 0 concave, (...).
        tilt: angle chi of the outer normal out of the sensing plane, positive towards the base [rad], (...).
        steps: a stroke is followed in no fewer.
    """
    asked, chi, _ = request_tip(eps, thetas, distance, friction, radius_along, radius_across, tilt)
    return _answer_mixed(asked, chi, np.ones(chi.shape, dtype=np.bool_), steps)


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
    steps: int = STEPS_OUT,
) -> CycleResponse:
    """:func:`push_cycle_tip` where ``tip`` (...) is true and :func:`push_cycle` elsewhere, followed all together.

    The arguments are theirs; ``tilt`` says nothing of sides, nor ``radius_along`` of tips.
    """
    end = np.asarray(tip, dtype=np.bool_)
    chi = np.where(end, tilt, 0.0)
    asked = request(eps, thetas, distance, friction, np.where(end, 0.0, radius_along), radius_across)
    shape = asked.distance.shape
    chi, end = (np.broadcast_to(values, shape).ravel() for values in (chi, end))
    return _answer_mixed(asked, chi, end, steps)


def _answer_mixed(asked: PushRequest, chi: FloatArray, tip: BoolArray, steps: int) -> CycleResponse:
    path_angles, wanted = refine(asked.angles, steps)
    path = follow(asked.eps, path_angles, asked.friction / np.cos(chi), asked.along, ArcProfile(asked.bend))
    r = path.slope
    lifted = 1.0 - 0.1 * r * np.tan(chi) * np.cos(path.delta - np.pi - asked.eps)
    leant = np.tan(np.arctan(asked.friction * path.along) + 0.5 * r - chi)
    at_tip = path.lever * lifted / (1.0 + (15.0 / 14.0) * r * r - 0.2 * leant * r)
    scale, near = asked.distance[..., None], asked.share.T.reshape(asked.shape)
    length = np.where(tip, 1.0, path.arc_length)
    return CycleResponse(
        delta=as_asked(asked, wanted, path.delta),
        moment_angle=as_asked(asked, wanted, np.where(tip, at_tip, path.moment_angle)) * near,
        slipped_off=as_asked(asked, wanted, path.slipped_off),
        slide=as_asked(asked, wanted, path.slide) * scale,
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
