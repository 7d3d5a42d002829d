"""The geometrically exact rung of the forward model, for reference and for the few contacts that need it.

Inextensible, isotropic, three-dimensional rod on a doubly curved body, Coulomb friction with sticking,
quasi-static and incremental, both strokes; the mechanics are in contour.rod and contour.planar_elastica. Same
signatures, units and signs as contour.contact; the answers also say where the solution did not converge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contour.response import (
    CycleResponse,
    PushRequest,
    PushResponse,
    as_asked,
    refine,
    request,
    request_tip,
)
from contour.rod import Body, SideBody, TipBody
from contour.rod_path import Hint, follow_rod
from contour.silhouette import ArcProfile, Profile, sampled
from contour.slip import follow
from contour.tip import follow_tip

__all__ = [
    "RodCycleResponse",
    "RodPushResponse",
    "push_cycle",
    "push_cycle_profile",
    "push_cycle_tip",
    "push_response",
]

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float64]

STEPS_OUT = 16
"""Steps a push out is followed in, at least; twice as many move delta by 0.01 deg rms on the way back."""
LEAST_ANGLE = 1e-4
"""A push is never followed at less than this angle [rad]: its slips drown in rounding."""
LEAST_ANGLE_TIP = 2e-4
"""The same for a tip, whose friction changes the rod's length by the cube of the angle alone; steps below are one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RodPushResponse(PushResponse):
    """A push response that says whether it is one."""

    converged: BoolArray
    """All equations hold; False where the iteration gave up, and the fields are then those of the last
    contact."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RodCycleResponse(CycleResponse):
    """A cycle response that says how far it is one."""

    converged: BoolArray
    """All equations hold up to here; False where the iteration gave up, fields then those of the last
    contact."""


def push_response(
    eps: ArrayLike,
    theta: ArrayLike,
    *,
    distance: ArrayLike,
    friction: ArrayLike,
    radius_along: ArrayLike,
    radius_across: ArrayLike,
) -> RodPushResponse:
    """Exact :func:`contour.contact.push_response`.

    >>> push = push_response(0.0, 0.1, distance=0.1, friction=0.0, radius_along=0.0, radius_across=np.inf)
    >>> round(float(push.compliance_ratio), 4), bool(push.converged)
    (1.0024, True)
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
    return RodPushResponse(
        delta=cycle.delta[..., 0],
        compliance_ratio=(angle / cycle.moment_angle)[..., 0],
        slipped_off=cycle.slipped_off[..., 0],
        slide=cycle.slide[..., 0],
        arc_length=cycle.arc_length[..., 0],
        converged=cycle.converged[..., 0],
    )


def push_cycle(
    eps: ArrayLike,
    thetas: ArrayLike,
    *,
    distance: ArrayLike,
    friction: ArrayLike,
    radius_along: ArrayLike,
    radius_across: ArrayLike,
) -> RodCycleResponse:
    """Exact :func:`contour.contact.push_cycle`."""
    asked = request(eps, thetas, distance, friction, radius_along, radius_across, least=LEAST_ANGLE)
    return _answer(asked, ArcProfile(asked.bend))


def push_cycle_profile(
    eps: ArrayLike,
    thetas: ArrayLike,
    *,
    distance: ArrayLike,
    friction: ArrayLike,
    radius_along: ArrayLike,
    profile: tuple[ArrayLike, ArrayLike],
) -> RodCycleResponse:
    """Exact :func:`contour.contact.push_cycle_profile`.

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
    asked = request(eps, thetas, distance, friction, radius_along, np.inf, least=LEAST_ANGLE)
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
) -> RodCycleResponse:
    """What pushes with the tip are answered with: the rod is bent all along, and its end slides on the
    surface.

    Args:
        eps: pushing direction off the inner normal's part in the sensing plane [rad], (...).
        thetas: angles of the base from touch, in their order [rad], (..., k).
        distance: L [m], centre of rotation to tip, (...).
        friction: mu, (...).
        radius_along: radius of the surface in the plane of the beam and the normal [m], inf flat, (...).
        radius_across: radius of the surface across it [m], inf flat, below 0 concave, (...).
        tilt: angle chi of the outer normal out of the sensing plane, positive towards the base [rad], (...).
    """
    asked, lean, bend = request_tip(
        eps, thetas, distance, friction, radius_along, radius_across, tilt, least=LEAST_ANGLE_TIP
    )
    profile, ridge = ArcProfile(asked.bend), ArcProfile(bend)
    path_angles, wanted = refine(asked.angles, STEPS_OUT)
    path_angles = np.maximum(path_angles, LEAST_ANGLE_TIP)
    near = follow_tip(asked.eps, path_angles, asked.friction, lean, bend, profile)
    hints = Hint(near.parameter, near.climb, near.eta, near.slipped_off)
    body = TipBody(asked.eps, asked.friction, lean, ridge, profile)
    return _follow(asked, body, (path_angles, wanted), hints)


def _answer(asked: PushRequest, profile: Profile) -> RodCycleResponse:
    path_angles, wanted = refine(asked.angles, STEPS_OUT)
    near = follow(asked.eps, path_angles, asked.friction, asked.along, profile)
    eta = 0.5 * np.pi - np.arctan(asked.friction * near.along)
    body = SideBody(asked.eps, asked.friction, asked.along, profile)
    hints = Hint(near.parameter, near.lean, eta, near.slipped_off)
    return _follow(asked, body, (path_angles, wanted), hints)


def _follow(
    asked: PushRequest, body: Body, path: tuple[FloatArray, NDArray[np.int64]], hints: Hint
) -> RodCycleResponse:
    path_angles, wanted = path
    found = follow_rod(body, path_angles, hints)
    scale, near = asked.distance[..., None], asked.share.T.reshape(asked.shape)
    return RodCycleResponse(
        delta=as_asked(asked, wanted, found.delta),
        moment_angle=as_asked(asked, wanted, found.moment_angle) * near,
        slipped_off=as_asked(asked, wanted, found.slipped_off),
        slide=as_asked(asked, wanted, found.slide) * scale,
        arc_length=as_asked(asked, wanted, found.arc_length) * scale,
        converged=as_asked(asked, wanted, found.converged),
    )
