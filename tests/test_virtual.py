"""The virtual antenna: forces, limits, watches, the beam's weight with a support under it."""

from __future__ import annotations

import numpy as np
import pytest

from contour.antenna import Antenna, Beam, Sensor
from contour.contacts import Kind
from contour.frames import Mount, carried_push
from contour.instrument import Stop, Stroke
from contour.machine import MachineModel, NoiseKey
from contour.virtual import CHUNK, TrueContact, VirtualAntenna

QUIET = Sensor(moment_noise=1e-15, moment_drift=0.0, encoder_step=1e-15, touch_sigmas=5e10)
"""A sensor that leaves the mechanics alone; touch is felt at 50 uN m all the same."""
WEIGHTLESS = Beam(density=1e-9)


def edges(distance, outward=0.0, **others):
    """Contacts with edges at ``distance`` (n,) [m], outer normals at ``outward`` in Pi."""
    distance = np.atleast_1d(np.asarray(distance, dtype=np.float64))
    n = distance.size
    values = {
        "distance": distance,
        "outward": np.broadcast_to(np.asarray(outward, dtype=np.float64), n).copy(),
        "tilt": np.zeros(n),
        "kind": np.full(n, np.int8(Kind.EDGE)),
        "radius_along": np.zeros(n),
        "radius_across": np.full(n, np.inf),
        "friction": np.full(n, 0.18),
        "point": np.zeros((n, 3)),
        "normal": np.zeros((n, 3)),
        "body": np.zeros(n, dtype=np.int64),
        "region": np.full(n, np.int8(-1)),
        "extent": np.full(n, np.inf),
        "depth": np.zeros(n),
    }
    return TrueContact(**{**values, **others})


def sticking(_contact, _eps, path, _rows):
    """Small angles on an edge without slip: |M| s/(3 EI) = theta, the force against the push."""
    return path.copy(), np.full_like(path, np.pi)


def machine_of(sensor, **others):
    """A machine whose sensor has no offset."""
    return MachineModel(sensor=sensor, initial_offset=0.0, **others)


def third_row(up):
    """A rotation whose third row is ``up``: at zero joints that is the world's up in sensor coordinates."""
    up = np.asarray(up, dtype=np.float64)
    first = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    first /= np.linalg.norm(first)
    return np.stack((first, np.cross(up, first), up))


def push(
    contact, phi, angle, *, beam=WEIGHTLESS, sensor=QUIET, up=(1.0, 0.0, 0.0), response=sticking, **others
):
    """Push each contact from joints at zero, the world's up along ``up`` in the sensor's frame; the reading."""
    n = contact.distance.size
    virtual = VirtualAntenna(
        Antenna(beam=beam, sensor=sensor), machine_of(sensor), Mount(third_row(up), np.zeros(3)), response
    )
    which = others.get("which", np.arange(n))
    one = np.ones(n, dtype=np.int64)
    reading, duration = virtual.push(
        contact,
        which=which,
        key=NoiseKey(antenna=which, approach=one, push=one),
        clock=others.get("clock", np.zeros(n)),
        joints=np.zeros((n, 2)),
        phi=np.full(n, phi),
        angle=np.full(n, angle),
        moment_limit=np.full(n, others.get("limit", 0.1)),
        watch=others.get("watch"),
    )
    np.testing.assert_array_equal(reading.which, which)
    assert duration.shape == (n,)
    return reading


def carried(reading):
    """Angle and force of the samples with the spin taken out."""
    run, samples = reading.samples.run, reading.samples
    return carried_push(*samples.angles.T, samples.moment, touch=reading.touch[run], phi=reading.phi[run])


def rows_of(samples, i):
    """The samples of run ``i``."""
    return slice(samples.start[i], samples.start[i + 1])


# -- force ---------------------------------------------------------------------------------------------------


def test_an_edge_answers_with_three_ei_theta_over_s():
    """Out and back, against the push, at every distance."""
    distance, phi = np.array([0.05, 0.1, 0.2]), 2.0
    reading = push(edges(distance, outward=phi - np.pi), phi, np.deg2rad(2.0))
    found = carried(reading)
    size = Antenna().stiffness3 * found.theta / distance[reading.samples.run]
    expected = -size[:, None] * np.array([np.cos(phi), np.sin(phi)])
    # Twelve and more digits in the angles; forces reach 9 mN m.
    np.testing.assert_allclose(found.force, expected, atol=1e-12)
    np.testing.assert_allclose(found.sideways, 0.0, atol=1e-12)


