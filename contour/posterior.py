"""What is believed of n contacts while they are being localised: priors, pushes so far, posterior.

Priors come from the contour (:mod:`contour.memory`), the fit from :mod:`contour.fit`. A contact whose readings
contradict its prior is fitted without it; one near the beam's end is fitted both as a side contact and as a touch of
the tip.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contour.antenna import Antenna
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
    fit,
    prepare,
)
from contour.frames import wrap_angle
from contour.memory import CURVATURE_SIGMA, RADIUS_ALONG
from contour.sensing import BINS, Bins, Touch

__all__ = ["Posterior", "friction_slope"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

SURE = np.deg2rad(12.0)
"""Sigma of the expected normal below which one start of the fit is enough."""
NEAR_TIP = 0.05
"""Share of L within which a contact may be one of the tip."""
TIP_SIGMA = 0.15e-3
"""What the tip's distance may differ from L by: its end is round [m]."""
TIP_TILT = 0.6
"""Sigma of the tangent of a tipped surface's tilt."""
BELIEVED = 1.25
"""chi^2 per degree of freedom below which a tip is not compared with a side contact again."""
TIP_MARGIN = 8.0
"""How much worse (a chi^2) the tip may explain the readings and still be preferred: contacts of the tip crowd at L,
where those of the side are rare, and have a distance less to please the readings with. Within as much the two are not
told apart, and s is no surer than they differ."""
SLID_SHARE = 0.85
"""Share of the friction angle that a force off the normal must reach for friction to have been seen."""
SEEN = 30.0
"""Moment, in standard deviations of a sample, above which a force's direction says something of friction."""


def friction_slope(ln_tan_alpha: FloatArray) -> FloatArray:
    """d alpha / d ln tan alpha = sin alpha cos alpha."""
    return np.asarray(0.5 * np.sin(2.0 * np.arctan(np.exp(ln_tan_alpha))))


