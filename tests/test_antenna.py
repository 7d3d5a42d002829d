"""Beam, sensor and antenna: stiffness, weight, sag, adaptor, limits."""

from __future__ import annotations

import numpy as np
import pytest

from contour.antenna import GRAVITY, Antenna, Beam, Sensor
from contour.errors import UsageError


def _cantilever(beam, load, points=4001):
    """Deflection (points,) of the clamped beam under ``load(x)`` [N/m], by quadrature four times over."""
    x = np.linspace(0.0, beam.length - beam.adaptor, points)
    step = x[1] - x[0]

    def integral(values):
        return np.concatenate(([0.0], np.cumsum(0.5 * step * (values[1:] + values[:-1]))))

    shear = integral(load(x))[-1] - integral(load(x))
    moment = integral(shear)[-1] - integral(shear)
    return x, integral(integral(moment / beam.stiffness))


def test_default_wire_is_the_one_of_the_paper():
    """EI = 4.14e-3 N m^2, yield at 30 mN m, a horizontal wire hangs by 1.08 % of L and weighs 854 uN m."""
    beam = Beam()
    assert beam.stiffness == pytest.approx(4.14e-3, rel=1e-3)
    assert beam.yield_moment == pytest.approx(30e-3, rel=6e-3)  # pi d^3 sigma/32 = 30.16 mN m
    assert beam.sag / beam.length == pytest.approx(0.0108, abs=5e-5)
    assert beam.gravity_moment == pytest.approx(854e-6, rel=1e-3)


@pytest.mark.parametrize("adaptor", [0.0, 0.03])
def test_sag_is_that_of_a_loaded_cantilever(adaptor):
    """sag and sag_at solve EI w'''' = q, clamped at the adaptor's end."""
    beam = Beam(adaptor=adaptor)
    x, deflection = _cantilever(beam, lambda x: np.full_like(x, beam.line_weight))
    # Trapezoids on 4000 intervals are good to about 1/4000^2.
    np.testing.assert_allclose(beam.sag_at(x + adaptor), deflection, atol=1e-6 * beam.sag)
    assert beam.sag == pytest.approx(deflection[-1], rel=1e-6)
    assert beam.sag_at(0.5 * adaptor) == 0.0


def test_printed_sag_is_pi_times_too_large():
    """(43) prints 8 rho g L^4/(E d^4) with rho per length; the right one is 1/pi of it."""
    beam = Beam()
    per_length = beam.line_weight / GRAVITY
    printed = 8.0 * per_length * GRAVITY * beam.length**4 / (beam.youngs_modulus * beam.diameter**4)
    assert printed / beam.sag == pytest.approx(np.pi, rel=1e-12)


def test_gravity_moment_is_taken_about_the_centre_of_rotation():
    """The wire beyond the adaptor, each piece with its own arm."""
    beam = Beam(adaptor=0.05)
    y = np.linspace(0.05, beam.length, 20001)
    mean = 0.5 * (y[1:] + y[:-1])
    assert beam.gravity_moment == pytest.approx(beam.line_weight * np.sum(mean * np.diff(y)), rel=1e-9)


def test_gravity_force_has_the_signs_of_a_weight():
    """m = y x f for f = -w up, integrated along the beam."""
    antenna, up = Antenna(), np.array([[0.3, 0.5, -0.8], [1.0, 0.0, 0.0]])
    y = np.linspace(0.0, antenna.beam.length, 20001)
    mean = 0.5 * (y[1:] + y[:-1])
    piece = np.diff(y)
    for row, force in zip(up, antenna.gravity_force(up), strict=True):
        arm = np.outer(mean, [0.0, 1.0, 0.0])
        moment = np.cross(arm, -antenna.beam.line_weight * row * piece[:, None]).sum(axis=0)
        np.testing.assert_allclose(force, [-moment[2], moment[0]], rtol=1e-9)


def test_hanging_wire_reads_15_micro_newton_metres_per_degree():
    """Why a tare holds only near its pose."""
    antenna, turn = Antenna(), np.deg2rad(1.0)
    hanging = antenna.gravity_force(np.array([0.0, -1.0, 0.0]))
    turned = antenna.gravity_force(np.array([np.sin(turn), -np.cos(turn), 0.0]))
    assert np.linalg.norm(turned - hanging) == pytest.approx(15e-6, rel=0.01)


@pytest.mark.parametrize("adaptor", [0.0, 0.02])
def test_compliance_of_an_edge_is_that_of_a_beam_with_a_stub(adaptor):
    """A force f at s bends the wire beyond the stub; turning the base by theta takes that back by s theta."""
    antenna, s, force = Antenna(beam=Beam(adaptor=adaptor)), 0.12, 0.01
    deflection = force * (s - adaptor) ** 3 / (3.0 * antenna.beam.stiffness)
    assert antenna.compliance(s) == pytest.approx(deflection / s / (force * s), rel=1e-12)


@pytest.mark.parametrize("adaptor", [0.0, 1e-6, 0.02, 0.1])
def test_distance_inverts_compliance(adaptor):
    """Every distance beyond the stub comes back; a cubic with one root there."""
    antenna = Antenna(beam=Beam(adaptor=adaptor))
    s = np.linspace(adaptor + 2e-3, 0.5, 400)
    # Close to the stub's end compliance falls as (s - a)^3, and digits with it.
    np.testing.assert_allclose(antenna.distance(antenna.compliance(s)), s, rtol=1e-9)


def test_compliance_with_an_adaptor_is_not_proportional_to_distance():
    """The bend of the paper's Fig. 6: doubling s more than doubles C."""
    antenna = Antenna(beam=Beam(adaptor=0.03))
    assert antenna.compliance(0.2) > 2.2 * antenna.compliance(0.1)
    assert Antenna().compliance(0.2) == pytest.approx(2.0 * Antenna().compliance(0.1), rel=1e-12)


def test_touch_is_felt_at_five_sigmas():
    """5 x 10 uN m."""
    assert Sensor().touch_moment == pytest.approx(50e-6, rel=1e-12)


@pytest.mark.parametrize(
    "make,message",
    [
        (lambda: Beam(length=0.0), "antenna length is 0.0: it must be a finite number above zero"),
        (lambda: Beam(diameter=np.nan), "antenna diameter is nan"),
        (lambda: Beam(youngs_modulus=np.inf), "antenna youngs_modulus is inf"),
        (lambda: Beam(adaptor=0.3), "adaptor is 300 mm: it must be at least 0 and shorter"),
        (lambda: Beam(adaptor=-0.001), "adaptor is -1 mm"),
        (lambda: Sensor(moment_noise=0.0), "antenna moment_noise is 0.0"),
        (lambda: Sensor(moment_drift=-1e-6), "antenna moment_drift is -1e-06: it must be zero or more"),
        (lambda: Antenna(moment_limit=40e-3), "40 mN m is above the yield moment 30.2 mN m: lower it"),
        (lambda: Antenna(moment_limit=-1.0), "antenna moment_limit is -1.0"),
        (
            lambda: Antenna(sensor=Sensor(moment_noise=2e-3)),
            "it would yield before contact is felt; use a thicker",
        ),
    ],
)
def test_impossible_antennas_are_refused_in_one_line(make, message):
    """The line names the number, its value and the remedy."""
    with pytest.raises(UsageError) as refusal:
        make()
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)