def test_delta_turns_the_force():
    """psi = phi - delta, here 20 deg off the direction against the push."""
    phi, delta = 0.5, np.pi + np.deg2rad(20.0)

    def slipping(_contact, _eps, path, _rows):
        return path.copy(), np.full_like(path, delta)

    force = carried(push(edges([0.1], outward=phi - np.pi), phi, 0.03, response=slipping)).force[20:60]
    turned = np.arctan2(force[:, 1], force[:, 0]) - (phi - delta)
    np.testing.assert_allclose(np.sin(turned), 0.0, atol=1e-9)
    assert np.all(np.cos(turned) > 0.0)


@pytest.mark.parametrize("turn", [0.0, 1.0, np.deg2rad(88.0)])
def test_pushing_away_from_the_body_is_not_felt(turn):
    """No force where the push has no part against the normal; the mechanics are not even asked."""

    def refuse(_contact, _eps, _path, _rows):
        raise AssertionError

    reading = push(edges([0.1], outward=0.7), 0.7 + turn, 0.05, response=refuse)
    np.testing.assert_allclose(reading.samples.moment, 0.0, atol=1e-12)


@pytest.mark.parametrize("depth", [-0.1e-3, 0.1e-3])
def test_a_gap_is_crossed_before_force_is_felt(depth):
    """Backed off by g, an edge at s is met after g/s; pressed in by g, the force is there at the start."""
    s, angle = 0.1, 0.05
    found = carried(push(edges([s], outward=-np.pi, depth=np.array([depth])), 0.0, angle))
    expected = Antenna().stiffness3 / s * np.maximum(found.theta + depth / s, 0.0)
    # The kink at 0.02 of the peak lies between the nodes at 0 and 0.025 or 0.03, where the force is a straight line.
    np.testing.assert_allclose(-found.force[:, 0], expected, atol=Antenna().stiffness3 / s * 0.01 * angle)
    smooth = found.theta > 0.0301 * angle
    np.testing.assert_allclose(-found.force[smooth, 0], expected[smooth], atol=1e-12)


def test_depth_counts_along_the_push():
    """A push off the normal must go 1/cos(eps) as far to cross a gap."""
    s, angle, eps, gap = 0.1, 0.05, np.deg2rad(40.0), 1e-3
    found = carried(push(edges([s], outward=-np.pi, depth=np.array([-gap])), eps, angle))
    expected = Antenna().stiffness3 / s * (found.theta - gap / s / np.cos(eps))
    smooth = found.theta > 0.31 * angle
    np.testing.assert_allclose(np.linalg.norm(found.force[smooth], axis=1), expected[smooth], atol=1e-12)


def test_answers_come_from_the_contacts_they_belong_to():
    """``rows`` number the contacts of the call, those pushed away from left out."""
    distance, seen = np.array([0.1, 0.12, 0.14, 0.16]), []

    def telling(contact, _eps, path, rows):
        seen.append(rows.copy())
        np.testing.assert_array_equal(contact.distance, distance[rows])
        return path * (1.0 + rows[:, None]), np.full_like(path, np.pi)

    outward = np.array([np.pi, 0.0, np.pi, np.pi])
    reading = push(edges(distance, outward=outward), 0.0, 0.03, response=telling, limit=9e-3)
    np.testing.assert_array_equal(seen[0], [0, 2, 3])
    # The last one alone passes 9 mN m, and is asked again for its shorter way.
    np.testing.assert_array_equal(seen[1], [3])
    found = carried(reading)
    for i, gain in enumerate((1.0, 0.0, 3.0, 4.0)):
        rows = rows_of(reading.samples, i)
        expected = -gain * Antenna().stiffness3 / distance[i] * found.theta[rows]
        np.testing.assert_allclose(found.force[rows, 0], expected, atol=1e-12)


