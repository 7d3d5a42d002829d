"""The machine: keyed noise, offsets, encoders, ramps, the strokes of a push, the end of an approach."""

from __future__ import annotations

import numpy as np
import pytest

from contour.antenna import Antenna, Sensor
from contour.errors import UsageError
from contour.instrument import Stroke
from contour.machine import (
    FREE_SAMPLES,
    PRESS_TICKS,
    REST_SAMPLES,
    TOUCH_SCANS,
    MachineModel,
    NoiseKey,
    trapezoid_duration,
    trapezoid_position,
)

QUIET = Sensor(moment_noise=1e-12, touch_sigmas=5e7)
"""No noise to speak of, but the default threshold of 50 uN m."""
TICK = 0.010 / 100.0
"""What the default machine moves in one scan of an approach [m]."""
BRAKE = 0.010**2 / (2.0 * 0.5)
"""Way to standstill from the default approach speed [m]."""
CREEP = 0.001 / 100.0
"""What it backs off in one scan [m]."""


def _key(rows):
    rows = np.asarray(rows)
    return NoiseKey(antenna=rows % 7, approach=rows // 7, push=rows % 3)


def _runs(values, counts):
    return np.split(values, np.cumsum(counts)[:-1])


# -- noise, offset, encoders --------------------------------------------------------------------------------


def test_noise_does_not_depend_on_company_or_order(rng):
    """A run's noise is the same alone, in a batch, and in the batch shuffled."""
    machine, rows, counts = MachineModel(seed=3), np.arange(40), rng.integers(0, 30, 40)
    together = _runs(machine.noise(_key(rows), counts), counts)
    order = rng.permutation(40)
    shuffled = _runs(machine.noise(_key(rows[order]), counts[order]), counts[order])
    for place, row in enumerate(order):
        np.testing.assert_array_equal(shuffled[place], together[row])
        alone = machine.noise(_key(rows[row : row + 1]), counts[row : row + 1])
        np.testing.assert_array_equal(alone, together[row])


def test_longer_runs_begin_as_shorter_ones():
    """The first k samples of a run are the same for any count of at least k."""
    machine, key = MachineModel(), _key([5])
    long = machine.noise(key, np.array([200]))
    for count in (1, 2, 3, 17, 128):
        np.testing.assert_array_equal(machine.noise(key, np.array([count])), long[:count])


def test_noise_is_white_with_the_sensors_deviation():
    """Each axis has the sensor's standard deviation; samples, axes and runs have nothing to do with each other."""
    machine, runs, count = MachineModel(), 400, 500
    noise = machine.noise(_key(np.arange(runs)), np.full(runs, count)).reshape(runs, count, 2)
    n = runs * count
    sigma = machine.sensor.moment_noise
    # Standard deviations of n samples scatter by 1/sqrt(2 n); correlations by 1/sqrt(n). Four of each.
    np.testing.assert_allclose(noise.std(axis=(0, 1)), sigma, rtol=4.0 / np.sqrt(2 * n))
    np.testing.assert_allclose(noise.mean(axis=(0, 1)), 0.0, atol=4.0 * sigma / np.sqrt(n))
    for one, other in (
        (noise[..., 0], noise[..., 1]),
        (noise[:, 1:], noise[:, :-1]),
        (noise[1:], noise[:-1]),
    ):
        assert abs(np.mean(one * other)) < 4.0 * sigma**2 / np.sqrt(one.size)


@pytest.mark.parametrize("changed", ["seed", "antenna", "approach", "push"])
def test_every_part_of_the_key_counts(changed):
    """Another seed, antenna, approach or push has other noise throughout."""
    parts = {"antenna": 1, "approach": 2, "push": 3}
    count = np.array([50])

    def noise(seed, **numbers):
        key = NoiseKey(**{name: np.array([number]) for name, number in numbers.items()})
        return MachineModel(seed=seed).noise(key, count)

    other = noise(1, **parts) if changed == "seed" else noise(0, **{**parts, changed: 9})
    assert not np.any(noise(0, **parts) == other)


def test_offset_is_a_start_and_a_ramp_of_each_axis():
    """The drift's rate is the sensor's, its sign drawn; the offset belongs to the antenna, not to the batch."""
    machine, antenna = MachineModel(), np.arange(300)
    start, later = machine.offset(antenna, np.zeros(300)), machine.offset(antenna, np.full(300, 60.0))
    np.testing.assert_allclose(np.abs(later - start), 60e-6, rtol=1e-9)  # 1 uN m/s for a minute
    falling = np.mean(later < start)
    assert abs(falling - 0.5) < 4.0 * 0.5 / np.sqrt(600)
    assert start.std() == pytest.approx(machine.initial_offset, rel=4.0 / np.sqrt(2 * 600))
    np.testing.assert_array_equal(machine.offset(antenna[7:8], np.full(1, 60.0)), later[7:8])


def test_offset_is_not_the_noise_again():
    """The numbers that make the offset do not come back as samples."""
    machine = MachineModel(initial_offset=10e-6)
    key = NoiseKey(antenna=np.zeros(3, np.int64), approach=np.arange(3), push=np.zeros(3, np.int64))
    samples = machine.noise(key, np.full(3, 1000))
    assert not np.isin(machine.offset(np.zeros(1, np.int64), np.zeros(1)), samples).any()


def test_encoders_give_whole_steps():
    """Multiples of the step, no more than half a step off."""
    machine, angle = MachineModel(), np.linspace(-1.0, 1.0, 9999)
    encoded, step = machine.encode(angle), MachineModel().sensor.encoder_step
    assert np.rad2deg(step) == pytest.approx(0.001)
    np.testing.assert_allclose(encoded / step, np.round(encoded / step), atol=1e-9)
    assert np.max(np.abs(encoded - angle)) <= 0.5 * step * (1.0 + 1e-9)


# -- moves ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("distance", [1e-4, 0.01, 0.05, 1.0])
def test_moves_keep_speed_and_acceleration(distance):
    """From rest to rest over the distance, within both limits, and at one of them all the time."""
    speed, acceleration, n = 0.1, 0.5, 200_001
    duration = trapezoid_duration(distance, speed, acceleration)
    time = np.linspace(0.0, duration, n)
    step = time[1]
    position = trapezoid_position(time, np.asarray(distance), duration, acceleration)
    velocity = np.gradient(position, step)
    # Differences of rounded positions: 1e-16 d/dt, squared for the second.
    assert position[0] == 0.0
    assert position[-1] == pytest.approx(distance, rel=1e-9)
    assert velocity.max() <= speed * (1.0 + 1e-6)
    change = np.gradient(velocity, step)[2:-2]
    assert np.abs(change).max() <= acceleration * (1.0 + 1e-3)
    busy = (velocity[2:-2] > 0.999 * speed) | (np.abs(change) > 0.99 * acceleration)
    assert busy.mean() > 0.999


def test_moves_take_the_slower_of_line_and_turn():
    """100 mm at 50 mm/s against half a radian at 20 deg/s."""
    machine, still = MachineModel(), np.zeros((3, 5))
    end = np.array([[0.06, 0.08, 0, 0, 0], [0, 0, 0, 0, 0.5], [0.06, 0.08, 0, 0, 0.9]])
    line, turn = 0.1 / 0.05 + 0.05 / 0.5, 0.5 / np.deg2rad(20.0) + np.deg2rad(20.0)
    slow = 0.9 / np.deg2rad(20.0) + np.deg2rad(20.0)
    np.testing.assert_allclose(machine.move_time(still, end), [line, turn, slow], rtol=1e-12)


def test_pushes_go_out_and_back_at_their_speeds():
    """Up to the angle at 2 deg/s, back to touch at 5 deg/s, a sample each scan."""
    machine, angle = MachineModel(), np.deg2rad([3.0, 0.5, 0.01])
    timeline = machine.push_timeline(angle)
    for i in range(3):
        rows = slice(timeline.start[i], timeline.start[i + 1])
        theta, stroke, time = timeline.theta[rows], timeline.stroke[rows], timeline.time[rows]
        np.testing.assert_array_equal(timeline.run[rows], i)
        np.testing.assert_allclose(np.diff(time), 0.01, rtol=1e-9)
        assert timeline.duration[i] == pytest.approx(time[-1])
        out, back = theta[stroke == Stroke.OUT], theta[stroke == Stroke.BACK]
        assert out.size + back.size == theta.size
        assert out[-1] == pytest.approx(angle[i], rel=1e-9)
        assert back[-1] == pytest.approx(0.0, abs=1e-9 * angle[i])
        speed_out, speed_back = np.diff(out, prepend=0.0) / 0.01, -np.diff(back, prepend=angle[i]) / 0.01
        assert np.all(speed_out >= -1e-12)
        assert np.all(speed_back >= -1e-12)
        assert speed_out.max() <= machine.push_speed * (1.0 + 1e-9)
        assert speed_back.max() <= machine.return_speed * (1.0 + 1e-9)
    assert timeline.duration[0] == pytest.approx(3.0 / 2.0 + 3.0 / 5.0 + np.deg2rad(7.0), abs=0.02)


def test_a_push_does_not_depend_on_the_others():
    """Rows of a batch are those of each push alone."""
    machine, angle = MachineModel(), np.deg2rad(np.array([2.0, 0.3, 1.1]))
    together = machine.push_timeline(angle)
    for i in range(3):
        alone, rows = machine.push_timeline(angle[i : i + 1]), slice(together.start[i], together.start[i + 1])
        for name in ("theta", "time", "stroke"):
            np.testing.assert_array_equal(getattr(alone, name), getattr(together, name)[rows])


# -- the end of an approach ----------------------------------------------------------------------------------


def _slope(distance):
    return Antenna().stiffness3 / np.asarray(distance, dtype=np.float64) ** 2


def _touch(machine, travel, distance, rows=None):
    rows = np.arange(np.size(travel)) if rows is None else rows
    return machine.touch_timeline(_key(rows), np.asarray(travel), _slope(distance))


def test_touch_is_declared_two_scans_above_the_threshold(rng):
    """Without noise the press ends with the second scan above 50 uN m, and the brake adds its way."""
    machine, n = MachineModel(sensor=QUIET), 200
    distance, travel = rng.uniform(0.02, 0.21, n), rng.uniform(0.0, 0.03, n)
    timeline, slope = _touch(machine, travel, distance), _slope(distance)
    for i in range(n):
        rows = slice(timeline.start[i], timeline.start[i + 1])
        press = timeline.elastic[rows][timeline.stroke[rows] == Stroke.PRESS]
        assert np.count_nonzero(press > machine.sensor.touch_moment) == TOUCH_SCANS
        depth = 0.010 * timeline.time[rows][timeline.stroke[rows] == Stroke.PRESS] - travel[i]
        np.testing.assert_allclose(press, slope[i] * depth, rtol=1e-6, atol=1e-9 * slope[i])
        assert 0.0 < depth[0] <= TICK * (1.0 + 1e-9)
        assert timeline.peak[i] == pytest.approx(press[-1] + slope[i] * BRAKE, rel=1e-6)


def test_touch_is_judged_against_the_mean_in_free_air(rng):
    """The press ends with the first two scans in a row that stand off its own tare by the threshold."""
    machine, n = MachineModel(sensor=Sensor(touch_sigmas=3.0)), 300
    timeline = _touch(machine, rng.uniform(0.0005, 0.01, n), np.full(n, 0.2))
    for i in range(n):
        rows = slice(timeline.start[i], timeline.start[i + 1])
        stroke, noise = timeline.stroke[rows], timeline.noise[rows]
        read = noise + np.column_stack((timeline.elastic[rows], np.zeros(stroke.size)))
        off = read[stroke == Stroke.PRESS] - noise[stroke == Stroke.FREE].mean(axis=0)
        over = np.hypot(*off.T) > machine.sensor.touch_moment
        assert over[-1]
        assert over[-2]
        assert not np.any(over[1:-1] & over[:-2])


def test_a_touch_near_the_base_overshoots_by_six_millinewton_metres():
    """At s = 21 mm and 10 mm/s: two scans and the brake are 0.2 to 0.3 mm, 28 mN m each millimetre."""
    travel = np.linspace(0.01, 0.0101, 50)
    peak = _touch(MachineModel(), travel, np.full(50, 0.021)).peak
    assert np.all((peak > 5.5e-3) & (peak < 8.6e-3))


def test_the_antenna_rests_at_the_edge_of_touch(rng):
    """Between one creep before touch and the depth where the moment is half the threshold, noise allowed for."""
    machine, n = MachineModel(), 500
    distance = rng.uniform(0.03, 0.21, n)
    timeline, slope = _touch(machine, rng.uniform(0.001, 0.03, n), distance), _slope(distance)
    assert np.all(timeline.rest_depth >= -CREEP * (1.0 + 1e-9))
    # The retreat ends at the first scan under half the threshold; noise, tare included, rarely delays it by 4 sigma.
    sigma = machine.sensor.moment_noise * np.sqrt(1.0 + 1.0 / 9.0)
    assert np.all(
        slope * timeline.rest_depth < 0.5 * machine.sensor.touch_moment + 4.0 * sigma + slope * CREEP
    )


def test_noise_alone_makes_no_touch():
    """The moment at the end of the press is elastic for all but a few of a thousand soft touches."""
    machine, n = MachineModel(), 1000
    timeline = _touch(machine, np.full(n, 0.02), np.full(n, 0.2))
    last = [
        timeline.elastic[a:b][timeline.stroke[a:b] == Stroke.PRESS][-1]
        for a, b in zip(timeline.start[:-1], timeline.start[1:], strict=True)
    ]
    # A sample alone exceeds 5 sigma about once in 270,000; the tare of 20 samples widens that little.
    assert np.mean(np.array(last) < 0.4 * machine.sensor.touch_moment) < 0.005


def test_samples_of_a_touch_come_in_order(rng):
    """At most 20 in free air, the press, the retreat, 10 at rest; one a scan, the last at the end."""
    machine, n = MachineModel(), 100
    travel = rng.uniform(0.0, 0.004, n)
    timeline = _touch(machine, travel, np.full(n, 0.1))
    for i in range(n):
        rows = slice(timeline.start[i], timeline.start[i + 1])
        stroke, time, elastic = timeline.stroke[rows], timeline.time[rows], timeline.elastic[rows]
        assert np.all(np.diff(stroke) >= 0)
        assert np.count_nonzero(stroke == Stroke.FREE) == min(int(travel[i] / TICK), FREE_SAMPLES)
        assert np.count_nonzero(stroke == Stroke.REST) == REST_SAMPLES
        np.testing.assert_array_equal(elastic[stroke == Stroke.FREE], 0.0)
        at_rest = _slope(0.1) * max(timeline.rest_depth[i], 0.0)
        np.testing.assert_allclose(elastic[stroke == Stroke.REST], at_rest)
        np.testing.assert_allclose(np.diff(time), 0.01, rtol=1e-6)
        assert timeline.duration[i] == pytest.approx(time[-1])
        touched = time[stroke == Stroke.PRESS][0]
        assert 0.0 < touched - travel[i] / 0.010 <= 0.01 + 1e-12


def test_a_touch_does_not_depend_on_the_others(rng):
    """Rows of a batch are those of each approach alone, bit for bit."""
    machine, n = MachineModel(seed=9), 12
    travel, distance = rng.uniform(0.0, 0.01, n), rng.uniform(0.02, 0.21, n)
    together = _touch(machine, travel, distance)
    for i in range(n):
        alone = _touch(machine, travel[i : i + 1], distance[i : i + 1], np.array([i]))
        rows = slice(together.start[i], together.start[i + 1])
        for name in ("time", "stroke", "noise", "elastic"):
            np.testing.assert_array_equal(getattr(alone, name), getattr(together, name)[rows])
        for name in ("rest_depth", "peak", "duration"):
            assert getattr(alone, name)[0] == getattr(together, name)[i]


def test_a_touch_that_is_never_felt_ends_all_the_same():
    """A moment that hardly rises stops the press after its last scan and is backed off to the edge."""
    machine = MachineModel(sensor=QUIET)
    timeline = machine.touch_timeline(_key([0]), np.array([0.01]), np.array([1e-4]))
    assert np.count_nonzero(timeline.stroke == Stroke.PRESS) == PRESS_TICKS


@pytest.mark.parametrize(
    "numbers,message",
    [
        ({"travel_speed": 0.0}, "gantry travel_speed is 0.0: it must be a finite number above zero"),
        ({"acceleration": np.inf}, "gantry acceleration is inf"),
        ({"push_speed": -0.1}, "gantry push_speed is -0.1"),
        ({"initial_offset": -1.0}, "gantry initial_offset is -1.0: it must be zero or more"),
        ({"seed": -1}, "seed is -1: it must be zero or more"),
    ],
)
def test_impossible_machines_are_refused_in_one_line(numbers, message):
    """The line names the number, its value and what it must be."""
    with pytest.raises(UsageError, match=message):
        MachineModel(**numbers)
