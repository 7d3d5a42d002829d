"""The reduced rod: against the truth data, its own equations, and what must hold whatever the numbers."""

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from contour import contact, slip
from contour.errors import UsageError
from contour.response import refine
from contour.silhouette import ArcProfile
from contour.slip import follow

REFERENCE = Path(__file__).parent / "reference"
FLAT = {"distance": 0.1, "radius_along": 0.0, "radius_across": np.inf}
OUT_AND_BACK = np.concatenate((np.linspace(0.125, 1.0, 8), np.linspace(0.875, 0.125, 7)))


def _truth(name):
    return np.genfromtxt(REFERENCE / name, delimiter=",", names=True, dtype=None, encoding=None)


def _rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.fixture(scope="module")
def pushes():
    """The truth of 160 pushes, and the reduced rod's answers: (table, q, error of C, error of delta)."""
    table = _truth("pushes.csv")
    s = 0.13
    push = contact.push_response(
        table["eps_rad"],
        table["theta_rad"],
        distance=s,
        friction=table["mu"],
        radius_along=table["Ra_over_s"] * s,
        radius_across=table["Rl_over_s"] * s,
    )
    assert not push.slipped_off.any()
    q = table["Rl_over_s"] / table["theta_rad"]
    return table, q, push.compliance_ratio / table["compliance_ratio"] - 1.0, push.delta - table["delta_rad"]


def test_pushes_near_the_normal_match_the_truth(pushes):
    """|eps| below 20 deg, q at least 2 or flat: the ratio within 0.015 % rms and delta within 0.015 deg rms."""
    table, q, ratio, delta = pushes
    good = (np.abs(table["eps_rad"]) < np.radians(20.0)) & (q >= 2.0)
    assert good.sum() > 50
    assert _rms(ratio[good]) < 0.00015
    assert _rms(delta[good]) < np.radians(0.015)


def test_all_pushes_match_the_truth(pushes):
    """All of the table: 95 % within 0.04 % and 0.05 deg."""
    _, _, ratio, delta = pushes
    assert np.quantile(np.abs(ratio), 0.95) < 0.0004
    assert np.quantile(np.abs(delta), 0.95) < np.radians(0.05)


def test_cycles_match_the_truth():
    """40 pushes out and back: moment within 0.005 % rms of each cycle's largest, delta within 0.03 deg rms."""
    table = _truth("cycles.csv").reshape(40, 15)
    one = {name: table[name][:, 0] for name in ("eps_rad", "mu", "Ra_over_s", "Rl_over_s")}
    cycle = contact.push_cycle(
        one["eps_rad"],
        table["theta_rad"],
        distance=1.0,
        friction=one["mu"],
        radius_along=one["Ra_over_s"],
        radius_across=one["Rl_over_s"],
    )
    largest = table["moment_angle_rad"].max(axis=1, keepdims=True)
    assert _rms((cycle.moment_angle - table["moment_angle_rad"]) / largest) < 0.00005
    assert _rms(cycle.delta - table["delta_rad"]) < np.radians(0.03)
    assert not cycle.slipped_off.any()


def _place(theta, eps, mu_tau, radius, kappa, x):
    """P, its directions and lean at arc length x; the lean from its equation, with friction tau = mu_tau
    along.
    """
    turn = kappa * x
    c = np.array([x, 0.0, 0.0]) if kappa == 0 else np.array([np.sin(turn), np.cos(turn) - 1.0, 0.0]) / kappa
    across, normal = np.array([np.cos(turn), -np.sin(turn), 0.0]), np.array([np.sin(turn), np.cos(turn), 0.0])
    y = np.array([0.0, 0.0, 1.0])
    t_0 = np.array([-np.sin(theta) * np.sin(eps), -np.sin(theta) * np.cos(eps), np.cos(theta)])

    def touch(zeta):
        return y + c + radius * ((np.cos(zeta) - 1.0) * normal - np.sin(zeta) * y)

    def excess(zeta):  # of the bend of an elastica over the turn from base tangent to surface
        p = touch(zeta)
        ahead = p @ t_0
        w = p - ahead * t_0
        r = np.linalg.norm(w) / ahead
        n_z = np.cos(zeta) * normal - np.sin(zeta) * y
        bend = 1.5 * r * (1.0 - mu_tau * r / 20.0 - 9.0 / 28.0 * r * r)
        return bend - np.arctan2(-(t_0 @ n_z), w @ n_z / np.linalg.norm(w))

    zeta = brentq(excess, -0.5 * theta, 2.0 * theta, xtol=1e-14)
    p = touch(zeta)
    ahead = p @ t_0
    return p, p - ahead * t_0, ahead, zeta, across, np.cos(zeta) * normal - np.sin(zeta) * y, t_0


