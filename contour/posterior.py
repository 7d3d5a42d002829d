"""What is believed of n contacts while they are being localised: priors, pushes so far, posterior.

Priors come from the contour (:mod:`contour.memory`), the fit from :mod:`contour.fit`. A contact whose readings speak
against its prior is fitted without it too, one near the beam's end both as a side contact and as a touch of the tip,
and what explains the readings best is believed. Where little is known a fit begins from the best of many states.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contour.antenna import Antenna
from contour.fit import Estimate, Prior, fit, screen
from contour.frames import wrap_angle
from contour.information import (
    BEND,
    LN_S,
    LN_TAN_ALPHA,
    NU,
    PARAMETERS,
    R_ALONG,
    ModelError,
    PushData,
    prepare,
)
from contour.memory import CURVATURE_SIGMA, RADIUS_ALONG
from contour.sensing import Bins, Touch

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
TIP_MARGIN = 8.0
"""How much worse (a chi^2) the tip may explain the readings and still be preferred: contacts of the tip crowd at L,
where those of the side are rare, and have a distance less to please the readings with."""
TIE = 8.0
"""Difference (a chi^2) within which side and tip are not told apart: s is then no surer than they differ."""
CORNER_MARGIN = 6.0
"""How much better (a chi^2) the readings must be explained without the contour's tangent for that to be believed."""
PULLED = 1.8
"""Sigmas off the tangent from which a contact is also fitted without it."""
UNLIKELY = 1.6
"""chi^2 per degree of freedom from which other explanations are looked for."""
STARTS = 2
"""States of a search that a fit begins from."""
WELL_KNOWN = 0.3
"""Sigma of ln tan alpha below which a search keeps it."""
FRICTIONS = np.deg2rad([3.0, 7.0, 12.0, 18.0, 26.0])
"""Friction angles that a search tries where nothing is known."""
TILTS = (-0.7, 0.0, 0.7)
"""Tangents of the tilt of a tip that a search tries."""
SLID_SHARE = 0.85
"""Share of the friction angle that a force off the normal must reach for friction to have been seen."""
SEEN = 30.0
"""Moment, in standard deviations of a sample, above which a force's direction says something of friction."""


