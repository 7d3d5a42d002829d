"""Closed forms: the laws of Kaneko1998 with their slips mended, and the one-push rule of Solomon2008.

Each takes and gives arrays that broadcast, in SI units; derivations and corrections are in
docs/derivations.md. Bending stiffness means EI [N m^2]; angles are in rad.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contour.errors import UsageError

__all__ = [
    "SLIP_RATES",
    "SLIP_TOTALS",
    "OnePush",
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
    "return_onset",
    "slip_law",
    "soft_body",
    "softening",
]

FloatArray = NDArray[np.float64]

SLIP_RATES = 1.0 / 5.0
"""k of (47) in Kaneko1998: the ratio of the rates of lateral and longitudinal slip, as the paper takes it."""
SLIP_TOTALS = 1.0 / 10.0
"""k with which (48) takes the ratio of the totals instead: half, and right inside the cone, where the contact
creeps."""
_HALVINGS = 60
"""Halvings of the friction cone in (48): a double's precision."""
_DISTANCE_STEPS = 50
"""Fixed-point steps for s in k(s/(R theta)); each gains a factor u/4 or better."""


def _floats(*values: ArrayLike) -> list[FloatArray]:
    return [np.asarray(value, dtype=np.float64) for value in values]


def force_direction(moment_x: ArrayLike, moment_z: ArrayLike) -> FloatArray:
    """psi [rad], direction in the sensing plane of the force on the beam, (13) and (14) of Kaneko1998.

    A force f at s along y_s gives the moment m = s y x f = s (f_z, 0, -f_x).

    >>> round(float(force_direction(1.0, -1.0)), 4)
    0.7854
    """
    m_x, m_z = _floats(moment_x, moment_z)
    return np.asarray(np.arctan2(m_x, -m_z))


def compliance(distance: ArrayLike, *, bending_stiffness: ArrayLike, adaptor: ArrayLike = 0.0) -> FloatArray:
    """c0 [rad/(N m)] of an edge at ``distance`` [m]: (s - a)^3/(3 EI s^2), a the adaptor's length [m].

    (7) and (12) of Kaneko1998 for a = 0; with a, the beam of length s - a bends by f (s - a)^3/(3 EI) under
    the force f = M/s, and the base turns by that over s.
    """
    s, stiffness, a = _floats(distance, bending_stiffness, adaptor)
    return np.asarray((s - a) ** 3 / (3.0 * stiffness * s * s))


def finite_angle(theta: ArrayLike, friction: ArrayLike = 0.0) -> FloatArray:
    """3 EI C/s of an edge pushed along its normal: 1 + (5/21) theta^2 - mu theta/5.

    ``friction`` is mu on the way out, where the beam pays out, and -mu on the way back.
    """
    angle, mu = _floats(theta, friction)
    return np.asarray(1.0 + (5.0 / 21.0) * angle * angle - 0.2 * mu * angle)


def k_of_h(h: ArrayLike) -> FloatArray:
    """Share k of the edge's compliance that is left on a round body, h = s/(R theta), for small angles.

    (23), (31) and (32) of Kaneko1998 solved without linearising in 1/h; to first order k = 1 - 3/(8h).

    >>> round(float(k_of_h(10.0)), 4)
    0.9636
    """
    return softening(1.0 / np.asarray(h, dtype=np.float64))


def k_of_h_printed(h: ArrayLike) -> FloatArray:
    """k as (34) of Kaneko1998 prints it: 1 - 1/(2h), which drops R (1 - cos zeta) of the same order."""
    return np.asarray(1.0 - 0.5 / np.asarray(h, dtype=np.float64))


def softening(u: FloatArray) -> FloatArray:
    """k as a function of u = 1/h = R theta/s, which may be zero."""
    # zeta/theta = ((2 + u) - sqrt((2 + u)^2 - 2u))/u, without its cancellation.
    zeta = 2.0 / (2.0 + u + np.sqrt(u * (u + 2.0) + 4.0))
    return np.asarray(1.5 * (1.0 - u * zeta) / (1.0 + zeta))


