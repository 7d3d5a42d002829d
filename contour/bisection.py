"""The strategies ``bisection`` and ``bisection-limited``: pushes that close in on the normal.

Section III of Kaneko1998. With delta = phi - psi, psi the direction of the force on the beam (13)-(14), an
out stroke without lateral slip has delta = pi; else psi lies off the outer normal to the side of delta - pi:

    first push    along the last inner normal (Fig. 15); on a new contour along the approach
    second push   phi = phi_1 - sign(delta_1 - pi) pi/2                                         (15)
    from then on  phi = (psi_(i-1) + psi_k)/2 + pi, k the nearest trial on the other side      (17), (18)

until |delta - pi| is within a tolerance. Then s = 3 EI C and nu+ = psi. A trial i >= 4 has |psi - nu+| below
alpha/2^(i-3) (19), on a flat profile. Where no trial lies on the other side, (15) is used again.

The turn of 90 deg in (15) can push the beam off a small body; ``bisection-limited`` turns by no more than
twice the largest friction angle expected, which still reaches the other side of the cone.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from contour.antenna import Antenna
from contour.contacts import Contacts, Flag
from contour.errors import InstrumentError, UsageError
from contour.frames import Mount, wrap_angle
from contour.instrument import PushReading, Stop, Watch
from contour.one_push import (
    Ledger,
    OutStroke,
    PushSettings,
    Result,
    curvature_allowance,
    first_action,
    out_stroke,
    push_angle,
)
from contour.sensing import Action, Ask, Touch, binned

__all__ = ["BisectionSettings", "BisectionStrategy", "next_direction", "normal_bound"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

QUARTER = 0.5 * np.pi


@dataclass(frozen=True, slots=True, kw_only=True)
class BisectionSettings:
    """When to stop, how far to turn, and what is assumed of the friction."""

    tolerance: float = float(np.deg2rad(1.0))
    """|delta - pi| at which a push counts as free of lateral slip [rad]."""
    most_pushes: int = 6
    """Trials after which a contact is given up as it is."""
    largest_step: float | None = None
    """Bound of the turn of (15) [rad]; None for the 90 deg of the paper."""
    friction_angle: float = float(np.deg2rad(20.0))
    """Largest friction angle expected [rad]; used until a contour has shown its own."""
    bend: float = 20.0
    """Standard deviation of the unknown 1/R_l of the profile, which turns the normal under a slide [1/m]."""
    push: PushSettings = field(default_factory=PushSettings)
    """How far to push."""
    name: str = "bisection"
    """What the strategy is called in tables."""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.tolerance) and self.tolerance > 0.0):
            raise UsageError(
                f"bisection tolerance is {self.tolerance!r} rad: it must be a finite number above zero"
            )
        if self.most_pushes < 1:
            raise UsageError(
                f"bisection most_pushes is {self.most_pushes}: a contact takes at least one push"
            )
        if self.largest_step is not None and not 0.0 < self.largest_step <= QUARTER:
            raise UsageError(
                f"bisection largest_step is {self.largest_step!r} rad: it must lie above 0 and up to pi/2"
            )
        if not (np.isfinite(self.bend) and self.bend >= 0.0):
            raise UsageError(f"bisection bend is {self.bend!r} 1/m: it must be zero or more")
        if not 0.0 < self.friction_angle < QUARTER:
            raise UsageError(
                f"bisection friction_angle is {self.friction_angle!r} rad: it must lie between 0 and pi/2"
            )


def next_direction(
    phi: FloatArray, psi: FloatArray, off: FloatArray, made: IntArray, step: float
) -> FloatArray:
    """Direction of the next push (n,) rad from the trials before it.

    Args:
        phi: (n, t) rad, directions pushed, in their order.
        psi: (n, t) rad, directions of the force on the beam.
        off: (n, t) rad, delta - pi.
        made: (n,) trials made, at least one each; columns from there on are not read.
        step: turn of (15) [rad].

    >>> one = np.array([[0.0]]), np.array([[np.pi - 0.3]]), np.array([[0.3]])
    >>> next_direction(*one, np.array([1]), np.pi / 2).round(4)
    array([-1.5708])
    """
    rows, last = np.arange(made.size), made - 1
    side = np.sign(off[rows, last])
    # On the way out sign(psi - nu+) = sign(delta - pi), and |delta - pi| tells how near nu+ a trial is.
    earlier = np.arange(off.shape[1]) < last[:, None]
    opposite = earlier & (np.sign(off) * side[:, None] < 0.0)
    nearest = np.argmin(np.where(opposite, np.abs(off), np.inf), axis=1)
    latest, other = psi[rows, last], psi[rows, nearest]
    halfway = latest + 0.5 * wrap_angle(other - latest) + np.pi  # (17), (18)
    turned = phi[rows, last] - side * step  # (15)
    return wrap_angle(np.where(opposite.any(axis=1), halfway, turned))


def normal_bound(trial: IntArray, friction_angle: FloatArray) -> FloatArray:
    """Bound [rad] of |psi - nu+| at a trial (counted from 1): the table of Fig. 10 of Kaneko1998 and (19).

    Within its bound nothing is known of the normal, so bound/sqrt(3) is the standard deviation.

    >>> normal_bound(np.array([1, 2, 3, 4, 5]), np.full(5, 8.0))
    array([8., 8., 4., 4., 2.])
    """
    halvings = np.where(trial <= 2, 0, np.where(trial == 3, 1, np.maximum(trial - 3, 1)))
    return np.asarray(friction_angle / 2.0**halvings)


@dataclass(frozen=True, slots=True, eq=False)
class _Trials:
    """The trials of n contacts as columns; what is not made yet is zero."""

    phi: FloatArray  # (n, t) rad, and so on as in OutStroke
    psi: FloatArray
    off: FloatArray
    psi_sigma: FloatArray
    compliance: FloatArray
    compliance_sigma: FloatArray
    theta: FloatArray
    made: IntArray  # (n,) trials that felt the body to their end

    @classmethod
    def none(cls, n: int, most: int) -> _Trials:
        """No trial yet of n contacts, room for ``most`` of each."""
        columns = {f.name: np.zeros((n, most)) for f in fields(cls) if f.name != "made"}
        return cls(**columns, made=np.zeros(n, dtype=np.int64))

    def add(self, rows: IntArray, stroke: OutStroke) -> None:
        """Note the usable strokes of contacts ``rows``, row by row of ``stroke``."""
        usable = stroke.usable
        place = rows[usable], self.made[rows[usable]]
        for f in fields(self):
            if f.name != "made":
                getattr(self, f.name)[place] = getattr(stroke, f.name)[usable]
        self.made[rows[usable]] += 1

    @property
    def tried(self) -> BoolArray:
        """(n, t) which trials are made."""
        return np.asarray(np.arange(self.off.shape[1]) < self.made[:, None])


@dataclass(slots=True, eq=False)
class _Work:
    """State of the n contacts being localised."""

    touch: Touch
    guess: FloatArray  # (n,) m, s before the first push
    trials: _Trials
    pushes: IntArray  # (n,)
    flags: IntArray  # (n,)
    limited: BoolArray  # (n,) the last trial was cut short by the moment limit
    action: NDArray[np.int8]  # (n,)
    phi: FloatArray  # (n,) rad, of the next push
    angle: FloatArray  # (n,) rad


class BisectionStrategy:
    """Localises n contacts at once; each contour remembers its last normal, distance and friction angle."""

    def __init__(
        self, antennas: int, antenna: Antenna, mount: Mount, settings: BisectionSettings | None = None
    ) -> None:
        self._antenna = antenna
        self._mount = mount
        self._settings = settings or BisectionSettings()
        self.name = self._settings.name
        self._ledger = Ledger(antennas)
        self._cone = np.zeros(antennas)  # [rad] widest half spread of psi on a contour, 0 for none seen
        self._work: _Work | None = None

    def start(self, touch: Touch) -> None:
        """Begin n contacts."""
        n, s = len(touch), self._settings
        guess = self._ledger.guess(touch, self._antenna)
        self._work = _Work(
            touch=touch,
            guess=guess,
            trials=_Trials.none(n, s.most_pushes),
            pushes=np.zeros(n, dtype=np.int64),
            flags=np.zeros(n, dtype=np.int64),
            limited=np.zeros(n, dtype=bool),
            action=first_action(touch),
            phi=self._ledger.inward(touch),
            angle=push_angle(guess, self._antenna, s.push),
        )

    def _here(self) -> _Work:
        if self._work is None:
            raise InstrumentError("the strategy was asked before any contact was started: call start() first")
        return self._work

    def ask(self) -> Ask:
        """The next trial of each contact that is not done."""
        work = self._here()
        limit = np.full(work.phi.size, self._antenna.moment_limit)
        shift = np.zeros(work.phi.size)
        return Ask(action=work.action, phi=work.phi, angle=work.angle, moment_limit=limit, shift=shift)

    def drop(self, rows: IntArray) -> None:
        """Contacts ``rows`` were not found again: what was found before them counts."""
        work = self._here()
        work.flags[rows[work.trials.made[rows] > 0]] |= np.int64(Flag.UNRESOLVED)
        work.action[rows] = np.int8(Action.DONE)

    def watch(self, rows: IntArray) -> Watch | None:
        """Nothing: the algorithm judges a push when it is over."""
        return None

    def tell(self, rows: IntArray, touch: Touch, reading: PushReading) -> None:
        """Readings of the trials asked for."""
        work = self._here()
        stroke = out_stroke(binned(reading, touch, self._antenna, self._mount), touch, self._antenna)
        before = work.trials.made[rows] > 0
        # A body that was there before and is not felt now has been slid off.
        off_body = stroke.fell & stroke.felt | ~stroke.felt & before
        work.flags[rows[off_body]] |= np.int64(Flag.SLIP_OFF)
        work.flags[rows[~stroke.felt & ~before]] |= np.int64(Flag.LOST)
        work.limited[rows] = (reading.stop == Stop.MOMENT) & (stroke.theta < 0.5 * work.angle[rows])
        work.pushes[rows] += 1
        work.trials.add(rows, stroke)
        self._decide(rows, stroke)

    def _decide(self, rows: IntArray, stroke: OutStroke) -> None:
        """Stop, or plan the next trial."""
        work, s = self._here(), self._settings
        resolved = stroke.usable & (np.abs(stroke.off) < s.tolerance)
        spent = work.pushes[rows] >= s.most_pushes
        work.flags[rows[stroke.usable & ~resolved & spent]] |= np.int64(Flag.UNRESOLVED)
        more = stroke.usable & ~resolved & ~spent
        work.action[rows] = np.where(more, np.int8(Action.REAPPROACH), np.int8(Action.DONE))
        go = rows[more]
        if go.size:
            trials = work.trials
            step = QUARTER if s.largest_step is None else s.largest_step
            made = trials.made[go]
            work.phi[go] = next_direction(trials.phi[go], trials.psi[go], trials.off[go], made, step)
            distance = self._antenna.distance(trials.compliance[go, made - 1])
            work.angle[go] = push_angle(distance, self._antenna, s.push)

    def _turns(self) -> FloatArray:
        """(n, t) rad, how far the normal may have turned under each trial's slide, which (16) leaves out."""
        trials = self._here().trials
        depth = self._antenna.distance(trials.compliance) * trials.theta
        slide = depth * np.sin(np.minimum(np.abs(trials.off), QUARTER))
        return np.asarray(self._settings.bend * slide)

    def _friction(self, turns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Friction angle of each contact and its sigma.

        Half the widest spread of psi on the contour so far, or what is expected where no contact of it has
        been pushed from both sides. A slide on a convex profile brings the two closer, so turns count.
        """
        work, s = self._here(), self._settings
        trials, which = work.trials, work.touch.which
        left, right = trials.tried & (trials.off < -s.tolerance), trials.tried & (trials.off > s.tolerance)
        both = left.any(axis=1) & right.any(axis=1)
        # All trials lie near the first one's direction, so that angles from there do not wrap.
        near = wrap_angle(trials.psi - trials.psi[:, :1])
        highest = np.where(right, near + turns, -np.inf).max(axis=1)
        lowest = np.where(left, near - turns, np.inf).min(axis=1)
        here = np.where(both, 0.5 * (highest - lowest), 0.0)
        self._cone[which] = np.maximum(self._cone[which], np.clip(here, 0.0, s.friction_angle))
        seen = self._cone[which] > 0.0
        angle = np.where(seen, self._cone[which], s.friction_angle)
        return angle, np.where(seen, 0.25 * angle, s.friction_angle)

    def contacts(self) -> Contacts:
        """The contacts, and the contours' memory brought up to date."""
        work, s = self._here(), self._settings
        trials = work.trials
        turns = self._turns()
        alpha, alpha_sigma = self._friction(turns)
        found = trials.made > 0
        best = np.argmin(np.where(trials.tried, np.abs(trials.off), np.inf), axis=1)
        here = np.arange(found.size), best
        distance = np.where(found, self._antenna.distance(trials.compliance[here]), work.guess)
        off = trials.off[here]
        # 3 EI C/s = cos(beta)/cos(eps) on a flat profile; eps = beta + off, |beta| up to alpha.
        aslant = np.tan(np.clip(off, -1.2, 1.2)) * np.tan(alpha)
        left_out = curvature_allowance(trials.theta[here], distance, alpha, s.push)
        relative = np.sqrt(trials.compliance_sigma[here] ** 2 + left_out**2 + aslant**2)
        # Anywhere within its bound the normal is as likely; a mean of two trials that slid has half a turn.
        carried = np.where(best > 0, 0.5 * turns.max(axis=1), 0.0)
        within = np.maximum(normal_bound(best + 1, alpha) + carried, np.abs(off)) / np.sqrt(3.0)
        flags = work.flags | np.where(work.limited, Flag.OVER_MOMENT, Flag.NONE)
        flags = np.where(found | (flags != 0), flags, np.int64(Flag.LOST))
        result = Result(
            distance=distance,
            distance_sigma=np.where(found, relative, 1.0) * distance,
            outward=np.where(found, trials.psi[here], work.touch.expected),
            outward_sigma=np.where(
                found, np.hypot(within, trials.psi_sigma[here]), work.touch.expected_sigma
            ),
            friction_angle=alpha,
            friction_sigma=alpha_sigma,
            pushes=work.pushes,
            flags=flags,
        )
        contacts = self._ledger.enter(result, work.touch, self._antenna, self._mount)
        self._work = None
        return contacts