class Posterior:
    """State of n contacts; every array has one row a contact."""

    def __init__(
        self, prior: Prior, corner: BoolArray, antenna: Antenna, error: ModelError, misfit: float
    ) -> None:
        n = prior.mean.shape[0]
        self._antenna = antenna
        self._error = error
        self._largest_misfit = misfit
        self._data: list[PushData] = []
        self._prior_mean, self._prior_sigma = prior.mean.copy(), prior.sigma.copy()
        self._cost = np.full(n, np.inf)
        self._compared = np.zeros(n, dtype=bool)
        self._doubt = np.zeros(n)
        self.corner: BoolArray = corner.copy()
        """(n,) whether the contour's tangent is left out."""
        self.tip: BoolArray = np.zeros(n, dtype=bool)
        """(n,) whether the tip touches; tan(tilt) then stands in the place of R/s."""
        self.mean: FloatArray = prior.mean.copy()
        """(n, 5) state."""
        self.covariance: FloatArray = np.zeros((n, PARAMETERS, PARAMETERS))
        """(n, 5, 5)"""
        self.misfit: FloatArray = np.zeros(n)
        """(n,) chi^2 per degree of freedom."""

    def tell(self, rows: IntArray, bins: Bins, touch: Touch, felt: BoolArray) -> None:
        """A push of each of the contacts ``rows``; those that felt nothing say nothing."""
        bins = replace(bins, count=bins.count * felt[:, None])
        first = len(self._data) == 0
        self._data.append(prepare(bins, touch, np.exp(self.mean[rows, LN_S]), rows, self._antenna))
        rows = rows[felt]
        if rows.size == 0:
            return
        starts = self._starts(rows, bins.take(np.flatnonzero(felt))) if first else [self.mean[rows]]
        self._fit(rows, starts)
        self._try_other(rows)
        again = self._contradicts(rows) & ~self.corner[rows]
        if again.any():
            rows = rows[again]
            self.corner[rows] = True
            self._loosen(rows)
            self._fit(rows, [self.mean[rows], *[start[again] for start in starts[1:]]])
            self._try_other(rows)

    def last_push(self, rows: IntArray) -> PushData:
        """The newest push of each of the contacts ``rows``."""
        data = PushData.concatenate(self._data)
        newest = np.zeros(self.tip.size, dtype=np.int64)
        newest[data.contact] = np.arange(data.contact.size)
        return replace(data.take(newest[rows], np.arange(rows.size)), tip=self.tip[rows])

    def sigmas(self, rows: IntArray, phi: FloatArray, *, doubt: bool = True) -> FloatArray:
        """(n, 5) standard deviations of the contacts ``rows``, last pushed towards ``phi`` (n,) rad.

        The model's error is in them, the misfit where there is one, and, unless ``doubt`` is off, how far a side
        contact and one of the tip are apart where the two could not be told: no further push would tell them.
        """
        variance = np.einsum("nii->ni", self.covariance[rows]).copy()
        alpha = np.arctan(np.exp(self.mean[rows, LN_TAN_ALPHA]))
        off = np.maximum(np.abs(wrap_angle(phi - self.mean[rows, NU])) - alpha, 0.0)
        outside = self._error.gain_outside * np.tan(np.minimum(off, 1.2)) ** 2
        variance[:, LN_S] += self._error.gain**2 + outside**2
        variance = np.maximum(variance, 0.0) * np.maximum(self.misfit[rows], 1.0)[:, None]
        if doubt:
            variance[:, LN_S] += (self._doubt[rows] / np.exp(self.mean[rows, LN_S])) ** 2
        return np.asarray(np.sqrt(variance))

    def _starts(self, rows: IntArray, bins: Bins) -> list[FloatArray]:
        """States to begin from: what was believed, and for normals hardly known what the force's direction says."""
        base = self.mean[rows].copy()
        size = np.linalg.norm(bins.force, axis=2)
        peak = np.maximum(size[:, :BINS].max(axis=1), 1e-9)
        distance = np.clip(
            self._antenna.stiffness3 * bins.theta[:, BINS - 1] / peak, 5e-3, 2.0 * self._antenna.beam.length
        )
        distance = np.where(self.tip[rows], np.exp(base[:, LN_S]), distance)
        rescale = distance / np.exp(base[:, LN_S])
        base[:, LN_S] = np.log(distance)
        base[:, R_ALONG] /= rescale
        base[:, BEND] *= rescale
        if np.all(self._prior_sigma[rows, NU] < SURE):
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

    def as_tip(self, rows: IntArray) -> None:
        """Priors of the contacts ``rows`` for a touch with the tip: s is L, and a tilt stands in the place of R."""
        length = self._antenna.beam.length
        scale = length / np.exp(self._prior_mean[rows, LN_S])
        self._prior_mean[rows, LN_S], self._prior_sigma[rows, LN_S] = np.log(length), TIP_SIGMA / length
        self._prior_mean[rows, R_ALONG], self._prior_sigma[rows, R_ALONG] = 0.0, TIP_TILT
        self._prior_mean[rows, BEND] *= scale
        self._prior_sigma[rows, BEND] *= scale
        self.mean[rows, LN_S], self.mean[rows, R_ALONG] = np.log(length), 0.0
        self.tip[rows] = True

    def _as_side(self, rows: IntArray) -> None:
        """Priors of the contacts ``rows`` for a touch with the beam's side, whose distance nothing tells."""
        distance = np.exp(self.mean[rows, LN_S])
        self._prior_sigma[rows, LN_S] = 1.0
        self._prior_mean[rows, R_ALONG] = RADIUS_ALONG[0] / distance
        self._prior_sigma[rows, R_ALONG] = RADIUS_ALONG[1] / distance
        self.mean[rows, R_ALONG] = RADIUS_ALONG[0] / distance
        self.tip[rows] = False

    def _try_other(self, rows: IntArray) -> None:
        """Fit contacts near the beam's end as side contacts and as touches of the tip, and keep what explains the
        readings better. A tip that follows a tip and explains them well is believed.
        """
        near = np.abs(np.exp(self.mean[rows, LN_S]) / self._antenna.beam.length - 1.0) < NEAR_TIP
        believed = self.tip[rows] & (self.misfit[rows] < BELIEVED)
        rows = rows[near & ~believed & ~self._compared[rows]]
        if rows.size == 0:
            return
        self._compared[rows] = True
        names = ("mean", "covariance", "misfit", "_cost", "tip")
        kept = {name: getattr(self, name)[rows].copy() for name in names}
        priors = self._prior_mean[rows].copy(), self._prior_sigma[rows].copy()
        was_tip = self.tip[rows].copy()
        self._as_side(rows[was_tip])
        self.as_tip(rows[~was_tip])
        self._fit(rows, [self.mean[rows].copy()])
        # A side contact has a distance and a radius more to please the readings with.
        margin = np.where(was_tip, -TIP_MARGIN, TIP_MARGIN)
        worse = self._cost[rows] > kept["_cost"] + margin
        back = rows[worse]
        # Where a side contact explains a tip's readings nearly as well, s is no surer than the two are apart.
        side = np.where(was_tip, self.mean[rows, LN_S], kept["mean"][:, LN_S])
        apart = np.abs(np.exp(side) - self._antenna.beam.length)
        tie = np.abs(self._cost[rows] - kept["_cost"]) < TIP_MARGIN
        self._doubt[rows] = np.where(tie, 0.5 * apart, 0.0)
        for name in names:
            getattr(self, name)[back] = kept[name][worse]
        self._prior_mean[back], self._prior_sigma[back] = priors[0][worse], priors[1][worse]

    def _contradicts(self, rows: IntArray) -> BoolArray:
        """Whether readings and tangent exclude each other, or readings and model."""
        pull = (
            np.abs(wrap_angle(self.mean[rows, NU] - self._prior_mean[rows, NU])) / self._prior_sigma[rows, NU]
        )
        excluded = (pull > 2.5) & (self._prior_sigma[rows, NU] < SURE)
        return np.asarray((self.misfit[rows] > self._largest_misfit) | excluded)

    def _loosen(self, rows: IntArray) -> None:
        """Forget the tangent and the curvature that the contour led to expect."""
        self._prior_sigma[rows, NU] = np.maximum(self._prior_sigma[rows, NU], np.deg2rad(45.0))
        distance = np.exp(self.mean[rows, LN_S])
        self._prior_mean[rows, BEND] = 0.0
        self._prior_sigma[rows, BEND] = 3.0 * CURVATURE_SIGMA * distance
        side = np.where(self.tip[rows], TIP_TILT, RADIUS_ALONG[1] / distance)
        self._prior_sigma[rows, R_ALONG] = np.maximum(self._prior_sigma[rows, R_ALONG], side)

    def _fit(self, rows: IntArray, starts: list[FloatArray]) -> None:
        """Fit the contacts ``rows`` to all their pushes, from each start, and keep the best."""
        data = PushData.concatenate(self._data)
        prior = Prior(mean=self._prior_mean[rows], sigma=self._prior_sigma[rows])
        # The other starts are only tried where the normal was hardly known; all starts are fitted side by side.
        doubtful = np.flatnonzero(prior.sigma[:, NU] >= SURE)
        every = np.concatenate([np.arange(rows.size), *[doubtful for _ in starts[1:]]])
        start = np.concatenate([starts[0], *[start[doubtful] for start in starts[1:]]])
        pushes, contact = _pushes_of(data.contact, rows[every])
        part = data.take(pushes, contact)
        found = fit(
            replace(part, tip=self.tip[rows[every]][contact]),
            Prior(mean=prior.mean[every], sigma=prior.sigma[every]),
            start,
            self._antenna,
            self._error,
        )
        order = np.lexsort((found.cost, every))
        best = order[np.unique(every[order], return_index=True)[1]]
        self.mean[rows] = found.mean[best]
        self.covariance[rows] = found.covariance[best]
        self.misfit[rows] = found.misfit[best]
        self._cost[rows] = found.cost[best]

    def slid(self, rows: IntArray) -> BoolArray:
        """Whether any sample of a contact lay on the edge of its friction cone, so that friction was seen."""
        if not self._data:
            return np.zeros(rows.size, dtype=bool)
        data = PushData.concatenate(self._data)
        psi = np.arctan2(data.force[..., 1], data.force[..., 0])
        off = np.abs(wrap_angle(psi - self.mean[data.contact, NU][:, None] - np.pi))
        loaded = np.linalg.norm(data.force, axis=2) > SEEN * self._antenna.sensor.moment_noise
        alpha = np.arctan(np.exp(self.mean[data.contact, LN_TAN_ALPHA]))
        edge = np.any(loaded & (data.count > 0.0) & (off > SLID_SHARE * alpha[:, None]), axis=1)
        slid = np.zeros(self.tip.size, dtype=bool)
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