def _slow_path(eps, thetas, mu, radius, kappa):
    """The reduced rod as contour.slip's docstring has it, by bisection, one push, plain floats: slides."""
    a = d_a = d_l = step_before = theta_before = 0.0
    length = paid = 1.0
    slides = []
    for theta in thetas:
        step = theta - theta_before
        w = step / step_before if step * step_before > 0 else 0.0
        share = w * w / (1 + 2 * w)
        memory = (a, length, paid, share * d_a, share * d_l)
        sense = np.sign(step)

        def state(x, theta=theta, memory=memory, sense=sense):
            a, length, paid, a_carry, l_carry = memory
            p, bent, ahead, zeta, across, normal, t_0 = _place(theta, eps, sense * mu, radius, kappa, x)
            aside = np.linalg.norm(bent)
            r = aside / ahead
            new = np.linalg.norm(p) * (1 + r * r / 10)
            end = t_0 + 1.5 * r * bent / aside
            slid = (x - a) * (1 + kappa * radius * (np.cos(zeta) - 1)) - (end @ across) * (new - length)
            lateral, along = slid - a_carry, new + radius * zeta - paid - l_carry
            slip = np.hypot(lateral, along)
            tau = mu * along / slip
            force = bent + (tau * aside - 1.5 * r * aside * (1 + tau * tau)) * t_0
            return force @ across + mu * (force @ normal) * lateral / slip, new, new + radius * zeta, slid

        low, high = a - 1.5 * theta, a + 1.5 * theta
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if state(middle)[0] > 0 else (middle, high)
        _, new, new_paid, d_a = state(low)
        d_l, a, length, paid = new_paid - paid, low, new, new_paid
        step_before, theta_before = step, theta
        slides.append(a)
    return np.array(slides)


@pytest.mark.parametrize(
    "eps, mu, radius, kappa",
    [
        (0.1, 0.2, 0.0, 0.0),
        (0.5, 0.2, 0.3, 0.0),
        (-0.3, 0.1, 0.0, 4.0),
        (0.05, 0.4, 0.5, -3.0),
        (0.3, 0.0, 1.0, 2.0),
    ],
)
def test_slide_solves_the_contact_condition(eps, mu, radius, kappa):
    """The fast path against plain bisection of the documented condition, with the lean's full equation.

    The quadratic for the lean and the chord of a step leave 4e-5 of the slide.
    """
    thetas = np.concatenate((np.linspace(0.01, 0.08, 8), np.linspace(0.07, 0.01, 7)))
    path = follow(
        np.array([eps]), thetas[:, None], np.array([mu]), np.array([radius]), ArcProfile(np.array([kappa]))
    )
    slow = _slow_path(eps, thetas, mu, radius, kappa)
    assert np.allclose(path.slide[:, 0], slow, atol=1e-4 * np.abs(slow).max())


def test_search_finds_what_newton_finds(monkeypatch, rng):
    """With Newton's answers refused, the brackets and bisections of the fallback walk the same path."""
    n = 40
    eps, mu, radius = rng.uniform(-0.6, 0.6, n), rng.uniform(0.05, 0.5, n), rng.uniform(0.0, 0.5, n)
    thetas = np.outer(0.06 * OUT_AND_BACK, np.ones(n))
    args = (eps, thetas, mu, radius, ArcProfile(rng.uniform(-3.0, 3.0, n)))
    newton = follow(*args)
    monkeypatch.setattr(slip, "SETTLED", -1.0)
    searched = follow(*args)
    assert not searched.slipped_off.any()
    # Newton stops where its next step would change the slide by about 1e-8 of the depth.
    assert np.allclose(newton.slide, searched.slide, atol=2e-8)
    assert np.allclose(newton.delta, searched.delta, atol=2e-6)


