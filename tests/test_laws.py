"""The closed forms: each law against what it was derived from."""

import numpy as np
import pytest
from scipy.optimize import brentq

from contour import contact
from contour.antenna import Antenna, Beam
from contour.errors import UsageError

EI = 4.142e-3  # [N m^2], the default beam


def test_force_direction_inverts_the_moment_of_a_force(rng):
    """psi is the angle, from +x_s to +z_s, of the force whose moment about the base is measured."""
    psi = rng.uniform(-np.pi, np.pi, 50)
    force = np.stack((np.cos(psi), np.zeros(50), np.sin(psi)), axis=-1)
    moment = np.cross([0.0, 0.1, 0.0], force)
    assert np.allclose(contact.force_direction(moment[:, 0], moment[:, 2]), psi, atol=1e-12)


def test_compliance_without_adaptor_is_proportional_to_distance():
    """(7): s = 3 EI C."""
    s = np.linspace(0.02, 0.2, 7)
    assert np.allclose(3.0 * EI * contact.compliance(s, bending_stiffness=EI), s, rtol=1e-14)


def test_compliance_with_adaptor_is_the_antenna_s():
    """The same stub in the antenna's own numbers, which are tested against a beam."""
    antenna = Antenna(beam=Beam(adaptor=0.015))
    here = contact.compliance(0.1, bending_stiffness=antenna.beam.stiffness, adaptor=0.015)
    assert here == pytest.approx(float(antenna.compliance(0.1)), rel=1e-14)


@pytest.mark.parametrize("u", [1e-3, 0.1, 0.5, 1.0])
def test_k_solves_the_small_angle_contact_with_a_round_body(u):
    """(23), (31) and (32) of Kaneko1998, small angles, solved by a root finder with s_x = theta = 1 and R =
    u.
    """

    def distance(zeta):
        return 1.0 - u * zeta

    def force(zeta):  # f/(EI) from the deflection, (32)
        return 3.0 * (distance(zeta) - 0.5 * u * zeta**2) / distance(zeta) ** 3

    def excess(zeta):  # of the slope at the contact, (23)
        return 0.5 * force(zeta) * distance(zeta) ** 2 - 1.0 - zeta

    zeta = brentq(excess, 0.0, 0.6, xtol=1e-15)
    k = 3.0 / (force(zeta) * distance(zeta))
    assert float(contact.k_of_h(1.0 / u)) == pytest.approx(k, rel=1e-12)


def test_k_is_first_order_three_eighths_and_the_print_says_a_half():
    """k = 1 - 3/(8h) + about 0.1/h^2, so that (34) is 1/(8h) off."""
    h = np.array([1e3, 1e4])
    assert np.allclose((1.0 - contact.k_of_h(h)) * h, 0.375, atol=0.2 / h)
    assert np.allclose((contact.k_of_h(h) - contact.k_of_h_printed(h)) * h, 0.125, atol=0.2 / h)


def test_k_of_an_edge_is_one():
    """An infinite h is an edge."""
    assert float(contact.k_of_h(np.inf)) == 1.0


@pytest.mark.parametrize("friction, radius", [(0.0, 0.0), (0.3, 0.0), (0.2, 0.03)])
def test_distance_from_compliance_inverts_a_push(friction, radius):
    """A push along the normal read back: closed form against reduced rod, which differ by u theta^2 and
    theta^4.
    """
    s, theta = 0.1, 0.05
    push = contact.push_response(
        0.0, theta, distance=s, friction=friction, radius_along=radius, radius_across=np.inf
    )
    c = push.compliance_ratio * s / (3.0 * EI)
    back = contact.distance_from_compliance(
        c, bending_stiffness=EI, theta=theta, friction=friction, radius_along=radius
    )
    u = radius * theta / s
    assert float(back) == pytest.approx(s, rel=2.0 * u * theta**2 + theta**3)


def test_slip_law_satisfies_its_equation(rng):
    """(48) with the square of (47): tan(beta) = tan(alpha) sin(gamma)."""
    eps, theta, mu = rng.uniform(-1.2, 1.2, 200), rng.uniform(0.01, 0.2, 200), rng.uniform(0.0, 0.6, 200)
    law = contact.slip_law(eps, theta, mu)
    lam = eps + np.pi / 2
    rate = np.cos(lam) - np.sin(lam) * np.tan(law.beta)
    gamma = np.arctan2(rate, 0.1 * theta * (np.sin(lam) / np.cos(law.beta)) ** 2)
    assert np.allclose(np.tan(law.beta), mu * np.sin(gamma), atol=1e-9)
    assert np.all(np.abs(law.beta) <= np.arctan(mu) + 1e-15)
    assert np.all((law.delta - np.pi) * np.sign(eps) >= -1e-12)


