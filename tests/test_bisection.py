"""Pushes that close in on the normal."""

from __future__ import annotations

import numpy as np
import pytest
from push_bench import Bench, true_contacts

from contour.antenna import Antenna, Sensor
from contour.bisection import BisectionSettings, BisectionStrategy, next_direction, normal_bound
from contour.contacts import Flag
from contour.errors import InstrumentError, UsageError
from contour.frames import Mount, wrap_angle
from contour.sensing import Action

LIMITED = BisectionSettings(largest_step=np.deg2rad(40.0), name="bisection-limited")


def bisection(bench: Bench, settings: BisectionSettings | None = None) -> BisectionStrategy:
    """A strategy for the contacts of ``bench``."""
    return BisectionStrategy(bench.truth.distance.size, bench.antenna, bench.mount, settings)


@pytest.mark.parametrize("alpha", [3.0, 10.0, 25.0])
def test_the_normal_is_within_the_papers_bound(alpha):
    """On flat profiles |psi_i - nu+| stays under Fig. 10 and (19), wherever the first push goes."""
    off = np.deg2rad(np.linspace(-60.0, 60.0, 41))
    bench = Bench(true_contacts(41, friction=np.tan(np.deg2rad(alpha))), expected_off=off)
    found = bench.localise(bisection(bench))
    assert found.good.all()
    bound = normal_bound(found.pushes, np.full(41, np.deg2rad(alpha)))
    # Creep leaves psi short of the direction pushed by up to eps theta/(10 tan alpha), 0.1 alpha at 3 deg;
    # the slide of the push shifts nothing on a flat profile.
    assert (np.abs(wrap_angle(found.outward)) < 1.1 * bound + np.deg2rad(0.1)).all()


def test_three_pushes_give_s_within_one_percent():
    """What section III of Kaneko1998 promises for edges, whatever the friction and the first direction."""
    alpha = np.deg2rad(np.tile([3.0, 10.0, 17.0, 25.0], 21))
    off = np.deg2rad(np.repeat(np.linspace(-60.0, 60.0, 21), 4))
    bench = Bench(true_contacts(84, friction=np.tan(alpha)), expected_off=off)
    found = bench.localise(bisection(bench, BisectionSettings(most_pushes=3)))
    resolved = found.good
    assert resolved.mean() > 0.9
    assert (np.abs(found.distance[resolved] / 0.1 - 1.0) < 0.01).all()


def test_the_second_push_turns_back_by_a_quarter_turn():
    """(15): away from the side that slipped; the limited variant by its own step."""
    for settings, step in ((None, 90.0), (LIMITED, 40.0)):
        bench = Bench(true_contacts(2), expected_off=np.deg2rad([30.0, -30.0]))
        bench.localise(bisection(bench, settings))
        first, second = bench.pushes[0][1], bench.pushes[1][1]
        # Pushed past the normal by +30 deg, delta is above pi: back means to smaller angles.
        np.testing.assert_allclose(np.rad2deg(wrap_angle(second - first)), [-step, step], atol=1e-9)


def test_every_push_but_the_first_is_from_a_new_touch():
    """Friction's memory of one trial must not enter the next."""
    bench = Bench(true_contacts(1), expected_off=np.deg2rad(30.0))
    bench.localise(bisection(bench))
    actions = [action[0] for _, _, action in bench.pushes]
    assert len(actions) >= 3
    assert actions == [Action.PUSH] + [Action.REAPPROACH] * (len(actions) - 1)


def test_a_touch_without_zero_is_zeroed_first():
    """A tare of no samples means nothing."""
    bench = Bench(true_contacts(1))
    bench.localise(bisection(bench), tare_samples=np.zeros(1, dtype=np.int64))
    assert bench.pushes[0][2][0] == Action.ZERO


def test_the_next_direction_pairs_the_nearest_trial_of_the_other_side():
    """(18): k is on the other side of nu+, and of those the nearest."""
    phi = np.zeros((1, 4))
    psi = np.deg2rad([[10.0, 4.0, -2.0, -6.0]])
    off = np.deg2rad([[20.0, 5.0, -3.0, -9.0]])
    # The last trial made is the third: its partners are the first and the second, and the second is nearer.
    wanted = np.deg2rad(0.5 * (4.0 - 2.0)) + np.pi
    assert wrap_angle(next_direction(phi, psi, off, np.array([3]), 1.0)[0] - wanted) == pytest.approx(
        0.0, abs=1e-12
    )


def test_the_mean_of_two_directions_is_taken_the_short_way():
    """Directions on both sides of 180 deg have their mean there, not at 0."""
    psi = np.deg2rad([[179.0, -177.0]])
    found = next_direction(np.zeros((1, 2)), psi, np.array([[0.1, -0.1]]), np.array([2]), 1.0)
    assert np.rad2deg(found[0]) == pytest.approx(1.0, abs=1e-9)


def test_without_a_trial_on_the_other_side_the_turn_is_repeated():
    """A limited step may not reach the other side at once."""
    phi, psi, off = np.array([[0.5, 0.1]]), np.zeros((1, 2)), np.array([[0.4, 0.2]])
    assert next_direction(phi, psi, off, np.array([2]), 0.4)[0] == pytest.approx(-0.3, abs=1e-12)