@pytest.mark.parametrize("radius", [0.0, 0.3, 1.0])
def test_lean_makes_the_rod_tangent(radius):
    """The quadratic for zeta against the tangency of an elastica, at both ends of the way: 1e-3 of zeta.

    Friction along the beam, mu = 0.5 here, bends the rod by mu r/20 = 2e-3 less on the way out and more on
    the way back.
    """
    theta, mu = 0.08, 0.5
    thetas = theta * OUT_AND_BACK
    args = (np.zeros(1), thetas[:, None], np.array([mu]), np.array([radius]), ArcProfile(np.zeros(1)))
    lean = follow(*args).lean[:, 0]
    for i, sense in ((7, 1.0), (9, -1.0)):
        zeta = _place(thetas[i], 0.0, sense * mu, radius, 0.0, 0.0)[3]
        assert lean[i] == pytest.approx(zeta, rel=1e-3)


def test_push_is_the_end_of_its_path(rng):
    """push_response is push_cycle at one angle."""
    eps, theta = rng.uniform(-0.5, 0.5, 20), rng.uniform(0.01, 0.1, 20)
    push = contact.push_response(eps, theta, friction=0.2, **FLAT)
    cycle = contact.push_cycle(eps, theta[:, None], friction=0.2, **FLAT)
    assert np.array_equal(push.delta, cycle.delta[:, 0])
    assert np.allclose(push.compliance_ratio * cycle.moment_angle[:, 0], theta, rtol=1e-14)


def test_mirror_image_is_answered_with_the_mirror_image(rng):
    """eps -> -eps turns delta - pi and the slide round and leaves the moment."""
    eps, mu = rng.uniform(-0.8, 0.8, 50), rng.uniform(0.0, 0.5, 50)
    radius = rng.choice([-0.05, 0.03, np.inf], 50)
    args = {"distance": 0.1, "friction": mu, "radius_along": 0.02, "radius_across": radius}
    one = contact.push_cycle(eps, 0.05 * OUT_AND_BACK, **args)
    other = contact.push_cycle(-eps, 0.05 * OUT_AND_BACK, **args)
    assert np.allclose(one.delta + other.delta, 2 * np.pi, atol=1e-9)
    assert np.allclose(one.slide, -other.slide, atol=1e-10)
    assert np.allclose(one.moment_angle, other.moment_angle, rtol=1e-9)


def test_only_ratios_of_lengths_matter(rng):
    """All lengths doubled: same angles, lengths doubled."""
    eps = rng.uniform(-0.5, 0.5, 20)
    one = contact.push_cycle(
        eps, 0.05 * OUT_AND_BACK, distance=0.1, friction=0.2, radius_along=0.03, radius_across=0.02
    )
    two = contact.push_cycle(
        eps, 0.05 * OUT_AND_BACK, distance=0.2, friction=0.2, radius_along=0.06, radius_across=0.04
    )
    assert np.allclose(one.moment_angle, two.moment_angle, rtol=1e-12)
    assert np.allclose(2.0 * one.slide, two.slide, rtol=1e-9, atol=1e-15)
    assert np.allclose(2.0 * one.arc_length, two.arc_length, rtol=1e-12)


def test_rows_do_not_know_of_each_other(rng):
    """A batch of more rows than a chunk answers each as it would alone."""
    n = 9000
    eps, mu = rng.uniform(-0.6, 0.6, n), rng.uniform(0.02, 0.5, n)
    args = {"distance": 0.1, "radius_along": 0.01, "radius_across": 0.04}
    many = contact.push_response(eps, 0.06, friction=mu, **args)
    for i in (0, 4321, n - 1):
        one = contact.push_response(eps[i], 0.06, friction=mu[i], **args)
        assert float(one.delta) == pytest.approx(many.delta[i], abs=1e-12)


