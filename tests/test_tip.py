"""The reduced rod with its tip: against the exact rod, and what must hold whatever the numbers."""

import numpy as np
import pytest

from contour import contact, elastica, tip
from contour.silhouette import ArcProfile

OUT_AND_BACK = np.concatenate((np.linspace(0.0, 1.0, 17)[1:], np.linspace(1.0, 0.0, 17)[1:-1]))


def _errors(eps, peak, steps=16, **args):
    """Largest error of the force over its largest, and of delta [rad], over pushes that both rods settle."""
    path = peak[:, None] * OUT_AND_BACK
    exact = elastica.push_cycle_tip(eps, path, **args)
    near = contact.push_cycle_tip(eps, path, **args, steps=steps)
    one, other = (c.moment_angle * np.exp(-1j * c.delta) for c in (near, exact))
    force = np.abs(one - other).max(axis=1) / np.abs(other).max(axis=1)
    good = np.all(exact.converged & ~exact.slipped_off & ~near.slipped_off, axis=1)
    return force, np.abs(near.delta - exact.delta).max(axis=1), good


def _pushes(rng, n, tilt):
    """Radii across of every kind, friction 0.05 to 0.5, tilts to ``tilt`` [deg]: (peak, arguments)."""
    across = 10 ** rng.uniform(np.log10(0.005), np.log10(0.2), n)
    kind = rng.integers(0, 3, n)
    args = {
        "distance": 0.2,
        "friction": rng.uniform(0.05, 0.5, n),
        "radius_along": np.where(rng.random(n) < 0.5, np.inf, rng.uniform(0.01, 0.2, n)),
        "radius_across": np.select([kind == 0, kind == 1], [np.inf, across], -np.maximum(across, 0.03)),
        "tilt": np.radians(rng.uniform(-tilt, tilt, n)),
    }
    return np.radians(rng.uniform(1.0, 4.0, n)), args


def test_inside_the_cone_it_is_the_exact_rod(rng):
    """Tilts to 48 deg, both strokes: 5e-5 of the force, 0.02 deg, whatever the radii (but for bodies of less than half
    the push's depth, which may be left).
    """
    n = 300
    peak, args = _pushes(rng, n, 48.0)
    eps = 0.9 * np.arctan(args["friction"]) * rng.uniform(-1.0, 1.0, n)
    force, delta, good = _errors(eps, peak, **args)
    good &= (args["radius_across"] < 0.0) | (args["radius_across"] > 0.1 * peak)
    assert good.mean() > 0.8
    assert force[good].max() < 5e-5
    assert delta[good].max() < np.radians(0.02)


def test_outside_the_cone_it_is_the_exact_rod(rng):
    """eps to 40 deg, mu to 0.2, q of 2 and more: 1e-3 of the force, 95 % within 1e-4."""
    n = 300
    peak, args = _pushes(rng, n, 48.0)
    args["friction"] = rng.uniform(0.05, 0.2, n)
    eps = rng.choice([-1.0, 1.0], n) * rng.uniform(np.radians(15.0), np.radians(40.0), n)
    force, _, good = _errors(eps, peak, **args)
    good &= (args["radius_across"] < 0.0) | (args["radius_across"] > 0.4 * peak)
    assert good.mean() > 0.7
    assert force[good].max() < 1e-3
    assert np.quantile(force[good], 0.95) < 1e-4


def test_short_steps_after_the_turn_do_not_shake_the_tip():
    """Friction along the lean turns round over steps of a hundredth of the push: 2e-4 of the exact rod's moment."""
    path = 0.04 * np.concatenate((np.linspace(0.1, 1.0, 30), [0.99, 0.98, 0.97, 0.95, 0.9]))
    args = {"distance": 0.2, "friction": 0.45, "radius_along": np.inf, "radius_across": 0.1, "tilt": 0.77}
    near, exact = (model.push_cycle_tip(0.035, path, **args).moment_angle for model in (contact, elastica))
    # Within the first step friction is on its way: the exact tip still sticks.
    off = np.abs(near / exact - 1.0)
    assert off[:30].max() < 1e-4
    assert off[31:].max() < 2e-4


def test_mirror_image_is_answered_with_the_mirror_image(rng):
    """eps -> -eps turns delta - pi and the slide round and leaves the moment."""
    n = 60
    peak, args = _pushes(rng, n, 45.0)
    args["radius_across"] = np.where(np.abs(args["radius_across"]) < 0.03, 0.03, args["radius_across"])
    eps = rng.uniform(-0.3, 0.3, n)
    one, other = (
        contact.push_cycle_tip(sign * eps, peak[:, None] * OUT_AND_BACK, **args) for sign in (1.0, -1.0)
    )
    assert np.allclose(one.delta + other.delta, 2.0 * np.pi, atol=1e-7)
    assert np.allclose(one.slide, -other.slide, atol=1e-9)
    assert np.allclose(one.moment_angle, other.moment_angle, rtol=1e-7)


