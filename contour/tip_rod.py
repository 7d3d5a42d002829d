"""The reduced rod whose tip touches: its end slides on a surface that leans out of the sensing plane.

Lengths are in units of the distance s at touch, the length of the rod. Frame at touch as in
contour.reduced_rod; the outer normal leans by chi towards the base, so that the surface's axes are

    e_n' = cos chi e_n - sin chi e_y,   e_y' = cos chi e_y + sin chi e_n.

The surface is the profile in (e_t, e_n') swept along a second one in the plane of e_n' and e_y'. Two numbers
place the tip: b on the profile, v along e_y'. The rod's length gives v, Coulomb's law gives b. With e_a, n, e_v
the surface's directions at the tip, P the tip, t0 the base tangent and m = t0 x P,

    |P|^2 = 1 - r^2 Q(p, r^2),   r = |m|/(P . t0),   p = r tau,   tau = F . t0/(F across),
    F ~ n - mu (da e_a + dv e_v)/slip,   F . m = 0,   slip^2 = da^2 + dv^2,

where da and dv are the step's slips. The last equation says that the force lies in the plane in which the rod
bends. The base moment is |M| s/(3 EI) = r/D(p, r^2); D and Q are series of the exact rod's.
docs/derivations.md derives this, section 6; the exact rod is in contour.elastica.
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from contour.silhouette import Profile

__all__ = [
    "NOTHING",
    "Memory",
    "Place",
    "Rows",
    "Turn",
    "base_turn",
    "direction",
    "divisor",
    "force",
    "held_pull",
    "place",
    "shrinkage",
    "take",
]

FloatArray = NDArray[np.float64]

NOTHING = 1e-40
"""Square of a slip that counts as none [s^2]; keeps 0/0 out of a step that does not move."""
LARGEST_PULL = 0.6
"""p beyond which the series are not followed: near 1 the force points along the chord and cannot bend the rod."""
RIDGE_TURN = 0.9
"""Sine of the turn along the beam's own profile beyond which it is not followed."""


class Rows(NamedTuple):
    """What stays the same along the push for some rows."""

    sin_eps: FloatArray
    cos_eps: FloatArray
    sin_tilt: FloatArray
    cos_tilt: FloatArray
    friction: FloatArray
    ridge: FloatArray
    profile: Profile

    def rows(self, index: NDArray[np.int64]) -> Rows:
        """The same for a selection."""
        e, f, g, h, mu, ridge = (v[index] for v in (*self[:4], self.friction, self.ridge))
        return Rows(e, f, g, h, mu, ridge, self.profile.rows(index))


class Turn(NamedTuple):
    """t0 in (e_t, e_n', e_y'), and Q's part that does not depend on r."""

    t: FloatArray
    n: FloatArray
    y: FloatArray
    shrink: FloatArray


class Memory(NamedTuple):
    """The last b, and the lateral and longitudinal position that slips count from (as contour.reduced_rod's)."""

    b: FloatArray
    slid: FloatArray
    paid: FloatArray


class Place(NamedTuple):
    """The tip at b, its v corrected for the rod's length, and what follows from both."""

    v: FloatArray
    v_rate: FloatArray
    """dv/da."""
    m_a: FloatArray
    """m . e_a; below zero where the body presses."""
    m_n: FloatArray
    m_v: FloatArray
    t_a: FloatArray
    """t0 . e_a."""
    t_n: FloatArray
    t_v: FloatArray
    slope2: FloatArray
    """r^2."""
    ahead: FloatArray
    """P . t0."""
    curvature: FloatArray
    speed: FloatArray
    climb: FloatArray
    """Arc length that belongs to v."""
    widen: FloatArray | float
    """Length of a slide over that of the profile's own."""


Record = TypeVar("Record", Turn, Memory)


def take(record: Record, index: NDArray[np.int64]) -> Record:
    """The same for a selection."""
    return type(record)(*(v[index] for v in record))