def friction_slope(ln_tan_alpha: FloatArray) -> FloatArray:
    """d alpha / d ln tan alpha = sin alpha cos alpha."""
    return np.asarray(0.5 * np.sin(2.0 * np.arctan(np.exp(ln_tan_alpha))))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Guess:
    """What may be of some contacts, one row each: how they touch, what is known before, and what the readings say."""

    rows: IntArray
    prior: Prior
    tip: BoolArray
    corner: BoolArray
    """Whether the contour's tangent is left out."""
    mean: FloatArray
    """(n, 5) state to begin from."""
    found: Estimate | None = None
    """Of the fit, once made."""

    @property
    def penalty(self) -> FloatArray:
        """(n,) what the guess must explain better (a chi^2) than another."""
        return np.asarray(np.where(self.corner, CORNER_MARGIN, 0.0) - np.where(self.tip, TIP_MARGIN, 0.0))

    def take(self, index: IntArray) -> _Guess:
        """Some of the rows."""
        return _Guess(
            rows=self.rows[index],
            prior=self.prior.take(index),
            tip=self.tip[index],
            corner=self.corner[index],
            mean=self.mean[index],
            found=None if self.found is None else self.found.take(index),
        )

    @staticmethod
    def concatenate(parts: list[_Guess]) -> _Guess:
        """All rows of guesses that have not been fitted."""
        return _Guess(
            rows=np.concatenate([part.rows for part in parts]),
            prior=Prior(
                mean=np.concatenate([part.prior.mean for part in parts]),
                sigma=np.concatenate([part.prior.sigma for part in parts]),
            ),
            tip=np.concatenate([part.tip for part in parts]),
            corner=np.concatenate([part.corner for part in parts]),
            mean=np.concatenate([part.mean for part in parts]),
        )

    def as_tip(self, length: float) -> _Guess:
        """For a touch with the tip: s is L, and a tilt stands in the place of R."""
        mean, sigma, state = self.prior.mean.copy(), self.prior.sigma.copy(), self.mean.copy()
        scale = length / np.exp(mean[:, LN_S])
        mean[:, LN_S], sigma[:, LN_S] = np.log(length), TIP_SIGMA / length
        mean[:, R_ALONG], sigma[:, R_ALONG] = 0.0, TIP_TILT
        mean[:, BEND] *= scale
        sigma[:, BEND] *= scale
        state[:, LN_S], state[:, R_ALONG] = np.log(length), 0.0
        return replace(self, prior=Prior(mean=mean, sigma=sigma), mean=state, tip=np.ones_like(self.tip))

    def as_side(self) -> _Guess:
        """For a touch with the beam's side, whose distance nothing tells."""
        mean, sigma, state = self.prior.mean.copy(), self.prior.sigma.copy(), self.mean.copy()
        distance = np.exp(state[:, LN_S])
        sigma[:, LN_S] = 1.0
        mean[:, R_ALONG] = state[:, R_ALONG] = RADIUS_ALONG[0] / distance
        sigma[:, R_ALONG] = RADIUS_ALONG[1] / distance
        return replace(self, prior=Prior(mean=mean, sigma=sigma), mean=state, tip=np.zeros_like(self.tip))

    def turned(self, length: float) -> _Guess:
        """The tip where the side was, and the reverse."""
        tip, side = np.flatnonzero(self.tip), np.flatnonzero(~self.tip)
        parts = [self.take(tip).as_side(), self.take(side).as_tip(length)]
        return _Guess.concatenate(parts)

    def loosened(self) -> _Guess:
        """Without the tangent and the curvature that the contour led to expect."""
        mean, sigma = self.prior.mean.copy(), self.prior.sigma.copy()
        distance = np.exp(self.mean[:, LN_S])
        sigma[:, NU] = np.maximum(sigma[:, NU], np.deg2rad(45.0))
        mean[:, BEND] = 0.0
        sigma[:, BEND] = 3.0 * CURVATURE_SIGMA * distance
        side = np.where(self.tip, TIP_TILT, RADIUS_ALONG[1] / distance)
        sigma[:, R_ALONG] = np.maximum(sigma[:, R_ALONG], side)
        return replace(self, prior=Prior(mean=mean, sigma=sigma), corner=np.ones_like(self.corner))


