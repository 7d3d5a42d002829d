"""What is believed of contacts: searches over starts, tip against side, and tangents that say nothing."""

from __future__ import annotations

import numpy as np
import pytest
from push_bench import Bench, true_contacts

from contour.antenna import Sensor
from contour.contacts import Kind
from contour.fit import Prior
from contour.frames import wrap_angle
from contour.information import BEND, LN_S, LN_TAN_ALPHA, NU, R_ALONG, ModelError
from contour.posterior import Posterior


def told(bench: Bench, prior: Prior, eps: np.ndarray, angle: float, *, tip: bool = False) -> Posterior:
    """What one push of every contact of ``bench``, ``eps`` off the inner normal, leaves to believe."""
    bins, touch = bench.first_push(eps, angle)
    n = len(touch)
    believed = Posterior(prior, np.zeros(n, dtype=bool), bench.antenna, ModelError())
    if tip:
        believed.as_tip(np.arange(n))
    believed.tell(np.arange(n), bins, touch, np.ones(n, dtype=bool))
    return believed


def prior_of(truth, *, normal_off: float, normal_sigma: float) -> Prior:
    """A contour's prior: distance as the last contact's within a third, the normal as asked."""
    n = truth.distance.size
    mean = np.zeros((n, 5))
    mean[:, LN_S] = np.log(truth.distance)
    mean[:, NU] = truth.outward + np.pi + normal_off
    mean[:, LN_TAN_ALPHA] = np.log(truth.friction)
    mean[:, R_ALONG] = 0.02 / truth.distance
    sigma = np.tile([0.35, normal_sigma, 0.1, 0.3, 4.0], (n, 1))
    return Prior(mean=mean, sigma=sigma)


def test_a_normal_hardly_known_is_found_from_any_side():
    """Friction and normal unknown, the normal expected 20 deg off either way: a search ends at the true one."""
    n = 24
    truth = true_contacts(
        n,
        radius_across=0.05,
        radius_along=0.02,
        friction=np.tan(np.deg2rad(np.repeat([5.0, 12.0, 20.0, 25.0], n // 4))),
    )
    off = np.deg2rad(20.0) * np.where(np.arange(n) % 2 == 0, 1.0, -1.0)
    prior = prior_of(truth, normal_off=0.0, normal_sigma=0.6)
    prior.mean[:, NU] += off
    prior.mean[:, LN_TAN_ALPHA], prior.sigma[:, LN_TAN_ALPHA] = np.log(0.16), 0.9
    believed = told(Bench(truth, sensor=Sensor()), prior, 1.2 * off, np.deg2rad(3.0))
    turn = np.abs(wrap_angle(believed.mean[:, NU] - truth.outward - np.pi))
    assert np.mean(turn < 3.0 * believed.sigmas(np.arange(n), truth.outward + np.pi)[:, NU] + 1e-3) >= 0.9
    assert np.median(turn) < np.deg2rad(1.0)


def test_readings_that_exclude_the_tangent_leave_it_out():
    """A tangent 25 deg off that claims 1 deg is taken for a corner's, and the normal comes from the readings."""
    truth = true_contacts(12, radius_across=0.05, radius_along=0.02)
    prior = prior_of(truth, normal_off=np.deg2rad(25.0), normal_sigma=np.deg2rad(1.0))
    believed = told(Bench(truth, sensor=Sensor()), prior, np.full(12, np.deg2rad(14.0)), np.deg2rad(3.0))
    assert np.all(believed.corner)
    assert np.median(np.abs(wrap_angle(believed.mean[:, NU] - truth.outward - np.pi))) < np.deg2rad(1.5)


def test_a_tip_is_told_from_a_side_contact_near_it():
    """The same push with the tip and with the side at 0.97 L: each is found out from the other's prior."""
    n = 12
    length = Bench(true_contacts(1)).antenna.beam.length
    tips = true_contacts(n, distance=length, kind=Kind.TIP, radius_across=0.05, friction=0.18)
    eps = np.full(n, np.deg2rad(16.0))
    prior = prior_of(tips, normal_off=0.0, normal_sigma=np.deg2rad(3.0))
    found = told(Bench(tips, sensor=Sensor()), prior, eps, np.deg2rad(3.0))
    assert found.tip.mean() > 0.9
    assert np.all(np.abs(found.mean[found.tip, R_ALONG]) < 0.4)
    sides = true_contacts(n, distance=0.97 * length, radius_across=0.05, radius_along=0.02, friction=0.18)
    prior = prior_of(sides, normal_off=0.0, normal_sigma=np.deg2rad(3.0))
    found = told(Bench(sides, sensor=Sensor()), prior, eps, np.deg2rad(3.0), tip=True)
    assert found.tip.mean() < 0.1
    assert np.all(np.abs(np.exp(found.mean[~found.tip, LN_S]) / (0.97 * length) - 1.0) < 0.01)


def test_a_prior_taken_for_a_tip_has_no_distance_left():
    """s is L within the roundness of the end, and the tilt, of either sign, stands in the place of R."""
    truth = true_contacts(3, distance=0.2)
    believed = Posterior(
        prior_of(truth, normal_off=0.0, normal_sigma=0.1),
        np.zeros(3, dtype=bool),
        Bench(truth).antenna,
        ModelError(),
    )
    believed.as_tip(np.array([1]))
    assert believed.tip.tolist() == [False, True, False]
    assert np.exp(believed.mean[1, LN_S]) == pytest.approx(0.21)
    assert believed.mean[1, R_ALONG] == 0.0
    assert believed.mean[0, BEND] == 0.0
