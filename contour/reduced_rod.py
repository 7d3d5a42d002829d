"""The reduced rod: the geometry and the forces of a bent beam as functions of one unknown, its slide.

The contact slides in the sensing plane on the body's silhouette and leans along the beam over its radius R;
the beam is a spring that points from its own base tangent to the touching point; Coulomb friction acts on the
lateral and longitudinal slip together, so that the memory of friction comes by itself (contour.slip). Lengths
are in units of the distance s at touch.

Frame at touch (fixed in the world during the push): e_t, e_n, e_y, where e_y is the beam, e_n the outer
normal and e_t lies a quarter turn past e_n in the sense of the angles of the sensing plane (from +x_s to
+z_s). A push with eps > 0 turns the beam towards -e_t, so the slide is negative.

At the slide a, with the profile's point c, tangent t and normal n there, the lean zeta of the touching point
P is the small-angle rod's, the root of a quadratic equation:

    P = e_y + c + R ((cos zeta - 1) n - sin zeta e_y),   zeta so that the rod is tangent there,
    X = P . t0,  W = P - X t0,  Y = |W|,  r = Y/X,  l = |P| (1 + r^2/10),  L = l + R zeta,

t0 the base tangent. The force is along W + h t0, its axial part h = tau Y - 3/2 r Y (1 + tau^2) with the
friction tau = mu dL/slip along a rod that is bent by 3/2 r; a solves Coulomb's law across,

    F . t + mu (F . n') dA/slip = 0,   slip^2 = dA^2 + dL^2,   n' = n cos zeta - e_y sin zeta,

dA and dL the step's increments of lateral slip, da - (t_end . t) dl, and of L. The base moment follows:
|M| s/(3 EI) = (r/X) / (1 + (15/14) r^2 - tau r/5). docs/derivations.md derives this; a converged rod is in
contour.elastica.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contour.silhouette import Profile

__all__ = [
    "Conditions",
    "Memory",
    "Place",
    "Rows",
    "Slopes",
    "Turn",
    "conditions",
    "place",
    "residual",
    "slopes",
]

FloatArray = NDArray[np.float64]

NOTHING = 1e-40
"""Square of a slip that counts as none [s^2]; keeps 0/0 out of a step that does not move."""


class Memory(NamedTuple):
    """What friction remembers of the steps before.

    The slip of a step counts from here. Where a stroke goes on, ``paid`` and ``slid`` hold in addition
    w^2/(1 + 2w) of the slip of the step before, w being the ratio of the steps: then the direction of the
    slip is that of its rate at the end of the step, to second order.
    """

    b: FloatArray
    length: FloatArray
    """l at the last step."""
    paid: FloatArray
    """L to count from."""
    slid: FloatArray
    """Lateral slip to count from."""

    def rows(self, index: NDArray[np.int64]) -> Memory:
        """The same for a selection."""
        return Memory(*(v[index] for v in self))


class Rows(NamedTuple):
    """What stays the same along the push for some rows."""

    sin_eps: FloatArray
    cos_eps: FloatArray
    friction: FloatArray
    radius: FloatArray
    profile: Profile

    def rows(self, index: NDArray[np.int64]) -> Rows:
        """The same for a selection."""
        return Rows(
            self.sin_eps[index],
            self.cos_eps[index],
            self.friction[index],
            self.radius[index],
            self.profile.rows(index),
        )


class Turn(NamedTuple):
    """The base's attitude at a step: cos theta, sin theta sin eps, sin theta cos eps."""

    cos: FloatArray
    t: FloatArray
    n: FloatArray
    lift: FloatArray
    """3/2 sin^2 theta."""
    drag: FloatArray
    """tau/20, as far as the stroke tells."""

    def rows(self, index: NDArray[np.int64]) -> Turn:
        """The same for a selection."""
        return Turn(*(v[index] for v in self))


class Place(NamedTuple):
    """The touching point at b, in the directions t and n there, and what follows from it."""

    p_t: FloatArray
    p_n: FloatArray
    p_y: FloatArray
    ahead: FloatArray
    """X."""
    tilt_t: FloatArray
    """-t0 . t."""
    tilt_n: FloatArray
    """-t0 . n."""
    zeta: FloatArray
    spread: FloatArray
    """Slope of the equation for zeta."""
    drop: FloatArray
    """R (1 - cos zeta)."""
    lateral: FloatArray
    """W . t."""
    normal: FloatArray
    """W . n."""
    press: FloatArray
    """W along the normal where the rod touches, n cos zeta - e_y sin zeta."""
    square: FloatArray
    """|P|^2."""
    cos: FloatArray
    sin: FloatArray
    curvature: FloatArray
    speed: FloatArray


