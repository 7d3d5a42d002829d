"""One push that slides, and what the strategies of out strokes share."""

from __future__ import annotations

import numpy as np
import pytest
from push_bench import QUIET, Bench, true_contacts

from contour.antenna import Antenna, Sensor
from contour.contacts import Flag
from contour.errors import InstrumentError, UsageError
from contour.frames import wrap_angle
from contour.one_push import OnePushSettings, OnePushStrategy, PushSettings, push_angle

DISTANCES = np.array([0.04, 0.08, 0.12, 0.16, 0.2])


def one_push(bench: Bench, settings: OnePushSettings | None = None) -> OnePushStrategy:
    """A strategy for the contacts of ``bench``."""
    return OnePushStrategy(bench.truth.distance.size, bench.antenna, bench.mount, settings)


def test_flat_profile_with_the_right_alpha_is_localised():
    """A sliding push on a flat edge gives s and the normal when alpha_est is the friction angle."""
    bench = Bench(true_contacts(5, distance=DISTANCES))
    found = bench.localise(one_push(bench))
    assert found.good.all()
    assert (found.pushes == 1).all()
    # Left out: friction along the beam, mu theta/5 = 0.18 x 0.052/5 = 0.2 %, and the cone's edge that creep
    # has not quite reached, up to 0.3 deg in D or tan(20 deg) x 0.3 deg = 0.2 % in s; the finite angle 0.1 %.
    np.testing.assert_allclose(found.distance, DISTANCES, rtol=5e-3)
    np.testing.assert_allclose(wrap_angle(found.outward), 0.0, atol=np.deg2rad(0.5))


def test_a_wrong_alpha_turns_the_normal_by_its_error():
    """nu+ = psi - sign(D) alpha_est, so the normal is off by what alpha_est is off."""
    bench = Bench(true_contacts(1, friction=np.tan(np.deg2rad(14.0))))
    found = bench.localise(one_push(bench))
    assert np.rad2deg(found.outward[0]) == pytest.approx(4.0, abs=0.5)  # creep, as above
    assert abs(found.outward[0]) < 2.0 * found.sigma_normal[0]


def test_a_push_that_does_not_slide_is_flagged():
    """Inside the cone the rule does not hold, and the reading shows it."""
    bench = Bench(true_contacts(1, friction=np.tan(np.deg2rad(25.0))))
    found = bench.localise(one_push(bench, OnePushSettings(offset=np.deg2rad(12.0))))
    assert found.flags[0] == Flag.UNRESOLVED


def test_a_distance_beyond_the_beam_is_flagged():
    """80 deg off the normal 3 EI C is far too long, and the assumed alpha does not bring it back."""
    truth = true_contacts(1, distance=0.18, friction=np.tan(np.deg2rad(25.0)))
    found = Bench(truth, expected_off=np.deg2rad(55.0)).localise(one_push(Bench(truth)))
    assert found.distance[0] > 0.22
    assert found.flags[0] & Flag.UNRESOLVED


def test_a_push_past_the_body_is_lost():
    """A push that feels nothing is counted and flagged, and leaves what was expected."""
    bench = Bench(true_contacts(1), expected_off=np.pi)
    found = bench.localise(one_push(bench))
    assert found.flags[0] == Flag.LOST
    assert found.pushes[0] == 1
    assert abs(wrap_angle(found.outward[0] - np.pi)) < 1e-12


def test_an_offset_of_the_moment_does_not_move_s():
    """The slope is fitted with its offset; dividing two readings would carry it whole."""
    bench = Bench(true_contacts(1, distance=0.2))
    plain = bench.localise(one_push(bench)).distance[0]
    shift = 50e-6 * np.array([0.0, -1.0])  # of (m_x, m_z): a force along -x_s, against the outer normal
    moved = bench.localise(one_push(bench), tare=bench.touch().tare + shift).distance[0]
    # The force at the end is 3.2 mN m: 1.6 % if divided. Across the force the offset turns psi by less than
    # 50 uN m sin(10 deg)/3.2 mN m = 0.16 deg, which is 0.1 % of s at eps 20 deg.
    assert moved == pytest.approx(plain, rel=2e-3)


