"""The exact rod: truth data, an independent integration, balance of energy, convergence, limits."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from contour import contact, elastica
from contour.response import refine
from contour.rod import SideBody
from contour.rod_path import Hint, follow_rod
from contour.silhouette import ArcProfile
from contour.slip import follow

REFERENCE = Path(__file__).parent / "reference"
OUT_AND_BACK = np.concatenate((np.linspace(0.125, 1.0, 8), np.linspace(0.875, 0.125, 7)))
FLAT = {"distance": 0.1, "radius_along": 0.0, "radius_across": np.inf}


def _truth(name):
    return np.genfromtxt(REFERENCE / name, delimiter=",", names=True, dtype=None, encoding=None)


def _p99(values):
    return float(np.quantile(np.abs(values), 0.99))


def test_pushes_match_the_truth():
    """160 pushes of an independent rod, 99 % of them within 0.1 % and 0.05 deg; that truth is good to 0.015
    deg.
    """
    table = _truth("pushes.csv")
    s = 0.11
    push = elastica.push_response(
        table["eps_rad"],
        table["theta_rad"],
        distance=s,
        friction=table["mu"],
        radius_along=table["Ra_over_s"] * s,
        radius_across=table["Rl_over_s"] * s,
    )
    assert push.converged.all()
    assert not push.slipped_off.any()
    assert _p99(push.compliance_ratio / table["compliance_ratio"] - 1.0) < 0.0002
    assert _p99(push.delta - table["delta_rad"]) < np.radians(0.03)
    assert _p99(push.slide / s - table["a_over_sx"]) < 1e-4
    assert _p99(push.arc_length / s - table["s_over_sx"]) < 2e-5


def test_cycles_match_the_truth():
    """40 cycles of an independent rod, 99 % of them within 0.1 % of the largest moment and 0.3 deg."""
    table = _truth("cycles.csv").reshape(40, 15)
    one = {name: table[name][:, 0] for name in ("eps_rad", "mu", "Ra_over_s", "Rl_over_s")}
    cycle = elastica.push_cycle(
        one["eps_rad"],
        table["theta_rad"],
        distance=1.0,
        friction=one["mu"],
        radius_along=one["Ra_over_s"],
        radius_across=one["Rl_over_s"],
    )
    assert cycle.converged.all()
    largest = table["moment_angle_rad"].max(axis=1, keepdims=True)
    assert _p99((cycle.moment_angle - table["moment_angle_rad"]) / largest) < 0.001
    assert _p99(cycle.delta - table["delta_rad"]) < np.radians(0.3)


def _one_path(eps, theta, mu, radius, kappa):
    """The end of one push with all its unknowns: (body, path)."""
    angles, _ = refine(np.array([[theta]]), 16)
    e, m = np.array([eps]), np.array([mu])
    profile = ArcProfile(np.array([kappa]))
    r = np.array([radius])
    near = follow(e, angles, m, r, profile)
    hints = Hint(near.parameter, near.lean, 0.5 * np.pi - np.arctan(m * near.along), near.slipped_off)
    return follow_rod(SideBody(e, m, r, profile), angles, hints)


@pytest.mark.parametrize(
    "eps, theta, mu, radius, kappa",
    [(0.3, 0.1, 0.2, 0.5, 3.0), (-0.6, 0.08, 0.1, 0.0, 0.0), (0.1, 0.3, 0.3, 1.0, -1.0)],
)
def test_rod_in_space_ends_on_the_body_and_touches_it(eps, theta, mu, radius, kappa):
    """r' = t, t' = (P - r) x F x t/EI integrated in 3-D from the base moment found: it ends at P, tangent to
    the body.
    """
    path = _one_path(eps, theta, mu, radius, kappa)
    a, zeta, length = path.slide[-1, 0], path.lean[-1, 0], path.arc_length[-1, 0]
    turn = kappa * a
    across = np.array([np.cos(turn), -np.sin(turn), 0.0])  # axes (t, n, y)
    n_0 = np.array([np.sin(turn), np.cos(turn), 0.0])
    c = a * across if kappa == 0 else np.array([np.sin(turn), np.cos(turn) - 1.0, 0.0]) / kappa
    normal = np.cos(zeta) * n_0 - np.sin(zeta) * np.array([0.0, 0.0, 1.0])
    point = np.array([0.0, 0.0, 1.0]) + c + radius * (normal - n_0)
    t_0 = np.array([-np.sin(theta) * np.sin(eps), -np.sin(theta) * np.cos(eps), np.cos(theta)])
    ahead = point @ t_0
    aside = point - ahead * t_0
    d = aside / np.linalg.norm(aside)
    moment = 3.0 * path.moment_angle[-1, 0]

    def end(axial):  # force axial t0 + lift d with the base moment ahead lift - |aside| axial
        force = axial * t_0 + (moment + np.linalg.norm(aside) * axial) / ahead * d

        def rate(_, y):
            bending = np.cross(point - y[:3], force)
            return np.concatenate((y[3:], np.cross(bending, y[3:])))

        return solve_ivp(rate, (0.0, length), np.concatenate((np.zeros(3), t_0)), rtol=1e-11, atol=1e-13).y[
            :, -1
        ]

    axial = brentq(lambda f: (end(f)[:3] - point) @ d, -0.9, 0.9, xtol=1e-12)
    found = end(axial)
    assert np.allclose(found[:3], point, atol=1e-8)
    assert found[3:] @ normal == pytest.approx(0.0, abs=1e-7)
    force = axial * t_0 + (moment + np.linalg.norm(aside) * axial) / ahead * d
    push = force @ normal
    rub = np.linalg.norm(force - push * normal)
    # Sliding: friction is mu N. The tangency found is good to 1e-7, and the axial force to 1e-5 of the
    # moment.
    assert rub / push == pytest.approx(mu, rel=2e-3)


def test_finite_angle_of_an_edge_is_five_over_twenty_one():
    """C/c0 - 1 tends to (5/21) theta^2 without friction, the rest of the order theta^4."""
    theta = np.array([0.05, 0.1, 0.2])
    push = elastica.push_response(0.0, theta, friction=0.0, **FLAT)
    assert np.allclose((push.compliance_ratio - 1.0) / theta**2, 5.0 / 21.0, atol=0.3 * theta**2)


def test_friction_along_the_beam_turns_sign_on_the_way_back():
    """-mu theta/5 on the way out, + on the way back; beyond the first step after the turn; rest mu^2
    theta^2.
    """
    theta, mu = 0.02, 0.3
    shares = np.array([0.5, 1.0, 0.5])
    rough = elastica.push_cycle(0.0, theta * shares, friction=mu, **FLAT)
    smooth = elastica.push_cycle(0.0, theta * shares, friction=0.0, **FLAT)
    change = smooth.moment_angle / rough.moment_angle - 1.0
    assert np.allclose(change, mu * theta * shares / 5.0 * [-1, -1, 1], atol=0.3 * (mu * theta) ** 2)


@pytest.mark.parametrize("u", [0.05, 0.3])
def test_round_body_softens_as_k_says(u):
    """Small angle, R theta/s = u: k(h) to the order theta^2."""
    theta = 0.01
    push = elastica.push_response(
        0.0, theta, distance=1.0, friction=0.0, radius_along=u / theta, radius_across=np.inf
    )
    assert float(push.compliance_ratio) == pytest.approx(float(contact.k_of_h(1.0 / u)), abs=2 * theta**2)


def test_way_back_without_friction_is_the_way_out(rng):
    """No friction, no memory."""
    eps = rng.uniform(-0.5, 0.5, 20)
    cycle = elastica.push_cycle(
        eps, 0.06 * OUT_AND_BACK, distance=1.0, friction=0.0, radius_along=0.3, radius_across=0.4
    )
    assert cycle.converged.all()
    assert np.allclose(cycle.delta[:, :7], cycle.delta[:, :7:-1], atol=1e-7)
    assert np.allclose(cycle.moment_angle[:, :7], cycle.moment_angle[:, :7:-1], rtol=1e-7)


def test_friction_only_takes_energy(rng):
    """The base's work over a whole cycle, integral of |M| cos(delta - pi) dtheta, is what friction burns."""
    eps, mu = rng.uniform(-0.5, 0.5, 40), rng.uniform(0.05, 0.5, 40)
    thetas = 0.06 * np.concatenate((np.linspace(0.0, 1.0, 41), np.linspace(0.975, 0.0, 40)))
    cycle = elastica.push_cycle(eps, thetas, distance=1.0, friction=mu, radius_along=0.1, radius_across=0.5)
    torque = cycle.moment_angle * np.cos(cycle.delta - np.pi)
    work = np.sum(0.5 * (torque[:, 1:] + torque[:, :-1]) * np.diff(thetas), axis=1)
    stored = 0.5 * 0.06**2
    assert np.all(work > 0.0)
    assert np.all(work < stored)
    # Along the beam alone friction mu N acts over twice theta^2/10: 4 mu theta/15 of what is stored, at eps =
    # 0.
    straight = elastica.push_cycle(0.0, thetas, friction=0.3, **FLAT)
    torque = straight.moment_angle
    burnt = np.sum(0.5 * (torque[1:] + torque[:-1]) * np.diff(thetas))
    assert burnt / stored == pytest.approx(4.0 * 0.3 * 0.06 / 15.0, rel=0.05)