def distance_from_compliance(
    measured: ArrayLike,
    *,
    bending_stiffness: ArrayLike,
    theta: ArrayLike = 0.0,
    friction: ArrayLike = 0.0,
    radius_along: ArrayLike = 0.0,
) -> FloatArray:
    """s [m] from C = theta/|M| of a push along the inner normal: s = 3 EI C/(k(h) (1 + (5/21) theta^2 - mu
    theta/5)).

    Args:
        measured: C [rad/(N m)].
        bending_stiffness: EI [N m^2].
        theta: angle of the push [rad]; zero for a compliance extrapolated to it.
        friction: mu on the way out, -mu on the way back.
        radius_along: R [m]; k(s/(R theta)) contains s, which is found by fixed-point steps.

    >>> round(float(distance_from_compliance(8.0, bending_stiffness=4.14e-3)), 5)
    0.09936
    """
    c, stiffness, angle, mu, radius = _floats(measured, bending_stiffness, theta, friction, radius_along)
    edge = 3.0 * stiffness * c / finite_angle(angle, mu)
    s = edge
    for _ in range(_DISTANCE_STEPS):
        s = edge / softening(radius * angle / s)
    return np.asarray(s)


class Slip(NamedTuple):
    """What the slip law says of one push out on a flat profile."""

    beta: FloatArray
    """nu+ - psi [rad], the force off the outer normal, within the friction angle."""
    delta: FloatArray
    """phi - psi [rad]."""
    compliance_ratio: FloatArray
    """C/c0 = cos(beta)/sin(lambda)."""


def slip_law(eps: ArrayLike, theta: ArrayLike, friction: ArrayLike, *, gain: float = SLIP_TOTALS) -> Slip:
    """(44) to (49) of Kaneko1998 on a flat profile, lambda = eps + pi/2, with the slips of the print mended.

    tan(beta) = tan(alpha) sin(gamma), tan(gamma) = (cos lambda - sin lambda tan beta)/(k theta (sin
    lambda/cos beta)^2); the square is missing in (47) and (48). ``gain`` is k: :data:`SLIP_TOTALS`, or
    :data:`SLIP_RATES` for the curves of Figs. 13, 14 and 22.

    >>> law = slip_law(0.349, 0.0873, 0.176)
    >>> round(float(np.degrees(law.delta)), 1), round(float(law.compliance_ratio), 3)
    (190.0, 1.048)
    """
    e, angle, mu = np.broadcast_arrays(*_floats(eps, theta, friction))
    if not (np.all(np.abs(e) < 0.5 * np.pi) and np.all(angle > 0.0) and np.all(mu >= 0.0)):
        raise UsageError("slip_law needs |eps| below pi/2, theta above zero and friction of zero or more")
    sin_l, cos_l = np.cos(e), -np.sin(e)
    low, high = -np.arctan(mu), np.arctan(mu)
    for _ in range(_HALVINGS):
        beta = 0.5 * (low + high)
        tan = np.tan(beta)
        gamma = np.arctan2(cos_l - sin_l * tan, gain * angle * (sin_l / np.cos(beta)) ** 2)
        above = tan > mu * np.sin(gamma)
        low, high = np.where(above, low, beta), np.where(above, beta, high)
    beta = 0.5 * (low + high)
    return Slip(beta, np.pi + e + beta, np.asarray(np.cos(beta) / sin_l))


def return_onset(eps: ArrayLike, friction: ArrayLike) -> FloatArray:
    """Share of the largest angle at which a push that slid on a flat profile begins to slide home.

    (tan|eps| - tan alpha)/(tan|eps| + tan alpha): the stuck contact point lets the force swing through the
    whole cone while the base turns back; zero inside the cone, where nothing slid but the creep.

    >>> round(float(return_onset(np.radians(20.0), np.tan(np.radians(10.0)))), 3)
    0.347
    """
    e, mu = _floats(eps, friction)
    tan = np.abs(np.tan(e))
    total = np.maximum(tan + mu, np.finfo(np.float64).tiny)
    return np.asarray(np.maximum(tan - mu, 0.0) / total)