def test_push_along_the_normal_does_not_slide():
    """eps = 0: delta is pi, the answer that of section 3, k(h) (1 + (5/21) theta^2 - mu theta/5)."""
    theta, mu, radius = 0.05, 0.3, 0.03
    push = contact.push_response(
        0.0, theta, distance=0.1, friction=mu, radius_along=radius, radius_across=np.inf
    )
    assert float(push.delta) == pytest.approx(np.pi, abs=1e-12)
    assert float(push.slide) == pytest.approx(0.0, abs=1e-15)
    law = contact.k_of_h(0.1 / (radius * theta)) * contact.finite_angle(theta, mu)
    # k takes tan(theta) for theta, u theta^2/8 of difference; finite angles differ in theta^4.
    assert float(push.compliance_ratio) == pytest.approx(float(law), abs=5e-5)


def test_frictionless_force_is_normal():
    """mu = 0 on a flat profile: the force in the sensing plane is the normal's projection, theta^2/2 off at
    most.
    """
    eps, theta = np.radians([10.0, 40.0, -60.0]), 0.05
    push = contact.push_response(eps, theta, friction=0.0, **FLAT)
    assert np.allclose(push.delta, np.pi + eps, atol=theta**2 / 2)


def test_frictionless_push_has_no_memory():
    """mu = 0: the way back is the way out."""
    thetas = np.array([0.01, 0.03, 0.05, 0.03, 0.01])
    cycle = contact.push_cycle(0.4, thetas, distance=0.1, friction=0.0, radius_along=0.02, radius_across=0.05)
    assert np.allclose(cycle.delta[:2], cycle.delta[:2:-1], atol=1e-9)
    assert np.allclose(cycle.moment_angle[:2], cycle.moment_angle[:2:-1], rtol=1e-9)


def test_one_push_and_return_sees_both_edges_of_the_cone():
    """eps 20 deg, alpha 10 deg, flat: the force is +10 deg off nu+ on the way out and -10 deg at the end of
    the return.

    As extrapolated to theta -> 0 on both strokes; 0.3 deg is the finite angle's part (theta^2/2 = 0.1 deg)
    and the share of friction that acts along the beam.
    """
    eps, alpha = np.radians(20.0), np.radians(10.0)
    cycle = contact.push_cycle(eps, 0.05 * OUT_AND_BACK, friction=np.tan(alpha), **FLAT)
    off_normal = np.pi + eps - cycle.delta
    assert off_normal[0] == pytest.approx(alpha, abs=np.radians(0.3))
    assert off_normal[-1] == pytest.approx(-alpha, abs=np.radians(0.3))
    assert off_normal[7] > 0 > off_normal[12]


def test_finer_paths_change_little(rng):
    """Angles put between those asked for move the answer by the discretisation alone."""
    eps, mu = rng.uniform(-0.4, 0.4, 60), rng.uniform(0.05, 0.4, 60)
    args = {"distance": 0.1, "friction": mu, "radius_along": 0.01, "radius_across": 0.05}
    thetas = 0.05 * OUT_AND_BACK
    finer = np.interp(np.arange(0, 14.01, 0.25), np.arange(15), thetas)
    coarse, fine = contact.push_cycle(eps, thetas, **args), contact.push_cycle(eps, finer, **args)
    # 0.02 deg rms was measured for 8 steps against many; 0.06 allows for the few rows here.
    assert _rms(coarse.delta - fine.delta[:, ::4]) < np.radians(0.06)
    assert _rms(coarse.moment_angle / fine.moment_angle[:, ::4] - 1.0) < 2e-4


def test_runaway_pushes_slip_off_and_stay_finite():
    """A round body smaller than half the depth of the push, pushed outside the cone: it is left, and that is
    said.
    """
    q = np.array([0.3, 0.45, 4.0])
    theta = 0.08
    cycle = contact.push_cycle(
        np.radians(25.0),
        theta * OUT_AND_BACK,
        distance=0.1,
        friction=np.tan(np.radians(10.0)),
        radius_along=0.0,
        radius_across=q * theta * 0.1,
    )
    assert cycle.slipped_off[:, 7].tolist() == [True, True, False]
    assert np.all(np.diff(cycle.slipped_off.astype(int), axis=1) >= 0)
    for values in (cycle.delta, cycle.moment_angle, cycle.slide, cycle.arc_length):
        assert np.all(np.isfinite(values))
    assert np.all((cycle.delta >= 0.0) & (cycle.delta <= 2 * np.pi))