class Posterior:
    """State of n contacts; every array has one row a contact."""

    def __init__(self, prior: Prior, corner: BoolArray, antenna: Antenna, error: ModelError) -> None:
        n = prior.mean.shape[0]
        self._antenna = antenna
        self._error = error
        self._data: list[PushData] = []
        self._prior_mean, self._prior_sigma = prior.mean.copy(), prior.sigma.copy()
        self._cost = np.full(n, np.inf)
        self._penalty = np.zeros(n)
        self._begun = np.zeros(n, dtype=bool)
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
        self._data.append(prepare(bins, touch, np.exp(self.mean[rows, LN_S]), rows, self._antenna))
        rows = rows[felt]
        if rows.size == 0:
            return
        self._take_distance(rows[~self._begun[rows]])
        self._begun[rows] = True
        self._keep(self._settle(self._of(rows), self._prior_sigma[rows, NU] >= SURE))
        self._compare(rows)

    @property
    def _all(self) -> PushData:
        """All pushes so far."""
        self._data = [PushData.concatenate(self._data)]
        return self._data[0]

    def last_push(self, rows: IntArray) -> PushData:
        """The newest push of each of the contacts ``rows``."""
        data = self._all
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

    def _of(self, rows: IntArray) -> _Guess:
        """What is believed of the contacts ``rows`` now."""
        return _Guess(
            rows=rows,
            prior=Prior(mean=self._prior_mean[rows].copy(), sigma=self._prior_sigma[rows].copy()),
            tip=self.tip[rows].copy(),
            corner=self.corner[rows].copy(),
            mean=self.mean[rows].copy(),
        )

    def _keep(self, guess: _Guess) -> None:
        """Believe a settled guess."""
        rows, found = guess.rows, guess.found
        if found is None:
            return
        self._prior_mean[rows], self._prior_sigma[rows] = guess.prior.mean, guess.prior.sigma
        self.tip[rows], self.corner[rows] = guess.tip, guess.corner
        self.mean[rows], self.covariance[rows] = found.mean, found.covariance
        self.misfit[rows], self._cost[rows] = found.misfit, found.cost
        self._penalty[rows] = guess.penalty

    def _take_distance(self, rows: IntArray) -> None:
        """The first guess of s of side contacts from the moment of their first push."""
        rows = rows[~self.tip[rows]]
        if rows.size == 0:
            return
        data = self.last_push(rows)
        bins = data.force.shape[1] // 2
        peak = np.maximum(np.linalg.norm(data.force[:, :bins], axis=2).max(axis=1), 1e-9)
        theta = data.path[:, 2 * bins]
        distance = np.clip(self._antenna.stiffness3 * theta / peak, 5e-3, 2.0 * self._antenna.beam.length)
        rescale = distance / np.exp(self.mean[rows, LN_S])
        self.mean[rows, LN_S] = np.log(distance)
        self.mean[rows, R_ALONG] /= rescale
        self.mean[rows, BEND] *= rescale

    def as_tip(self, rows: IntArray) -> None:
        """Take the contacts ``rows`` for touches with the tip."""
        guess = self._of(rows).as_tip(self._antenna.beam.length)
        self._prior_mean[rows], self._prior_sigma[rows] = guess.prior.mean, guess.prior.sigma
        self.mean[rows], self.tip[rows] = guess.mean, True

    def _compare(self, rows: IntArray) -> None:
        """Weigh what is believed of the contacts ``rows`` against what else may be: that the contour's tangent says
        nothing here, and, near the beam's end, that the tip touches where the side was believed to, or the reverse.
        """
        away = np.abs(wrap_angle(self.mean[rows, NU] - self._prior_mean[rows, NU]))
        pulled = (away > PULLED * self._prior_sigma[rows, NU]) & (self._prior_sigma[rows, NU] < SURE)
        unlikely = self.misfit[rows] > UNLIKELY
        near = np.abs(np.exp(self.mean[rows, LN_S]) / self._antenna.beam.length - 1.0) < NEAR_TIP
        other = near & ~(self._compared[rows] & ~unlikely)
        loose = (pulled | unlikely) & ~self.corner[rows]
        again = unlikely & self.corner[rows]
        self._compared[rows[other]] = True
        length = self._antenna.beam.length
        guesses = [
            self._of(rows[loose]).loosened(),
            self._of(rows[again]),
            self._of(rows[other]).turned(length),
            self._of(rows[other & loose]).turned(length).loosened(),
        ]
        every = _Guess.concatenate(guesses)
        tried = self._settle(every, np.ones(every.rows.size, dtype=bool))
        if tried.found is None:
            return
        self._choose(tried)

    def _choose(self, tried: _Guess) -> None:
        """Keep what explains the readings best, and note how far a side contact and a tip are apart that cannot be
        told.
        """
        if tried.found is None:
            return
        score = tried.found.cost + tried.penalty
        own = self._cost[tried.rows] + self._penalty[tried.rows]
        order = np.lexsort((score, tried.rows))
        contacts, first = np.unique(tried.rows[order], return_index=True)
        best = order[first]
        tip = np.where(tried.tip, score, np.inf)
        side = np.where(tried.tip, np.inf, score)
        lowest = np.full((2, self.tip.size), np.inf)
        where = np.zeros(self.tip.size)
        np.minimum.at(lowest[0], tried.rows, side)
        np.minimum.at(lowest[1], tried.rows, tip)
        mine = self.tip[contacts].astype(np.int64)
        lowest[mine, contacts] = np.minimum(lowest[mine, contacts], own[order][first])
        at_side = np.flatnonzero(side <= lowest[0, tried.rows])
        where[tried.rows[at_side]] = tried.found.mean[at_side, LN_S]
        beside = contacts[(mine == 0) & (own[order][first] <= lowest[0, contacts])]
        where[beside] = self.mean[beside, LN_S]
        # Where the two explain the readings about as well, s is no surer than they are apart.
        both = np.isfinite(lowest).all(axis=0)
        tie = both[contacts] & (np.abs(np.subtract(*np.where(both, lowest, 0.0)))[contacts] < TIE)
        apart = np.abs(np.exp(where[contacts]) - self._antenna.beam.length)
        self._doubt[contacts] = np.where(tie, 0.5 * apart, 0.0)
        better = score[best] < own[order][first] - 1e-6
        self._keep(tried.take(best[better]))

    def _settle(self, guess: _Guess, searching: BoolArray) -> _Guess:
        """Fit a guess to all pushes of its contacts; those ``searching`` (n,) from the best of many states, the others
        from their own.
        """
        n = guess.rows.size
        if n == 0:
            return guess
        pushes, contact = _pushes_of(self._all.contact, guess.rows)
        data = replace(self._all.take(pushes, contact), tip=guess.tip[contact])
        every = np.arange(n)
        start = guess.mean.copy()
        search = np.flatnonzero(searching)
        if search.size:
            states = self._starts(guess.take(search))
            pushes, contact = _pushes_of(data.contact, search)
            prior = guess.prior.take(search)
            cost = screen(data.take(pushes, contact), prior, states, self._antenna, self._error)
            some = np.argsort(cost, axis=1)[:, :STARTS]
            states = np.take_along_axis(states, some[:, :, None], axis=1)
            start[search] = states[:, 0]
            every = np.concatenate([every, *[search for _ in range(1, STARTS)]])
            start = np.concatenate([start, *[states[:, i] for i in range(1, STARTS)]])
        if every.size > n:
            pushes, contact = _pushes_of(data.contact, every)
            data = data.take(pushes, contact)
        found = fit(data, guess.prior.take(every), start, self._antenna, self._error)
        order = np.lexsort((found.cost, every))
        best = order[np.unique(every[order], return_index=True)[1]]
        return replace(guess, found=found.take(best))

    def _starts(self, guess: _Guess) -> FloatArray:
        """(n, m, 5) states to begin a search from: what was believed, and what the force's direction says of the
        normal for friction angles small and large; of tips for tilts either way.
        """
        push = self.last_push(guess.rows)
        force = push.force
        bins = force.shape[1] // 2
        out = np.arctan2(*force[:, bins - 2 : bins].sum(axis=1).T[::-1])
        back = np.arctan2(*force[:, 2 * bins - 4 : 2 * bins - 1].sum(axis=1).T[::-1])
        swing = wrap_angle(back - out)
        tilt = wrap_angle(push.phi - out - np.pi)
        known = guess.prior.sigma[:, LN_TAN_ALPHA] < WELL_KNOWN
        mean = np.arctan(np.exp(guess.prior.mean[:, LN_TAN_ALPHA]))
        base = guess.mean
        found = [base, base.copy(), base.copy()]
        found[0][:, NU] = base[:, NU]
        found[1][:, NU] = push.phi - 0.3 * tilt
        found[2][:, NU] = out + 0.5 * swing + np.pi
        seen = np.log(np.tan(np.clip(0.5 * np.abs(swing), np.deg2rad(2.0), np.deg2rad(30.0))))
        found[2][:, LN_TAN_ALPHA] = np.where(known, base[:, LN_TAN_ALPHA], seen)
        for share, angle in zip((1.0, 0.5, 0.0, -0.5, -1.0), FRICTIONS, strict=True):
            far = base.copy()
            alpha = np.where(known, mean, angle)
            far[:, NU] = push.phi - tilt - np.sign(tilt) * np.where(known, share * mean, angle)
            far[:, LN_TAN_ALPHA] = np.log(np.tan(alpha))
            found.append(far)
        states = np.stack(found, axis=1)
        if not guess.tip.any():
            return states
        leant = np.repeat(states, len(TILTS), axis=1)
        for i, lean in enumerate(TILTS):
            leant[guess.tip, i :: len(TILTS), R_ALONG] += lean
        return leant

    def slid(self, rows: IntArray) -> BoolArray:
        """Whether any sample of a contact lay on the edge of its friction cone, so that friction was seen."""
        if not self._data:
            return np.zeros(rows.size, dtype=bool)
        data = self._all
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
