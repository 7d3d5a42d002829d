"""The strategy ``one-push``: distance and normal from one push that slides, with an assumed friction angle.

The rule of Solomon2008 in the signs of Kaneko1998: the force of a push that slides lies on the edge of the
friction cone, so with D = delta - pi and an assumed alpha_est

    eps_est = D + sign(D) alpha_est, s = 3 EI theta cos(eps_est)/(|M| cos alpha_est), nu+ = phi - eps_est + pi

It needs a push that slides, a flat profile and the right alpha. What every strategy of single out strokes
shares stands here too: the straight line fitted to |M| over theta, and how far to push.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from contour.antenna import Antenna
from contour.contacts import Contacts, Flag, Kind
from contour.errors import InstrumentError, UsageError
from contour.frames import Mount, wrap_angle
from contour.instrument import PushReading, Stop, Watch
from contour.memory import touch_position
from contour.sensing import BINS, Action, Ask, Bins, Touch, binned, locate

__all__ = [
    "Ledger",
    "OnePushSettings",
    "OnePushStrategy",
    "OutStroke",
    "PushSettings",
    "Result",
    "curvature_allowance",
    "first_action",
    "out_stroke",
    "push_angle",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

FELT = 8.0
"""Largest moment of a push, in standard deviations of a sample, below which it felt nothing."""
FALL = 0.5
"""Share of its largest moment below which the end of an out stroke tells that the beam slid off the body."""
LAST_BINS = 2
"""Bins at the end of the out stroke whose force gives the direction psi."""
BEYOND = 1.05
"""Share of the beam's length from which on a distance is impossible."""
TIP_SIGMAS = 3.0
"""A contact within this many sigma_s of the beam's length may be its tip."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PushSettings:
    """How far to push, and what is assumed of what a single out stroke cannot tell."""

    angle: float = float(np.deg2rad(3.0))
    """Angle of a push at ``angle_distance`` and beyond [rad]."""
    angle_distance: float = 0.06
    """Distance below which the angle shrinks in proportion, as section IV of Kaneko1998 does [m]."""
    moment_share: float = 0.85
    """Share of the moment limit that a push plans to use."""
    radius: float = 0.05
    """Standard deviation of the body's unknown radius R along the beam [m]."""

    def __post_init__(self) -> None:
        for name in ("angle", "angle_distance", "moment_share"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise UsageError(f"push {name} is {value!r}: it must be a finite number above zero")
        if not (np.isfinite(self.radius) and self.radius >= 0.0):
            raise UsageError(f"push radius is {self.radius!r}: it must be zero or more, in m")


def first_action(touch: Touch) -> NDArray[np.int8]:
    """(n,) a push; but a touch without free air before it has no zero yet."""
    return np.where(touch.tare_samples > 0, np.int8(Action.PUSH), np.int8(Action.ZERO))


def push_angle(distance: FloatArray, antenna: Antenna, settings: PushSettings) -> FloatArray:
    """Angle [rad] of pushes at ``distance`` [m]: in proportion to s where short, under the moment limit."""
    angle = settings.angle * np.minimum(distance / settings.angle_distance, 1.0)
    limit = settings.moment_share * antenna.moment_limit * distance / antenna.stiffness3
    return np.asarray(np.minimum(angle, limit))


def curvature_allowance(
    theta: FloatArray, distance: FloatArray, friction: FloatArray | float, settings: PushSettings
) -> FloatArray:
    """Relative standard deviation of s from what the slope of an out stroke leaves out.

    3 EI C/s = k(h)(1 - mu theta/5) with k = 1 - (3/8) R theta/s for an unknown R (the right first order of
    (34) of Kaneko1998). A term theta^2 of |M| moves the straight line's slope by as much as it moves the end.
    """
    round_body = 0.375 * settings.radius * theta / distance
    return np.asarray(np.hypot(round_body, 0.2 * np.tan(friction) * theta))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OutStroke:
    """What P out strokes say by themselves."""

    phi: FloatArray
    """(P,) rad, direction of the push."""
    psi: FloatArray
    """(P,) rad, direction of the force on the beam at the end of the stroke, (13)-(14) of Kaneko1998."""
    psi_sigma: FloatArray
    """(P,) rad, the noise in it."""
    compliance: FloatArray
    """(P,) rad per N m, theta over |M|: one over the slope of |M| against theta, its offset fitted."""
    compliance_sigma: FloatArray
    """(P,) relative standard deviation, noise and drift."""
    theta: FloatArray
    """(P,) rad, where the stroke turned back."""
    felt: BoolArray
    """(P,) whether the push felt a body at all."""
    fell: BoolArray
    """(P,) whether the moment fell away: the beam slid off the body."""

    @property
    def off(self) -> FloatArray:
        """(P,) rad, delta - pi in (-pi, pi]: 0 without lateral slip, else of the sign of eps."""
        return wrap_angle(self.phi - self.psi - np.pi)

    @property
    def usable(self) -> BoolArray:
        """(P,) whether slope and direction mean anything."""
        return self.felt & ~self.fell


def out_stroke(bins: Bins, touch: Touch, antenna: Antenna) -> OutStroke:
    """Slope and direction of the out strokes of ``bins``, pushed from ``touch`` row by row."""
    force, theta, count = bins.force[:, :BINS], bins.theta[:, :BINS], bins.count[:, :BINS]
    time = bins.time[:, :BINS]
    noise = antenna.sensor.moment_noise
    size = np.linalg.norm(force, axis=2) * (count > 0.0)
    total = np.maximum(count.sum(axis=1, keepdims=True), 1.0)
    away = (theta - (count * theta).sum(axis=1, keepdims=True) / total) * count
    spread = np.maximum((away * theta).sum(axis=1), 1e-18)
    slope = (away * size).sum(axis=1) / spread
    slope = slope - (away * _support(bins, slope, antenna)).sum(axis=1) / spread
    safe = np.maximum(slope, 1e-9)
    # At constant speed the drift is collinear with the slope: it cannot be fitted away.
    drift = antenna.sensor.moment_drift * np.abs((away * time).sum(axis=1)) / spread
    largest, last = size.max(axis=1), size[:, -1]
    end_count = np.maximum(count[:, -LAST_BINS:].sum(axis=1), 1.0)
    end = (force * count[..., None])[:, -LAST_BINS:].sum(axis=1) / end_count[:, None]
    end_noise = noise * np.sqrt(1.0 / end_count + 1.0 / np.maximum(touch.tare_samples, 1))
    return OutStroke(
        phi=bins.phi,
        psi=np.arctan2(end[:, 1], end[:, 0]),
        psi_sigma=end_noise / np.maximum(np.linalg.norm(end, axis=1), noise),
        compliance=1.0 / safe,
        compliance_sigma=np.hypot(noise / np.sqrt(spread), drift) / safe,
        theta=bins.peak,
        felt=largest > FELT * noise,
        fell=(last < FALL * largest) | (slope <= 0.0),
    )


def _support(bins: Bins, slope: FloatArray, antenna: Antenna) -> FloatArray:
    """(P, BINS) N m, what the body takes of the change of the beam's weight since touch, along the force.

    The bins are free of the weight of a free beam. One that is held at s passes on
    w (6 L^2 - 4 L s + s^2)/(8 s) of a load w per length; without this s would be up to 1 % off where the beam
    stands upright.
    """
    theta, force = bins.theta[:, :BINS], bins.force[:, :BINS]
    length = antenna.beam.length
    distance = np.clip(antenna.distance(1.0 / np.maximum(slope, 1e-9)), 0.05 * length, length)
    lever = (6.0 * length**2 - 4.0 * length * distance + distance**2) / 8.0
    push = np.stack((np.cos(bins.phi), np.sin(bins.phi)), axis=1)
    tilt = np.sum(bins.up * push, axis=1)[:, None]
    change = -bins.up_along[:, None] * np.sin(theta) - tilt * (1.0 - np.cos(theta))
    size = np.maximum(np.linalg.norm(force, axis=2), antenna.sensor.moment_noise)
    facing = np.sum(force * push[:, None, :], axis=2) / size
    return np.asarray(lever[:, None] * antenna.beam.line_weight * change * facing)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Result:
    """What a strategy of out strokes concludes about n contacts."""

    distance: FloatArray
    """(n,) m"""
    distance_sigma: FloatArray
    """(n,) m"""
    outward: FloatArray
    """(n,) rad"""
    outward_sigma: FloatArray
    """(n,) rad"""
    friction_angle: FloatArray
    """(n,) rad"""
    friction_sigma: FloatArray
    """(n,) rad"""
    pushes: IntArray
    """(n,)"""
    flags: IntArray
    """(n,) :class:`Flag`"""


class Ledger:
    """The last contact of every contour: all that the strategies of out strokes remember."""

    def __init__(self, antennas: int) -> None:
        self.distance = np.full(antennas, np.nan)
        self.outward = np.full(antennas, np.nan)
        self.contacts = np.zeros(antennas, dtype=np.int64)

    def inward(self, touch: Touch) -> FloatArray:
        """(n,) rad, the last inner normal; on a new contour the one that the approach leads to expect."""
        last = self.outward[touch.which]
        unknown = touch.fresh | np.isnan(last)
        return wrap_angle(np.where(unknown, touch.expected, np.nan_to_num(last)) + np.pi)

    def guess(self, touch: Touch, antenna: Antenna) -> FloatArray:
        """(n,) m, the last distance; on a new contour what the rise of the moment while touching says."""
        length = antenna.beam.length
        rise = np.clip(np.sqrt(antenna.stiffness3 / touch.rise), 0.1 * length, length)
        last = self.distance[touch.which]
        return np.where(touch.fresh | np.isnan(last), rise, np.nan_to_num(last, nan=1.0))

    def enter(self, result: Result, touch: Touch, antenna: Antenna, mount: Mount) -> Contacts:
        """The contacts of ``result``; the good ones are remembered."""
        axis = touch_position(touch, result.distance, antenna)
        point, normal = locate(touch, axis, result.distance, result.outward, antenna, mount)
        near_tip = np.abs(result.distance - antenna.beam.length) < TIP_SIGMAS * result.distance_sigma
        beyond = result.distance > BEYOND * antenna.beam.length
        n = len(touch)
        contacts = Contacts(
            which=touch.which,
            touch=axis,
            point=point,
            normal=normal,
            distance=result.distance,
            sigma_distance=result.distance_sigma,
            outward=wrap_angle(result.outward),
            sigma_normal=result.outward_sigma,
            friction_angle=result.friction_angle,
            sigma_friction=result.friction_sigma,
            radius_along=np.zeros(n),
            curvature_across=np.zeros(n),
            kind=np.where(near_tip, np.int8(Kind.TIP), np.int8(Kind.SIDE)),
            pushes=result.pushes,
            flags=result.flags | np.where(beyond, Flag.UNRESOLVED, Flag.NONE),
            machine_time=np.zeros(n),
            sequence=self.contacts[touch.which].copy(),
        )
        self.contacts[touch.which] += 1
        good = contacts.good
        self.distance[touch.which[good]] = contacts.distance[good]
        self.outward[touch.which[good]] = contacts.outward[good]
        return contacts


@dataclass(frozen=True, slots=True, kw_only=True)
class OnePushSettings:
    """What is assumed of the friction, and which way to push."""

    friction_angle: float = float(np.deg2rad(10.0))
    """alpha_est [rad]."""
    friction_sigma: float = float(np.deg2rad(5.0))
    """Standard deviation of that assumption [rad]."""
    offset: float = float(np.deg2rad(20.0))
    """How far off the last inner normal to push, so that the beam slides [rad]."""
    least_slip: float = float(np.deg2rad(1.0))
    """|delta - pi| below which the push has not slid, and the rule does not hold [rad]."""
    push: PushSettings = field(default_factory=PushSettings)
    """How far to push."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.friction_angle < 0.5 * np.pi:
            raise UsageError(
                f"one-push friction_angle is {self.friction_angle!r} rad: it must lie in 0 to pi/2"
            )
        if not (self.friction_sigma > 0.0 and self.least_slip > 0.0):
            raise UsageError("one-push friction_sigma and least_slip must be above zero, in rad")


@dataclass(slots=True, eq=False)
class _Work:
    """State of the n contacts being localised."""

    touch: Touch
    phi: FloatArray
    angle: FloatArray
    result: Result
    action: NDArray[np.int8]


class OnePushStrategy:
    """Localises n contacts at once, each by a single push out of the friction cone (Solomon2008)."""

    name = "one-push"

    def __init__(
        self, antennas: int, antenna: Antenna, mount: Mount, settings: OnePushSettings | None = None
    ) -> None:
        self._antenna = antenna
        self._mount = mount
        self._settings = settings or OnePushSettings()
        self._ledger = Ledger(antennas)
        self._work: _Work | None = None

    def start(self, touch: Touch) -> None:
        """Begin n contacts."""
        n, s = len(touch), self._settings
        distance = self._ledger.guess(touch, self._antenna)
        phi = wrap_angle(self._ledger.inward(touch) + s.offset)
        # Until a push has told more, a contact is lost: nothing is known but what the touch led to expect.
        unknown = Result(
            distance=distance,
            distance_sigma=distance.copy(),
            outward=touch.expected.copy(),
            outward_sigma=touch.expected_sigma.copy(),
            friction_angle=np.full(n, s.friction_angle),
            friction_sigma=np.full(n, s.friction_sigma),
            pushes=np.zeros(n, dtype=np.int64),
            flags=np.full(n, Flag.LOST, dtype=np.int64),
        )
        angle = push_angle(distance, self._antenna, s.push)
        self._work = _Work(touch=touch, phi=phi, angle=angle, result=unknown, action=first_action(touch))

    def _here(self) -> _Work:
        if self._work is None:
            raise InstrumentError("the strategy was asked before any contact was started: call start() first")
        return self._work

    def ask(self) -> Ask:
        """One push for each contact that has none."""
        work = self._here()
        n = work.phi.size
        limit = np.full(n, self._antenna.moment_limit)
        return Ask(action=work.action, phi=work.phi, angle=work.angle, moment_limit=limit, shift=np.zeros(n))

    def drop(self, rows: IntArray) -> None:
        """Contacts ``rows`` were not found again: they stay lost."""
        self._here().action[rows] = np.int8(Action.DONE)

    def watch(self, rows: IntArray) -> Watch | None:
        """Nothing: the rule judges a push when it is over."""
        return None

    def tell(self, rows: IntArray, touch: Touch, reading: PushReading) -> None:
        """Readings of the pushes asked for."""
        work, s = self._here(), self._settings
        stroke = out_stroke(binned(reading, touch, self._antenna, self._mount), touch, self._antenna)
        alpha = s.friction_angle
        eps = stroke.off + np.sign(stroke.off) * alpha
        # Beyond a quarter turn the rule has no distance; such contacts are flagged below.
        lever = np.maximum(np.cos(eps), 0.05) / np.cos(alpha)
        distance = self._antenna.distance(stroke.compliance * lever)
        left_out = curvature_allowance(stroke.theta, distance, alpha, s.push)
        assumed = np.abs(np.tan(alpha) - np.tan(np.clip(np.abs(eps), 0.0, 1.5))) * s.friction_sigma
        relative = np.sqrt(stroke.compliance_sigma**2 + left_out**2 + assumed**2)
        flags = np.where(np.abs(stroke.off) < s.least_slip, Flag.UNRESOLVED, Flag.NONE)
        flags |= np.where(stroke.fell | (np.cos(eps) < 0.05), Flag.SLIP_OFF, Flag.NONE)
        limited = (reading.stop == Stop.MOMENT) & (stroke.theta < 0.5 * work.angle[rows])
        flags |= np.where(limited, Flag.OVER_MOMENT, Flag.NONE)
        told = stroke.felt
        hit, result = rows[told], work.result
        result.pushes[rows] += 1
        result.distance[hit] = distance[told]
        result.distance_sigma[hit] = (relative * distance)[told]
        result.outward[hit] = wrap_angle(stroke.phi - eps - np.pi)[told]
        result.outward_sigma[hit] = np.hypot(stroke.psi_sigma, s.friction_sigma)[told]
        result.flags[hit] = flags[told]
        work.action[rows] = np.int8(Action.DONE)

    def contacts(self) -> Contacts:
        """The contacts; the good ones tell where their contours are pushed next."""
        work = self._here()
        contacts = self._ledger.enter(work.result, work.touch, self._antenna, self._mount)
        self._work = None
        return contacts