def test_time_steps_converge_at_second_order(monkeypatch, rng):
    """Way out: four times the steps, at least eight times closer to a much finer path."""
    eps, mu = rng.uniform(-0.3, 0.3, 60), rng.uniform(0.05, 0.4, 60)
    args = {"distance": 1.0, "friction": mu, "radius_along": 0.1, "radius_across": 0.4}
    answer = {}
    for steps in (8, 32, 128):
        monkeypatch.setattr(elastica, "STEPS_OUT", steps)
        answer[steps] = elastica.push_response(eps, 0.06, **args).delta
    coarse, fine = (np.sqrt(np.mean((answer[k] - answer[128]) ** 2)) for k in (8, 32))
    assert coarse / fine > 8.0


def test_mirror_image_is_answered_with_the_mirror_image(rng):
    """eps -> -eps turns delta - pi and the slide round and leaves the moment."""
    eps, mu = rng.uniform(-0.8, 0.8, 20), rng.uniform(0.0, 0.5, 20)
    args = {"distance": 0.1, "friction": mu, "radius_along": 0.02, "radius_across": 0.03}
    one = elastica.push_cycle(eps, 0.05 * OUT_AND_BACK, **args)
    other = elastica.push_cycle(-eps, 0.05 * OUT_AND_BACK, **args)
    assert np.allclose(one.delta + other.delta, 2 * np.pi, atol=1e-7)
    assert np.allclose(one.moment_angle, other.moment_angle, rtol=1e-7)
    assert np.allclose(one.slide, -other.slide, atol=1e-9)


