"""The joint estimator: what it recovers, and whether its sigmas tell the truth."""

from __future__ import annotations

import numpy as np
from push_bench import Bench, true_contacts

from contour.antenna import Sensor
from contour.fit import TAIL, Prior, expected_covariance, fit, screen
from contour.frames import wrap_angle
from contour.information import BEND, LN_S, LN_TAN_ALPHA, NU, R_ALONG, ModelError, prepare

LOOSE = np.array([0.5, np.deg2rad(20.0), 0.9, 0.4, 6.0])


def pushed(bench: Bench, eps: np.ndarray, angle: float):
    """Data of one push of every contact of ``bench``, ``eps`` off the inner normal."""
    bins, touch = bench.first_push(eps, angle)
    return prepare(bins, touch, bench.truth.distance, np.arange(len(touch)), bench.antenna)


def true_state(truth) -> np.ndarray:
    """(n, 5) state of the estimator for known contacts."""
    s = truth.distance
    columns = (
        np.log(s),
        truth.outward + np.pi,
        np.log(truth.friction),
        truth.radius_along / s,
        s / truth.radius_across,
    )
    return np.column_stack(columns)


def mixed(n: int, rng: np.random.Generator):
    """Side contacts of all sorts, pushed near their normals."""
    return true_contacts(
        n,
        distance=rng.uniform(0.06, 0.19, n),
        outward=rng.uniform(-np.pi, np.pi, n),
        radius_along=rng.uniform(0.0, 0.06, n),
        radius_across=rng.uniform(0.02, 0.08, n),
        friction=np.tan(np.deg2rad(rng.choice([5.0, 10.0, 17.0, 25.0], n))),
    )


def test_state_is_recovered_from_a_start_off_the_truth(rng):
    """From a start a percent and a degree off, 40 pushes just outside the cone end within three of their sigmas."""
    truth = mixed(40, rng)
    # There both edges of the cone are seen, so that every unknown is told.
    eps = np.arctan(truth.friction) + np.deg2rad(4.0)
    bench = Bench(truth, exact=True, sensor=Sensor())
    data = pushed(bench, eps, np.deg2rad(2.0))
    state = true_state(truth)
    start = state + np.array([0.01, 0.02, 0.05, 0.03, 0.2])
    found = fit(data, Prior(mean=start, sigma=np.tile(LOOSE, (40, 1))), start, bench.antenna, ModelError())
    assert np.all(found.converged)
    for parameter in (LN_S, NU):
        off = np.abs(wrap_angle(found.mean[:, parameter] - state[:, parameter]))
        assert np.mean(off < 3.0 * found.sigma(parameter)) >= 0.95
    assert np.median(np.abs(wrap_angle(found.mean[:, NU] - state[:, NU]))) < np.deg2rad(0.5)


def test_intervals_cover_the_truth_on_readings_of_the_exact_rod(rng):
    """Of 400 contacts 95 % intervals of s and normal hold 92 to 99 %: two sigmas of a binomial is 2 %."""
    n = 400
    truth = mixed(n, rng)
    bench = Bench(truth, exact=True, sensor=Sensor())
    data = pushed(bench, rng.normal(0.0, np.deg2rad(3.0), n), np.deg2rad(3.0))
    state = true_state(truth)
    spread = np.array([0.3, np.deg2rad(3.0), 0.3, 0.15, 1.0])
    prior = Prior(mean=state + spread * rng.standard_normal((n, 5)), sigma=np.tile(spread, (n, 1)))
    start = prior.mean.copy()
    start[:, LN_S] = state[:, LN_S] + 0.02
    found = fit(data, prior, start, bench.antenna, ModelError())
    for parameter in (LN_S, NU):
        off = np.abs(wrap_angle(found.mean[:, parameter] - state[:, parameter]))
        covered = np.mean(off < 1.96 * np.hypot(found.sigma(parameter), ModelError().gain))
        assert 0.92 < covered <= 0.99
    # 0.25 % is asked of contours that have learned friction and radii; priors this loose cost a little more.
    assert np.sqrt(np.mean((found.mean[:, LN_S] - state[:, LN_S]) ** 2)) < 3e-3


def test_turning_everything_in_the_plane_turns_the_normal_alone(rng):
    """The estimate of nu follows a turn of contact and push; the other parameters do not change."""
    truth = mixed(10, rng)
    turn = 0.7
    turned = true_contacts(
        10, **{f: getattr(truth, f) for f in ("distance", "radius_along", "radius_across", "friction")},
        outward=truth.outward + turn,
    )  # fmt: skip
    estimates = []
    for contacts in (truth, turned):
        bench = Bench(contacts)
        data = pushed(bench, np.full(10, 0.1), np.deg2rad(3.0))
        state = true_state(contacts)
        prior = Prior(mean=state, sigma=np.tile(LOOSE, (10, 1)))
        estimates.append(fit(data, prior, state + 0.01, bench.antenna, ModelError()).mean)
    change = estimates[1] - estimates[0]
    assert np.allclose(wrap_angle(change[:, NU] - turn), 0.0, atol=1e-3)
    assert np.allclose(change[:, [LN_S, R_ALONG]], 0.0, atol=2e-4)


