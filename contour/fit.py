"""The estimator: distance, normal and friction angle of n contacts from the bins of all their pushes.

State of a contact, with what it is a nuisance for:

    x = (ln s, nu, ln tan alpha, R/s, s/R_l)

nu the inner normal's angle in Pi, R along the beam, R_l across. The forward model is the reduced rod of
:mod:`contour.contact`, followed through both strokes. What belongs to a single push is eliminated from its bins before
they are put together: offset and drift of both moment axes, the residual depth of the touch, and the model's own
error (a bias of the force's direction on each stroke, the shape of the moment's growth). A Gauss-Newton iteration with
Levenberg's damping then finds the maximum of the posterior, all contacts at once.

Only readings and priors enter. The covariance is that of the full state, so sigma_s and sigma_normal already contain
what curvature, friction and offsets cost.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contour.antenna import Antenna
from contour.contact import push_cycle_mixed
from contour.sensing import BACK_RANGE, OUT_RANGE, Bins, Touch

__all__ = [
    "BEND",
    "LN_S",
    "LN_TAN_ALPHA",
    "NU",
    "PARAMETERS",
    "R_ALONG",
    "TAIL",
    "Estimate",
    "ModelError",
    "Prior",
    "PushData",
    "expected_covariance",
    "fit",
    "prepare",
    "screen",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

LN_S, NU, LN_TAN_ALPHA, R_ALONG, BEND = range(5)
PARAMETERS = 5

_STEP = np.array([0.0, 2e-4, 2e-3, 2e-3, 1e-2])
"""Differences for the derivatives; the moment follows ln s exactly and needs none."""
_LOWER = np.array([np.log(2e-3), -np.inf, np.log(np.tan(np.deg2rad(0.3))), -0.3, -400.0])
_UPPER = np.array([np.log(1.0), np.inf, np.log(np.tan(np.deg2rad(45.0))), 4.0, 400.0])
_MAX_STEP = np.array([0.5, 0.15, 0.7, 0.5, 5.0])
_ITERATIONS = 12
TAIL = 3.0
"""Degrees of freedom of the normal's prior."""
STEPS = 8
"""No step along a push is longer than this part of it."""
_SMALL_GAIN = 0.03
"""Fall of the cost (a chi^2) that is not worth another iteration."""
_TRUSTED_GAIN = 1.0
"""Fall of the cost that a step with little damping is trusted with, without looking."""
_TRUSTED = 0.02
"""Damping below which that is so."""
_LOST = 1e3
"""Damping at which small promises mean that the iteration is stuck, not that it is done."""

