"""From samples to touches and bins: zero, weight and spin taken out; points, and pushes that run away."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from contour.antenna import Antenna, Beam, Sensor
from contour.contacts import Kind
from contour.frames import Mount
from contour.instrument import ApproachReading, Outcome, Samples, Stroke
from contour.machine import MachineModel, NoiseKey
from contour.sensing import BACK_RANGE, BINS, OUT_RANGE, RunawayWatch, binned, locate, make_touch
from contour.virtual import TrueContact, VirtualAntenna

QUIET = Sensor(moment_noise=1e-15, moment_drift=0.0, encoder_step=1e-15, touch_sigmas=5e10)
"""A sensor that leaves the mechanics alone."""
FREE, AT_REST, PRESSED = 20, 10, 6
"""Samples of a touch made here."""


def _edges(distance, outward):
    n = distance.size
    zero = np.zeros(n)
    return TrueContact(
        distance=distance,
        outward=outward,
        tilt=zero,
        kind=np.full(n, np.int8(Kind.EDGE)),
        radius_along=zero,
        radius_across=np.full(n, np.inf),
        friction=np.full(n, 0.2),
        point=np.zeros((n, 3)),
        normal=np.zeros((n, 3)),
        body=np.zeros(n, dtype=np.int64),
        region=np.full(n, np.int8(-1)),
        extent=np.full(n, np.inf),
        depth=zero,
    )


def _sticking(_contact, _eps, path, _rows):
    return path.copy(), np.full_like(path, np.pi)


def _approaches(antenna, machine, mount, pose, clock, *, slope=0.0):
    """Readings of approaches along the world's x: free air, a press rising by ``slope`` a scan, free again."""
    n = pose.shape[0]
    count = FREE + PRESSED + AT_REST
    stroke = np.repeat(np.int8([Stroke.FREE, Stroke.PRESS, Stroke.REST]), [FREE, PRESSED, AT_REST])
    run = np.repeat(np.arange(n), count)
    time = clock[run] + np.tile(np.arange(count) * 0.01, n)
    weight = antenna.gravity_force(mount.rotation_world_sensor(pose)[:, 2, :])
    moment = np.column_stack((weight[:, 1], -weight[:, 0]))[run] + machine.offset(run, time)
    press = np.concatenate((np.zeros(FREE), slope * np.arange(1, PRESSED + 1), np.zeros(AT_REST)))
    moment[:, 0] += np.tile(press, n)
    return ApproachReading(
        which=np.arange(n),
        outcome=np.full(n, np.int8(Outcome.FOUND)),
        pose=pose,
        direction_world=np.tile([1.0, 0.0, 0.0], (n, 1)),
        travel=np.full(n, 0.01),
        samples=Samples(
            start=np.arange(n + 1) * count,
            time=time,
            angles=pose[run, 3:5],
            moment=moment,
            stroke=np.tile(stroke, n),
        ),
        depth_per_sample=1e-4,
    )


def _touch(antenna, machine, mount, pose, clock, **others):
    n = pose.shape[0]
    return make_touch(
        _approaches(antenna, machine, mount, pose, clock, **others),
        mount,
        expected=np.zeros(n),
        expected_sigma=np.ones(n),
        fresh=np.ones(n, dtype=bool),
    )


def _poses(rng, n):
    joints = np.column_stack((rng.uniform(-np.pi, np.pi, n), np.deg2rad(rng.uniform(-70.0, 70.0, n))))
    return np.column_stack((rng.normal(size=(n, 3)), joints))