def test_the_weight_of_a_tilted_beam_does_not_move_s():
    """What the support takes of the weight's change has the same slope as the compliance, up to 1 % of s."""
    up, down = (Bench(true_contacts(5, distance=DISTANCES), elevation=a) for a in (1.0, -1.0))
    # Corrected with s from the uncorrected slope: 1 % of 1 % stays, and terms in theta^2.
    np.testing.assert_allclose(
        up.localise(one_push(up)).distance, down.localise(one_push(down)).distance, rtol=1e-3
    )


def test_pushes_stay_under_the_moment_limit():
    """An edge answers a planned push with at most the planned share of the limit."""
    antenna, settings = Antenna(moment_limit=2e-3), PushSettings()
    angle = push_angle(DISTANCES, antenna, settings)
    assert (antenna.stiffness3 * angle / DISTANCES <= settings.moment_share * 2e-3 * (1.0 + 1e-12)).all()
    assert (push_angle(DISTANCES, Antenna(), settings) <= settings.angle).all()


def test_sigmas_cover_the_errors_under_the_assumptions_made(rng):
    """With friction, radii and noise drawn as assumed, 95 % intervals hold at least 90 % of the truth."""
    n = 600
    alpha = np.clip(rng.normal(np.deg2rad(10.0), np.deg2rad(5.0), n), 0.01, None)
    truth = true_contacts(
        n,
        distance=rng.uniform(0.05, 0.2, n),
        friction=np.tan(alpha),
        radius_along=np.abs(rng.normal(0.0, 0.05, n)),
    )
    bench = Bench(truth, sensor=Sensor())
    found = bench.localise(one_push(bench))
    good = found.good
    assert good.mean() > 0.8  # friction angles above 19 deg hold the push: 4 % of them, and little else
    s_in = np.abs(found.distance - truth.distance) < 1.96 * found.sigma_distance
    normal_in = np.abs(wrap_angle(found.outward)) < 1.96 * found.sigma_normal
    # 95 % +- 3 x 0.9 % by counting; the linear rule for s is less than exact at two sigma.
    assert s_in[good].mean() > 0.9
    assert normal_in[good].mean() > 0.9


def test_a_later_contact_is_pushed_off_the_last_normal():
    """On a contour the normal of the last good contact leads the push, not what the touch expects."""
    bench = Bench(true_contacts(1), expected_off=0.1)
    strategy = one_push(bench)
    first = bench.localise(strategy)
    bench.localise(strategy, fresh=False)
    wanted = first.outward[0] + np.pi + OnePushSettings().offset
    assert wrap_angle(bench.pushes[-1][1][0] - wanted) == pytest.approx(0.0, abs=1e-12)


def test_the_touch_is_left_as_it_was():
    """What a push tells does not write into the touch that was handed over."""
    bench = Bench(true_contacts(1), expected_off=0.2)
    touch = bench.touch()
    expected = touch.expected.copy()
    bench.localise(one_push(bench), expected=touch.expected)
    np.testing.assert_array_equal(touch.expected, expected)


def test_impossible_settings_are_refused():
    """Each with a line that names the number."""
    with pytest.raises(UsageError, match="friction_angle"):
        OnePushSettings(friction_angle=2.0)
    with pytest.raises(UsageError, match="least_slip"):
        OnePushSettings(least_slip=0.0)
    with pytest.raises(UsageError, match="angle_distance"):
        PushSettings(angle_distance=0.0)
    with pytest.raises(UsageError, match="radius"):
        PushSettings(radius=-1.0)


def test_asking_before_a_contact_is_started_is_refused():
    """With the remedy."""
    with pytest.raises(InstrumentError, match="start"):
        OnePushStrategy(1, Antenna(sensor=QUIET), Bench(true_contacts(1)).mount).ask()