def test_reduced_rod_is_near_on_both_strokes(rng):
    """The rung below in its good range: 0.01 % rms in moment and 0.025 deg rms in delta."""
    n = 150
    eps, mu, theta = rng.uniform(-0.3, 0.3, n), rng.uniform(0.05, 0.5, n), rng.uniform(0.02, 0.08, n)
    args = {
        "distance": 1.0,
        "friction": mu,
        "radius_along": rng.choice([0.0, 0.03, 0.3], n),
        "radius_across": rng.uniform(3.0, 30.0, n) * theta,
    }
    exact = elastica.push_cycle(eps, theta[:, None] * OUT_AND_BACK, **args)
    near = contact.push_cycle(eps, theta[:, None] * OUT_AND_BACK, **args)
    largest = exact.moment_angle.max(axis=1, keepdims=True)
    assert np.sqrt(np.mean(((near.moment_angle - exact.moment_angle) / largest) ** 2)) < 1e-4
    assert np.sqrt(np.mean((near.delta - exact.delta) ** 2)) < np.radians(0.025)


def test_every_push_converges_or_has_slipped_off(rng):
    """Small bodies, wild directions: nothing is silently wrong, everything finite, and flags never come
    back.
    """
    n = 300
    theta = rng.uniform(0.01, 0.1, n)
    cycle = elastica.push_cycle(
        rng.uniform(-1.0, 1.0, n),
        theta[:, None] * OUT_AND_BACK,
        distance=1.0,
        friction=rng.uniform(0.02, 0.5, n),
        radius_along=rng.choice([0.0, 0.1, 1.0], n),
        radius_across=np.exp(rng.uniform(np.log(0.3), np.log(4.0), n)) * theta,
    )
    assert cycle.converged[:, -1].mean() > 0.98
    assert 0.05 < cycle.slipped_off[:, 7].mean() < 0.5
    for values in (cycle.delta, cycle.moment_angle, cycle.slide, cycle.arc_length):
        assert np.all(np.isfinite(values))
    assert np.all(np.diff(cycle.slipped_off.astype(int), axis=1) >= 0)
    assert np.all(np.diff(cycle.converged.astype(int), axis=1) <= 0)