def _lean(
    rows: Rows, turn: Turn, level: FloatArray, tilt_n: FloatArray, p_n: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """zeta, the lean of the touching point, and what its equation divides by."""
    # zeta: tan(bend) = tilt_n + cos zeta, times X, a quadratic but for terms that the edge's own lean stands
    # in for.
    level_tilt = level * tilt_n
    depth = level_tilt + p_n
    rho = depth / level
    edge = 1.5 * rho
    edge -= tilt_n
    constant = (3.0 / 7.0) * rho
    constant -= turn.drag
    constant *= rho
    constant += 1.0
    constant *= depth
    constant *= 1.5
    constant -= level_tilt
    rho = edge * edge
    rho *= 1.0 / 3.0
    rho += turn.lift
    rho *= edge
    constant -= rho
    spread = (0.5 * rows.radius) * tilt_n
    spread += level
    spread *= turn.cos
    zeta = (4.0 * turn.cos * turn.cos - 3.0) * rows.radius
    zeta *= constant
    root = spread * spread
    root -= zeta
    np.maximum(root, 0.0, out=root)
    np.sqrt(root, out=root)
    root += spread
    zeta = constant + constant
    zeta /= root
    return zeta, spread


def place(rows: Rows, turn: Turn, b: FloatArray) -> Place:
    """Where the rod touches at b."""
    along, out, cos, sin, curvature, speed = rows.profile.at(b)
    tilt_t = turn.t * cos
    tilt_t -= turn.n * sin
    tilt_n = turn.t * sin
    tilt_n += turn.n * cos
    p_t = along * cos
    p_t -= out * sin
    p_n = along * sin
    p_n += out * cos
    level = turn.cos - turn.t * along
    level -= turn.n * out
    zeta, spread = _lean(rows, turn, level, tilt_n, p_n)
    shift = rows.radius * zeta
    drop = shift * zeta
    drop *= 0.5
    shift -= drop * zeta / 3.0
    p_n -= drop
    ahead = level - turn.cos * shift
    ahead += tilt_n * drop
    lateral = ahead * tilt_t
    lateral += p_t
    normal = ahead * tilt_n
    normal += p_n
    p_y = 1.0 - shift
    # Minus what the lean takes: zeta W_y + zeta^2/2 W . n.
    press = 0.5 * zeta * normal
    press -= ahead * turn.cos
    press += p_y
    press *= zeta
    np.subtract(normal, press, out=press)
    square = p_t * p_t
    square += p_n * p_n
    square += p_y * p_y
    return Place(
        p_t,
        p_n,
        p_y,
        ahead,
        tilt_t,
        tilt_n,
        zeta,
        spread,
        drop,
        lateral,
        normal,
        press,
        square,
        cos,
        sin,
        curvature,
        speed,
    )


class Conditions(NamedTuple):
    """Coulomb's law across at a place, in the slips since the last step."""

    slid: FloatArray
    """dA."""
    paid: FloatArray
    """dL."""
    aside: FloatArray
    """Y."""
    bent: FloatArray
    """3/2 r Y, the axial part of a force across the end of the bent rod."""
    length: FloatArray
    """l."""
    secant: FloatArray
    """|P|/X."""


def conditions(rows: Rows, p: Place, b: FloatArray, before: Memory) -> Conditions:
    """Slips since the last step, and what the law of friction needs, at a place."""
    chord = np.sqrt(p.square)
    secant = chord / p.ahead
    length = secant * secant
    r2 = length - 1.0
    bent = (1.5 * p.ahead) * r2
    aside = p.ahead * np.sqrt(np.maximum(r2, 0.0))
    length *= 0.1
    length += 0.9
    length *= chord
    paid = rows.radius * p.zeta
    paid += length
    paid -= before.paid
    slid = p.curvature * p.drop
    np.subtract(1.0, slid, out=slid)
    slid *= rows.profile.chord(b, before.b)
    # The end tangent's part across, -tilt_t + 3/2 W . t/X, carries the rod sideways as it pays out.
    carry = 1.5 * p.lateral
    carry /= p.ahead
    carry -= p.tilt_t
    carry *= length - before.length
    slid -= carry
    slid -= before.slid
    return Conditions(slid, paid, aside, bent, length, secant)


class Slopes(NamedTuple):
    """Derivatives along the profile."""

    lateral: FloatArray
    """Of W . t."""
    normal: FloatArray
    """Of W . n."""
    paid: FloatArray
    """Of L."""


def slopes(rows: Rows, turn: Turn, p: Place, c: Conditions) -> Slopes:
    """How force and paid-out length change as the contact slides, to leading order in the lean."""
    lean = 1.5 * p.curvature * p.lateral
    lean -= p.tilt_t * (p.curvature * p.ahead + 0.5 * p.tilt_n)
    lean /= p.spread
    lean *= rows.radius
    forward = turn.cos * lean
    forward += p.tilt_t
    lateral = p.curvature * p.normal
    lateral += forward * p.tilt_t
    np.subtract(1.0, lateral, out=lateral)
    normal = p.curvature * p.lateral
    normal -= forward * p.tilt_n
    secant2 = c.secant * c.secant
    paid = p.p_t - lean
    paid /= p.ahead * c.secant
    paid *= 0.3 * secant2 + 0.9
    forward *= 0.2 * secant2 * c.secant
    paid += forward
    paid += lean
    return Slopes(lateral, normal, paid)


def residual(rows: Rows, turn: Turn, b: FloatArray, before: Memory) -> tuple[FloatArray, FloatArray]:
    """F . t + mu (F . n') dA/slip at b, and W . n."""
    p = place(rows, turn, b)
    c = conditions(rows, p, b, before)
    slip = np.sqrt(c.slid * c.slid + c.paid * c.paid + NOTHING)
    tau = rows.friction * c.paid / slip
    axial = tau * c.aside - c.bent * (1.0 + tau * tau)
    force_n = p.press - axial * (p.tilt_n + p.zeta)
    return p.lateral - axial * p.tilt_t + rows.friction * force_n * c.slid / slip, p.normal