def test_bent_answers_are_followed_on_both_strokes():
    """A force that bends with theta, and is less on the way back, is met by the nodes to 3e-4 of its peak."""

    def bent(_contact, _eps, path, _rows):
        back = np.arange(path.shape[1]) > np.argmax(path, axis=1)[:, None]
        return path * (1.0 + 0.1 * path / path.max()) * np.where(back, 0.98, 1.0), np.full_like(path, np.pi)

    reading = push(edges([0.1], outward=np.pi), 0.0, 0.05, response=bent)
    found, back = carried(reading), reading.samples.stroke == Stroke.BACK
    share = found.theta / 0.05
    scale = Antenna().stiffness3 / 0.1 * 0.05
    expected = scale * share * (1.0 + 0.1 * share) * np.where(back, 0.98, 1.0)
    settled = ~back | (
        share < 0.98
    )  # the step at the turning point is spread over the first 2 % of the way back
    # Between nodes 0.1 apart the parabola 0.1 x^2 stands off its chord by 0.1 x 0.1^2/4.
    np.testing.assert_allclose(-found.force[settled, 0], expected[settled], atol=3e-4 * scale)


# -- what the machine adds -----------------------------------------------------------------------------------


def test_readings_do_not_depend_on_company():
    """Samples of an antenna are the same, bit for bit, served alone or with others."""
    contact, clock = edges([0.08, 0.12, 0.17], outward=np.pi), np.array([3.0, 700.0, 12.0])
    common = {"sensor": Sensor(), "beam": Beam(), "limit": 4e-3}
    together = push(contact, 0.0, 0.03, clock=clock, **common)
    assert set(together.stop.tolist()) == {Stop.ANGLE, Stop.MOMENT}
    for i in range(3):
        one = np.array([i])
        alone = push(contact.take(one), 0.0, 0.03, which=one, clock=clock[one], **common)
        rows = rows_of(together.samples, i)
        for name in ("time", "angles", "moment", "stroke"):
            np.testing.assert_array_equal(getattr(alone.samples, name), getattr(together.samples, name)[rows])
        assert alone.angle[0] == together.angle[i]


def test_samples_carry_noise_offset_and_encoder_steps():
    """Moments scatter by the sensor's noise about offset and drift; angles and touch are whole steps."""
    sensor = Sensor()
    machine = MachineModel(sensor=sensor)
    mount = Mount(third_row((0.0, -1.0, 0.0)), np.zeros(3))
    virtual = VirtualAntenna(Antenna(beam=WEIGHTLESS), machine, mount, sticking)
    one = np.ones(1, dtype=np.int64)
    reading, duration = virtual.push(
        edges([0.1], outward=0.0),
        which=one,
        key=NoiseKey(antenna=one, approach=one, push=one),
        clock=np.array([100.0]),
        joints=np.array([[0.1234567, 0.0]]),
        phi=np.zeros(1),
        angle=np.array([0.02]),
        moment_limit=np.ones(1),
    )
    samples = reading.samples
    assert samples.time[0] == pytest.approx(100.01)
    assert samples.time[-1] == pytest.approx(100.0 + duration[0])
    # Pushed away from the body, nothing but offset and noise is read.
    rest = samples.moment - machine.offset(np.ones(samples.time.size, np.int64), samples.time)
    assert rest.std() == pytest.approx(sensor.moment_noise, rel=4.0 / np.sqrt(2 * rest.size))
    assert np.abs(rest.mean(axis=0)).max() < 4.0 * sensor.moment_noise / np.sqrt(samples.time.size)
    steps = np.vstack((samples.angles, reading.touch)) / sensor.encoder_step
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


# -- stopping ------------------------------------------------------------------------------------------------


def test_the_moment_limit_turns_the_push_back():
    """Where 3 EI theta/s would pass the limit the push ends there and says so; others reach their angle."""
    distance, limit, angle = np.array([0.05, 0.2]), 5e-3, np.deg2rad(3.0)
    reading = push(edges(distance, outward=np.pi), 0.0, angle, limit=limit)
    np.testing.assert_array_equal(reading.stop, [Stop.MOMENT, Stop.ANGLE])
    assert reading.angle[0] == pytest.approx(limit * 0.05 / Antenna().stiffness3, rel=1e-9)
    assert reading.angle[1] == angle
    for i, peak in enumerate((limit, Antenna().stiffness3 * angle / 0.2)):
        rows = rows_of(reading.samples, i)
        assert np.linalg.norm(reading.samples.moment[rows], axis=1).max() == pytest.approx(peak, rel=1e-6)