def test_a_quarter_turn_slips_off_a_small_radius_and_says_so():
    """On R_l = 6 mm, q = 1.15, the printed step leaves the body; the limited one stays on it."""
    truth = true_contacts(1, radius_across=6e-3)
    printed, limited = (Bench(truth, expected_off=np.deg2rad(20.0)) for _ in range(2))
    assert printed.localise(bisection(printed)).flags[0] == Flag.SLIP_OFF
    found = limited.localise(bisection(limited, LIMITED))
    assert found.good[0]
    # Both trials of the limited variant lie 20 deg off: by symmetry their mean is the normal.
    assert abs(np.rad2deg(found.outward[0])) < 0.2


def test_a_first_push_that_slips_off_is_not_called_lost():
    """The body was felt: only the measurement failed, and the expected normal is kept with its sigma."""
    bench = Bench(true_contacts(1, radius_across=3e-3), expected_off=np.deg2rad(15.0))
    found = bench.localise(bisection(bench))
    assert found.flags[0] == Flag.SLIP_OFF
    assert found.outward[0] == pytest.approx(np.deg2rad(15.0))
    assert found.sigma_normal[0] == pytest.approx(np.deg2rad(20.0))


def test_a_tolerance_that_is_never_reached_ends_in_a_flag():
    """The best trial is kept, all pushes are counted."""
    bench = Bench(true_contacts(1), expected_off=np.deg2rad(30.0))
    settings = BisectionSettings(tolerance=1e-12, most_pushes=4)
    found = bench.localise(bisection(bench, settings))
    assert found.flags[0] == Flag.UNRESOLVED
    assert found.pushes[0] == 4
    assert abs(found.distance[0] / 0.1 - 1.0) < 0.01  # as after three pushes


def test_friction_is_read_off_pushes_from_both_sides():
    """On flat profiles half the spread of psi is alpha."""
    alpha = np.deg2rad([6.0, 10.0, 16.0])
    bench = Bench(true_contacts(3, friction=np.tan(alpha)), expected_off=np.deg2rad(40.0))
    found = bench.localise(bisection(bench, BisectionSettings(bend=0.0)))
    # Both pushes lie far outside the cone; what is left is the share of s_lon in the slip, 1 - sin(gamma)
    # with tan(gamma) = s_lat/s_lon > 10: below 0.5 %, plus as much for the nodes of the stroke.
    np.testing.assert_allclose(found.friction_angle, alpha, rtol=0.02)


def test_sigmas_of_the_normal_cover_curved_profiles(rng):
    """With friction, curvature and first directions drawn at random, at least 92 % of normals lie in 95 %."""
    n = 400
    truth = true_contacts(
        n,
        distance=rng.uniform(0.06, 0.2, n),
        friction=np.tan(np.deg2rad(rng.uniform(3.0, 20.0, n))),
        radius_across=1.0 / np.abs(rng.normal(0.0, 15.0, n)),
        radius_along=np.abs(rng.normal(0.0, 0.05, n)),
    )
    bench = Bench(truth, sensor=Sensor(), expected_off=np.deg2rad(rng.uniform(-30.0, 30.0, n)))
    found = bench.localise(bisection(bench))
    good = found.good
    inside = np.abs(wrap_angle(found.outward)) < 1.96 * found.sigma_normal
    assert inside[good].mean() > 0.92
    s_inside = np.abs(found.distance - truth.distance) < 1.96 * found.sigma_distance
    assert s_inside[good].mean() > 0.92


def test_a_later_contact_is_first_pushed_along_the_last_normal():
    """Fig. 15: where the neighbour's normal was found, not where the touch expects it."""
    bench = Bench(true_contacts(1), expected_off=np.deg2rad(30.0))
    strategy = bisection(bench)
    first = bench.localise(strategy)
    made = len(bench.pushes)
    bench.localise(strategy, fresh=False)
    assert wrap_angle(bench.pushes[made][1][0] - first.outward[0] - np.pi) == pytest.approx(0.0, abs=1e-12)


def test_a_contact_not_found_again_keeps_its_first_trial():
    """Dropped contacts are flagged, not thrown away."""
    bench = Bench(true_contacts(1), expected_off=np.deg2rad(30.0))
    strategy = bisection(bench)
    found = bench.localise(strategy, drop_after=1)
    assert found.flags[0] == Flag.UNRESOLVED
    assert found.pushes[0] == 1
    # One trial 30 deg off: C/c0 = cos(10 deg)/cos(30 deg) = 1.14.
    assert found.distance[0] == pytest.approx(0.114, rel=0.01)
    assert bench.localise(strategy, drop_after=0).flags[0] == Flag.LOST


def test_impossible_settings_are_refused():
    """Each with a line that names the number."""
    for name, value in (
        ("tolerance", 0.0),
        ("most_pushes", 0),
        ("largest_step", 2.0),
        ("friction_angle", 0.0),
        ("bend", -1.0),
    ):
        with pytest.raises(UsageError, match=name):
            BisectionSettings(**{name: value})


def test_asking_before_a_contact_is_started_is_refused():
    """With the remedy."""
    with pytest.raises(InstrumentError, match="start"):
        BisectionStrategy(1, Antenna(), Mount.identity()).ask()