def test_sampled_profile_answers_as_its_arc():
    """A circle by its heights against the circle by its radius: cells of 0.04 R leave normals 1e-4 rad
    off.
    """
    radius, theta = 0.012, 0.05
    args = {"distance": 0.1, "friction": 0.15, "radius_along": 0.02}
    x = np.linspace(-0.8, 0.8, 41) * radius
    eps = np.radians([-25.0, 3.0, 20.0])
    arc = elastica.push_cycle(eps, theta * OUT_AND_BACK, radius_across=radius, **args)
    curve = elastica.push_cycle_profile(
        eps, theta * OUT_AND_BACK, profile=(x, np.sqrt(radius**2 - x**2) - radius), **args
    )
    assert curve.converged.all()
    assert np.allclose(arc.delta, curve.delta, atol=3e-4)
    assert np.allclose(arc.moment_angle, curve.moment_angle, rtol=5e-5)


@pytest.mark.parametrize("tilt", [-0.9, 0.0, 0.6])
def test_tip_without_friction_is_the_rod_under_a_normal_force(tilt):
    """Flat surface, eps = 0: the planar rod of full length with the surface's normal force that ends on the
    surface.
    """
    theta = 0.08
    cycle = elastica.push_cycle_tip(
        0.0, [theta], distance=1.0, friction=0.0, radius_along=np.inf, radius_across=np.inf, tilt=tilt
    )
    # In the plane (y, n): the tangent's angle from y turns from -theta up by the force along n' = (-sin, cos)
    # tilt.
    lift = np.array([-np.sin(tilt), np.cos(tilt)])

    def shoot(force, m_0):
        def rate(_, y):
            return [
                np.cos(y[2]),
                np.sin(y[2]),
                y[3],
                -force * (np.cos(y[2]) * lift[1] - np.sin(y[2]) * lift[0]),
            ]

        return solve_ivp(rate, (0.0, 1.0), [0.0, 0.0, -theta, m_0], rtol=1e-11, atol=1e-13).y[:, -1]

    def base(force):  # the base curvature that leaves no moment at the end
        return brentq(lambda m: shoot(force, m)[3], 0.0, 1.0, xtol=1e-13)

    def gap(force):
        end = shoot(force, base(force))
        return (end[0] - 1.0) * lift[0] + end[1] * lift[1]

    m_0 = base(brentq(gap, 0.05, 1.0, xtol=1e-12))
    assert float(cycle.moment_angle[0]) == pytest.approx(m_0 / 3.0, rel=1e-6)
    assert cycle.converged.all()
    assert float(cycle.arc_length[0]) == pytest.approx(1.0, abs=1e-12)


def test_reduced_tip_is_near_on_both_strokes(rng):
    """Half the steps of the exact rod: 0.1 % and 0.02 deg rms at tilts to 40 deg and pushes to 3.5 deg."""
    n = 60
    args = {
        "distance": 0.2,
        "friction": rng.uniform(0.05, 0.4, n),
        "radius_along": np.inf,
        "radius_across": np.inf,
        "tilt": rng.uniform(-0.7, 0.7, n),
    }
    eps = rng.uniform(-0.4, 0.4, n)
    exact = elastica.push_cycle_tip(eps, 0.06 * OUT_AND_BACK, **args)
    near = contact.push_cycle_tip(eps, 0.06 * OUT_AND_BACK, **args)
    assert exact.converged.all()
    largest = exact.moment_angle.max(axis=1, keepdims=True)
    assert np.sqrt(np.mean(((near.moment_angle - exact.moment_angle) / largest) ** 2)) < 0.001
    assert np.sqrt(np.mean((near.delta - exact.delta) ** 2)) < np.radians(0.05)