def _ridge(rows: Rows, v: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sine and cosine of the second profile's turn at v, and its height there."""
    sin_z = np.clip(rows.ridge * v, -RIDGE_TURN, RIDGE_TURN)
    cos_z = np.sqrt(1.0 - sin_z * sin_z)
    return sin_z, cos_z, -v * sin_z / (1.0 + cos_z)


def place(rows: Rows, turn: Turn, b: FloatArray, guess: FloatArray) -> Place:
    """Where the tip is at b; ``guess`` is near its v."""
    along, out, cos, sin, curvature, speed = rows.profile.at(b)
    bent = rows.ridge.any()
    widen: FloatArray | float = 1.0
    if bent:
        sin_z, cos_z, drop = _ridge(rows, guess)
        along += drop * sin
        out += drop * cos
        widen = 1.0 + curvature * drop
        curvature, speed = curvature / widen, speed / widen
    deep = out - rows.sin_tilt
    p_a = along * cos - deep * sin
    p_n = along * sin + deep * cos
    p_y = rows.cos_tilt + guess
    t_a = turn.t * cos - turn.n * sin
    t_n = turn.t * sin + turn.n * cos
    t_v = turn.y
    ahead = t_a * p_a + t_n * p_n + t_v * p_y
    m_a = t_n * p_y - t_v * p_n
    m_n = t_v * p_a - t_a * p_y
    m_v = t_a * p_n - t_n * p_a
    slope2 = (m_a * m_a + m_n * m_n + m_v * m_v) / (ahead * ahead)
    # |P|^2 = 1 - r^2 Q, of which (sin chi)^2 + (cos chi)^2 = 1 is taken out.
    rest = (0.186 * slope2 - turn.shrink) * slope2 - along * along + (rows.sin_tilt - deep) * out
    rest = np.maximum(rest, -0.9 * rows.cos_tilt * rows.cos_tilt)
    v = rest / (rows.cos_tilt + np.sqrt(rows.cos_tilt * rows.cos_tilt + rest))
    more = v - guess
    w_a, w_y = p_a - ahead * t_a, p_y - ahead * t_v
    give = p_y + turn.shrink * w_y
    if bent:
        give -= (p_n + turn.shrink * (p_n - ahead * t_n)) * sin_z / cos_z
    rate = -(p_a + turn.shrink * w_a) / give
    climb = v
    if bent:
        climb = v * (1.0 + sin_z * sin_z / 6.0)
        # Turn n and e_v with the ridge.
        m_n, m_v = cos_z * m_n + sin_z * m_v, cos_z * m_v - sin_z * m_n
        t_n, t_v = cos_z * t_n + sin_z * t_v, cos_z * t_v - sin_z * t_n
    return Place(
        v,
        rate,
        m_a + t_n * more,
        m_n - t_a * more,
        m_v,
        t_a,
        t_n,
        t_v,
        slope2,
        ahead,
        curvature,
        speed,
        climb,
        widen,
    )


def base_turn(rows: Rows, sine: FloatArray, cosine: FloatArray, p: FloatArray) -> Turn:
    """t0 at sin theta and cos theta on the surface's axes, and Q for p."""
    t_n = -sine * rows.cos_eps
    return Turn(
        -sine * rows.sin_eps,
        rows.cos_tilt * t_n - rows.sin_tilt * cosine,
        rows.cos_tilt * cosine + rows.sin_tilt * t_n,
        shrinkage(p),
    )


def shrinkage(p: FloatArray) -> FloatArray:
    """Q(p, 0)."""
    return 0.2 - p * (6.0 / 175.0 + p * (0.035 + p * (0.0345 + 0.03 * p)))


def held_pull(p: FloatArray, before: FloatArray, now: FloatArray) -> FloatArray:
    """p of a tip that has not slipped along since it was p and r^2 was ``before``: r^2 Q(p, 0) stays what it was."""
    target = shrinkage(p) * before / now
    for _ in range(2):
        rate = 6.0 / 175.0 + p * (0.07 + p * (0.1035 + 0.12 * p))
        p = p + (shrinkage(p) - target) / rate
    return p


def divisor(p: FloatArray, r2: FloatArray) -> FloatArray:
    """D(p, r^2): r over the moment angle of a rod of length 1."""
    straight = 1.0 - p * (0.2 + p * (32.0 / 175.0 + p * (0.1646 + p * (0.1589 + 0.1385 * p))))
    return straight + r2 * (6.0 / 35.0 - p * (0.173 + 0.146 * p))


def force(rows: Rows, p: Place, slid: FloatArray, paid: FloatArray) -> tuple[FloatArray, FloatArray]:
    """p = r tau of the force, and its angle off the end tangent."""
    scale = rows.friction / np.sqrt(slid * slid + paid * paid + NOTHING)
    f_a, f_v = -scale * slid, -scale * paid
    # F across in the plane of bending is F . (m x t0)/|m|.
    size = np.sqrt(p.slope2) * p.ahead
    across = f_a * (p.m_n * p.t_v - p.m_v * p.t_n) + (p.m_v * p.t_a - p.m_a * p.t_v)
    across += f_v * (p.m_a * p.t_n - p.m_n * p.t_a)
    onward = f_a * p.t_a + p.t_n + f_v * p.t_v
    pull = np.where(across > 0.0, onward * size * size / (p.ahead * across), LARGEST_PULL)
    eta = np.arctan2(across, onward * size) - 1.5 * np.sqrt(p.slope2)
    return np.clip(pull, -LARGEST_PULL, LARGEST_PULL), eta


def direction(rows: Rows, base: tuple[FloatArray, FloatArray], b: FloatArray, v: FloatArray) -> FloatArray:
    """delta, from the tip's place on the axes at touch."""
    sine, cosine = base
    along, deep, cos, sin, _, _ = rows.profile.at(b)
    p_y = rows.cos_tilt + v
    if rows.ridge.any():
        _, _, drop = _ridge(rows, v)
        along += drop * sin
        deep += drop * cos
    deep -= rows.sin_tilt
    at_n, at_y = rows.cos_tilt * deep + rows.sin_tilt * p_y, rows.cos_tilt * p_y - rows.sin_tilt * deep
    towards = -(rows.sin_eps * along + rows.cos_eps * at_n)
    across = rows.sin_eps * at_n - rows.cos_eps * along
    return np.asarray(np.pi + np.arctan2(across, sine * at_y - cosine * towards))
