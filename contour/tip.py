"""Following a rod whose tip touches through a push: Coulomb friction, step by step, until it slips off.

As contour.slip does for sides: the geometry of contour.tip_rod is linearised in the slide, and the friction law
is solved on it by Newton steps. Lengths are in units of the distance s at touch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contour.bracket import first_root
from contour.silhouette import Profile
from contour.slip import pace
from contour.tip_rod import (
    NOTHING,
    Memory,
    Place,
    Rows,
    Turn,
    base_turn,
    direction,
    divisor,
    force,
    held_pull,
    place,
    take,
)

__all__ = ["TipPath", "follow_tip"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

CHUNK = 8192
"""Rows worked on at once: enough to hide the interpreter, few enough for a core's caches."""
INNER_STEPS, INNER_STEPS_HARD = (2, 2), (2, 3, 4, 6, 6, 6, 6)
"""Newton steps on friction in each step on the geometry: all rows, then those that have not settled."""
SETTLED = 1e-8
"""What the next step would change, relative to the depth of the push: the last is accepted below this."""
LENGTH_STEPS = 3
"""Corrections of v on a corner, each about tan(chi) r/5 of the one before."""


SWAY = 4.0
"""Most change of p in the rod's length, over the step's share of theta: at some 12 the tip would not slip."""


SLIDES = 2.0
"""Slip across over slip along from which on a tip counts as sliding."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TipPath:
    """A push followed through k angles, n at a time, arrays (k, n), lengths in s."""

    delta: FloatArray
    """phi - psi [rad], 0 .. 2 pi."""
    moment_angle: FloatArray
    """|M| s/(3 EI) [rad]."""
    parameter: FloatArray
    """The profile's own parameter b of the contact."""
    slide: FloatArray
    """a, positive towards e_t."""
    climb: FloatArray
    """v along e_y', arc length."""
    eta: FloatArray
    """Angle from the rod's end tangent to the force [rad]."""
    slipped_off: BoolArray
    """The contact has left the body; the values are those of a contact held where it last was."""


class _Law(NamedTuple):
    """F . m = 0 on linearised geometry, in y = |da|:

    pull + slope y + ((grip + grip_slope y) y - (hold + hold_slope y) (still + pay y))/slip = 0.
    """

    sense: FloatArray
    pull: FloatArray
    slope: FloatArray
    grip: FloatArray
    grip_slope: FloatArray
    hold: FloatArray
    hold_slope: FloatArray
    still: FloatArray
    pay: FloatArray
    low: FloatArray
    """Root with friction's initial slope, which is its steepest: no root is below."""


def _law(rows: Rows, p: Place, slid: FloatArray, before: Memory) -> _Law:
    mu = rows.friction
    slope = p.t_v - p.t_a * p.v_rate + p.curvature * p.m_a + rows.ridge * p.v_rate * p.m_v
    m_a_rate = p.t_n * p.v_rate - p.curvature * p.m_n
    still = p.climb - before.paid - p.v_rate * slid
    hold = mu * (p.m_v + p.t_n * slid)
    level = p.m_n - slope * slid
    sense = -np.sign(level - hold * np.sign(still))
    pull = sense * level
    grip = mu * (m_a_rate * slid - p.m_a)
    hold *= sense
    low = grip / (np.abs(still) + 1e-20) + slope
    low = np.maximum((hold * np.sign(still) - pull) / low, 0.0)
    return _Law(
        sense=sense,
        pull=pull,
        slope=slope,
        grip=grip,
        grip_slope=-sense * mu * m_a_rate,
        hold=hold,
        hold_slope=-mu * p.t_n,
        still=still,
        pay=sense * p.v_rate,
        low=low,
    )


def _first(law: _Law, y_old: FloatArray) -> FloatArray:
    """Where to start, on the branch that the tip is on.

    With the elastic part left out, and y = |still| tan(omega), friction is grip sin(omega) - holding
    cos(omega), holding = hold sign(still). Where holding is below zero this is largest short of 90 deg: a tip
    that creeps is held by more friction than one that slides, and there are loads for which it may do either.
    It goes on with what it does; at first it creeps.
    """
    size = np.abs(law.still)
    holding = law.hold * np.sign(law.still)
    most = np.hypot(law.grip, holding)
    omega = np.arcsin(np.minimum(-law.pull / most, 1.0)) + np.arctan2(holding, law.grip)
    creeps = (law.pull + most >= 0.0) & (omega < 0.5 * np.pi) & (-holding * y_old <= law.grip * size)
    # A sliding tip is held by its full friction, or by a little more: nearer than ``least`` is no root.
    full = -(law.pull + law.grip) / law.slope
    least = np.where(holding < 0.0, -(law.pull + most) / law.slope, full)
    slides = np.where(y_old < least, full, y_old)
    y = np.maximum(np.where(creeps, np.minimum(y_old, size * np.tan(omega)), slides), law.low)
    # Where the body curves away faster than the rod follows, the law has a second root: stay this side of it.
    return np.where(law.slope > 0.0, y, law.low)


