"""The ladder of forward models: the cheapest rung that holds the tolerance, and what each rung is for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from contour.contacts import Kind
from contour.errors import UsageError
from contour.ladder import RUNGS, Ladder, Rung, choose
from contour.virtual import TrueContact

TOLERANCE = 1e-3
"""The default of a scene: of the force, over its largest in the push."""
SHARES = np.concatenate((np.linspace(0.0, 1.0, 11), np.linspace(0.9, 0.0, 10)))
"""Of the peak angle, out and back."""
FINE = np.interp(np.linspace(0.0, 20.0, 67), np.arange(21.0), SHARES)
"""The same in as many steps as a simulated push has."""


def contacts(distance, **others):
    """Contacts at ``distance`` (n,) [m] on flat edges, unless told otherwise."""
    distance = np.atleast_1d(np.asarray(distance, dtype=np.float64))
    n = distance.size
    values = {
        "distance": distance,
        "outward": np.full(n, np.pi),
        "tilt": np.zeros(n),
        "kind": np.full(n, np.int8(Kind.SIDE)),
        "radius_along": np.zeros(n),
        "radius_across": np.full(n, np.inf),
        "friction": np.full(n, np.tan(np.deg2rad(10.0))),
        "point": np.zeros((n, 3)),
        "normal": np.zeros((n, 3)),
        "body": np.zeros(n, dtype=np.int64),
        "region": np.full(n, np.int8(-1)),
        "extent": np.full(n, np.inf),
        "depth": np.zeros(n),
    }
    given = {name: np.broadcast_to(np.asarray(value), n).copy() for name, value in others.items()}
    return TrueContact(**{**values, **given})


def no_silhouette(rows, reach):
    """For contacts whose radii say it all."""
    raise AssertionError(rows, reach)


def force(rung, contact, eps, peak, silhouette=no_silhouette, shares=SHARES):
    """Force over 3 EI/s as complex numbers (n, k): size |M| s/(3 EI), direction -delta; and the ladder."""
    ladder = Ladder(rung, TOLERANCE, silhouette)
    eps, peak = (
        np.broadcast_to(np.asarray(v, dtype=np.float64), contact.distance.shape) for v in (eps, peak)
    )
    moment, delta = ladder(contact, eps, peak[:, None] * shares, np.arange(eps.size))
    return moment * np.exp(-1j * delta), ladder


def error(one, exact):
    """(n,) largest difference over the largest force of the push."""
    return np.abs(one - exact).max(axis=1) / np.abs(exact).max(axis=1)


def test_unknown_rungs_are_refused_by_name():
    """The message lists those there are."""
    with pytest.raises(
        UsageError, match="rung 'exact' is not known: use one of auto, edge, reduced, profile, elas"
    ):
        Ladder("exact", TOLERANCE, no_silhouette)
    assert RUNGS == ("auto", "edge", "reduced", "profile", "elastica")


def test_automatic_choice_holds_the_tolerance(rng):
    """Over contacts of all kinds a scan meets, the rung chosen is within the tolerance of the exact rod.

    The reduced rod always; the edge's bound is fitted, and 1 in 100 may exceed it by a third.
    """
    n = 600
    shape = rng.integers(0, 3, n)
    across = np.select(
        [shape == 0, shape == 1], [np.full(n, np.inf), rng.uniform(0.02, 0.1, n)], -rng.uniform(0.03, 0.1, n)
    )
    contact = contacts(
        rng.uniform(0.04, 0.2, n),
        radius_along=np.where(rng.random(n) < 0.4, 0.0, rng.uniform(0.0, 0.1, n)),
        radius_across=across,
        friction=np.tan(np.deg2rad(rng.choice([3.0, 10.0, 17.0, 25.0], n))),
    )
    eps = np.deg2rad(np.where(rng.random(n) < 0.5, rng.uniform(-5.0, 5.0, n), rng.uniform(-40.0, 40.0, n)))
    peak = np.deg2rad(rng.uniform(1.0, 4.0, n))
    exact, ladder = force("elastica", contact, eps, peak)
    assert ladder.unconverged == 0
    auto, ladder = force("auto", contact, eps, peak)
    off = error(auto, exact)
    for rung, share in ((Rung.EDGE, 0.01), (Rung.REDUCED, 0.0), (Rung.ELASTICA, 0.0)):
        rows = ladder.used == rung
        assert rows.any()
        assert np.mean(off[rows] > TOLERANCE) <= share
        assert off[rows].max() < TOLERANCE * 4.0 / 3.0


def tips(rng, n, tilt):
    """Tips on surfaces of every kind that lean by up to ``tilt`` [deg], with directions and peaks to push them."""
    kind = rng.integers(0, 3, n)
    radius = 10 ** rng.uniform(np.log10(0.005), np.log10(0.2), n)
    contact = contacts(
        np.full(n, 0.2),
        kind=np.int8(Kind.TIP),
        radius_along=10 ** rng.uniform(-2.3, 0.0, n),
        radius_across=np.select([kind == 0, kind == 1], [np.inf, -radius], radius),
        tilt=np.deg2rad(rng.uniform(-tilt, tilt, n)),
        friction=np.tan(np.deg2rad(rng.choice([3.0, 10.0, 17.0, 25.0], n))),
    )
    eps = np.deg2rad(np.where(rng.random(n) < 0.5, rng.uniform(-5.0, 5.0, n), rng.uniform(-40.0, 40.0, n)))
    return contact, eps, np.deg2rad(rng.uniform(1.0, 4.0, n))


def test_automatic_choice_holds_the_tolerance_for_tips(rng):
    """To 48 deg of lean: the reduced tip, where chosen, holds the tolerance (1 in 300 may be a third over); one push
    in seven at most takes the exact rung, which settles.
    """
    contact, eps, peak = tips(rng, 600, 48.0)
    exact, ladder = force("elastica", contact, eps, peak, shares=FINE)
    settled = ladder.used == Rung.ELASTICA
    assert ladder.unconverged <= 1
    auto, ladder = force("auto", contact, eps, peak, shares=FINE)
    reduced = ladder.used == Rung.REDUCED
    assert (~reduced).mean() < 1.0 / 7.0
    off = error(auto, exact)[reduced & settled]
    assert np.mean(off > TOLERANCE) < 1.0 / 300.0
    assert off.max() < TOLERANCE * 4.0 / 3.0
    # The choice is not idle: among the pushes sent on, the reduced tip misses the tolerance by far.
    sent = np.flatnonzero(~reduced & settled)
    near, _ = force("reduced", contact.take(sent), eps[sent], peak[sent], shares=FINE)
    assert error(near, exact[sent]).max() > 5.0 * TOLERANCE


def test_tips_are_chosen_by_what_the_reduced_one_leaves_out():
    """A ball as small as the push is deep; a surface that leans away, just outside the cone; neither is a plain tip."""
    contact = contacts(
        [0.2] * 4,
        kind=np.int8(Kind.TIP),
        radius_across=[np.inf, 0.008, np.inf, np.inf],
        tilt=np.deg2rad([45.0, 30.0, -45.0, 45.0]),
        friction=np.tan(np.deg2rad([10.0, 10.0, 20.0, 20.0])),
    )
    eps = np.deg2rad([3.0, 30.0, 30.0, 30.0])
    rungs = choose(contact, eps, np.full(4, np.deg2rad(4.0)), TOLERANCE)
    np.testing.assert_array_equal(rungs, [Rung.REDUCED, Rung.ELASTICA, Rung.ELASTICA, Rung.REDUCED])


def test_an_edge_needs_no_more_than_closed_forms():
    """A sharp flat edge pushed along its normal: the edge's forms are right, and chosen."""
    contact = contacts(0.1)
    exact, _ = force("elastica", contact, 0.0, 0.05)
    auto, ladder = force("auto", contact, 0.0, 0.05)
    assert ladder.used[0] == Rung.EDGE
    assert error(auto, exact)[0] < TOLERANCE