def _pushed(rng, n, *, beam, sensor=QUIET, away=False, offset=0.0):
    """Bins of ``n`` pushes on edges from any pose on any mount, and what went in."""
    antenna = Antenna(beam=beam, sensor=sensor)
    machine = MachineModel(sensor=sensor, initial_offset=offset)
    mount = Mount(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))
    pose, clock = _poses(rng, n), rng.uniform(0.0, 500.0, n)
    touch = _touch(antenna, machine, mount, pose, clock)
    phi, distance = rng.uniform(-np.pi, np.pi, n), rng.uniform(0.05, 0.2, n)
    one = np.ones(n, dtype=np.int64)
    reading, _ = VirtualAntenna(antenna, machine, mount, _sticking).push(
        _edges(distance, phi if away else phi - np.pi),
        which=np.arange(n),
        key=NoiseKey(antenna=np.arange(n), approach=one, push=one),
        clock=clock + 0.5,
        joints=pose[:, 3:5],
        phi=phi,
        angle=np.full(n, np.deg2rad(3.0)),
        moment_limit=np.full(n, 1.0),
    )
    bins = binned(reading, touch, antenna, mount)
    force = -antenna.stiffness3 / distance[:, None] * bins.theta
    given = force[..., None] * np.stack((np.cos(phi), np.sin(phi)), axis=1)[:, None, :]
    return bins, np.zeros_like(given) if away else given, machine, mount, pose


# -- bins ----------------------------------------------------------------------------------------------------


def test_bins_give_back_the_force_that_went_in(rng):
    """Out and back, from any pose on any mount: spin and a constant offset are gone, direction and size are left."""
    bins, given, *_ = _pushed(rng, 200, beam=Beam(density=1e-9), offset=100e-6)
    assert np.all(bins.count > 0)
    # The force is linear in theta, so means of both belong together; forces reach 13 mN m.
    np.testing.assert_allclose(bins.force, given, atol=1e-11)


def test_weight_is_taken_out_at_every_orientation(rng):
    """A free beam of default weight reads nothing, wherever it points and whichever way it is turned."""
    bins, _, *_ = _pushed(rng, 200, beam=Beam(), away=True, offset=100e-6)
    # Within a bin of width d the weight is not quite linear in theta: means of its sine differ by up to d^2/12.
    width = np.deg2rad(3.0) / BINS
    np.testing.assert_allclose(bins.force, 0.0, atol=Beam().gravity_moment * width**2 / 12.0)


def test_drift_is_left_in_proportion_to_time_since_the_tare(rng):
    """What the ramp adds after the tare: its rate times ``time``, turned back with the sensor's spin."""
    sensor = Sensor(moment_noise=1e-15, moment_drift=1e-6, encoder_step=1e-15, touch_sigmas=5e10)
    bins, given, *_ = _pushed(rng, 100, beam=Beam(density=1e-9), sensor=sensor, offset=100e-6)
    left = np.linalg.norm(bins.force - given, axis=2)
    assert bins.time.min() > 0.3
    np.testing.assert_allclose(left, np.sqrt(2.0) * 1e-6 * bins.time, rtol=1e-4)


def test_bins_cover_their_strokes(rng):
    """As many of each stroke, in the order made; their means lie within their ranges, and every sample counts once."""
    bins, *_ = _pushed(rng, 20, beam=Beam())
    share = bins.theta / bins.peak[:, None]
    out, back = share[:, :BINS], share[:, BINS:]
    for values, (low, high), sign in ((out, OUT_RANGE, 1.0), (back, BACK_RANGE, -1.0)):
        edges = low + (high - low) * np.arange(BINS + 1) / BINS
        edges = edges if sign > 0.0 else edges[::-1]
        assert np.all(sign * (values - edges[:-1]) >= -1e-12)
        assert np.all(sign * (values - edges[1:]) <= 1e-12)
    assert np.all(np.diff(bins.time, axis=1) > 0.0)
    # 2 deg/s: 3 deg last 1.5 s and the ramps of 35 ms; every sample of the way out lies in some bin.
    assert np.all(np.abs(bins.count[:, :BINS].sum(axis=1) - 153.5) <= 1.0)


def test_up_is_told_in_the_frame_at_touch(rng):
    """Components of the world's up along x_s, z_s and the beam."""
    bins, _, _, mount, pose = _pushed(rng, 30, beam=Beam())
    up = mount.rotation_world_sensor(pose)[:, 2, :]
    np.testing.assert_allclose(bins.up, up[:, [0, 2]], atol=1e-12)
    np.testing.assert_allclose(bins.up_along, up[:, 1], atol=1e-12)