def test_a_push_across_the_cone_tells_the_friction_better_than_one_inside():
    """Outside one push and its return give alpha to a few percent; inside only the creep hints at it."""
    truth = true_contacts(2, radius_across=0.05, distance=0.1)
    bench = Bench(truth, sensor=Sensor())
    data = pushed(bench, np.deg2rad(np.array([1.0, 16.0])), np.deg2rad(3.0))
    state = true_state(truth)
    prior = Prior(mean=state, sigma=np.tile(LOOSE, (2, 1)))
    sigma = fit(data, prior, state, bench.antenna, ModelError()).sigma(LN_TAN_ALPHA)
    assert sigma[1] < 0.05
    assert sigma[0] > 3.0 * sigma[1]


def test_no_state_nearby_explains_the_readings_better(rng):
    """The estimate's cost is below that of its start and of its neighbours a tenth of a sigma away."""
    truth = mixed(12, rng)
    bench = Bench(truth, sensor=Sensor())
    data = pushed(bench, rng.normal(0.0, 0.05, 12), np.deg2rad(3.0))
    state = true_state(truth)
    prior = Prior(mean=state, sigma=np.tile(LOOSE, (12, 1)))
    found = fit(data, prior, state + 0.01, bench.antenna, ModelError())
    for parameter in (LN_S, NU, LN_TAN_ALPHA, R_ALONG, BEND):
        for side in (-1.0, 1.0):
            moved = found.mean.copy()
            moved[:, parameter] += side * 0.5 * found.sigma(parameter)
            there = cost_of(data, prior, moved, bench)
            assert np.all(there > found.cost - 0.1)


def cost_of(data, prior: Prior, state: np.ndarray, bench: Bench) -> np.ndarray:
    """The cost (n,) of given states."""
    return screen(data, prior, state[:, None], bench.antenna, ModelError())[:, 0]


def test_a_search_sees_the_cost_that_a_fit_ends_with(rng):
    """The screened cost of the estimate is its own, up to what a trusted step may miss; elsewhere it is more."""
    truth = mixed(20, rng)
    bench = Bench(truth, sensor=Sensor())
    data = pushed(bench, rng.normal(0.0, 0.05, 20), np.deg2rad(3.0))
    state = true_state(truth)
    prior = Prior(mean=state, sigma=np.tile(LOOSE, (20, 1)))
    found = fit(data, prior, state + 0.01, bench.antenna, ModelError())
    away = found.mean + 3.0 * np.array([found.sigma(parameter) for parameter in range(5)]).T
    cost = screen(data, prior, np.stack((found.mean, away), axis=1), bench.antenna, ModelError())
    convex = found.mean[:, R_ALONG] >= 0.0  # a search takes a negative R for none
    assert convex.sum() > 10
    assert np.allclose(cost[convex, 0], found.cost[convex], atol=0.5)
    assert np.all(cost[:, 1] > cost[:, 0] + 1.0)


def test_a_tangent_far_off_gives_way_to_the_readings(rng):
    """A tangent 4 deg off that claims 0.4 deg: pushes across the cone tell better, and the estimate follows them."""
    truth = mixed(30, rng)
    bench = Bench(truth, sensor=Sensor())
    data = pushed(bench, np.arctan(truth.friction) + np.deg2rad(5.0), np.deg2rad(2.0))
    state = true_state(truth)
    mean = state.copy()
    mean[:, NU] += np.deg2rad(4.0)
    prior = Prior(mean=mean, sigma=np.tile([0.5, np.deg2rad(0.4), 0.9, 0.4, 6.0], (30, 1)))
    found = fit(data, prior, mean, bench.antenna, ModelError())
    off = np.abs(wrap_angle(found.mean[:, NU] - state[:, NU]))
    assert np.median(off) < np.deg2rad(0.5)
    assert np.mean(off < 3.0 * found.sigma(NU)) > 0.85


def test_a_prior_far_away_pulls_less_than_one_nearby():
    """The normal's prior has Student's tails: its pull falls beyond the square root of its degrees of freedom."""
    prior = Prior(mean=np.zeros((3, 5)), sigma=np.full((3, 5), 0.1))
    states = np.zeros((3, 5))
    states[:, NU] = [0.1, 0.1 * np.sqrt(TAIL), 1.0]
    pull = prior.pull(states)
    size = np.abs(pull.gradient[:, NU])
    assert size[1] > size[0]
    assert size[1] > size[2]
    assert pull.firm[2, NU] == 0.0
    step = 1e-6
    there = states.copy()
    there[:, NU] += step
    # The cost is twice a potential, as a chi^2 is: its slope is minus twice the pull.
    assert np.allclose((prior.pull(there).cost - pull.cost) / step, -2.0 * pull.gradient[:, NU], rtol=1e-4)


def test_a_long_slide_counts_less_where_the_profile_bends():
    """How the curvature goes on is not known: a push that slides far over a bent profile tells less of the normal than
    one over a profile that may not bend otherwise.
    """
    truth = true_contacts(1, radius_across=0.01, distance=0.1)
    bench = Bench(truth, sensor=Sensor())
    data = pushed(bench, np.deg2rad(np.array([35.0])), np.deg2rad(3.0))
    state = true_state(truth)
    known = np.diag(1.0 / LOOSE**2)[None]
    sigma = [
        np.sqrt(
            expected_covariance(data, state, known, bench.antenna, ModelError(bending=bending))[0, NU, NU]
        )
        for bending in (0.0, 0.5)
    ]
    assert sigma[1] > 1.2 * sigma[0]