@pytest.mark.parametrize(
    "q, delta, ratio",
    [
        (1.0, 250.0, 1.463),
        (1.3, 216.5, 1.194),
        (2.0, 199.7, 1.098),
        (4.0, 193.3, 1.065),
        (np.inf, 190.0, 1.048),
    ],
)
def test_small_radii_run_round_the_body(q, delta, ratio):
    """eps 20 deg, alpha 10 deg, small theta: delta and C/c0 grow as the lateral radius falls to the push's
    depth.
    """
    theta = np.radians(2.0)
    push = contact.push_response(
        np.radians(20.0),
        theta,
        distance=0.1,
        friction=np.tan(np.radians(10.0)),
        radius_along=0.0,
        radius_across=q * theta * 0.1,
    )
    assert np.degrees(push.delta) == pytest.approx(delta, abs=0.3)
    assert float(push.compliance_ratio) == pytest.approx(ratio, rel=0.004)


@pytest.mark.parametrize("q", [0.35, 0.45, 0.6, 0.9])
def test_pushes_inside_the_cone_hold_on_bodies_smaller_than_their_depth(q):
    """eps to 8 deg within alpha = 10 deg: friction holds what the curvature would let run; C/c0 within 0.2
    %.
    """
    theta = np.radians(4.0)
    push = contact.push_response(
        np.radians([2.0, 5.0, 8.0]),
        theta,
        distance=0.1,
        friction=np.tan(np.radians(10.0)),
        radius_along=0.0,
        radius_across=q * theta * 0.1,
    )
    assert not push.slipped_off.any()
    assert np.allclose(push.compliance_ratio, 1.0, atol=0.0021)
    assert np.all(np.degrees(push.delta) - 180.0 < 1.0)


def test_corner_holds_the_contact():
    """radius_across = 0: no slide, no turn of the force."""
    push = contact.push_response(0.3, 0.05, distance=0.1, friction=0.1, radius_along=0.0, radius_across=0.0)
    assert float(push.slide) == pytest.approx(0.0, abs=1e-9)
    assert float(push.delta) == pytest.approx(np.pi, abs=1e-6)
    assert not push.slipped_off


def test_corner_does_not_depend_on_which_side_zero_is_met():
    """A corner is a corner whichever sign its zero has."""
    args = {"distance": 0.1, "friction": 0.1, "radius_along": 0.0}
    one = contact.push_response(0.1, 0.05, radius_across=0.0, **args)
    other = contact.push_response(0.1, 0.05, radius_across=-0.0, **args)
    assert float(one.delta) == pytest.approx(float(other.delta), abs=1e-9)


def _circle(radius, half, count=41):
    x = np.linspace(-half, half, count)
    return x, np.sqrt(radius**2 - x**2) - radius


def test_sampled_profile_answers_as_its_arc():
    """A circle by its heights against the circle by its radius: cells of 0.04 R leave normals 1e-4 rad
    off.
    """
    radius, theta = 0.012, 0.05
    args = {"distance": 0.1, "friction": 0.15, "radius_along": 0.02}
    eps = np.radians([-25.0, 3.0, 20.0])
    arc = contact.push_cycle(eps, theta * OUT_AND_BACK, radius_across=radius, **args)
    curve = contact.push_cycle_profile(
        eps, theta * OUT_AND_BACK, profile=_circle(radius, 0.8 * radius), **args
    )
    assert np.allclose(arc.delta, curve.delta, atol=3e-4)
    assert np.allclose(arc.moment_angle, curve.moment_angle, rtol=5e-5)
    assert np.allclose(arc.slide, curve.slide, atol=1e-6)


