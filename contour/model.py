"""The strategy ``model``: both strokes of every push, one joint estimate a contact, no push more than it needs.

Each contact is first pushed along the last inner normal of its contour. The bins of all its pushes are fitted together
(:mod:`contour.fit`) with what the contour knows: the tangent through the last touches, the friction angle learned so
far, the curvatures found before. If the posterior is not within the tolerance the next push is the one, of a handful,
that is expected to shrink it most. A contact whose readings contradict the tangent is fitted without it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contour.antenna import Antenna
from contour.contacts import Contacts, Flag, Kind
from contour.errors import InstrumentError
from contour.fit import expected_covariance
from contour.frames import Mount, wrap_angle
from contour.information import BEND, LN_S, LN_TAN_ALPHA, NU, PARAMETERS, R_ALONG, ModelError
from contour.instrument import PushReading, Stop, Watch
from contour.memory import Memory, touch_position
from contour.posterior import Posterior, friction_slope
from contour.sensing import BINS, Action, Ask, RunawayWatch, Touch, binned, locate

__all__ = ["ModelSettings", "ModelStrategy"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

FELT = 8.0
"""Largest moment of a push, in standard deviations of a sample, below which it felt nothing."""
EDGE_RADIUS = 2.5e-3
"""Profiles sharper than this are called edges [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelSettings:
    """What the strategy aims at and how far it goes for it."""

    tolerance_distance: float = 3.5e-3
    """Standard deviation of s to stop at, relative to s."""
    tolerance_normal: float = float(np.deg2rad(1.5))
    """Standard deviation of the normal to stop at [rad]."""
    angle: float = float(np.deg2rad(3.0))
    """Angle of a push at ``angle_distance`` and beyond [rad]."""
    angle_distance: float = 0.06
    """Distance below which the angle shrinks in proportion, as section IV of Kaneko1998 does [m]."""
    corner_angle: float = float(np.deg2rad(1.5))
    """Bound of the angle where the contour turns sharply [rad]."""
    moment_share: float = 0.85
    """Share of the moment limit that a push plans to use."""
    least_angle: float = float(np.deg2rad(0.8))
    """Angle that a push is not made smaller than, but for the moment limit [rad]."""
    tolerance_friction: float = float(np.deg2rad(2.0))
    """Standard deviation of the friction angle that the first contact of a contour spends a second push on [rad]."""
    flag: float = 2.0
    """Multiple of the tolerances beyond which a contact is flagged."""
    most_pushes: int = 4
    """Pushes a contact may take."""
    both_strokes: bool = True
    """Whether the return stroke is used; off only to show what it buys."""
    misfit: float = 3.0
    """chi^2 per degree of freedom from which the readings contradict the model."""


@dataclass(slots=True, eq=False)
class _Work:
    """State of the n contacts being localised; one row a contact."""

    touch: Touch
    believed: Posterior
    pushes: IntArray
    aborted: BoolArray
    lost: BoolArray
    limited: BoolArray
    action: NDArray[np.int8]
    phi: FloatArray
    angle: FloatArray


class ModelStrategy:
    """Localises n contacts at once; remembers each contour's friction, curvature and touches."""

    name: str

    def __init__(
        self,
        antennas: int,
        antenna: Antenna,
        mount: Mount,
        settings: ModelSettings | None = None,
        error: ModelError | None = None,
    ) -> None:
        self._antenna = antenna
        self._mount = mount
        self._settings = settings or ModelSettings()
        self.name = "model" if self._settings.both_strokes else "model-out"
        self._error = error or ModelError()
        self._memory = Memory(antennas)
        self._work: _Work | None = None

    def start(self, touch: Touch) -> None:
        """Begin n contacts."""
        n = len(touch)
        memory = self._memory
        memory.forget(touch.which[touch.fresh])
        prior, tangent = memory.prior(touch, self._antenna)
        phi = np.where(touch.fresh, touch.expected, memory.outward[touch.which]) + np.pi
        careful = tangent.corner
        believed = Posterior(prior, tangent.corner, self._antenna, self._error)
        self._work = _Work(
            touch=touch,
            believed=believed,
            pushes=np.zeros(n, dtype=np.int64),
            aborted=np.zeros(n, dtype=bool),
            lost=np.zeros(n, dtype=bool),
            limited=np.zeros(n, dtype=bool),
            action=np.full(n, Action.PUSH, dtype=np.int8),
            phi=phi,
            angle=self._angle(prior.mean, prior.sigma, phi, careful),
        )
        believed.as_tip(np.flatnonzero(memory.tipped[touch.which]))

    def _here(self) -> _Work:
        if self._work is None:
            raise InstrumentError("the strategy was asked before any contact was started: call start() first")
        return self._work

    def _angle(self, mean: FloatArray, sigma: FloatArray, phi: FloatArray, careful: BoolArray) -> FloatArray:
        """Angle of a push: in proportion to s where short, under the moment limit, and where the push may lie outside
        the friction cone not deeper than the profile's radius, q = R_l/(s theta) > 1.3.
        """
        s = self._settings
        distance = np.exp(mean[:, LN_S])
        angle = s.angle * np.minimum(distance / s.angle_distance, 1.0)
        angle = np.where(careful, np.minimum(angle, s.corner_angle), angle)
        limit = s.moment_share * self._antenna.moment_limit * distance / self._antenna.stiffness3
        angle = np.minimum(angle, limit)
        off = np.abs(wrap_angle(phi - mean[:, NU])) + 2.0 * np.minimum(sigma[:, NU], 0.5)
        cone = np.arctan(np.exp(mean[:, LN_TAN_ALPHA] - sigma[:, LN_TAN_ALPHA]))
        deepest = 1.0 / (1.3 * np.maximum(np.abs(mean[:, BEND]), 1e-3))
        least = np.minimum(s.least_angle, limit)
        return np.where(off > cone, np.maximum(np.minimum(angle, deepest), least), angle)

    def ask(self) -> Ask:
        """The next action for each contact."""
        work = self._here()
        n = work.pushes.size
        limit = np.full(n, self._antenna.moment_limit)
        return Ask(action=work.action, phi=work.phi, angle=work.angle, moment_limit=limit, shift=np.zeros(n))

    def drop(self, rows: IntArray) -> None:
        """Contacts ``rows`` were not found again: they stay as they are."""
        self._here().action[rows] = np.int8(Action.DONE)

    def watch(self, rows: IntArray) -> Watch | None:
        """Ends a push whose force runs round the body or falls away."""
        work = self._here()
        return RunawayWatch(work.touch.take(rows), work.phi[rows], work.angle[rows], self._antenna)

    def tell(self, rows: IntArray, touch: Touch, reading: PushReading) -> None:
        """Readings of the pushes asked for."""
        work = self._here()
        bins = binned(reading, touch, self._antenna, self._mount)
        if not self._settings.both_strokes:
            bins = replace(bins, count=bins.count * (np.arange(2 * BINS) < BINS))
        work.pushes[rows] += 1
        felt = np.linalg.norm(bins.force, axis=2).max(axis=1) > FELT * self._antenna.sensor.moment_noise
        work.lost[rows] = ~felt
        work.aborted[rows] |= reading.stop == Stop.WATCH
        work.limited[rows] |= reading.stop == Stop.MOMENT
        work.believed.tell(rows, bins, touch, felt)
        self._decide(rows)

    def _merit(self, sigma_s: FloatArray, sigma_normal: FloatArray) -> FloatArray:
        return np.maximum(
            sigma_s / self._settings.tolerance_distance, sigma_normal / self._settings.tolerance_normal
        )

    def _decide(self, rows: IntArray) -> None:
        """Stop, or plan the push that is expected to help most."""
        work, s = self._here(), self._settings
        believed = work.believed
        sigma = believed.sigmas(rows, work.phi[rows], doubt=False)
        slope = friction_slope(believed.mean[rows, LN_TAN_ALPHA])
        learning = (
            work.touch.fresh[rows]
            & (sigma[:, LN_TAN_ALPHA] * slope > s.tolerance_friction)
            & (work.pushes[rows] < 2)
        )
        short = (
            (self._merit(sigma[:, LN_S], sigma[:, NU]) > 1.0) | (believed.misfit[rows] > s.misfit) | learning
        )
        more = (short | work.lost[rows]) & (work.pushes[rows] < s.most_pushes)
        work.action[rows] = np.where(more, np.int8(Action.REAPPROACH), np.int8(Action.DONE))
        next_rows = rows[more]
        if next_rows.size:
            self._plan(next_rows, sigma[more])

    def _plan(self, rows: IntArray, sigma: FloatArray) -> None:
        """Direction and angle of the next push: the candidate with the smallest expected posterior."""
        work = self._here()
        believed = work.believed
        mean = believed.mean[rows]
        alpha = np.arctan(np.exp(mean[:, LN_TAN_ALPHA]))
        unsure = sigma[:, LN_TAN_ALPHA] * friction_slope(mean[:, LN_TAN_ALPHA])
        wide = alpha + np.minimum(unsure, np.deg2rad(8.0)) + np.deg2rad(3.0)
        offsets = np.stack((wide, -wide, 0.6 * alpha, -0.6 * alpha), axis=1)
        template = believed.last_push(rows)
        known = np.linalg.inv(believed.covariance[rows] + 1e-12 * np.eye(PARAMETERS))
        information = np.asarray(known, dtype=np.float64)
        columns = offsets.shape[1]
        phi = (mean[:, NU, None] + offsets).ravel()
        every = np.repeat(np.arange(rows.size), columns)
        careful = (believed.corner[rows] | work.aborted[rows])[every]
        angle = self._angle(mean[every], sigma[every], phi, careful)
        template = template.take(every, np.arange(every.size))
        path = template.path / template.path.max(axis=1, keepdims=True) * angle[:, None]
        imagined = replace(template, phi=phi, path=path)
        after = expected_covariance(imagined, mean[every], information[every], self._antenna, self._error)
        spread = np.sqrt(np.abs(np.einsum("nii->ni", after)))
        merit = self._merit(spread[:, LN_S], spread[:, NU]).reshape(-1, columns)
        # A push of the kind already made teaches little about the model's own error: the other side wins ties.
        side = np.sign(wrap_angle(work.phi[rows] - mean[:, NU]))
        merit *= np.where(np.sign(offsets) == side[:, None], 1.1, 1.0)
        best = np.argmin(merit, axis=1) + columns * np.arange(rows.size)
        work.phi[rows], work.angle[rows] = phi[best], angle[best]
        lost = work.lost[rows]
        work.phi[rows[lost]] = work.touch.expected[rows[lost]] + np.pi

    def contacts(self) -> Contacts:
        """The contacts, and the contours' memory brought up to date."""
        work, s = self._here(), self._settings
        touch, n = work.touch, work.pushes.size
        rows = np.arange(n)
        believed = work.believed
        mean = believed.mean
        sigma = believed.sigmas(rows, work.phi)
        distance = np.exp(mean[:, LN_S])
        outward = wrap_angle(mean[:, NU] + np.pi)
        flags = np.zeros(n, dtype=np.int64)
        vague = (sigma[:, LN_S] > s.flag * s.tolerance_distance) | (
            sigma[:, NU] > s.flag * s.tolerance_normal
        )
        flags[vague | (believed.misfit > s.misfit)] |= Flag.UNRESOLVED
        flags[work.lost] |= Flag.LOST
        flags[work.aborted & (flags > 0)] |= Flag.SLIP_OFF
        flags[work.limited & (flags > 0)] |= Flag.OVER_MOMENT
        axis = touch_position(touch, distance, self._antenna)
        radius_across = distance / np.where(np.abs(mean[:, BEND]) > 1e-6, mean[:, BEND], 1e-6)
        kind = np.where(
            (radius_across > 0.0) & (radius_across < EDGE_RADIUS), np.int8(Kind.EDGE), np.int8(Kind.SIDE)
        )
        kind = np.where(believed.tip, np.int8(Kind.TIP), kind)
        point, normal = locate(touch, axis, distance, outward, self._antenna, self._mount)
        contacts = Contacts(
            which=touch.which,
            touch=axis,
            point=point,
            normal=normal,
            distance=distance,
            sigma_distance=sigma[:, LN_S] * distance,
            outward=outward,
            sigma_normal=sigma[:, NU],
            friction_angle=np.arctan(np.exp(mean[:, LN_TAN_ALPHA])),
            sigma_friction=sigma[:, LN_TAN_ALPHA] * friction_slope(mean[:, LN_TAN_ALPHA]),
            radius_along=np.where(believed.tip, 0.0, mean[:, R_ALONG] * distance),
            curvature_across=mean[:, BEND] / distance,
            kind=kind,
            pushes=work.pushes,
            flags=flags,
            machine_time=np.zeros(n),
            sequence=self._memory.contacts[touch.which].copy(),
        )
        self._memory.learn(contacts, mean, sigma, believed.slid(rows))
        self._work = None
        return contacts