# -- touches -------------------------------------------------------------------------------------------------


def test_touches_tell_zero_rise_and_place(rng):
    """Mean in free air and its time, slope of the press, position of the base in the frame at touch."""
    antenna, n = Antenna(), 25
    machine = MachineModel(sensor=Sensor(moment_drift=0.0))
    mount = Mount(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))
    pose, clock = _poses(rng, n), rng.uniform(0.0, 100.0, n)
    touch = _touch(antenna, machine, mount, pose, clock, slope=40e-6)
    frame = mount.rotation_world_sensor(pose)
    weight = antenna.gravity_force(frame[:, 2, :])
    tare = np.column_stack((weight[:, 1], -weight[:, 0])) + machine.offset(np.arange(n), clock)
    np.testing.assert_allclose(touch.tare, tare, atol=1e-15)
    np.testing.assert_allclose(touch.tare_time, clock + 0.095, atol=1e-9)
    np.testing.assert_array_equal(touch.tare_samples, FREE)
    np.testing.assert_allclose(touch.preload, 0.0, atol=1e-15)
    np.testing.assert_array_equal(touch.preload_samples, AT_REST)
    np.testing.assert_allclose(touch.rise, 40e-6 / 1e-4, rtol=1e-9)
    position = np.einsum("nij,nj->ni", frame.transpose(0, 2, 1), mount.position_world(pose))
    np.testing.assert_allclose(touch.base_in_plane, position[:, [0, 2]], atol=1e-12)
    np.testing.assert_allclose(touch.base_along, position[:, 1], atol=1e-12)
    np.testing.assert_allclose(touch.approach, np.arctan2(frame[:, 0, 2], frame[:, 0, 0]), atol=1e-12)
    np.testing.assert_allclose(touch.approach_share, np.hypot(frame[:, 0, 0], frame[:, 0, 2]), atol=1e-12)
    assert len(touch.take(np.array([4, 2, 4]))) == 3


def test_preload_is_what_rests_on_the_beam():
    """A moment left at rest is the force left there: (s f_x, s f_z) = (-m_z, m_x)."""
    machine, mount = MachineModel(sensor=QUIET, initial_offset=0.0), Mount.identity()
    reading = _approaches(Antenna(), machine, mount, np.zeros((1, 5)), np.zeros(1))
    reading.samples.moment[reading.samples.stroke == Stroke.REST] += (3e-6, -5e-6)
    none = np.zeros(1)
    touch = make_touch(reading, mount, expected=none, expected_sigma=none, fresh=none > 0.0)
    np.testing.assert_allclose(touch.preload, [[5e-6, 3e-6]], atol=1e-15)


# -- places --------------------------------------------------------------------------------------------------


def test_points_lie_a_radius_off_the_beam(rng):
    """The surface is met s along the beam, one radius against the outer normal; normals lie in Pi."""
    antenna, n = Antenna(), 20
    machine = MachineModel(sensor=QUIET)
    mount = Mount(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))
    pose = _poses(rng, n)
    touch = _touch(antenna, machine, mount, pose, np.zeros(n))
    distance, outward = rng.uniform(0.02, 0.2, n), rng.uniform(-np.pi, np.pi, n)
    point, normal = locate(touch, touch.base_in_plane, distance, outward, antenna, mount)
    frame, base = mount.rotation_world_sensor(pose), mount.position_world(pose)
    axis = base + distance[:, None] * frame[:, :, 1]
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.sum(normal * frame[:, :, 1], axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.sum(normal * frame[:, :, 0], axis=1), np.cos(outward), atol=1e-12)
    np.testing.assert_allclose(np.sum(normal * frame[:, :, 2], axis=1), np.sin(outward), atol=1e-12)
    np.testing.assert_allclose(axis - point, antenna.beam.radius * normal, atol=1e-12)


# -- runaways ------------------------------------------------------------------------------------------------


