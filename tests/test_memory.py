"""What a contour remembers: tangents from touches, friction from slides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from push_bench import Bench, true_contacts

from contour.antenna import Antenna
from contour.contacts import Contacts, Kind
from contour.frames import wrap_angle
from contour.information import BEND, LN_TAN_ALPHA, NU
from contour.memory import FRICTION, Memory

ANTENNA = Antenna()
RADIUS = 0.04
STEP = 0.1  # rad along the circle


def touched_at(angle: float, fresh: bool = False):
    """A touch of a circle at ``angle``, as the base would stand."""
    bench = Bench(true_contacts(1, outward=angle))
    here = RADIUS * np.array([[np.cos(angle), np.sin(angle)]])
    return replace(bench.touch(), base_in_plane=here, fresh=np.array([fresh]))


def contact_at(angle: float, flags: int = 0) -> Contacts:
    """The contact that belongs to :func:`touched_at`."""
    here = RADIUS * np.array([[np.cos(angle), np.sin(angle)]])
    one = np.ones(1)
    return Contacts(
        which=np.zeros(1, dtype=int), touch=here, point=np.zeros((1, 3)), normal=np.zeros((1, 3)),
        distance=0.1 * one, sigma_distance=1e-4 * one, outward=angle * one, sigma_normal=5e-3 * one,
        friction_angle=0.2 * one, sigma_friction=0.01 * one, radius_along=0.01 * one, curvature_across=25.0 * one,
        kind=np.array([Kind.SIDE], dtype=np.int8), pushes=np.ones(1, dtype=int), flags=np.array([flags]),
        machine_time=one, sequence=np.zeros(1, dtype=int),
    )  # fmt: skip


def remember(memory: Memory, angles, slid: bool = False, flags: int = 0) -> None:
    """Let the contour have had contacts at ``angles``."""
    for angle in angles:
        state = np.array([[np.log(0.1), angle + np.pi, -1.0, 0.1, 2.5]])
        memory.learn(contact_at(angle, flags), state, np.full((1, 5), 0.02), np.array([slid]))


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_two_touches_and_the_new_one_give_the_circles_normal_and_curvature(sense):
    """On a circle the parabola's normal is exact and its curvature that of the circle, whichever way one goes."""
    memory = Memory(1)
    remember(memory, [0.3, 0.3 + sense * STEP])
    prior, tangent = memory.prior(touched_at(0.3 + 2 * sense * STEP), ANTENNA)
    assert not tangent.corner[0]
    assert abs(wrap_angle(prior.mean[0, NU] - np.pi - (0.3 + 2 * sense * STEP))) < 1e-6
    assert prior.mean[0, BEND] == pytest.approx(0.1 / RADIUS, rel=0.01)
    assert prior.sigma[0, NU] < np.deg2rad(3.0)


def test_one_touch_mirrors_the_last_normal():
    """With a single earlier touch the chord mirrors its normal, which is exact on a circle too."""
    memory = Memory(1)
    remember(memory, [0.0])
    prior, _ = memory.prior(touched_at(STEP), ANTENNA)
    assert abs(wrap_angle(prior.mean[0, NU] - np.pi - STEP)) < 1e-6


def test_a_sharp_turn_is_a_corner_and_says_nothing_of_the_normal():
    """Chords that turn by half a right angle and more are not trusted."""
    memory = Memory(1)
    remember(memory, [0.0, STEP])
    touch = replace(touched_at(STEP), base_in_plane=RADIUS * np.array([[0.7, 0.1]]))
    _, tangent = memory.prior(touch, ANTENNA)
    assert tangent.corner[0]
    assert tangent.sigma[0] >= np.deg2rad(20.0)


def test_friction_is_learned_from_slides_alone():
    """A contact that stuck leaves the friction angle as unknown as it was; one that slid tells it."""
    memory = Memory(1)
    remember(memory, [0.0], slid=False)
    assert memory.friction[0] == FRICTION[0]
    remember(memory, [STEP], slid=True)
    prior, _ = memory.prior(touched_at(2 * STEP), ANTENNA)
    assert prior.mean[0, LN_TAN_ALPHA] == -1.0
    assert prior.sigma[0, LN_TAN_ALPHA] < 0.1


def test_a_flagged_contact_breaks_the_chain_of_touches():
    """After a flag the next chord would span an unknown piece: the tracer's word is all there is."""
    memory = Memory(1)
    remember(memory, [0.0, STEP])
    remember(memory, [2 * STEP], flags=2)
    _, tangent = memory.prior(touched_at(3 * STEP), ANTENNA)
    assert tangent.sigma[0] >= np.deg2rad(20.0)


def test_a_fresh_touch_forgets_the_contour_but_not_its_friction():
    """A new outline on the same body: normals are unknown again, friction is a rumour."""
    memory = Memory(1)
    remember(memory, [0.0, STEP], slid=True)
    memory.forget(np.array([0]))
    prior, _ = memory.prior(touched_at(1.0, fresh=True), ANTENNA)
    assert prior.sigma[0, NU] >= np.deg2rad(19.0)
    assert prior.mean[0, LN_TAN_ALPHA] == -1.0
    assert prior.sigma[0, LN_TAN_ALPHA] >= 0.15
