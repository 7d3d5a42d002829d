"""Following the reduced rod through a push: Coulomb friction, step by step, until the contact slips off.

Each step solves the reduced rod's contact condition (contour.reduced_rod) for the slide. Geometry and elastic
force are nearly linear in the slide; friction, dA/slip, is not: the geometry is linearised, and the friction
law is solved on it by Newton steps. Lengths are in units of the distance s at touch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contour.bracket import first_root
from contour.reduced_rod import (
    NOTHING,
    Conditions,
    Memory,
    Place,
    Rows,
    Turn,
    conditions,
    place,
    residual,
    slopes,
)
from contour.silhouette import Profile

__all__ = ["Path", "follow", "pace"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

CHUNK = 8192
"""Rows worked on at once: enough to hide the interpreter, few enough for a core's caches."""
INNER_STEPS = (2, 2)
"""Newton steps on the friction law within each step on the geometry, all rows."""
INNER_STEPS_HARD = (2, 3, 4, 6, 6, 6, 6)
"""The same on the rows that have not settled, before the bracketing search."""
SETTLED = 1e-8
"""What the next step would change, relative to the depth of the push: the last is accepted below this."""
LEAST_SLIP = 1e-20
"""Shortest slip that a bound divides by [s]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Path:
    """A push followed through k angles, n at a time, arrays (k, n), lengths in s."""

    delta: FloatArray
    """phi - psi [rad], 0 .. 2 pi."""
    moment_angle: FloatArray
    """|M| s/(3 EI) [rad]."""
    slope: FloatArray
    """r, tangent of the angle between base tangent and chord."""
    lever: FloatArray
    """r/X, the moment of a rod that bends little."""
    parameter: FloatArray
    """The profile's own parameter b of the contact."""
    slide: FloatArray
    """a, positive towards e_t."""
    lean: FloatArray
    """zeta [rad]."""
    arc_length: FloatArray
    """l."""
    along: FloatArray
    """dL/slip, the share of friction that acts along the beam, with its sign."""
    slipped_off: BoolArray
    """The contact has left the body; the values are those of a contact held where it last was."""


class _Law(NamedTuple):
    """Coulomb's law across on linearised geometry, in y = |dA|:

    pull + slope y - h sense_tilt + (grip + grip_slope y - mu h lean) y/slip = 0,  slip^2 = y^2 + (still + pay
    y)^2.
    """

    sense: FloatArray
    """Sign of dA."""
    pull: FloatArray
    """sense W . t at dA = 0."""
    slope: FloatArray
    sense_tilt: FloatArray
    """Minus sense t0 . t."""
    grip: FloatArray
    """mu W . n at dA = 0."""
    grip_slope: FloatArray
    lean: FloatArray
    """Minus t0 . n, with the contact's lean."""
    still: FloatArray
    """dL at dA = 0."""
    pay: FloatArray
    low: FloatArray
    """Root with friction's initial slope, which is its steepest: no root is below."""


def _law(rows: Rows, turn: Turn, p: Place, c: Conditions) -> _Law:
    mu = rows.friction
    rise = slopes(rows, turn, p, c)
    axial = mu * np.sign(c.paid)
    level = p.lateral - rise.lateral * c.slid
    sense = -np.sign(level - (axial * c.aside - c.bent * (1.0 + axial * axial)) * p.tilt_t)
    pull = sense * level
    pay = rise.paid
    pay *= sense
    y = sense * c.slid
    grip_slope = mu * rise.normal
    grip_slope *= sense
    grip = mu * p.press
    grip -= grip_slope * y
    still = c.paid - pay * y
    low = grip / (np.abs(still) + LEAST_SLIP)
    low += rise.lateral
    np.divide(-pull, low, out=low)
    np.maximum(low, 0.0, out=low)
    return _Law(
        sense=sense,
        pull=pull,
        slope=rise.lateral,
        sense_tilt=sense * p.tilt_t,
        grip=grip,
        grip_slope=grip_slope,
        lean=p.tilt_n + p.zeta,
        still=still,
        pay=pay,
        low=low,
    )


def _first(law: _Law, y_old: FloatArray) -> FloatArray:
    """Where to start: the highest of the last slip and the roots with full friction and with its initial
    slope.
    """
    y = -law.pull
    y -= law.grip
    y /= law.slope
    np.maximum(y, y_old, out=y)
    # Where the body curves away faster than the rod follows, the law has a second root: stay this side of it.
    np.copyto(y, 0.0, where=law.slope <= 0.0)
    np.maximum(y, law.low, out=y)
    return y