def test_slip_law_keeps_one_percent_within_half_the_cone():
    """Fig. 13: a push at alpha/2 from the normal errs by less than 1 % whatever the cone, at 5 deg."""
    alpha = np.radians(np.arange(1.0, 31.0))
    law = contact.slip_law(alpha / 2, np.radians(5.0), np.tan(alpha), gain=contact.SLIP_RATES)
    assert np.all(np.abs(law.compliance_ratio - 1.0) < 0.01)


def test_slip_totals_agree_with_the_reduced_rod_and_rates_creep_twice_as_much():
    """Inside the cone delta - pi is eps theta/(10 tan alpha) (1 - beta bends it back by theta/(10 tan
    alpha)).
    """
    eps, theta, mu = np.radians(3.0), 0.02, 0.2
    rod = contact.push_response(eps, theta, distance=1.0, friction=mu, radius_along=0.0, radius_across=np.inf)
    totals = contact.slip_law(eps, theta, mu).delta - np.pi
    rates = contact.slip_law(eps, theta, mu, gain=contact.SLIP_RATES).delta - np.pi
    assert float(totals) == pytest.approx(float(rod.delta) - np.pi, rel=0.05)
    assert float(rates / totals) == pytest.approx(2.0, rel=0.05)


def test_return_onset_is_where_the_reduced_rod_begins_to_slide_home():
    """On a flat profile the force of a push that slid swings through the cone, then slides home on its other
    edge.

    The creep before the other edge (tan(beta) = tan(alpha) sin(gamma), sin(gamma) = 0.9 here) smears the
    onset by less than 0.1 of the way that the cone takes.
    """
    eps, alpha, theta = np.radians(20.0), np.radians(10.0), 0.05
    shares = np.concatenate((np.linspace(0.05, 1.0, 20), np.linspace(0.99, 0.01, 99)))
    cycle = contact.push_cycle(
        eps, shares * theta, distance=1.0, friction=np.tan(alpha), radius_along=0.0, radius_across=np.inf
    )
    beta = cycle.delta - np.pi - eps
    assert beta[19] == pytest.approx(-alpha, rel=0.02)
    onset = shares[20 + np.flatnonzero(beta[20:] > 0.9 * alpha)[0]]
    assert onset == pytest.approx(float(contact.return_onset(eps, np.tan(alpha))), abs=0.065)


def test_soft_body_gives_back_distance_and_stiffness(rng):
    """(38) to (42): the second root is the distance, the first lies between 0 and the shift."""
    shift = rng.uniform(0.01, 0.05, 100)
    s = shift + rng.uniform(0.01, 0.15, 100)
    k_o = 10.0 ** rng.uniform(1.0, 4.0, 100)
    first = contact.compliance_on_soft_body(s, bending_stiffness=EI, body_stiffness=k_o)
    second = contact.compliance_on_soft_body(s - shift, bending_stiffness=EI, body_stiffness=k_o)
    found = contact.soft_body(first, second, shift, bending_stiffness=EI)
    # Conditioning: the body's share of C falls to 1e-5 for the stiffest and farthest.
    assert np.allclose(found.distance, s, rtol=1e-10)
    assert np.allclose(found.body_stiffness, k_o, rtol=1e-5)
    assert np.all((found.other_root > 0.0) & (found.other_root < shift) & (shift < found.distance))
    for root in (found.distance, found.other_root):  # (40)
        c_1, c_2 = EI * first, EI * second
        left = 3 * (c_1 - c_2 - shift) * root**2 + 3 * shift * (2 * c_2 + shift) * root
        assert np.allclose(left, 3 * c_2 * shift**2 + shift**3, rtol=1e-9)


def test_one_push_is_exact_for_full_friction_on_a_flat_profile(rng):
    """Sliding with all friction across, delta = pi + eps - sign(eps) alpha and C/c0 = cos(alpha)/cos(eps)."""
    alpha = np.radians(12.0)
    eps = rng.choice([-1.0, 1.0], 40) * rng.uniform(0.25, 0.9, 40)
    delta = np.pi + eps - np.sign(eps) * alpha
    moment = 3.0 * EI * 0.05 / (0.08 * np.cos(alpha) / np.cos(eps))
    guess = contact.one_push(0.05, moment, delta, friction_angle=alpha, bending_stiffness=EI)
    assert np.allclose(guess.distance, 0.08, rtol=1e-12)
    assert np.allclose(guess.eps, eps, atol=1e-12)


def test_laws_refuse_what_they_cannot_hold_for():
    """Outside their domain the laws say so."""
    with pytest.raises(UsageError, match="eps"):
        contact.slip_law(1.6, 0.05, 0.2)
    with pytest.raises(UsageError, match="shift"):
        contact.soft_body(1.0, 2.0, -0.01, bending_stiffness=EI)