@pytest.mark.parametrize(
    "numbers,eps",
    [({"radius_along": 0.03}, 0.0), ({"radius_across": 0.02}, 20.0), ({}, 20.0)],
    ids=["round along", "round across", "slides"],
)
def test_what_the_edge_leaves_out_takes_the_reduced_rod(numbers, eps):
    """Curvature along or across the beam, or a slide: the edge is wrong by more than the tolerance, the rod is not."""
    contact, eps, peak = contacts(0.1, **numbers), np.deg2rad(eps), np.deg2rad(3.0)
    exact, _ = force("elastica", contact, eps, peak)
    assert error(force("edge", contact, eps, peak)[0], exact)[0] > 2.0 * TOLERANCE
    auto, ladder = force("auto", contact, eps, peak)
    assert ladder.used[0] == Rung.REDUCED
    assert error(auto, exact)[0] < TOLERANCE


def test_a_small_body_pushed_hard_takes_the_exact_rod():
    """Lateral radius under the depth of the push, outside the cone: the reduced rod is beyond the tolerance."""
    contact, eps, peak = contacts(0.1, radius_across=6.5e-3), np.deg2rad(25.0), np.deg2rad(4.0)
    contact = replace(contact, friction=np.full(1, np.tan(np.deg2rad(17.0))))
    exact, ladder = force("elastica", contact, eps, peak)
    assert ladder.unconverged == 0
    assert error(force("reduced", contact, eps, peak)[0], exact)[0] > TOLERANCE
    assert force("auto", contact, eps, peak)[1].used[0] == Rung.ELASTICA