def test_without_friction_the_way_back_is_the_way_out():
    """mu = 0 has no memory, but for the axial force in the rod's length, which is that of the step before."""
    thetas = np.array([0.01, 0.03, 0.05, 0.03, 0.01])
    cycle = contact.push_cycle_tip(
        0.4, thetas, distance=0.2, friction=0.0, radius_along=0.05, radius_across=0.05, tilt=0.6
    )
    assert np.allclose(cycle.delta[:2], cycle.delta[:2:-1], atol=1e-7)
    assert np.allclose(cycle.moment_angle[:2], cycle.moment_angle[:2:-1], rtol=2e-6)


def test_a_lean_surface_curves_more_and_rubs_more():
    """Small pushes on a flat surface: outside the cone the force is atan(mu/cos chi) off the normal's part in Pi; the
    slide's own rise tan(chi) a^2/2 and the friction along the lean vanish with theta.
    """
    tilt, mu = np.radians([-45.0, 0.0, 45.0]), 0.15
    cycle = contact.push_cycle_tip(
        np.radians(35.0),
        [1e-3],
        distance=0.2,
        friction=mu,
        radius_along=np.inf,
        radius_across=np.inf,
        tilt=tilt,
    )
    off = np.pi + np.radians(35.0) - cycle.delta[:, 0]
    assert np.allclose(off, np.arctan(mu / np.cos(tilt)), atol=1e-3)


def test_search_finds_what_newton_finds(monkeypatch, rng):
    """With Newton's answers refused, brackets and bisections walk the same path."""
    n = 30
    args = (
        rng.uniform(-0.6, 0.6, n),
        np.outer(0.05 * OUT_AND_BACK, np.ones(n)),
        rng.uniform(0.05, 0.25, n),
        rng.uniform(0.0, 0.7, n),
        np.where(np.arange(n) % 2, 5.0, 0.0),
        ArcProfile(rng.uniform(-3.0, 3.0, n)),
    )
    newton = tip.follow_tip(*args)
    monkeypatch.setattr(tip, "SETTLED", -1.0)
    searched = tip.follow_tip(*args)
    assert not searched.slipped_off.any()
    assert np.allclose(newton.slide, searched.slide, atol=2e-8)
    assert np.allclose(newton.delta, searched.delta, atol=2e-6)


@pytest.mark.parametrize("tilt", [-70.0, 70.0])
def test_steep_surfaces_stay_finite(tilt, rng):
    """To 70 deg, where friction may hold all that the rod can do: finite, and said where the tip has left."""
    n = 200
    cycle = contact.push_cycle_tip(
        rng.uniform(-0.7, 0.7, n),
        0.07 * OUT_AND_BACK,
        distance=0.2,
        friction=rng.uniform(0.0, 0.5, n),
        radius_along=0.02,
        radius_across=rng.choice([-0.05, 0.005, 0.05, np.inf, 0.0], n),
        tilt=np.radians(tilt),
    )
    for values in (cycle.delta, cycle.moment_angle, cycle.slide):
        assert np.all(np.isfinite(values))
    assert np.all(np.diff(cycle.slipped_off.astype(int), axis=1) >= 0)


def test_runaway_pushes_slip_off():
    """A ball smaller than half the depth of the push, pushed outside the cone, is left."""
    q = np.array([0.3, 4.0])
    cycle = contact.push_cycle_tip(
        np.radians(30.0),
        0.08 * OUT_AND_BACK,
        distance=0.2,
        friction=0.1,
        radius_along=np.inf,
        radius_across=q * 0.08 * 0.2,
        tilt=0.4,
    )
    assert cycle.slipped_off[:, 15].tolist() == [True, False]


def test_a_step_that_does_not_turn_changes_nothing():
    """The same angle again is answered with the same force, to 1e-5 (the axial force is a step late)."""
    cycle = contact.push_cycle_tip(
        0.2,
        [0.02, 0.04, 0.04, 0.03, 0.03],
        distance=0.2,
        friction=0.2,
        radius_along=0.05,
        radius_across=0.05,
        tilt=0.5,
    )
    for twice in ((1, 2), (3, 4)):
        assert cycle.moment_angle[twice[0]] == pytest.approx(cycle.moment_angle[twice[1]], rel=1e-5)
        assert cycle.delta[twice[0]] == pytest.approx(cycle.delta[twice[1]], abs=1e-4)


def test_sides_and_tips_are_answered_as_alone(rng):
    """In one call of :func:`contour.contact.push_cycle_mixed` each is what its own function says."""
    n = 40
    eps, ends = rng.uniform(-0.4, 0.4, n), rng.random(n) < 0.5
    path = 0.05 * OUT_AND_BACK
    common = {"distance": 0.2, "friction": 0.2, "radius_across": rng.uniform(0.05, 0.2, n)}
    tilt = rng.uniform(-0.7, 0.7, n)
    both = contact.push_cycle_mixed(eps, path, **common, radius_along=0.03, ridge=0.1, tilt=tilt, tip=ends)
    side = contact.push_cycle(eps, path, **common, radius_along=0.03)
    end = contact.push_cycle_tip(eps, path, **common, radius_along=0.1, tilt=tilt)
    for name in ("delta", "moment_angle", "slide", "arc_length", "slipped_off"):
        wanted = np.where(ends[:, None], getattr(end, name), getattr(side, name))
        np.testing.assert_array_equal(getattr(both, name), wanted)
