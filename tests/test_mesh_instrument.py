"""Antennas on a mesh scene: how approaches end, what is refused, readings that depend on nobody else."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from contour.antenna import Antenna
from contour.contacts import Kind
from contour.errors import InstrumentError
from contour.frames import Mount
from contour.instrument import Outcome, Stroke
from contour.ladder import Rung
from contour.machine import REST_SAMPLES, MachineModel
from contour.mesh_env import MeshEnvironment
from contour.mesh_instrument import MeshInstrument

ANTENNA = Antenna()
RADIUS = ANTENNA.beam.radius
HALF = 0.02
"""Half the edge of the box [m]."""
BALL = 0.05
"""Radius of the ball [m]."""
X, Y, Z = np.eye(3)


def _box(centre=(0.0, 0.0, 0.0)):
    box = trimesh.creation.box(extents=[2.0 * HALF] * 3)
    box.apply_translation(centre)
    return box


def _ball():
    return trimesh.creation.icosphere(subdivisions=5, radius=BALL)


@pytest.fixture(scope="module")
def box():
    """A box of 40 mm about the origin."""
    return MeshEnvironment(_box(), friction=0.2)


@pytest.fixture(scope="module")
def ball():
    """A ball of radius 50 mm about the origin."""
    return MeshEnvironment(_ball(), friction=0.2)


def _instrument(environment, n=1, mount=None, **others):
    return MeshInstrument(
        environment,
        antennas=n,
        antenna=ANTENNA,
        machine=MachineModel(),
        mount=mount or Mount.identity(),
        **others,
    )


def _pose(*rows):
    """Poses with the beam along +y: (X, Y, Z, 0, 0)."""
    return np.column_stack((np.array(rows), np.zeros((len(rows), 2))))


def _approach(instrument, pose, direction, travel=0.1, which=None):
    n = len(pose)
    which = np.arange(n) if which is None else which
    return instrument.approach(which, pose, np.tile(direction, (n, 1)), np.full(n, travel))


def _push(instrument, which, phi, angle=0.03, limit=15e-3):
    n = len(which)
    return instrument.push(which, np.full(n, phi), np.full(n, angle), moment_limit=np.full(n, limit))


# -- how approaches end --------------------------------------------------------------------------------------


def test_a_face_is_touched_a_radius_before_it(box):
    """A beam parallel to a face lies along it; what is felt is the edge nearest the base, 80 mm away."""
    instrument = _instrument(box)
    reading = _approach(instrument, _pose([-0.06, -0.1, 0.003]), X)
    truth, _ = instrument.true_contacts(np.arange(1))
    assert reading.outcome[0] == Outcome.FOUND
    assert truth.kind[0] == Kind.LINE
    # Up to first touch the way is exact; the rest depth is told apart.
    assert reading.travel[0] - truth.depth[0] == pytest.approx(0.06 - HALF - RADIUS, abs=1e-9)
    np.testing.assert_allclose(reading.pose[0, :3], [-0.06 + reading.travel[0], -0.1, 0.003], atol=1e-12)
    assert truth.distance[0] == pytest.approx(0.1 - HALF, abs=1e-6)
    np.testing.assert_allclose(truth.normal[0], -X, atol=1e-9)
    assert abs(abs(truth.outward[0]) - np.pi) < 1e-9
    assert truth.radius_across[0] == np.inf


@pytest.mark.parametrize("height", [0.0, 0.02, -0.035])
def test_a_ball_is_touched_where_geometry_says(ball, height):
    """An axis that passes at ``height`` touches where its distance from the centre is the sum of the radii."""
    instrument, s = _instrument(ball), 0.12
    reading = _approach(instrument, _pose([-0.08, -s, height]), X)
    truth, _ = instrument.true_contacts(np.arange(1))
    # 20,000 faces: the mesh lies up to 25 um inside the ball, most of which the smooth surface makes good.
    first = 0.08 - np.sqrt((BALL + RADIUS) ** 2 - height**2)
    angle = np.arctan2(height, -np.sqrt((BALL + RADIUS) ** 2 - height**2))
    facing = -np.cos(angle)
    assert reading.travel[0] - truth.depth[0] / facing == pytest.approx(first, abs=10e-6)
    assert truth.kind[0] == Kind.SIDE
    assert truth.distance[0] == pytest.approx(s, abs=1e-3)
    assert np.cos(truth.outward[0] - angle) > np.cos(np.deg2rad(0.3))
    # The beam's axis runs on the ball's surface offset by the beam's radius.
    assert truth.radius_along[0] == pytest.approx(BALL + RADIUS, rel=0.02)
    assert truth.radius_across[0] == pytest.approx(BALL + RADIUS, rel=0.02)
    np.testing.assert_allclose(np.linalg.norm(truth.point[0]), BALL, atol=30e-6)


def test_the_end_of_the_beam_touches_as_a_tip(ball):
    """A beam that ends over the ball touches with its tip: s is the length, the normal leans out of Pi."""
    instrument = _instrument(ball)
    length = ANTENNA.beam.length
    reading = _approach(instrument, _pose([0.0, -length - 0.02, 0.08]), -Z)
    truth, _ = instrument.true_contacts(np.arange(1))
    assert reading.outcome[0] == Outcome.FOUND
    assert truth.kind[0] == Kind.TIP
    assert truth.distance[0] == length
    lean = np.arcsin(0.02 / BALL)  # the tip meets the ball 20 mm before its middle, where it faces the base
    assert truth.tilt[0] == pytest.approx(lean, abs=np.deg2rad(1.0))
    assert truth.outward[0] == pytest.approx(np.pi / 2, abs=np.deg2rad(0.5))


def test_a_miss_ends_at_the_end_of_the_travel(box):
    """No touch within the travel: the antenna stands there, nothing was sampled, time has passed."""
    instrument = _instrument(box)
    reading = _approach(instrument, _pose([-0.06, -0.1, 0.0]), X, travel=0.03)
    assert reading.outcome[0] == Outcome.NOT_FOUND
    assert not reading.touched[0]
    assert reading.samples.time.size == 0
    np.testing.assert_allclose(reading.pose[0], [-0.03, -0.1, 0, 0, 0], atol=1e-12)
    assert instrument.machine_time[0] == pytest.approx(0.03 / 0.010)


def test_a_start_inside_a_body_is_told_and_left(box):
    """Turned round into a body: the antenna is back where it was free, and nothing was sampled."""
    instrument = _instrument(box)
    free = np.array([[0.0, 0.1, 0.0, 0.0, 0.0]])  # the beam leads away from the box
    _approach(instrument, free, Z, travel=0.001)
    reading = _approach(instrument, np.array([[0.0, 0.1, 0.0, np.pi, 0.0]]), X)
    assert reading.outcome[0] == Outcome.TOUCHING
    assert not reading.touched[0]
    assert reading.samples.time.size == 0
    np.testing.assert_allclose(reading.pose, free + np.array([[0.0, 0.0, 0.001, 0.0, 0.0]]), atol=1e-12)


def test_a_body_in_the_way_blocks_the_move_to_the_start(box):
    """The antenna stands at the edge of touch with what was in the way, and says along which motion."""
    instrument = _instrument(box)
    _approach(instrument, _pose([-0.06, -0.1, 0.0]), -X, travel=0.01)
    reading = _approach(instrument, _pose([0.06, -0.1, 0.0]), -X)
    assert reading.outcome[0] == Outcome.BLOCKED
    assert reading.touched[0]
    np.testing.assert_allclose(reading.direction_world[0], X, atol=1e-12)
    truth, _ = instrument.true_contacts(np.arange(1))
    assert reading.pose[0, 0] - truth.depth[0] == pytest.approx(-HALF - RADIUS, abs=1e-9)
    np.testing.assert_allclose(truth.normal[0], -X, atol=1e-9)
    assert np.all(np.diff(reading.samples.time) > 0.0)


def test_the_nearest_body_is_met_with_its_own_friction():
    """Two boxes in a row, each with its coefficient."""
    scene = trimesh.Scene([_box(), _box((0.1, 0.0, 0.0))])
    instrument = _instrument(MeshEnvironment(scene, friction=[0.1, 0.4]), 2)
    reading = instrument.approach(
        np.arange(2), _pose([-0.06, -0.1, 0.0], [0.16, -0.1, 0.0]), np.array([X, -X]), np.full(2, 0.1)
    )
    np.testing.assert_array_equal(reading.outcome, Outcome.FOUND)
    truth, _ = instrument.true_contacts(np.arange(2))
    np.testing.assert_array_equal(truth.body, [0, 1])
    np.testing.assert_allclose(truth.friction, [0.1, 0.4])


def test_contacts_move_with_scene_and_mount(rng):
    """Scene, base and directions turned and shifted together: the same s, depth and angle in Pi."""
    turn, shift = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = turn, shift
    moved = _box()
    moved.apply_transform(place)
    pose = _pose([-0.06, -0.1, 0.013])
    found = []
    for mesh, mount, way in ((_box(), Mount.identity(), X), (moved, Mount(turn, shift), turn @ X)):
        instrument = _instrument(MeshEnvironment(mesh, friction=0.2), mount=mount)
        reading = _approach(instrument, pose, way)
        found.append((reading.pose, instrument.true_contacts(np.arange(1))[0]))
    (ends, truth), (same_ends, same) = found
    np.testing.assert_allclose(same_ends, ends, atol=1e-9)
    assert same.distance[0] == pytest.approx(truth.distance[0], abs=1e-9)
    assert np.cos(same.outward[0] - truth.outward[0]) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(same.point[0], turn @ truth.point[0] + shift, atol=1e-9)


# -- readings of a touch -------------------------------------------------------------------------------------


def test_the_press_rises_with_the_stiffness_of_an_edge(box):
    """|M| grows by 3 EI/s^2 for each metre, against the approach; before it only offset and weight are read."""
    instrument = _instrument(box)
    reading = _approach(instrument, _pose([-0.06, -0.1, 0.0]), X)
    samples = reading.samples
    free = samples.moment[samples.stroke == Stroke.FREE]
    press = samples.moment[samples.stroke == Stroke.PRESS] - free.mean(axis=0)
    # The force on the beam points to -x, a moment +m_z of s f: (13)-(14) of Kaneko1998.
    rise = np.diff(press[:, 1])
    slope = ANTENNA.stiffness3 / 0.08**2 * reading.depth_per_sample
    assert rise.mean() == pytest.approx(slope, abs=4.0 * 10e-6 * np.sqrt(2.0) / rise.size)
    offset = MachineModel().offset(np.zeros(1, np.int64), samples.time[:1])
    expected = offset[0] - np.array([ANTENNA.beam.gravity_moment, 0.0])
    np.testing.assert_allclose(free.mean(axis=0), expected, atol=4.0 * 10e-6 / np.sqrt(len(free)) + 1e-6)
    assert np.count_nonzero(samples.stroke == Stroke.REST) == REST_SAMPLES


def test_clocks_run_through_moves_touch_and_push(box):
    """Times of a pass are in order, and the machine time covers them."""
    instrument = _instrument(box)
    which = np.arange(1)
    touch = _approach(instrument, _pose([-0.06, -0.1, 0.0]), X)
    at_touch = instrument.machine_time[0]
    assert at_touch == pytest.approx(touch.samples.time[-1], abs=0.011)
    pushed = _push(instrument, which, 0.0)
    assert pushed.samples.time[0] == pytest.approx(at_touch + 0.01)
    assert instrument.machine_time[0] == pytest.approx(pushed.samples.time[-1])
    instrument.release(which, np.full(1, 0.005))
    zero = instrument.zero(which)
    assert instrument.machine_time[0] > zero.time[0] > pushed.samples.time[-1]


def test_release_goes_back_along_the_approach(ball):
    """By the clearance, with the same joints, into free air."""
    instrument = _instrument(ball)
    way = np.array([0.6, 0.0, -0.8])
    reading = _approach(instrument, _pose([-0.06, -0.12, 0.06]), way)
    assert reading.outcome[0] == Outcome.FOUND
    pose = instrument.release(np.arange(1), np.full(1, 0.004))
    np.testing.assert_allclose(pose[0, :3], reading.pose[0, :3] - 0.004 * way, atol=1e-12)
    np.testing.assert_array_equal(pose[0, 3:], reading.pose[0, 3:])


def test_zero_is_the_offset_and_weight_at_its_pose(box):
    """Half a second of averaging: within four of the deviations that it claims."""
    instrument = _instrument(box, 50)
    pose = _pose(*([[-0.06, -0.3, 0.0]] * 50))
    _approach(instrument, pose, -X, travel=0.001)
    zero = instrument.zero(np.arange(50))
    expected = MachineModel().offset(np.arange(50), zero.time) - np.array([ANTENNA.beam.gravity_moment, 0.0])
    off = (zero.moment - expected) / zero.sigma[:, None]
    np.testing.assert_allclose(zero.sigma, 10e-6 / np.sqrt(50.0))
    # 100 normal numbers: their deviation scatters by 1/sqrt(200), the largest stays under 4.5.
    assert off.std() == pytest.approx(1.0, abs=4.0 / np.sqrt(200.0))
    assert np.abs(off).max() < 4.5


def test_what_needs_another_state_is_refused(box):
    """No zero while touching or without a pose, no push in free air; the message says what to do first."""
    instrument, which = _instrument(box), np.arange(1)
    with pytest.raises(
        InstrumentError, match="zero asked for before any approach: give the antenna a pose first"
    ):
        instrument.zero(which)
    with pytest.raises(InstrumentError, match="push asked for in free air: approach first"):
        _push(instrument, which, 0.0)
    _approach(instrument, _pose([-0.06, -0.1, 0.0]), X)
    with pytest.raises(InstrumentError, match="zero asked for while touching: release the antenna first"):
        instrument.zero(which)
    instrument.release(which, np.full(1, 0.001))
    with pytest.raises(InstrumentError, match="approach first"):
        _push(instrument, which, 0.0)


# -- company -------------------------------------------------------------------------------------------------


def _bits(reading):
    return {f.name: getattr(reading, f.name) for f in fields(reading)}


def test_readings_do_not_depend_on_which_others_are_served(ball):
    """Three antennas served together, or one by one in another order: the same readings bit for bit."""
    pose = _pose([-0.08, -0.12, 0.0], [-0.08, -0.1, 0.02], [-0.08, -0.15, -0.03])
    together = _instrument(ball, 3)
    touched = _approach(together, pose, X)
    pushed = _push(together, np.arange(3), 0.1)
    again = _push(together, np.arange(3), -0.1)
    apart = _instrument(ball, 3)
    for i in (2, 0, 1):
        one = np.array([i])
        alone = _approach(apart, pose[one], X, which=one)
        pairs = [(alone, touched.take(one))]
        for phi, both in ((0.1, pushed), (-0.1, again)):
            reading = _push(apart, one, phi)
            assert reading.angle[0] == both.angle[i]
            pairs.append((reading.samples, both.samples.take(one)))
        pairs.append((alone.samples, touched.samples.take(one)))
        for first, second in pairs:
            for name, value in _bits(first).items():
                if isinstance(value, np.ndarray):
                    np.testing.assert_array_equal(value, getattr(second, name))
    np.testing.assert_array_equal(apart.machine_time, together.machine_time)


def test_every_touch_and_push_has_noise_of_its_own(box):
    """The same contact approached twice, and pushed twice the same way, is read with other noise each time."""
    instrument, pose = _instrument(box), _pose([-0.06, -0.1, 0.0])
    touches, pushes = [], []
    for _ in range(2):
        touches.append(_approach(instrument, pose, X).samples.moment[:20])
        pushes += [_push(instrument, np.arange(1), 0.0, angle=0.02).samples.moment[:60] for _ in range(2)]
        instrument.release(np.arange(1), np.full(1, 0.03))
    # Equal noise would leave the drift, less than 0.1 uN m within these samples; other noise leaves sqrt(2) x 10 uN m.
    assert np.std(touches[1] - touches[0], axis=0).min() > 5e-6
    for i in range(3):
        assert np.std(pushes[i + 1] - pushes[i], axis=0).min() > 5e-6


# -- forward models ------------------------------------------------------------------------------------------


def test_one_scene_uses_two_rungs():
    """A box's edge is answered by the closed forms, a ball beside it by the reduced rod; each is counted apart."""
    ball = _ball()
    ball.apply_translation([0.5, 0.0, 0.0])
    environment = MeshEnvironment(trimesh.Scene([_box(), ball]), friction=0.2)
    instrument = _instrument(environment, 3)
    pose = _pose([-0.06, -0.1, 0.0], [0.42, -0.12, 0.0], [-0.06, -0.13, 0.0])
    _approach(instrument, pose, X)
    instrument.push(
        np.arange(3),
        np.array([0.0, 0.0, np.pi]),
        np.full(3, 0.03),
        moment_limit=np.array([15e-3, 1e-3, 15e-3]),
    )
    _, rung = instrument.true_contacts(np.arange(3))
    # The third pushes away from the body: no model is asked.
    np.testing.assert_array_equal(rung, [Rung.EDGE, Rung.REDUCED, -1])
    # Who is then pushed away from the body keeps the rung of the push that was felt.
    _push(instrument, np.array([1, 0]), np.pi)
    np.testing.assert_array_equal(instrument.true_contacts(np.arange(3))[1], [Rung.EDGE, Rung.REDUCED, -1])
    assert instrument.unconverged == 0


def test_a_push_past_the_end_of_a_face_follows_the_silhouette(box):
    """1 mm from the face's end, pushed 40 deg off the normal: the rung is the profile's, and the force turns."""
    answers = {}
    for rung in ("auto", "reduced"):
        instrument = _instrument(box, 2, rung=rung)
        _approach(instrument, _pose([-0.06, -0.1, 0.019], [-0.06, -0.1, 0.0]), X)
        both = _push(instrument, np.arange(2), np.deg2rad(40.0), angle=0.06, limit=25e-3)
        answers[rung] = both.samples.take(np.array([0]))
        used = instrument.true_contacts(np.arange(2))[1]
        np.testing.assert_array_equal(used, [Rung.PROFILE if rung == "auto" else Rung.REDUCED, Rung.REDUCED])
    out = answers["auto"].stroke == Stroke.OUT
    peak = np.flatnonzero(out)[-1]
    difference = answers["auto"].moment[peak] - answers["reduced"].moment[peak]
    assert np.linalg.norm(difference) > 0.5e-3
