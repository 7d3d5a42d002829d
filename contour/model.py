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
from contour.fit import (
    BEND,
    LN_S,
    LN_TAN_ALPHA,
    NU,
    PARAMETERS,
    R_ALONG,
    ModelError,
    Prior,
    PushData,
    expected_covariance,
    fit,
    prepare,
)
from contour.frames import Mount, wrap_angle
from contour.instrument import PushReading, Stop, Watch
from contour.memory import CURVATURE_SIGMA, RADIUS_ALONG, Memory, Tangent, touch_position
from contour.sensing import BINS, Action, Ask, Bins, RunawayWatch, Touch, binned, locate

__all__ = ["ModelSettings", "ModelStrategy"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

FELT = 8.0
"""Largest moment of a push, in standard deviations of a sample, below which it felt nothing."""
SURE = np.deg2rad(12.0)
"""Sigma of the expected normal below which one start of the fit is enough."""
NEAR_TIP = 0.05
"""Share of L within which a contact may be one of the tip."""
TIP_SIGMA = 0.15e-3
"""What the tip's distance may differ from L by: its end is round [m]."""
TIP_TILT = 0.6
"""Sigma of the tangent of a tipped surface's tilt."""
BELIEVED = 1.6
"""chi^2 per degree of freedom below which a tip is not compared with a side contact again."""
TIP_DOUBT = 9.0
"""Difference (a chi^2) below which side and tip are not told apart."""
TIP_MARGIN = 4.0
"""How much worse (a chi^2) the tip may explain the readings and still be preferred: it has fewer freedoms."""
EDGE_RADIUS = 2.5e-3
"""Profiles sharper than this are called edges [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelSettings:
    """What the strategy aims at and how far it goes for it."""

    tolerance_distance: float = 3.5e-3
    """Standard deviation of s to stop at, relative to s."""
    tolerance_normal: float = float(np.deg2rad(1.2))
    """Standard deviation of the normal to stop at [rad]."""
    angle: float = float(np.deg2rad(3.0))
    """Angle of a push at ``angle_distance`` and beyond [rad]."""
    angle_distance: float = 0.06
    """Distance below which the angle shrinks in proportion, as section IV of Kaneko1998 does [m]."""
    largest_angle: float = float(np.deg2rad(4.0))
    """Bound of the angle [rad]."""
    corner_angle: float = float(np.deg2rad(1.5))
    """Bound of the angle where the contour turns sharply [rad]."""
    moment_share: float = 0.85
    """Share of the moment limit that a push plans to use."""
    least_angle: float = float(np.deg2rad(0.8))
    """Angle that a push is not made smaller than, but for the moment limit [rad]."""
    tolerance_friction: float = float(np.deg2rad(2.0))
    """Standard deviation of the friction angle that the first contact of a contour spends a second push on [rad]."""
    flag: float = 2.5
    """Multiple of the tolerances beyond which a contact is flagged."""
    most_pushes: int = 4
    """Pushes a contact may take."""
    both_strokes: bool = True
    """Whether the return stroke is used; off only to show what it buys."""
    misfit: float = 3.0
    """chi^2 per degree of freedom from which the readings contradict the model."""


@dataclass(slots=True, eq=False)
class _Work:
    """State of the n contacts being localised."""

    touch: Touch
    prior: Prior
    tangent: Tangent
    corner: BoolArray
    data: list[PushData]
    pushes: IntArray
    aborted: BoolArray
    lost: BoolArray
    limited: BoolArray
    mean: FloatArray
    covariance: FloatArray
    misfit: FloatArray
    cost: FloatArray
    tip: BoolArray
    compared: BoolArray
    doubt: FloatArray
    action: NDArray[np.int8]
    phi: FloatArray
    angle: FloatArray


class ModelStrategy:
    """Localises n contacts at once; remembers each contour's friction, curvature and touches."""

    name = "model"

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
        careful = tangent.corner | touch.fresh
        self._work = _Work(
            touch=touch,
            prior=prior,
            tangent=tangent,
            corner=tangent.corner.copy(),
            data=[],
            pushes=np.zeros(n, dtype=np.int64),
            aborted=np.zeros(n, dtype=bool),
            lost=np.zeros(n, dtype=bool),
            limited=np.zeros(n, dtype=bool),
            mean=prior.mean.copy(),
            covariance=np.zeros((n, PARAMETERS, PARAMETERS)),
            misfit=np.zeros(n),
            cost=np.full(n, np.inf),
            tip=np.zeros(n, dtype=bool),
            compared=np.zeros(n, dtype=bool),
            doubt=np.zeros(n),
            action=np.full(n, Action.PUSH, dtype=np.int8),
            phi=phi,
            angle=self._angle(prior.mean, prior.sigma, phi, careful),
        )
        self._as_tip(np.flatnonzero(memory.tipped[touch.which]))

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
        work.data.append(prepare(bins, touch, np.exp(work.mean[rows, LN_S]), rows, self._antenna))
        work.pushes[rows] += 1
        felt = np.linalg.norm(bins.force, axis=2).max(axis=1) > FELT * self._antenna.sensor.moment_noise
        work.lost[rows] = ~felt
        work.aborted[rows] |= reading.stop == Stop.WATCH
        work.limited[rows] |= reading.stop == Stop.MOMENT
        self._refit(rows[felt], bins, felt)
        self._decide(rows)

    def _starts(self, rows: IntArray, bins: Bins) -> list[FloatArray]:
        """States to begin from: what was believed, and for normals hardly known what the force's direction says."""
        work = self._here()
        base = work.mean[rows].copy()
        size = np.linalg.norm(bins.force, axis=2)
        peak = np.maximum(size[:, :BINS].max(axis=1), 1e-9)
        distance = np.clip(
            self._antenna.stiffness3 * bins.theta[:, BINS - 1] / peak, 5e-3, 2.0 * self._antenna.beam.length
        )
        distance = np.where(work.tip[rows], np.exp(base[:, LN_S]), distance)
        rescale = distance / np.exp(base[:, LN_S])
        base[:, LN_S] = np.log(distance)
        base[:, R_ALONG] /= rescale
        base[:, BEND] *= rescale
        if np.all(work.prior.sigma[rows, NU] < SURE):
            return [base]
        out = np.arctan2(*bins.force[:, BINS - 2 : BINS].sum(axis=1).T[::-1])
        back = np.arctan2(*bins.force[:, 2 * BINS - 4 : 2 * BINS - 1].sum(axis=1).T[::-1])
        swing = wrap_angle(back - out)
        tilt = wrap_angle(bins.phi - out - np.pi)
        sticks, slid, far = base.copy(), base.copy(), base.copy()
        sticks[:, NU] = bins.phi - 0.3 * tilt
        slid[:, NU] = out + 0.5 * swing + np.pi
        slid[:, LN_TAN_ALPHA] = np.log(
            np.tan(np.clip(0.5 * np.abs(swing), np.deg2rad(2.0), np.deg2rad(30.0)))
        )
        alpha = np.arctan(np.exp(base[:, LN_TAN_ALPHA]))
        far[:, NU] = bins.phi - tilt - np.sign(tilt) * alpha
        return [base, sticks, slid, far]

    def _refit(self, rows: IntArray, bins: Bins, felt: BoolArray) -> None:
        if rows.size == 0:
            return
        work = self._here()
        starts = (
            self._starts(rows, bins.take(np.flatnonzero(felt)))
            if work.pushes[rows].max() == 1
            else [work.mean[rows]]
        )
        self._fit(rows, starts)
        self._try_other(rows)
        contradicts = self._contradicts(rows) & ~work.corner[rows]
        again = rows[contradicts]
        if again.size:
            work.corner[again] = True
            self._loosen(again)
            self._fit(again, [work.mean[again], *[start[contradicts] for start in starts[1:]]])
            self._try_other(again)

    def _as_tip(self, rows: IntArray) -> None:
        """Priors of the contacts ``rows`` for a touch with the tip: s is L, and a tilt stands in the place of R."""
        work, length = self._here(), self._antenna.beam.length
        scale = length / np.exp(work.prior.mean[rows, LN_S])
        work.prior.mean[rows, LN_S], work.prior.sigma[rows, LN_S] = np.log(length), TIP_SIGMA / length
        work.prior.mean[rows, R_ALONG], work.prior.sigma[rows, R_ALONG] = 0.0, TIP_TILT
        work.prior.mean[rows, BEND] *= scale
        work.prior.sigma[rows, BEND] *= scale
        work.mean[rows, LN_S], work.mean[rows, R_ALONG] = np.log(length), 0.0
        work.tip[rows] = True

    def _as_side(self, rows: IntArray) -> None:
        """Priors of the contacts ``rows`` for a touch with the beam's side, whose distance nothing tells."""
        work = self._here()
        distance = np.exp(work.mean[rows, LN_S])
        work.prior.sigma[rows, LN_S] = 1.0
        work.prior.mean[rows, R_ALONG] = RADIUS_ALONG[0] / distance
        work.prior.sigma[rows, R_ALONG] = RADIUS_ALONG[1] / distance
        work.mean[rows, R_ALONG] = RADIUS_ALONG[0] / distance
        work.tip[rows] = False

    def _try_other(self, rows: IntArray) -> None:
        """Fit contacts near the beam's end as side contacts and as touches of the tip, and keep what explains the
        readings better. A tip that follows a tip and explains them well is believed.
        """
        work = self._here()
        near = np.abs(np.exp(work.mean[rows, LN_S]) / self._antenna.beam.length - 1.0) < NEAR_TIP
        believed = work.tip[rows] & (work.misfit[rows] < BELIEVED)
        rows = rows[near & ~believed & ~work.compared[rows]]
        if rows.size == 0:
            return
        work.compared[rows] = True
        names = ("mean", "covariance", "misfit", "cost", "tip")
        kept = {name: getattr(work, name)[rows].copy() for name in names}
        priors = work.prior.mean[rows].copy(), work.prior.sigma[rows].copy()
        was_tip = work.tip[rows].copy()
        self._as_side(rows[was_tip])
        self._as_tip(rows[~was_tip])
        self._fit(rows, [work.mean[rows].copy()])
        # A side contact has a distance and a radius more to please the readings with.
        margin = np.where(was_tip, -TIP_MARGIN, TIP_MARGIN)
        worse = work.cost[rows] > kept["cost"] + margin
        back = rows[worse]
        # Where a side contact explains a tip's readings nearly as well, s is no surer than the two are apart.
        side = np.where(was_tip, work.mean[rows, LN_S], kept["mean"][:, LN_S])
        apart = np.abs(np.exp(side) - self._antenna.beam.length)
        tie = np.abs(work.cost[rows] - kept["cost"]) < TIP_DOUBT
        work.doubt[rows] = np.where(tie, 0.5 * apart, 0.0)
        for name in names:
            getattr(work, name)[back] = kept[name][worse]
        work.prior.mean[back], work.prior.sigma[back] = priors[0][worse], priors[1][worse]

    def _contradicts(self, rows: IntArray) -> BoolArray:
        """Whether readings and tangent exclude each other, or readings and model."""
        work = self._here()
        pull = (
            np.abs(wrap_angle(work.mean[rows, NU] - work.prior.mean[rows, NU])) / work.prior.sigma[rows, NU]
        )
        excluded = (pull > 2.5) & (work.prior.sigma[rows, NU] < SURE)
        return np.asarray((work.misfit[rows] > self._settings.misfit) | excluded)

    def _loosen(self, rows: IntArray) -> None:
        """Forget the tangent and the curvature that the contour led to expect."""
        work = self._here()
        work.prior.sigma[rows, NU] = np.maximum(work.prior.sigma[rows, NU], np.deg2rad(45.0))
        distance = np.exp(work.mean[rows, LN_S])
        work.prior.mean[rows, BEND] = 0.0
        work.prior.sigma[rows, BEND] = 3.0 * CURVATURE_SIGMA * distance
        side = np.where(work.tip[rows], TIP_TILT, RADIUS_ALONG[1] / distance)
        work.prior.sigma[rows, R_ALONG] = np.maximum(work.prior.sigma[rows, R_ALONG], side)

    def _fit(self, rows: IntArray, starts: list[FloatArray]) -> None:
        """Fit the contacts ``rows`` to all their pushes, from each start, and keep the best."""
        work = self._here()
        data = PushData.concatenate(work.data)
        prior = Prior(mean=work.prior.mean[rows], sigma=work.prior.sigma[rows])
        # The other starts are only tried where the normal was hardly known; all starts are fitted side by side.
        doubtful = np.flatnonzero(prior.sigma[:, NU] >= SURE)
        every = np.concatenate([np.arange(rows.size), *[doubtful for _ in starts[1:]]])
        start = np.concatenate([starts[0], *[start[doubtful] for start in starts[1:]]])
        pushes, contact = _pushes_of(data.contact, rows[every])
        part = data.take(pushes, contact)
        found = fit(
            replace(part, tip=work.tip[rows[every]][contact]),
            Prior(mean=prior.mean[every], sigma=prior.sigma[every]),
            start,
            self._antenna,
            self._error,
        )
        order = np.lexsort((found.cost, every))
        best = order[np.unique(every[order], return_index=True)[1]]
        work.mean[rows] = found.mean[best]
        work.covariance[rows] = found.covariance[best]
        work.misfit[rows] = found.misfit[best]
        work.cost[rows] = found.cost[best]

    def _sigmas(self, rows: IntArray) -> FloatArray:
        """(n, 5) standard deviations, the model's error and the misfit in them."""
        work = self._here()
        variance = np.einsum("nii->ni", work.covariance[rows]).copy()
        off = np.maximum(
            np.abs(wrap_angle(work.phi[rows] - work.mean[rows, NU]))
            - np.arctan(np.exp(work.mean[rows, LN_TAN_ALPHA])),
            0.0,
        )
        variance[:, LN_S] += (
            self._error.gain**2 + (self._error.gain_outside * np.tan(np.minimum(off, 1.2)) ** 2) ** 2
        )
        variance = np.maximum(variance, 0.0) * np.maximum(work.misfit[rows], 1.0)[:, None]
        variance[:, LN_S] += (work.doubt[rows] / np.exp(work.mean[rows, LN_S])) ** 2
        return np.asarray(np.sqrt(variance))

    def _merit(self, sigma_s: FloatArray, sigma_normal: FloatArray) -> FloatArray:
        return np.maximum(
            sigma_s / self._settings.tolerance_distance, sigma_normal / self._settings.tolerance_normal
        )

    def _decide(self, rows: IntArray) -> None:
        """Stop, or plan the push that is expected to help most."""
        work, s = self._here(), self._settings
        sigma = self._sigmas(rows)
        slope = np.sin(2.0 * np.arctan(np.exp(work.mean[rows, LN_TAN_ALPHA]))) / 2.0
        learning = (
            work.touch.fresh[rows]
            & (sigma[:, LN_TAN_ALPHA] * slope > s.tolerance_friction)
            & (work.pushes[rows] < 2)
        )
        short = (self._merit(sigma[:, LN_S], sigma[:, NU]) > 1.0) | (work.misfit[rows] > s.misfit) | learning
        more = (short | work.lost[rows]) & (work.pushes[rows] < s.most_pushes)
        work.action[rows] = np.where(more, np.int8(Action.REAPPROACH), np.int8(Action.DONE))
        next_rows = rows[more]
        if next_rows.size:
            self._plan(next_rows, sigma[more])

    def _plan(self, rows: IntArray, sigma: FloatArray) -> None:
        """Direction and angle of the next push: the candidate with the smallest expected posterior."""
        work = self._here()
        mean = work.mean[rows]
        alpha = np.arctan(np.exp(mean[:, LN_TAN_ALPHA]))
        wide = (
            alpha
            + np.minimum(sigma[:, LN_TAN_ALPHA] * np.sin(2.0 * alpha) / 2.0, np.deg2rad(8.0))
            + np.deg2rad(3.0)
        )
        offsets = np.stack((wide, -wide, 0.6 * alpha, -0.6 * alpha), axis=1)
        template = replace(self._last_push(rows), tip=work.tip[rows])
        known = np.linalg.inv(work.covariance[rows] + 1e-12 * np.eye(PARAMETERS))
        information = np.asarray(known, dtype=np.float64)
        merits, phis, angles = [], [], []
        for column in range(offsets.shape[1]):
            phi = mean[:, NU] + offsets[:, column]
            angle = self._angle(mean, sigma, phi, work.corner[rows] | work.aborted[rows])
            path = template.path / template.path.max(axis=1, keepdims=True) * angle[:, None]
            data = replace(template, phi=phi, path=path)
            after = np.einsum(
                "nii->ni", expected_covariance(data, mean, information, self._antenna, self._error)
            )
            merits.append(self._merit(np.sqrt(np.abs(after[:, LN_S])), np.sqrt(np.abs(after[:, NU]))))
            phis.append(phi)
            angles.append(angle)
        # A push of the kind already made teaches little about the model's own error: the other side wins ties.
        side = np.sign(wrap_angle(work.phi[rows] - mean[:, NU]))
        merit = np.stack(merits, axis=1) * np.where(np.sign(offsets) == side[:, None], 1.1, 1.0)
        best = np.argmin(merit, axis=1)
        pick = np.arange(rows.size)
        work.phi[rows] = np.stack(phis, axis=1)[pick, best]
        work.angle[rows] = np.stack(angles, axis=1)[pick, best]
        lost = work.lost[rows]
        work.phi[rows[lost]] = work.touch.expected[rows[lost]] + np.pi

    def _last_push(self, rows: IntArray) -> PushData:
        """The newest push of each of the contacts ``rows``."""
        work = self._here()
        data = PushData.concatenate(work.data)
        newest = np.zeros(work.pushes.size, dtype=np.int64)
        newest[data.contact] = np.arange(data.contact.size)
        return data.take(newest[rows], np.arange(rows.size))

    def contacts(self) -> Contacts:
        """The contacts, and the contours' memory brought up to date."""
        work, s = self._here(), self._settings
        touch, n = work.touch, work.pushes.size
        rows = np.arange(n)
        sigma = self._sigmas(rows)
        distance = np.exp(work.mean[:, LN_S])
        outward = wrap_angle(work.mean[:, NU] + np.pi)
        flags = np.zeros(n, dtype=np.int64)
        vague = (sigma[:, LN_S] > s.flag * s.tolerance_distance) | (
            sigma[:, NU] > s.flag * s.tolerance_normal
        )
        flags[vague | (work.misfit > s.misfit)] |= Flag.UNRESOLVED
        flags[work.lost] |= Flag.LOST
        flags[work.aborted & (flags > 0)] |= Flag.SLIP_OFF
        flags[work.limited & (flags > 0)] |= Flag.OVER_MOMENT
        axis = touch_position(touch, distance, self._antenna)
        radius_across = distance / np.where(np.abs(work.mean[:, BEND]) > 1e-6, work.mean[:, BEND], 1e-6)
        kind = np.where(
            (radius_across > 0.0) & (radius_across < EDGE_RADIUS), np.int8(Kind.EDGE), np.int8(Kind.SIDE)
        )
        kind = np.where(work.tip, np.int8(Kind.TIP), kind)
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
            friction_angle=np.arctan(np.exp(work.mean[:, LN_TAN_ALPHA])),
            sigma_friction=sigma[:, LN_TAN_ALPHA]
            * np.sin(2.0 * np.arctan(np.exp(work.mean[:, LN_TAN_ALPHA])))
            / 2.0,
            radius_along=np.where(work.tip, 0.0, work.mean[:, R_ALONG] * distance),
            curvature_across=work.mean[:, BEND] / distance,
            kind=kind,
            pushes=work.pushes,
            flags=flags,
            machine_time=np.zeros(n),
            sequence=self._memory.contacts[touch.which].copy(),
        )
        self._memory.learn(contacts, work.mean, sigma, self._slid(rows))
        self._work = None
        return contacts

    def _slid(self, rows: IntArray) -> BoolArray:
        """Whether any sample of a contact lay on the edge of its friction cone, so that friction was seen."""
        work = self._here()
        if not work.data:
            return np.zeros(rows.size, dtype=bool)
        data = PushData.concatenate(work.data)
        psi = np.arctan2(data.force[..., 1], data.force[..., 0])
        off = np.abs(wrap_angle(psi - work.mean[data.contact, NU][:, None] - np.pi))
        loaded = np.linalg.norm(data.force, axis=2) > 30.0 * self._antenna.sensor.moment_noise
        alpha = np.arctan(np.exp(work.mean[data.contact, LN_TAN_ALPHA]))
        edge = np.any(loaded & (data.count > 0.0) & (off > 0.85 * alpha[:, None]), axis=1)
        slid = np.zeros(work.pushes.size, dtype=bool)
        np.logical_or.at(slid, data.contact, edge)
        return slid[rows]


def _pushes_of(contact: IntArray, wanted: IntArray) -> tuple[IntArray, IntArray]:
    """All pushes of the contacts ``wanted``, which may repeat: rows of the pushes, and the index into ``wanted``."""
    order = np.argsort(contact, kind="stable")
    first = np.searchsorted(contact[order], wanted, side="left")
    count = np.searchsorted(contact[order], wanted, side="right") - first
    index = np.repeat(np.arange(wanted.size), count)
    place = np.arange(index.size) - np.repeat(np.cumsum(count) - count, count)
    return order[np.repeat(first, count) + place], index