def test_a_watch_sees_the_out_stroke_in_fixed_chunks():
    """Every sample of the out stroke once and in order, twenty at a time; nothing changes if it lets go on."""
    contact, seen = edges([0.1, 0.15], outward=np.pi), {0: [], 1: []}

    def look(rows, chunk):
        for place, row in enumerate(rows.tolist()):
            seen[row].append(chunk.time[chunk.start[place] : chunk.start[place + 1]])
        return np.full(rows.size, 0.03)

    watched = push(contact, 0.0, 0.03, sensor=Sensor(), watch=look)
    plain = push(contact, 0.0, 0.03, sensor=Sensor())
    np.testing.assert_array_equal(watched.samples.moment, plain.samples.moment)
    np.testing.assert_array_equal(watched.stop, [Stop.ANGLE, Stop.ANGLE])
    for i in range(2):
        rows = rows_of(plain.samples, i)
        out = plain.samples.time[rows][plain.samples.stroke[rows] == Stroke.OUT]
        np.testing.assert_array_equal(np.concatenate(seen[i]), out)
        assert {part.size for part in seen[i][:-1]} == {CHUNK}


def test_a_watch_stops_a_push_early_and_leaves_the_past_alone():
    """It turns back after the brake's way; what was shown stays, and the other push is the same bit for bit."""
    contact, sensor = edges([0.1, 0.15], outward=np.pi), Sensor()
    shown = []

    def stop_first(rows, chunk):
        shown.append(chunk)
        return np.where((rows == 0) & (len(shown) == 3), 0.0, 0.05)

    watched = push(contact, 0.0, 0.05, sensor=sensor, watch=stop_first)
    plain = push(contact, 0.0, 0.05, sensor=sensor)
    np.testing.assert_array_equal(watched.stop, [Stop.WATCH, Stop.ANGLE])
    other, same = rows_of(watched.samples, 1), rows_of(plain.samples, 1)
    np.testing.assert_array_equal(watched.samples.moment[other], plain.samples.moment[same])
    past = slice(0, 3 * CHUNK)
    # The ramps are computed anew from another duration: rounding, and no step of an encoder.
    np.testing.assert_allclose(watched.samples.moment[past], plain.samples.moment[past], atol=1e-12)
    np.testing.assert_allclose(watched.samples.angles[past], plain.samples.angles[past], atol=1e-12)
    reached = np.linalg.norm(plain.samples.angles[3 * CHUNK - 1])
    machine = machine_of(sensor)
    brake = machine.push_speed**2 / (2.0 * machine.turn_acceleration)
    assert watched.angle[0] == pytest.approx(reached + brake, abs=sensor.encoder_step)
    out = np.count_nonzero(watched.samples.stroke[rows_of(watched.samples, 0)] == Stroke.OUT)
    assert 3 * CHUNK <= out <= 3 * CHUNK + np.ceil(100.0 * machine.push_speed / machine.turn_acceleration) + 1
    np.testing.assert_array_equal([chunk.start.size - 1 for chunk in shown[:4]], [2, 2, 2, 1])


def test_a_watch_may_shorten_a_push_without_stopping_it_at_once():
    """An angle not yet passed is where the push turns back."""
    reading = push(edges([0.1], outward=np.pi), 0.0, 0.05, watch=lambda rows, _: np.full(rows.size, 0.031))
    assert reading.angle[0] == pytest.approx(0.031, rel=1e-12)
    assert reading.stop[0] == Stop.WATCH
    assert np.linalg.norm(reading.samples.angles, axis=1).max() == pytest.approx(0.031, rel=1e-9)


# -- weight --------------------------------------------------------------------------------------------------


