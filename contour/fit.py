"""The estimator: distance, normal and friction angle of n contacts from the bins of all their pushes.

A Gauss-Newton iteration with Levenberg's damping finds the maximum of the posterior of the states of
:mod:`contour.information`, all contacts at once. Only readings and priors enter. The covariance is that of the full
state, so sigma_s and sigma_normal already contain what curvature, friction and offsets cost.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contour.antenna import Antenna
from contour.information import (
    NU,
    PARAMETERS,
    R_ALONG,
    ModelError,
    PushData,
    bare,
    linearised,
    normal_equations,
)

__all__ = ["TAIL", "Estimate", "Prior", "Pull", "expected_covariance", "fit", "screen"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_LOWER = np.array([np.log(2e-3), -np.inf, np.log(np.tan(np.deg2rad(0.3))), -0.3, -400.0])
_UPPER = np.array([np.log(1.0), np.inf, np.log(np.tan(np.deg2rad(45.0))), 4.0, 400.0])
_MAX_STEP = np.array([0.5, 0.15, 0.7, 0.5, 5.0])
_ITERATIONS = 12
TAIL = 3.0
"""Degrees of freedom of the normal's prior."""
_SMALL_GAIN = 0.03
"""Fall of the cost (a chi^2) that is not worth another iteration."""
_TRUSTED_GAIN = 1.0
"""Fall of the cost that a step with little damping is trusted with, without looking."""
_TRUSTED = 0.02
"""Damping below which that is so."""
_PATIENCE = 5
_HOPELESS = 50.0
"""Cost per degree of freedom that is not followed further after so many steps."""
_LOST = 1e3
"""Damping at which small promises mean that the iteration is stuck, not that it is done."""


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


def _gather(values: FloatArray, contact: IntArray, n: int) -> FloatArray:
    """Sum of the rows of each contact; pushes are sorted by contact in the common case of one each."""
    if contact.size == n and np.array_equal(contact, np.arange(n)):
        return values
    total = np.zeros((n, *values.shape[1:]))
    np.add.at(total, contact, values)
    return total


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
    for step_number in range(_ITERATIONS):
        local = np.full(n, -1)
        local[active] = np.arange(active.size)
        rows = np.flatnonzero(local[data.contact] >= 0)
        part = data.take(rows, local[data.contact[rows]])
        state = trial[active][part.contact]
        system = normal_equations(part, state, linearised(part, state, antenna), antenna, error)
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
        # What nothing explains after so many steps is left: it will not be believed.
        hopeless = (step_number >= _PATIENCE) & (cost[active] > _HOPELESS * dof[active])
        active = active[~(done | hopeless)]
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
    system = normal_equations(part, x, bare(part, x, antenna), antenna, error)
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
    system = normal_equations(data, x, linearised(data, x, antenna), antenna, error)
    inverse = np.linalg.inv(information + system[:, :5, :5] + 1e-12 * np.eye(5))
    return np.asarray(inverse, dtype=np.float64)