def test_every_tip_converges_or_has_slipped_off(rng):
    """Tilts to 48 deg, radii from 5 mm, mu to 0.5, and paths as a simulator's: many angles, some repeated, some next to
    nothing.
    """
    n = 120
    radius = 10 ** rng.uniform(np.log10(0.005), np.log10(0.2), n)
    kind = rng.integers(0, 3, n)
    shares = np.concatenate((np.linspace(0.0, 1.0, 25), [0.99], np.linspace(0.99, 0.0, 25)))
    peak = 10 ** rng.uniform(-3.3, -1.15, n)
    path = np.maximum(peak[:, None] * shares + rng.uniform(-2e-4, 5e-4, n)[:, None], 0.0)
    cycle = elastica.push_cycle_tip(
        rng.uniform(-0.7, 0.7, n),
        path,
        distance=0.21,
        friction=rng.uniform(0.05, 0.5, n),
        radius_along=10 ** rng.uniform(-2.0, 0.0, n),
        radius_across=np.select([kind == 0, kind == 1], [np.inf, -np.maximum(radius, 0.02)], radius),
        tilt=rng.uniform(-0.84, 0.84, n),
    )
    assert np.all(cycle.converged | cycle.slipped_off)
    assert cycle.slipped_off[:, -1].mean() < 0.1


def test_tip_on_a_small_body_sticks_as_the_push_turns():
    """Inside the cone, on a body of half the push's depth: the first steps back leave it where it was.

    The rod does not hold it against the body's curvature, and a Newton step once sent it 14 mm round the body.
    """
    path = 0.055 * np.concatenate((np.linspace(0.05, 1.0, 32), [0.99, 0.98, 0.95, 0.9]))
    cycle = elastica.push_cycle_tip(
        -0.0733, path, distance=0.2, friction=0.306, radius_along=0.18, radius_across=0.0062, tilt=-0.656
    )
    assert cycle.converged.all()
    assert np.all(np.abs(np.diff(cycle.slide)) < 5e-6)


def test_tip_that_does_not_turn_stays_as_it_was():
    """The same angle again, and angles under the least, leave the exact tip where it was."""
    cycle = elastica.push_cycle_tip(
        0.3,
        [1e-5, 5e-5, 0.02, 0.03, 0.03, 0.02],
        distance=0.2,
        friction=0.2,
        radius_along=np.inf,
        radius_across=0.05,
        tilt=0.5,
    )
    assert cycle.converged.all()
    assert cycle.moment_angle[3] == cycle.moment_angle[4]
    assert cycle.delta[3] == cycle.delta[4]
    assert cycle.moment_angle[1] == pytest.approx(5.0 * cycle.moment_angle[0], rel=1e-9)


def test_corner_holds_the_contact():
    """radius_across = 0: nothing slides across, and friction along the beam stays."""
    args = {"distance": 0.1, "friction": 0.2, "radius_along": 0.0}
    corner = elastica.push_cycle([0.0, 0.4], 0.05 * OUT_AND_BACK, radius_across=0.0, **args)
    straight = elastica.push_cycle(0.0, 0.05 * OUT_AND_BACK, radius_across=np.inf, **args)
    assert corner.converged.all()
    assert np.allclose(corner.delta, np.pi, atol=1e-9)
    assert np.allclose(corner.moment_angle[0], straight.moment_angle, rtol=1e-9)
    # The rod is tangent to a normal 0.4 rad beside its bend: friction mu r/5 sees tan(0.4)^2 r of it, second
    # order.
    assert np.allclose(corner.moment_angle[1], straight.moment_angle, rtol=0.2 * 0.05**2)


def test_upright_tip_slides_as_a_side():
    """tilt = 0, flat: the slip of the tip is the slip of a side but for the rod's fixed length, theta^2 of
    each.
    """
    args = {"distance": 0.2, "friction": 0.2, "radius_across": np.inf}
    eps = np.array([0.05, 0.15, 0.4])
    tip = elastica.push_cycle_tip(eps, 0.05 * OUT_AND_BACK, radius_along=np.inf, tilt=0.0, **args)
    side = elastica.push_cycle(eps, 0.05 * OUT_AND_BACK, radius_along=0.0, **args)
    off = side.delta[:, :8] - np.pi
    assert np.allclose(tip.delta[:, :8] - np.pi, off, rtol=0.05, atol=1e-4)


def test_zero_angle_is_the_start():
    """theta = 0 has no moment; a push of nothing has the limit of the ratio."""
    cycle = elastica.push_cycle(0.2, [0.0, 0.05, 0.0], friction=0.2, **FLAT)
    assert cycle.moment_angle[0] == 0.0
    assert cycle.moment_angle[2] == 0.0
    push = elastica.push_response(0.2, 0.0, friction=0.2, **FLAT)
    assert float(push.compliance_ratio) == pytest.approx(1.0, abs=0.01)