GAUSS = 0.5 / np.sqrt(3.0) * np.array([-1.0, 1.0])
"""Where to evaluate the mean over a bin, in widths of it from its middle: exact for a force cubic in the angle."""
NUISANCES = 9
"""Unknowns that belong to one push: two offsets, two drifts, the depth of touch, two biases of direction, a gain, how
the curvature changes along the slide.
"""
UNSEEN_TILT = 0.2
"""Squared tangent of a tip's tilt that may always be there: pushes hardly tell it."""
NO_GAIN = 1e-9
"""Standard deviation that stands for none."""
DEPTH_SIGMA = 6e-6
"""How far from the edge of touch the machine may stand where no moment tells: its last step back [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelError:
    """Standard deviations of the forward model's own error, and of the instrument's slow ones.

    Direction and moment of the reduced rod against the exact one, binned, on both strokes. Chosen so that intervals
    cover as they claim on readings of the exact rod at the default noise (``tests/test_fit.py``); at a tenth of that
    noise they are too small for pushes outside the cone.
    """

    direction_bias: float = float(np.deg2rad(0.015))
    """Of the force's direction, one value a stroke [rad]."""
    direction_bin: float = float(np.deg2rad(0.02))
    """Of the force's direction, each bin on its own [rad]."""
    gain: float = 1.5e-4
    """Of the moment, one value a push, relative; it cannot be told from s."""
    gain_outside: float = 5e-4
    """More of it per squared tangent of the angle between push and normal beyond the friction cone."""
    tip_direction: float = float(np.deg2rad(0.8))
    """Of the force's direction at the tip, one value a stroke and one a bin, per squared tangent of the tilt [rad]."""
    tip_gain: float = 5e-4
    """Of the moment of a touch with the tip, one value a push, relative."""
    tip_gain_tilt: float = 2e-3
    """More of it per squared tangent of the tilt."""
    bending: float = 0.5
    """Of the curvature's change along the slide, per curvature squared: an ellipse's between its vertices."""
    bending_at_least: float = 5.0
    """Curvature that this always counts with [1/m]."""
    bending_rest: float = 0.3
    """Of the normal's turn by it, each bin on its own, relative."""
    moment_bin: float = 8e-5
    """Of the moment, each bin on its own, relative to the peak."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prior:
    """Prior of n contacts, Gaussian but for the normal: contours bend where they had been straight, and a tangent's
    error has long tails (Student's, with :data:`TAIL` degrees of freedom).
    """

    mean: FloatArray
    """(n, 5)"""
    sigma: FloatArray
    """(n, 5); infinite where nothing is known."""

    def take(self, index: IntArray) -> Prior:
        """Some of the contacts."""
        return Prior(mean=self.mean[index], sigma=self.sigma[index])

    def pull(self, states: FloatArray) -> Pull:
        """What the prior says of ``states`` (n, 5)."""
        known = np.isfinite(self.sigma)
        information = np.where(known, 1.0 / np.maximum(self.sigma, 1e-12) ** 2, 0.0)
        away = np.where(known, self.mean - states, 0.0)
        away[:, NU] = np.mod(away[:, NU] + np.pi, 2.0 * np.pi) - np.pi
        cost = information * away**2
        z2 = cost[:, NU] / TAIL
        cost[:, NU] = TAIL * np.log1p(z2)
        weight, firm = information.copy(), information.copy()
        weight[:, NU] /= 1.0 + z2
        firm[:, NU] *= np.maximum(1.0 - z2, 0.0) / (1.0 + z2) ** 2
        return Pull(cost.sum(axis=1), weight * away, weight, firm)


class Pull(NamedTuple):
    """What a prior adds at n states."""

    cost: FloatArray
    """(n,)"""
    gradient: FloatArray
    """(n, 5)"""
    weight: FloatArray
    """(n, 5) information to step with."""
    firm: FloatArray
    """(n, 5) information that counts: the curvature of the cost, where it has one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Estimate:
    """Maximum of the posterior of n contacts."""

    mean: FloatArray
    """(n, 5) state."""
    covariance: FloatArray
    """(n, 5, 5), the model's error included, the misfit not."""
    chi2: FloatArray
    """(n,) misfit of the bins."""
    dof: FloatArray
    """(n,) bins (two components each) that the misfit counts."""
    cost: FloatArray
    """(n,) misfit and prior together."""
    converged: NDArray[np.bool_]
    """(n,) whether the iteration settled."""

    @property
    def misfit(self) -> FloatArray:
        """(n,) chi^2 per degree of freedom."""
        return self.chi2 / np.maximum(self.dof, 1.0)

    def take(self, index: IntArray) -> Estimate:
        """Some of the contacts."""
        return Estimate(**{f.name: getattr(self, f.name)[index] for f in fields(self)})

    def sigma(self, parameter: int) -> FloatArray:
        """(n,) standard deviation of one parameter."""
        return np.sqrt(np.maximum(self.covariance[:, parameter, parameter], 0.0))


def _forward(
    x: FloatArray, phi: FloatArray, path: FloatArray, tip: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Moment angle, direction psi and slide over s along ``path`` for states ``x``; all (p, k). A negative R counts as
    none.
    """
    bend = x[:, BEND]
    across = np.where(np.abs(bend) > 1e-6, 1.0 / np.where(np.abs(bend) > 1e-6, bend, 1.0), np.inf)
    cycle = push_cycle_mixed(
        phi - x[:, NU],
        path,
        distance=1.0,
        friction=np.exp(x[:, LN_TAN_ALPHA]),
        radius_along=np.maximum(x[:, R_ALONG], 0.0),
        radius_across=across,
        tilt=np.arctan(x[:, R_ALONG]),
        tip=tip,
        steps=STEPS,
    )
    return cycle.moment_angle, phi[:, None] - cycle.delta, cycle.slide


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PushData:
    """The bins of P pushes, ready to be fitted, and what is known of the nuisances that belong to each push."""

    phi: FloatArray
    """(P,) rad"""
    path: FloatArray
    """(P, 4B + 1) rad, two angles for the mean over each bin, and the turning point between the strokes."""
    force: FloatArray
    """(P, 2B, 2) N m"""
    count: FloatArray
    """(P, 2B) samples"""
    time: FloatArray
    """(P, 2B) s since the tare."""
    gravity: FloatArray
    """(P, 2B, 2) N/m, change of the weight per length in Pi since touch."""
    depth: FloatArray
    """(P,) m, depth of the beam at rest at touch, along the push."""
    depth_sigma: FloatArray
    """(P,) m"""
    tare_sigma: FloatArray
    """(P,) N m"""
    tip: BoolArray
    """(P,) whether the push is taken to be one with the tip; its state has tan(tilt) in the place of R/s."""
    contact: IntArray
    """(P,) contact that each push belongs to."""

    def take(self, rows: IntArray, contact: IntArray) -> PushData:
        """The pushes ``rows``, with new contact numbers."""
        taken = {f.name: getattr(self, f.name)[rows] for f in fields(self) if f.name != "contact"}
        return PushData(**taken, contact=contact)

    @staticmethod
    def concatenate(parts: list[PushData]) -> PushData:
        """All pushes of ``parts``."""
        if len(parts) == 1:
            return parts[0]
        return PushData(
            **{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(PushData)}
        )


_VARIED = (NU, LN_TAN_ALPHA, R_ALONG, BEND)


class _Reply(NamedTuple):
    """What P pushes are answered with."""

    force: FloatArray
    """(P, 2B, 2) N m, mean over each bin."""
    slide: FloatArray
    """(P, 2B) mean slide over each bin, in s."""
    derivative: FloatArray
    """(P, 2B, 2, m) of the force."""


def _response(data: PushData, x: FloatArray, antenna: Antenna) -> tuple[FloatArray, FloatArray]:
    """Mean force over each bin, (v, P, 2B, 2) N m, for v variants of the states (v, P, 5), and the slide of the first
    variant, (P, 2B) in s.
    """
    variants, pushes, _ = x.shape
    nodes = data.path.shape[1]
    distance = np.exp(x[..., LN_S])
    path = np.maximum(data.path[None] + (data.depth[None] / distance)[..., None], 0.0)
    tip = np.tile(data.tip, variants)
    moment, psi, slide = _forward(
        x.reshape(-1, PARAMETERS), np.tile(data.phi, variants), path.reshape(-1, nodes), tip
    )
    force = moment[..., None] * np.stack((np.cos(psi), np.sin(psi)), axis=-1)
    keep = np.arange(nodes) != nodes // 2
    force = force[:, keep].reshape(variants, pushes, -1, len(GAUSS), 2).mean(axis=3)
    slide = slide[:pushes, keep].reshape(pushes, -1, len(GAUSS)).mean(axis=2)
    return np.asarray((antenna.stiffness3 / distance)[..., None, None] * force), slide


def _bare(data: PushData, x: FloatArray, antenna: Antenna) -> _Reply:
    """Without derivatives."""
    force, slide = _response(data, x[None], antenna)
    return _Reply(force[0], slide, np.zeros((*force.shape[1:], 0)))


def _linearised(data: PushData, x: FloatArray, antenna: Antenna) -> _Reply:
    """With the derivatives along the state; a negative R (concave along the beam, or the noise of an edge) is continued
    from R = 0.
    """
    clipped = x.copy()
    clipped[:, R_ALONG] = np.where(data.tip, x[:, R_ALONG], np.maximum(x[:, R_ALONG], 0.0))
    stack = np.repeat(clipped[None], len(_VARIED) + 1, axis=0)
    for i, parameter in enumerate(_VARIED):
        stack[i + 1, :, parameter] += _STEP[parameter]
    force, slide = _response(data, stack, antenna)
    derivative = np.empty((*force.shape[1:], PARAMETERS))
    derivative[..., LN_S] = -force[0]
    for i, parameter in enumerate(_VARIED):
        derivative[..., parameter] = (force[i + 1] - force[0]) / _STEP[parameter]
    beyond = np.where(data.tip, 0.0, np.minimum(x[:, R_ALONG], 0.0))
    return _Reply(force[0] + beyond[:, None, None] * derivative[..., R_ALONG], slide, derivative)


def _held_weight(data: PushData, distance: FloatArray, unit: FloatArray, antenna: Antenna) -> FloatArray:
    """(P, 2B, 2) N m: the support carries part of the weight, and its reaction changes as the beam turns in gravity."""
    length = antenna.beam.length
    lever = (6.0 * length**2 - 4.0 * length * distance + distance**2) / 8.0
    return np.asarray((-lever[:, None] * np.sum(data.gravity * unit, axis=-1))[..., None] * unit)


def _normal_equations(
    data: PushData, x: FloatArray, reply: _Reply, antenna: Antenna, error: ModelError
) -> FloatArray:
    """Information with everything that belongs to one push eliminated: (P, m + 1, m + 1), the last row for the
    residual.
    """
    bare, derivative = reply.force, reply.derivative
    pushes, bins, _ = bare.shape
    distance = np.exp(x[:, LN_S])
    moment = np.maximum(np.linalg.norm(bare, axis=-1), NO_GAIN)
    unit = bare / moment[..., None]
    force = bare + _held_weight(data, distance, unit, antenna)
    aside = np.stack((-unit[..., 1], unit[..., 0]), axis=-1)
    peak = moment.max(axis=1, keepdims=True)
    used = data.count > 0.0
    noise = antenna.sensor.moment_noise**2 / np.maximum(data.count, 1.0)
    along = noise + (error.moment_bin * peak) ** 2
    tilt = np.where(data.tip, x[:, R_ALONG] ** 2 + UNSEEN_TILT, 0.0)
    astray = np.hypot(error.direction_bin, error.tip_direction * tilt)
    # The curvature is that at touch; as the contact slides the normal turns a little otherwise.
    bent = error.bending * (np.abs(x[:, BEND]) + distance * error.bending_at_least) ** 2
    turned_by = bent[:, None] * reply.slide**2
    across = noise + (astray[:, None] * moment) ** 2 + (error.bending_rest * turned_by * moment) ** 2
    weight = np.where(
        used[..., None], 1.0 / np.stack((along, across), axis=-1), 0.0
    )  # in the frame (unit, aside)

    def turned(vector: FloatArray) -> FloatArray:
        """(P, 2B, 2, ...) from axes x, z to (unit, aside)."""
        a, b = vector[:, :, 0], vector[:, :, 1]
        extra = (1,) * (vector.ndim - 3)
        u, v = unit.reshape(*unit.shape, *extra), aside.reshape(*aside.shape, *extra)
        return np.stack((u[:, :, 0] * a + u[:, :, 1] * b, v[:, :, 0] * a + v[:, :, 1] * b), axis=2)

    back = np.arange(bins) >= bins // 2
    nuisance = np.zeros((pushes, bins, 2, NUISANCES))
    nuisance[:, :, 0, 0], nuisance[:, :, 1, 0] = unit[..., 0], aside[..., 0]
    nuisance[:, :, 0, 1], nuisance[:, :, 1, 1] = unit[..., 1], aside[..., 1]
    nuisance[..., 2:4] = nuisance[..., 0:2] * data.time[:, :, None, None]
    nuisance[:, :, 0, 4] = (antenna.stiffness3 / distance**2)[:, None]  # moment per depth of touch
    nuisance[:, :, 1, 5] = np.where(back, 0.0, moment)
    nuisance[:, :, 1, 6] = np.where(back, moment, 0.0)
    nuisance[:, :, 0, 7] = moment
    nuisance[:, :, 1, 8] = 0.5 * turned_by * moment
    spread = np.empty((pushes, NUISANCES))
    spread[:, 0:2] = data.tare_sigma[:, None] ** 2
    spread[:, 2:4] = max(antenna.sensor.moment_drift, 1e-9) ** 2
    spread[:, 4] = data.depth_sigma**2
    spread[:, 5:7] = (error.direction_bias**2 + (error.tip_direction * tilt) ** 2)[:, None]
    # Of side contacts the gain cannot be told from s; it is put to the distance's sigma in the end.
    tip_gain = error.tip_gain + error.tip_gain_tilt * tilt
    spread[:, 7] = np.where(data.tip, tip_gain, NO_GAIN) ** 2
    spread[:, 8] = 1.0
    columns = np.concatenate((turned(derivative), turned(data.force - force)[..., None]), axis=3)
    columns = columns.reshape(pushes, 2 * bins, derivative.shape[3] + 1)
    removed = nuisance.reshape(pushes, 2 * bins, NUISANCES)
    w = weight.reshape(pushes, 2 * bins, 1)
    weighted = (w * removed).transpose(0, 2, 1)
    inner = weighted @ removed + np.eye(NUISANCES) / spread[:, :, None]
    cross = weighted @ columns
    information = (w * columns).transpose(0, 2, 1) @ columns - cross.transpose(0, 2, 1) @ np.linalg.solve(
        inner, cross
    )
    return np.asarray(information, dtype=np.float64)


def _gather(values: FloatArray, contact: IntArray, n: int) -> FloatArray:
    """Sum of the rows of each contact; pushes are sorted by contact in the common case of one each."""
    if contact.size == n and np.array_equal(contact, np.arange(n)):
        return values
    total = np.zeros((n, *values.shape[1:]))
    np.add.at(total, contact, values)
    return total


def prepare(bins: Bins, touch: Touch, distance: FloatArray, contact: IntArray, antenna: Antenna) -> PushData:
    """Bins of P pushes from ``touch`` (P rows) as data; ``distance`` (P,) m is a first guess of s.

    The moment at rest tells how deep the beam stands; without one it may also stand a little clear of the body.
    """
    half = bins.theta.shape[1] // 2
    slots = (np.arange(half) + 0.5) / half
    out = OUT_RANGE[0] + (OUT_RANGE[1] - OUT_RANGE[0]) * slots
    back = BACK_RANGE[0] + (BACK_RANGE[1] - BACK_RANGE[0]) * slots[::-1]
    middle = np.concatenate((out, back)) * bins.peak[:, None]
    theta = np.where(bins.count > 0.0, bins.theta, middle)
    spread = np.array([OUT_RANGE[1] - OUT_RANGE[0], BACK_RANGE[0] - BACK_RANGE[1]]) / half
    spread = np.repeat(spread, half)[None, :, None] * bins.peak[:, None, None] * GAUSS
    nodes = np.maximum(theta[..., None] + spread, 0.0).reshape(theta.shape[0], -1)
    push = np.stack((np.cos(bins.phi), np.sin(bins.phi)), axis=1)
    along = np.sum(bins.up * push, axis=1)
    change = -bins.up_along[:, None] * np.sin(theta) - along[:, None] * (1.0 - np.cos(theta))
    noise = antenna.sensor.moment_noise
    tare_sigma = noise / np.sqrt(np.maximum(touch.tare_samples, 1))
    rest_sigma = np.hypot(tare_sigma, noise / np.sqrt(np.maximum(touch.preload_samples, 1)))
    held = -(touch.preload[:, 0] * np.cos(touch.approach) + touch.preload[:, 1] * np.sin(touch.approach))
    per_moment = distance**2 / antenna.stiffness3
    return PushData(
        phi=bins.phi,
        path=np.insert(nodes, nodes.shape[1] // 2, bins.peak, axis=1),
        force=bins.force,
        count=bins.count,
        time=bins.time,
        gravity=-antenna.beam.line_weight * change[..., None] * push[:, None, :],
        depth=np.maximum(held, 0.0) * per_moment,
        depth_sigma=np.hypot(DEPTH_SIGMA, rest_sigma * per_moment),
        tare_sigma=tare_sigma,
        tip=np.zeros(contact.size, dtype=np.bool_),
        contact=contact,
    )


def fit(data: PushData, prior: Prior, start: FloatArray, antenna: Antenna, error: ModelError) -> Estimate:
    """Fit n contacts to all their pushes.

    Args:
        data: P pushes as :func:`prepare` made them; ``data.contact`` says which contact each belongs to.
        prior: of n contacts.
        start: (n, 5) states to begin from.
        antenna: beam and sensor as calibrated.
        error: of the forward model.
    """
    n = start.shape[0]
    lower = np.tile(_LOWER, (n, 1))
    lower[data.contact[data.tip], R_ALONG] = -_UPPER[R_ALONG]
    x = np.clip(start, lower, _UPPER)
    firm = np.zeros((n, PARAMETERS))
    weight = np.zeros((n, PARAMETERS))
    dof = np.zeros(n)
    np.add.at(dof, data.contact, 2.0 * (data.count > 0.0).sum(axis=1))
    cost, chi2 = np.full(n, np.inf), np.full(n, np.inf)
    normal = np.zeros((n, PARAMETERS, PARAMETERS))
    gradient = np.zeros((n, PARAMETERS))
    damping = np.full(n, 1e-2)
    converged = np.zeros(n, dtype=bool)
    trial = x.copy()
    active = np.arange(n)
    for _ in range(_ITERATIONS):
        local = np.full(n, -1)
        local[active] = np.arange(active.size)
        rows = np.flatnonzero(local[data.contact] >= 0)
        part = data.take(rows, local[data.contact[rows]])
        state = trial[active][part.contact]
        system = _normal_equations(part, state, _linearised(part, state, antenna), antenna, error)
        total = _gather(system, part.contact, active.size)
        pull = prior.take(active).pull(trial[active])
        new_cost = total[:, 5, 5] + pull.cost
        better = new_cost <= cost[active] * (1.0 + 1e-9) + 1e-9
        good = active[better]
        x[good], cost[good], chi2[good] = trial[good], new_cost[better], total[better, 5, 5]
        normal[good] = total[better, :5, :5]
        gradient[good] = total[better, :5, 5] + pull.gradient[better]
        weight[good], firm[good] = pull.weight[better], pull.firm[better]
        damping[good] *= 0.2
        damping[active[~better]] *= 30.0
        matrix = normal[active] + np.eye(5) * weight[active][:, None, :]
        diagonal = np.maximum(np.einsum("nii->ni", matrix), 1e-9)
        damped = matrix + np.eye(5) * (damping[active][:, None] * diagonal)[:, None, :]
        step = np.linalg.solve(damped, gradient[active][..., None])[..., 0]
        step = np.clip(step, -_MAX_STEP, _MAX_STEP)
        trial[active] = np.clip(x[active] + step, lower[active], _UPPER)
        # What the quadratic model promises of this step; a promise this small is not worth keeping.
        promise = np.sum(gradient[active] * (trial[active] - x[active]), axis=1)
        settled = damping[active] < _LOST
        done = (promise < _SMALL_GAIN) | ((promise < _TRUSTED_GAIN) & (damping[active] < _TRUSTED))
        converged[active[done]] = settled[done]
        last = active[done & settled]
        x[last], cost[last] = trial[last], cost[last] - promise[done & settled]
        active = active[~done]
        if active.size == 0:
            break
    matrix = normal + np.eye(5) * firm[:, None, :]
    covariance = np.asarray(np.linalg.inv(matrix + 1e-12 * np.eye(5)), dtype=np.float64)
    return Estimate(mean=x, covariance=covariance, chi2=chi2, dof=dof, cost=cost, converged=converged)


def screen(
    data: PushData, prior: Prior, states: FloatArray, antenna: Antenna, error: ModelError
) -> FloatArray:
    """Cost (n, m) of m states ``states`` (n, m, 5) of each contact; the other arguments as for :func:`fit`.

    A negative R counts as none here.
    """
    n, m, _ = states.shape
    pushes = data.contact.size
    every = np.tile(np.arange(pushes), m)
    part = data.take(every, (np.arange(m)[:, None] * n + data.contact).ravel())
    x = states.transpose(1, 0, 2).reshape(-1, PARAMETERS)[part.contact]
    system = _normal_equations(part, x, _bare(part, x, antenna), antenna, error)
    total = np.zeros(m * n)
    np.add.at(total, part.contact, system[:, 0, 0])
    tiled = Prior(mean=np.tile(prior.mean, (m, 1)), sigma=np.tile(prior.sigma, (m, 1)))
    total += tiled.pull(states.transpose(1, 0, 2).reshape(-1, PARAMETERS)).cost
    return np.asarray(total.reshape(m, n).T)


def expected_covariance(
    data: PushData, x: FloatArray, information: FloatArray, antenna: Antenna, error: ModelError
) -> FloatArray:
    """(P, 5, 5) covariance that each of the P imagined pushes of ``data`` would leave.

    Args:
        data: pushes with angles and counts; their forces do not matter.
        x: (P, 5) states.
        information: (P, 5, 5) what is known before.
        antenna: beam and sensor.
        error: of the forward model.
    """
    system = _normal_equations(data, x, _linearised(data, x, antenna), antenna, error)
    inverse = np.linalg.inv(information + system[:, :5, :5] + 1e-12 * np.eye(5))
    return np.asarray(inverse, dtype=np.float64)