def _base_moment(beam, load, support, points=841):
    """Base moment [N m] of a beam clamped at 0, under ``load`` [N/m], held at ``support`` [m]: differences.

    EI d^4 w = load on a grid with a node before the clamp and two after the free end; at the support w = 0
    takes the place of the equation.
    """
    step = beam.length / (points - 1)
    n = points + 3  # node i lies at (i - 1) step
    held, last = round(support / step) + 1, points
    matrix, right = np.zeros((n, n)), np.zeros(n)
    matrix[0, 1] = 1.0
    matrix[1, [0, 2]] = -1.0, 1.0
    matrix[2, last - 1 : last + 2] = 1.0, -2.0, 1.0
    matrix[3, [last - 2, last - 1, last + 1, last + 2]] = -1.0, 2.0, -2.0, 1.0
    for i in range(2, last + 1):
        matrix[i + 2, i - 2 : i + 3] = 1.0, -4.0, 6.0, -4.0, 1.0
        right[i + 2] = load * step**4 / beam.stiffness
    matrix[held + 2], right[held + 2] = 0.0, 0.0
    matrix[held + 2, held] = 1.0
    w = np.linalg.solve(matrix, right)
    return beam.stiffness * (w[2] - 2.0 * w[1] + w[0]) / step**2


@pytest.mark.parametrize("s", [0.05, 0.1, 0.2])
def test_the_support_takes_its_share_of_the_weight(s):
    """A hanging wire turned while an edge holds it: the change of its weight bends it clamped and supported."""
    angle, up = 0.04, (0.0, -1.0, 0.0)
    contact = edges([s], outward=np.pi)
    heavy, light = (carried(push(contact, 0.0, angle, beam=beam, up=up)) for beam in (Beam(), WEIGHTLESS))
    extra = heavy.force[:, 0] - light.force[:, 0]
    # Turned towards +x_s, the hanging beam weighs towards -x_s, by w sin(theta) a length.
    expected = _base_moment(Beam(), -Beam().line_weight * np.sin(angle), s)
    # The grid's error is of the order (step/s)^2, 2.5e-5, times a few.
    np.testing.assert_allclose(
        extra, expected * np.sin(heavy.theta) / np.sin(angle), atol=3e-4 * abs(expected), rtol=0.0
    )


@pytest.mark.parametrize("s,bias", [(0.2, 0.0031), (0.05, -0.0009)])
def test_weight_biases_the_slope_of_a_push(s, bias):
    """w (-L^2/4 + L s/2 - s^2/8)/(3 EI/s) for a hanging wire: +0.31 % at 200 mm, -0.09 % at 50 mm."""
    contact, up = edges([s], outward=np.pi), (0.0, -1.0, 0.0)
    heavy, light = (carried(push(contact, 0.0, 0.02, beam=beam, up=up)) for beam in (Beam(), WEIGHTLESS))
    peak = np.argmax(heavy.theta)
    assert heavy.force[peak, 0] / light.force[peak, 0] - 1.0 == pytest.approx(bias, abs=5e-5)


def test_a_free_beam_reads_its_weight_alone():
    """Pushed away from the body, the moments are those of the weight at each pose, without any support."""
    up = np.array([0.48, 0.6, 0.64])
    found = carried(push(edges([0.1], outward=0.3), 0.3, 0.05, beam=Beam(), up=up))
    push_way, aside = np.array([np.cos(0.3), np.sin(0.3)]), np.array([-np.sin(0.3), np.cos(0.3)])
    # The carried axis along the push is cos(theta) e - sin(theta) y; the one aside stays.
    now = (up[[0, 2]] @ push_way) * np.cos(found.theta) - up[1] * np.sin(found.theta)
    weight = now[:, None] * push_way + (up[[0, 2]] @ aside) * aside
    np.testing.assert_allclose(found.force, -Beam().gravity_moment * weight, atol=1e-12)


def test_taking_contacts_takes_every_field():
    """Rows in another order."""
    taken = edges([0.1, 0.2, 0.3], outward=[1.0, 2.0, 3.0]).take(np.array([2, 0]))
    np.testing.assert_array_equal(taken.distance, [0.3, 0.1])
    np.testing.assert_array_equal(taken.outward, [3.0, 1.0])
    assert taken.point.shape == (2, 3)