def _watch(n):
    machine, mount = MachineModel(sensor=QUIET, initial_offset=0.0), Mount.identity()
    antenna = Antenna(beam=Beam(density=1e-9))
    touch = _touch(antenna, machine, mount, np.zeros((n, 5)), np.zeros(n))
    return RunawayWatch(touch, np.zeros(n), np.full(n, 0.05), Antenna())


def _chunk(size, psi):
    """Twenty samples of each run with moments of ``size`` (n,) and direction ``psi`` (n,)."""
    n = size.size
    moment = np.repeat(size[:, None] * np.column_stack((np.sin(psi), -np.cos(psi))), 20, axis=0)
    return Samples(
        start=np.arange(n + 1) * 20,
        time=np.zeros(20 * n),
        angles=np.zeros((20 * n, 2)),
        moment=moment,
        stroke=np.full(20 * n, np.int8(Stroke.OUT)),
    )


def test_pushes_that_run_round_the_body_are_stopped():
    """A force that turns by more than 35 deg from where it was first felt ends its push, the others go on."""
    watch, rows = _watch(3), np.arange(3)
    np.testing.assert_array_equal(watch(rows, _chunk(np.full(3, 1e-3), np.full(3, 3.1))), 0.05)
    turned = 3.1 + np.deg2rad([0.0, 30.0, 40.0])
    np.testing.assert_array_equal(watch(rows, _chunk(np.full(3, 2e-3), turned)), [0.05, 0.05, 0.0])
    # Later chunks name the pushes that are left: memory goes by row.
    np.testing.assert_array_equal(
        watch(rows[:2], _chunk(np.full(2, 3e-3), 3.1 - np.deg2rad([40.0, 0.0]))), [0.0, 0.05]
    )


def test_pushes_whose_force_falls_away_are_stopped():
    """A moment that drops to a third of its largest has slipped off."""
    watch, rows, psi = _watch(2), np.arange(2), np.zeros(2)
    np.testing.assert_array_equal(watch(rows, _chunk(np.full(2, 2e-3), psi)), 0.05)
    np.testing.assert_array_equal(watch(rows, _chunk(np.array([0.8e-3, 0.6e-3]), psi)), [0.05, 0.0])


def test_moments_within_the_noise_say_nothing():
    """Directions of moments under twelve sigmas turn as they like, and small peaks may fall."""
    watch, rows = _watch(1), np.arange(1)
    for psi in (0.0, 2.0, -2.0):
        np.testing.assert_array_equal(watch(rows, _chunk(np.array([100e-6]), np.array([psi]))), 0.05)
    np.testing.assert_array_equal(watch(rows, _chunk(np.array([250e-6]), np.zeros(1))), 0.05)
    np.testing.assert_array_equal(watch(rows, _chunk(np.array([20e-6]), np.zeros(1))), 0.05)


def test_watches_judge_against_the_tare():
    """An offset of the sensor is no force, and each push has the tare of its own touch."""
    machine, mount, offset = MachineModel(sensor=QUIET, initial_offset=0.0), Mount.identity(), 500e-6
    reading = _approaches(Antenna(beam=Beam(density=1e-9)), machine, mount, np.zeros((2, 5)), np.zeros(2))
    reading.samples.moment[reading.samples.run == 1] += offset
    none = np.zeros(2)
    touch = make_touch(reading, mount, expected=none, expected_sigma=none, fresh=none > 0.0)
    watch = RunawayWatch(touch, none, np.full(2, 0.05), Antenna())
    for size, psi in ((0.2e-3, 0.0), (0.4e-3, 0.1), (0.6e-3, 0.2)):
        chunk = _chunk(np.array([size]), np.array([psi]))
        chunk.moment[:] += offset
        np.testing.assert_array_equal(watch(np.array([1]), chunk), 0.05)
    swung = _chunk(np.array([0.6e-3]), np.array([np.deg2rad(50.0)]))
    swung.moment[:] += offset
    np.testing.assert_array_equal(watch(np.array([1]), swung), 0.0)