def test_contact_that_leaves_its_profile_has_slipped_off():
    """The body ends 1 mm to the side where the push goes: off, beyond; on the other side nothing happens."""
    x, heights = _circle(0.05, 0.02, 81)
    heights = np.where(x < -0.001, np.nan, heights)
    args = {"distance": 0.1, "friction": 0.1, "radius_along": 0.0, "profile": (x, heights)}
    cycle = contact.push_cycle_profile(np.radians([35.0, -35.0]), 0.08 * OUT_AND_BACK, **args)
    assert cycle.slipped_off[0, 7]
    assert not cycle.slipped_off[1].any()
    assert np.all(np.isfinite(cycle.moment_angle))


def test_zero_angle_has_the_limit_of_small_ones():
    """theta = 0 is answered with the directions and the ratio of the smallest pushes."""
    at, near = (contact.push_response(0.4, t, friction=0.2, **FLAT) for t in (0.0, 1e-6))
    assert float(at.delta) == pytest.approx(float(near.delta), abs=1e-6)
    assert float(at.compliance_ratio) == pytest.approx(float(near.compliance_ratio), rel=1e-6)


def test_refine_keeps_the_angles_asked_for(rng):
    """Steps are split, turns are eased, and what was asked for is found again to the bit."""
    angles = np.array([[0.08], [0.06], [0.0601]]) * rng.uniform(0.5, 1.0, 100)
    finer, wanted = refine(angles, 8)
    assert np.array_equal(finer[wanted], angles)
    assert np.all(np.abs(np.diff(finer, axis=0)).max(axis=0) <= angles[0] / 8 * (1 + 1e-9))
    assert np.all(np.diff(finer[: wanted[0] + 1], axis=0) > 0)


def test_tip_on_an_upright_surface_answers_nearly_as_a_side():
    """tilt = 0: all that differs is that the rod is not paid out, theta^2/10 of its length."""
    args = {"distance": 0.2, "friction": 0.2, "radius_across": np.inf}
    tip = contact.push_cycle_tip(0.3, 0.05 * OUT_AND_BACK, radius_along=np.inf, tilt=0.0, **args)
    side = contact.push_cycle(0.3, 0.05 * OUT_AND_BACK, radius_along=0.0, **args)
    # Both slide as their rods shorten and lengthen; theta of the creep is all that differs.
    assert np.allclose(tip.delta, side.delta, atol=0.15 * 0.05**2)
    # What is paid out softens the side: r^2/10 + a^2/2, and a tenth for the lean of r/2 that turns the tip's force.
    assert np.allclose(tip.moment_angle, side.moment_angle, rtol=0.05**2 / 4)
    assert np.abs(tip.moment_angle / side.moment_angle - 1.0).max() > 0.05**2 / 10
    assert np.allclose(tip.arc_length, 0.2)


def test_broadcasting_follows_numpy():
    """(3, 1) directions and (4,) distances make (3, 4) pushes."""
    push = contact.push_response(
        np.zeros((3, 1)),
        0.05,
        distance=np.linspace(0.05, 0.2, 4),
        friction=0.1,
        radius_along=0.0,
        radius_across=np.inf,
    )
    assert push.delta.shape == push.slipped_off.shape == (3, 4)


@pytest.mark.parametrize(
    "change, word",
    [
        ({"thetas": np.zeros(0)}, "thetas"),
        ({"thetas": [-0.1]}, "thetas"),
        ({"thetas": [3.0]}, "thetas"),
        ({"eps": np.nan}, "eps"),
        ({"distance": 0.0}, "distance"),
        ({"friction": -0.1}, "friction"),
        ({"radius_along": -0.1}, "radius_along"),
        ({"radius_across": np.nan}, "radius_across"),
        ({"eps": np.zeros(3), "distance": np.ones(2)}, "broadcast"),
    ],
)
def test_bad_arguments_are_named(change, word):
    """One line that names the argument."""
    args = {"eps": 0.1, "thetas": [0.05], "friction": 0.2, **FLAT, **change}
    with pytest.raises(UsageError, match=word):
        contact.push_cycle(args.pop("eps"), args.pop("thetas"), **args)


def test_steep_tips_are_refused():
    """A tip pushed along its axis is not felt."""
    with pytest.raises(UsageError, match="tilt"):
        contact.push_cycle_tip(0.0, [0.05], friction=0.2, tilt=1.5, **FLAT)