def _newton(law: _Law, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """One Newton step on the law: the new y, the step and the slip."""
    along = law.still + law.pay * y
    slip2 = y * y + along * along + NOTHING
    slip = np.sqrt(slip2)
    grip = law.grip + law.grip_slope * y
    hold = law.hold + law.hold_slope * y
    lateral = y / slip
    share = along / slip
    value = law.pull + law.slope * y + grip * lateral - hold * share
    steep = (grip * share + hold * lateral) * law.still / slip2
    steep += law.slope + law.grip_slope * lateral - law.hold_slope * share
    step = value / steep
    y = np.maximum(y - step, 0.5 * law.low)
    return y, step, slip


def _improve(
    rows: Rows, turn: Turn, at: tuple[FloatArray, FloatArray], before: Memory, inner: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A better b and v, and how far they still were, squared and compared with the slip."""
    b, v = at
    p = place(rows, turn, b, v)
    slid = p.widen * rows.profile.chord(b, before.b) - before.slid
    law = _law(rows, p, slid, before)
    y_old = law.sense * slid
    y = _first(law, y_old)
    for _ in range(inner):
        y, step, slip = _newton(law, y)
    moved = y - y_old
    left = step * step / slip + moved * moved
    moved *= law.sense
    return b + moved * p.speed, p.v + p.v_rate * moved, left


def _residual(
    rows: Rows, turn: Turn, b: FloatArray, v: FloatArray, before: Memory
) -> tuple[FloatArray, BoolArray, FloatArray]:
    """F . m at b, whether the body presses there, and v from one near it."""
    p = place(rows, turn, b, place(rows, turn, b, v).v)
    slid = p.widen * rows.profile.chord(b, before.b) - before.slid
    paid = p.climb - before.paid
    slip = np.sqrt(slid * slid + paid * paid + NOTHING)
    return p.m_n - rows.friction * (p.m_a * slid + p.m_v * paid) / slip, p.m_a < 0.0, p.v


def _search(
    rows: Rows, turn: Turn, v: FloatArray, before: Memory, depth: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """b and v of the first equilibrium past the last position; False where there is none."""
    near = [v]

    def evaluate(b: FloatArray) -> tuple[FloatArray, BoolArray]:
        value, pressed, near[0] = _residual(rows, turn, b, near[0], before)
        return value, pressed & rows.profile.within(b)

    b, found = first_root(evaluate, before.b, depth, rows.profile.reach())
    return b, _residual(rows, turn, b, near[0], before)[2], found


def _solve(
    rows: Rows, turn: Turn, guess: tuple[FloatArray, FloatArray], before: Memory, depth: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """b and v at the end of one step: Newton from the guess on all rows, then on the few that need more.

    The search takes the rows that wander or settle where no contact can be.
    """
    b, v = guess
    for inner in INNER_STEPS:
        b, v, left = _improve(rows, turn, (b, v), before, inner)
    on_body = np.ones(b.shape, dtype=np.bool_)
    bad = np.flatnonzero(~((left <= SETTLED * depth) & rows.profile.within(b)))
    for inner in INNER_STEPS_HARD:
        if not bad.size:
            return b, v, on_body
        part = rows.rows(bad)
        b[bad], v[bad], left = _improve(part, take(turn, bad), (b[bad], v[bad]), take(before, bad), inner)
        bad = bad[~((left <= SETTLED * depth[bad]) & part.profile.within(b[bad]))]
    if bad.size:
        start = np.where(np.isfinite(v[bad]), v[bad], 0.0)
        args = (rows.rows(bad), take(turn, bad), start, take(before, bad), depth[bad])
        b[bad], v[bad], on_body[bad] = _search(*args)
    return b, v, on_body


def follow_tip(
    eps: FloatArray,
    thetas: FloatArray,
    friction: FloatArray,
    tilt: FloatArray,
    ridge: FloatArray,
    profile: Profile,
) -> TipPath:
    """Follow n pushes with the tip through k angles.

    Args:
        eps: pushing direction off the inner normal's part in the sensing plane [rad], (n,).
        thetas: angles of the base from touch [rad], (k, n), all above zero.
        friction: mu, (n,).
        tilt: chi, lean of the outer normal towards the base [rad], (n,).
        ridge: curvature of the surface in the plane of beam and normal, (n,), in 1/s.
        profile: the surface's profiles across it, n of them, lengths in units of s.
    """
    size = thetas.shape
    names = ("delta", "moment_angle", "parameter", "slide", "climb", "eta")
    fields = {name: np.zeros(size) for name in names}
    slipped = np.zeros(size, dtype=np.bool_)
    for first in range(0, size[1], CHUNK):
        part = slice(first, min(first + CHUNK, size[1]))
        rows = Rows(
            np.sin(eps[part]),
            np.cos(eps[part]),
            np.sin(tilt[part]),
            np.cos(tilt[part]),
            friction[part],
            ridge[part],
            profile.rows(np.arange(part.start, part.stop)),
        )
        # Iterates of a push that runs away may overflow; they are caught by where they land.
        with np.errstate(all="ignore"):
            _follow_rows(rows, thetas[:, part], {k: v[:, part] for k, v in fields.items()}, slipped[:, part])
    return TipPath(slipped_off=slipped, **fields)


def _mobilised(
    shown: FloatArray, pull: FloatArray, slope2: tuple[FloatArray, FloatArray], across: FloatArray
) -> FloatArray:
    """p of the step: friction along turns round no faster than the rod's length takes it up without a slip, unless the
    tip slides ``across``, whose share of the slip that is.
    """
    held = held_pull(shown, *slope2)
    most = np.where(np.isfinite(held) & (np.abs(across) < SLIDES), np.abs(held - shown), np.inf)
    return shown + np.clip(pull - shown, -most, most)


def _follow_rows(rows: Rows, thetas: FloatArray, out: dict[str, FloatArray], slipped: BoolArray) -> None:
    n = thetas.shape[1]
    zero = np.zeros(n)
    b = v = climb = slid = paid = rate = rate_v = eta = moved_before = theta_before = zero
    felt = -thetas[0] * rows.cos_eps * rows.sin_tilt / rows.cos_tilt
    pull = shown = felt
    slope2 = zero
    gone = np.zeros(n, dtype=np.bool_)
    corner = rows.profile.held()
    held = bool(corner.any())
    for step, theta in enumerate(thetas):
        free = np.flatnonzero(~(corner | gone))
        sine = np.sin(theta)
        moved = theta - theta_before
        w = pace(moved, moved_before)
        # The rod's length knows p a step late, and not so suddenly that the tip would slip the wrong way.
        most = SWAY * np.abs(moved) / theta
        felt = felt + np.clip(pull - felt, -most, most)
        turn = base_turn(rows, sine, np.cos(theta), felt)
        carry = w * w / (1.0 + 2.0 * w)
        before = Memory(b, carry * slid, climb + carry * paid)
        guess_b, guess_v = b + rate * (w * moved_before), v + rate_v * (w * moved_before)
        if free.size == n:
            new_b, new_v, on_body = _solve(rows, turn, (guess_b, guess_v), before, theta)
            gone |= ~on_body
        else:
            new_b, new_v = b.copy(), v.copy()
            new_b[free], new_v[free], on_body = _solve(
                rows.rows(free),
                take(turn, free),
                (guess_b[free], guess_v[free]),
                take(before, free),
                theta[free],
            )
            gone[free] |= ~on_body
        if gone.any():
            new_b, new_v = np.where(gone, b, new_b), np.where(gone, v, new_v)
        p = place(rows, turn, new_b, new_v)
        if held:
            for _ in range(LENGTH_STEPS):
                p = place(rows, turn, new_b, p.v)
        pulled = np.flatnonzero((p.m_a >= 0.0) & ~gone)
        if pulled.size:
            # A root at which the body would have to pull: look for one further on, or the contact is lost.
            args = (
                rows.rows(pulled),
                take(turn, pulled),
                new_v[pulled],
                take(before, pulled),
                theta[pulled],
            )
            new_b[pulled], new_v[pulled], on_body = _search(*args)
            gone[pulled] = ~on_body
            p = place(rows, turn, new_b, new_v)
        d_a = p.widen * rows.profile.chord(new_b, b)
        d_v = p.climb - climb
        new_pull, new_eta = force(rows, p, d_a - before.slid, p.climb - before.paid)
        # A step that does not turn the base leaves the force as it was.
        pull, eta = np.where(moved == 0.0, pull, new_pull), np.where(moved == 0.0, eta, new_eta)
        slid, paid, climb = d_a, d_v, p.climb
        turned = np.divide(1.0, moved, out=np.zeros(n), where=moved != 0.0)
        rate, rate_v = (new_b - b) * turned, (p.v - v) * turned
        b, v = new_b, p.v
        out["delta"][step] = direction(rows, (sine, np.cos(theta)), b, v)
        shown = pull if not step else _mobilised(shown, pull, (slope2, p.slope2), d_a / d_v)
        slope2 = p.slope2
        out["moment_angle"][step] = np.sqrt(slope2) / divisor(shown, slope2)
        out["parameter"][step] = b
        out["slide"][step] = rows.profile.arc(b)
        out["climb"][step] = climb
        out["eta"][step] = eta
        slipped[step] = gone
        theta_before, moved_before = theta, moved