def test_a_slide_past_the_end_of_a_face_takes_its_silhouette():
    """A flat face that ends 1 mm aside: the force turns at its corner, which no radius at the contact can tell."""
    contact, eps, peak = contacts(0.1, extent=1e-3), np.deg2rad(30.0), np.deg2rad(4.0)
    asked = []

    def corner(rows, reach):
        """Flat to 1 mm on both sides, then down at 45 deg."""
        asked.append((rows.copy(), reach.copy()))
        offsets = reach[:, None] * np.linspace(-1.0, 1.0, 401)
        return offsets, -np.maximum(np.abs(offsets) - 1e-3, 0.0)

    auto, ladder = force("auto", contact, eps, peak, corner)
    assert ladder.used[0] == Rung.PROFILE
    rows, reach = asked[0]
    np.testing.assert_array_equal(rows, [0])
    flat, _ = force("reduced", contact, eps, peak)
    assert error(flat, auto)[0] > 10.0 * TOLERANCE
    # The silhouette is asked for as far as the contact slides: all of the push beyond the cone, some 3 mm.
    assert 2.5e-3 < reach[0] < 6e-3
    # On a silhouette that goes on flat the rung is the reduced rod.
    same, _ = force(
        "profile", contact, eps, peak, lambda _, r: (r[:, None] * np.linspace(-1, 1, 401), np.zeros((1, 401)))
    )
    assert error(same, flat)[0] < TOLERANCE


def test_rungs_are_noted_for_the_rows_they_answered():
    """Rows that are asked again keep the rest; rows never asked stay at -1."""
    ladder = Ladder("auto", TOLERANCE, no_silhouette)
    contact = contacts([0.1, 0.1], radius_along=[0.0, 0.03])
    path = 0.05 * np.tile(SHARES, (2, 1))
    ladder(contact, np.zeros(2), path, np.array([4, 1]))
    np.testing.assert_array_equal(ladder.used, [-1, Rung.REDUCED, -1, -1, Rung.EDGE])
    ladder(contact.take(np.array([1])), np.zeros(1), path[:1], np.array([4]))
    np.testing.assert_array_equal(ladder.used, [-1, Rung.REDUCED, -1, -1, Rung.REDUCED])


@pytest.mark.parametrize("rung", ["edge", "reduced", "elastica"])
def test_answers_do_not_depend_on_company(rung, rng):
    """A push is answered the same bit for bit alone and with others, sides and tips among them."""
    n = 24
    contact = contacts(
        rng.uniform(0.05, 0.2, n),
        radius_along=rng.uniform(0.0, 0.05, n),
        radius_across=rng.uniform(0.02, 0.1, n),
        kind=np.where(np.arange(n) % 3 == 0, np.int8(Kind.TIP), np.int8(Kind.SIDE)),
    )
    eps = rng.uniform(-0.3, 0.3, n)
    together, _ = force(rung, contact, eps, 0.05)
    for i in range(n):
        alone, _ = force(rung, contact.take(np.array([i])), eps[i], 0.05)
        np.testing.assert_array_equal(alone[0], together[i])


def test_tips_are_answered_as_tips():
    """Never by the edge or a silhouette; beside a side contact they keep their own mechanics."""
    contact = contacts(
        [0.2, 0.2], kind=[np.int8(Kind.SIDE), np.int8(Kind.TIP)], radius_along=[0.02, 0.02], tilt=[0.0, 0.6]
    )
    both, ladder = force("reduced", contact, 0.1, 0.05)
    np.testing.assert_array_equal(ladder.used, Rung.REDUCED)
    assert error(both[1:], both[:1])[0] > TOLERANCE
    _, ladder = force("edge", contact.take(np.array([1])), 0.1, 0.05)
    assert ladder.used[0] == Rung.REDUCED


def test_pushes_that_slip_off_feel_nothing_more():
    """A push of 45 deg on a body smaller than its depth leaves it: the moment ends, in the middle of the push."""
    contact = contacts(0.15, radius_across=2e-3)
    answer, _ = force("reduced", contact, np.deg2rad(45.0), np.deg2rad(5.0))
    lost = np.abs(answer[0]) == 0.0
    assert lost[10]
    assert not lost[1]


def test_pushes_the_exact_rod_cannot_follow_are_answered_by_the_reduced_one(monkeypatch):
    """They are counted, and their rung is the one that answered."""
    from contour import elastica

    follow = elastica.push_cycle

    def stuck(*args, **kwargs):
        cycle = follow(*args, **kwargs)
        converged = cycle.converged.copy()
        converged[1, 5:] = False
        return replace(cycle, converged=converged)

    monkeypatch.setattr(elastica, "push_cycle", stuck)
    contact = contacts([0.1, 0.12, 0.14], radius_along=0.02)
    answer, ladder = force("elastica", contact, 0.1, 0.05)
    assert ladder.unconverged == 1
    np.testing.assert_array_equal(ladder.used, [Rung.ELASTICA, Rung.REDUCED, Rung.ELASTICA])
    reduced, _ = force("reduced", contact, 0.1, 0.05)
    np.testing.assert_array_equal(answer[1], reduced[1])


def test_a_looser_tolerance_takes_cheaper_rungs():
    """The choice falls, or stays, as the tolerance grows."""
    contact = contacts(np.linspace(0.05, 0.2, 40), radius_along=np.linspace(0.0, 0.1, 40), radius_across=0.03)
    eps, peak = np.linspace(-0.5, 0.5, 40), np.full(40, 0.05)
    tight, loose = (choose(contact, eps, peak, tolerance) for tolerance in (1e-4, 2e-2))
    assert np.all(loose <= tight)
    assert np.any(loose < tight)