def _newton(
    law: _Law, mu: FloatArray, c: Conditions, y: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """One Newton step on the law: the new y, the step and the slip."""
    along = law.pay * y
    along += law.still
    slip2 = along * along
    slip2 += y * y
    slip2 += NOTHING
    slip = np.sqrt(slip2)
    slip2 *= slip
    lateral = y / slip
    tau = along / slip
    tau *= mu
    axial = tau * tau
    axial += 1.0
    axial *= c.bent
    np.subtract(tau * c.aside, axial, out=axial)
    normal = law.grip_slope * y
    normal += law.grip
    normal -= mu * axial * law.lean
    value = law.slope * y
    value += law.pull
    value -= axial * law.sense_tilt
    value += normal * lateral
    # d(y/slip)/dy = still along/slip^3, d(along/slip)/dy = -still y/slip^3.
    still_slip = law.still / slip2
    along *= still_slip
    along *= normal
    along += law.slope
    along += law.grip_slope * lateral
    tau *= -2.0 * c.bent
    tau += c.aside
    tau *= mu
    still_slip *= y
    tau *= still_slip
    tau *= law.sense_tilt + mu * lateral * law.lean
    along += tau
    value /= along
    y = y - value
    np.maximum(y, 0.5 * law.low, out=y)
    return y, value, slip


def _improve(
    rows: Rows, turn: Turn, b: FloatArray, before: Memory, inner: int
) -> tuple[FloatArray, FloatArray]:
    """A better b, and how far it still was, squared and compared with the slip (the second order that is
    left).

    The law is a concave function of y, so that Newton steps come to its root from below.
    """
    p = place(rows, turn, b)
    c = conditions(rows, p, b, before)
    law = _law(rows, turn, p, c)
    y_old = law.sense * c.slid
    y = _first(law, y_old)
    for _ in range(inner):
        y, step, slip = _newton(law, rows.friction, c, y)
    step *= step
    step /= slip
    y_old -= y
    moved = y_old * law.sense
    y_old *= y_old
    step += y_old
    moved *= p.speed
    return b - moved, step


def _search(rows: Rows, turn: Turn, before: Memory, depth: FloatArray) -> tuple[FloatArray, BoolArray]:
    """The first equilibrium past the last position; False where there is none."""

    def evaluate(b: FloatArray) -> tuple[FloatArray, BoolArray]:
        value, normal = residual(rows, turn, b, before)
        return value, (normal > 0.0) & rows.profile.within(b)

    return first_root(evaluate, before.b, depth, rows.profile.reach())


def _solve(
    rows: Rows, turn: Turn, guess: FloatArray, before: Memory, depth: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """The position at the end of one step: Newton from the guess on all rows, then on the few that need more.

    The search takes the rows that wander or settle where no contact can be.
    """
    b = guess
    for inner in INNER_STEPS:
        b, left = _improve(rows, turn, b, before, inner)
    on_body = np.ones(b.shape, dtype=np.bool_)
    rest = np.flatnonzero(~((left <= SETTLED * depth) & rows.profile.within(b)))
    if not rest.size:
        return b, on_body
    bad = _Stragglers(rest, rows.rows(rest), turn.rows(rest), before.rows(rest), depth[rest])
    for inner in INNER_STEPS_HARD:
        new, left = _improve(bad.rows, bad.turn, b[bad.which], bad.before, inner)
        b[bad.which] = new
        settled = (left <= SETTLED * bad.depth) & bad.rows.profile.within(new)
        bad = bad.take(np.flatnonzero(~settled))
        if not bad.which.size:
            break
    if bad.which.size:
        b[bad.which], on_body[bad.which] = _search(bad.rows, bad.turn, bad.before, bad.depth)
    return b, on_body


class _Stragglers(NamedTuple):
    """Rows that have not settled, with all that their next step needs."""

    which: NDArray[np.int64]
    rows: Rows
    turn: Turn
    before: Memory
    depth: FloatArray

    def take(self, keep: NDArray[np.int64]) -> _Stragglers:
        """Some of them."""
        return _Stragglers(
            self.which[keep],
            self.rows.rows(keep),
            self.turn.rows(keep),
            self.before.rows(keep),
            self.depth[keep],
        )


def follow(
    eps: FloatArray, thetas: FloatArray, friction: FloatArray, radius: FloatArray, profile: Profile
) -> Path:
    """Follow n pushes through k angles.

    Args:
        eps: pushing direction off the inner normal [rad], (n,).
        thetas: angles of the base from touch [rad], (k, n), all above zero.
        friction: mu, (n,).
        radius: R along the beam, (n,), in units of s.
        profile: the silhouettes, n of them, lengths in units of s.
    """
    count, n = thetas.shape
    names = ("delta", "moment_angle", "slope", "lever", "parameter", "slide", "lean", "arc_length", "along")
    fields = {name: np.zeros((count, n)) for name in names}
    slipped = np.zeros((count, n), dtype=np.bool_)
    for first in range(0, n, CHUNK):
        part = slice(first, min(first + CHUNK, n))
        index = np.arange(part.start, part.stop)
        rows = Rows(np.sin(eps[part]), np.cos(eps[part]), friction[part], radius[part], profile.rows(index))
        # Iterates of a push that runs away may overflow; they are caught by where they land.
        with np.errstate(all="ignore"):
            _follow_rows(rows, thetas[:, part], {k: v[:, part] for k, v in fields.items()}, slipped[:, part])
    return Path(slipped_off=slipped, **fields)


def _follow_rows(rows: Rows, thetas: FloatArray, out: dict[str, FloatArray], slipped: BoolArray) -> None:
    n = thetas.shape[1]
    zero = np.zeros(n)
    b, length, paid = zero, np.ones(n), np.ones(n)
    slid = pay = rate = along = moved_before = theta_before = zero
    gone = np.zeros(n, dtype=np.bool_)
    corner = rows.profile.held()
    for step, theta in enumerate(thetas):
        free = np.flatnonzero(~(corner | gone))
        sine = np.sin(theta)
        moved = theta - theta_before
        w = pace(moved, moved_before)
        turn = Turn(
            np.cos(theta),
            sine * rows.sin_eps,
            sine * rows.cos_eps,
            1.5 * sine * sine,
            0.05 * rows.friction * np.where(w > 0.0, along, np.sign(moved)),
        )
        carry = w * w / (1.0 + 2.0 * w)
        before = Memory(b, length, paid + carry * pay, carry * slid)
        guess = b + rate * (w * moved_before)
        if free.size == n:
            new, on_body = _solve(rows, turn, guess, before, theta)
            gone |= ~on_body
        else:
            new = b.copy()
            new[free], on_body = _solve(
                rows.rows(free), turn.rows(free), guess[free], before.rows(free), theta[free]
            )
            gone[free] |= ~on_body
        if gone.any():
            new = np.where(gone, b, new)
        p = place(rows, turn, new)
        pulled = np.flatnonzero((p.normal <= 0.0) & ~gone)
        if pulled.size:
            # A root at which the body would have to pull: look for one further on, or the contact is lost.
            new[pulled], on_body = _search(
                rows.rows(pulled), turn.rows(pulled), before.rows(pulled), theta[pulled]
            )
            gone[pulled] = ~on_body
            p = place(rows, turn, new)
        c = conditions(rows, p, new, before)
        along = c.paid / np.sqrt(c.slid * c.slid + c.paid * c.paid + NOTHING)
        slid, pay = c.slid + before.slid, c.paid + before.paid - paid
        paid, length = paid + pay, c.length
        rate = np.divide(new - b, moved, out=np.zeros(n), where=moved != 0.0)
        b = new
        # |W| from its components: |P|^2 - X^2 would lose the digits of a small push.
        w_y = p.p_y - p.ahead * turn.cos
        slope = np.sqrt(p.lateral * p.lateral + p.normal * p.normal + w_y * w_y) / p.ahead
        lever = slope / p.ahead
        # P on the axes at touch, then along and across the push.
        at_t, at_n = p.p_t * p.cos + p.p_n * p.sin, p.p_n * p.cos - p.p_t * p.sin
        towards = -(rows.sin_eps * at_t + rows.cos_eps * at_n)
        across = rows.sin_eps * at_n - rows.cos_eps * at_t
        out["delta"][step] = np.pi + np.arctan2(across, sine * p.p_y - turn.cos * towards)
        out["moment_angle"][step] = lever / (
            1.0 + slope * ((15.0 / 14.0) * slope - (0.2 * rows.friction) * along)
        )
        out["slope"][step] = slope
        out["lever"][step] = lever
        out["parameter"][step] = b
        out["slide"][step] = rows.profile.arc(b)
        out["lean"][step] = p.zeta
        out["arc_length"][step] = c.length
        out["along"][step] = along
        slipped[step] = gone
        theta_before, moved_before = theta, moved


def pace(moved: FloatArray, moved_before: FloatArray) -> FloatArray:
    """Ratio of a step to the one before where the stroke goes on, 0 where one begins."""
    onward = moved * moved_before > 0.0
    return np.divide(moved, moved_before, out=np.zeros_like(moved), where=onward)