def compliance_on_soft_body(
    distance: ArrayLike, *, bending_stiffness: ArrayLike, body_stiffness: ArrayLike
) -> FloatArray:
    """C [rad/(N m)] on a body that gives way with ``body_stiffness`` k_o [N/m]: s/(3 EI) + 1/(s^2 k_o),
    (38).
    """
    s, stiffness, k_o = _floats(distance, bending_stiffness, body_stiffness)
    return np.asarray(s / (3.0 * stiffness) + 1.0 / (s * s * k_o))


class SoftBody(NamedTuple):
    """Where a soft body is, and how soft it is."""

    distance: FloatArray
    """s [m] of the first push, (42)."""
    body_stiffness: FloatArray
    """k_o [N/m], inf where the compliances are those of a rigid body."""
    other_root: FloatArray
    """The root (41) that is no distance: it lies between 0 and the shift."""


def soft_body(
    first: ArrayLike, second: ArrayLike, shift: ArrayLike, *, bending_stiffness: ArrayLike
) -> SoftBody:
    """Distance and stiffness of a soft body from two compliances, (38) to (42) of Kaneko1998.

    With c = 3 EI C and D the shift, both pushes obey s^2 (c1 - s) = (s - D)^2 (c2 - s + D), whose cubes
    cancel: f(s) = (3D + c2 - c1) s^2 - D (2 c2 + 3D) s + D^2 (c2 + D) = 0. Its leading factor exceeds 2D,
        because
    c1 - c2 < D; f(0) = D^2 (c2 + D) > 0; f(D) = D^2 (D - c1) < 0, because c1 > s > D. So exactly one root
    lies between 0 and D and exactly one beyond D, which alone leaves a length s - D > 0 for the second push.

    Args:
        first: C [rad/(N m)] at s.
        second: C at s - shift, nearer to the body.
        shift: how much nearer the base went [m].
        bending_stiffness: EI [N m^2].
    """
    c_1, c_2, d, stiffness = _floats(first, second, shift, bending_stiffness)
    c_1, c_2 = 3.0 * stiffness * c_1, 3.0 * stiffness * c_2
    lead = 3.0 * d + c_2 - c_1
    if not (np.all(d > 0.0) and np.all(c_1 > d) and np.all(c_2 > 0.0) and np.all(lead > 0.0)):
        raise UsageError(
            "soft_body needs a shift above zero, shorter than 3 EI times the first compliance, and compliances "
            "that differ by less than the shift allows: repeat the two pushes farther apart"
        )
    root = np.sqrt(4.0 * c_1 * c_2 + 4.0 * d * (c_1 - c_2) - 3.0 * d * d)
    half = d * (2.0 * c_2 + 3.0 * d)
    s = 0.5 * (half + d * root) / lead
    rest = s * s * (c_1 - s)
    given = rest > 0.0
    k_o = np.divide(3.0 * stiffness, rest, out=np.full(rest.shape, np.inf), where=given)
    return SoftBody(s, k_o, np.asarray(0.5 * (half - d * root) / lead))


class OnePush(NamedTuple):
    """What the one-push rule makes of a push."""

    distance: FloatArray
    """s [m]."""
    eps: FloatArray
    """Estimated pushing direction off the inner normal [rad]; phi - eps is the inner normal."""


def one_push(
    theta: ArrayLike,
    moment: ArrayLike,
    delta: ArrayLike,
    *,
    friction_angle: ArrayLike,
    bending_stiffness: ArrayLike,
) -> OnePush:
    """Distance and normal from one push that slips, Solomon2008, with an assumed friction angle.

    D = delta - pi, eps = D + sign(D) alpha, s = 3 EI theta cos(eps)/(|M| cos(alpha)). It holds where the
    contact slides on a flat profile and alpha is right; inside the cone its normal is off by the friction
    angle.
    """
    angle, m, d, alpha, stiffness = _floats(theta, moment, delta, friction_angle, bending_stiffness)
    off = d - np.pi
    eps = off + np.sign(off) * alpha
    return OnePush(
        np.asarray(3.0 * stiffness * angle * np.cos(eps) / (np.abs(m) * np.cos(alpha))), np.asarray(eps)
    )
