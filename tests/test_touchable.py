"""What a beam could touch: convex bodies all round, insides only through their mouths, limits of the machine."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from contour.antenna import Antenna
from contour.frames import Mount
from contour.nearest import as_faces, sample_evenly
from contour.plan import default_plan, orientation_plan
from contour.reach import Reach
from contour.touchable import touchable

ANTENNA, MOUNT = Antenna(), Mount.identity()


def _cup(height=0.06, inner=0.025, outer=0.03, floor=0.005):
    """A cup that opens upwards, by turning its outline round z."""
    outline = [[0, 0], [outer, 0], [outer, height], [inner, height], [inner, floor], [0, floor]]
    return trimesh.creation.revolve(np.array(outline), sections=96)


def _asked(mesh, *, plan=None, reach=None, antenna=ANTENNA):
    vertices, faces = as_faces(np.array(mesh.triangles))
    samples = sample_evenly(vertices, faces, 4000, seed=0)
    plan = default_plan(mesh.bounds, antenna, MOUNT, reach) if plan is None else plan
    return samples, touchable(samples.points, samples.normals, np.array(mesh.triangles), plan, antenna, MOUNT)


def test_all_of_a_ball_can_be_touched():
    """A convex body within the beam's length."""
    _, found = _asked(trimesh.creation.icosphere(subdivisions=4, radius=0.05))
    assert found.all()


def test_nothing_in_a_closed_hollow_can():
    """A ball with a cavity: outside all, inside nothing."""
    inner = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    inner.invert()
    ball = trimesh.util.concatenate([trimesh.creation.icosphere(subdivisions=3, radius=0.05), inner])
    samples, found = _asked(ball)
    np.testing.assert_array_equal(found, np.linalg.norm(samples.points, axis=1) > 0.04)


def test_a_cups_inside_is_seen_through_its_mouth():
    """Outside all; the inner wall as deep as the steepest beam of the plan gets past the rim on the other side.

    A beam that falls by phi2 passes the opposite rim at most a diameter away: places deeper than 2 R tan(phi2)
    are out of its sight.
    """
    samples, found = _asked(_cup())
    plan = default_plan(_cup().bounds, ANTENNA, MOUNT)
    radius, height = np.linalg.norm(samples.points[:, :2], axis=1), samples.points[:, 2]
    outside = (radius > 0.0295) | (height < 1e-4)
    assert found[outside].all()
    wall = (np.abs(radius - 0.025) < 1e-4) & (np.abs(samples.normals[:, 2]) < 0.1)
    deepest = 2.0 * 0.025 * np.tan(np.arcsin(-plan.direction[:, 2].min()))
    under = 0.06 - height[wall]
    assert not found[wall][under > deepest].any()
    assert (under > deepest).any()
    assert found[wall][under < 0.25 * deepest].mean() > 0.95
    bottom = (radius < 0.024) & (np.abs(height - 0.005) < 1e-4)
    assert bottom.any()
    assert not found[bottom].any()


def test_a_lid_closes_the_cup():
    """A plate over its mouth leaves a slit of 0.5 mm, too thin for the beam of 0.8 mm: nothing inside any more."""
    lid = trimesh.creation.cylinder(radius=0.04, height=0.002)
    lid.apply_translation([0.0, 0.0, 0.0615])
    samples, found = _asked(trimesh.util.concatenate([_cup(), lid]))
    radius, height = np.linalg.norm(samples.points[:, :2], axis=1), samples.points[:, 2]
    inside = (radius < 0.0251) & (height < 0.0595) & (height > 0.004)
    assert inside.any()
    assert not found[inside].any()


def test_gaps_narrower_than_the_beam_are_closed():
    """Two plates face each other: places between them count if the beam's radius leaves room, not else."""
    for gap, wanted in ((0.3e-3, False), (4e-3, True)):
        plates = [trimesh.creation.box(extents=(0.1, 0.02, 0.1)) for _ in range(2)]
        plates[1].apply_translation([0.0, 0.02 + gap, 0.0])
        both = trimesh.util.concatenate(plates)
        plan = orientation_plan([[0.6, 0.02, 0.2]], both.bounds, ANTENNA, MOUNT)
        samples, found = _asked(both, plan=plan)
        between = (samples.normals[:, 1] > 0.9) & (samples.points[:, 1] < 0.011)
        assert between.any()
        assert found[between].any() == wanted


@pytest.mark.parametrize("slit,wanted", [(0.6e-3, False), (2e-3, True)])
def test_beams_do_not_fit_through_slits_thinner_than_they_are(slit, wanted):
    """A ball behind a plate with a slit: its flank is in sight, but the beam is 0.8 mm thick."""
    plates = [trimesh.creation.box(extents=(0.05, 0.002, 0.1)) for _ in range(2)]
    for plate, side in zip(plates, (-1.0, 1.0), strict=True):
        plate.apply_translation([0.0075 + side * (0.025 + 0.5 * slit), 0.0, 0.0])
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.01)
    ball.apply_translation([0.0, 0.03, 0.0])
    both = trimesh.util.concatenate([*plates, ball])
    plan = orientation_plan([[0.0, 1.0, 0.0]], both.bounds, ANTENNA, MOUNT)
    vertices, faces = as_faces(np.array(ball.triangles))
    samples = sample_evenly(vertices, faces, 20_000, seed=0)
    found = touchable(samples.points, samples.normals, np.array(both.triangles), plan, ANTENNA, MOUNT)
    assert found.any() == wanted
    assert not found[samples.points[:, 0] < 0.004].any()


def test_the_side_touches_only_what_is_square_to_the_beam():
    """One direction, along which a tip finds no room to stand: a ball's band of 5 deg, on both sides, no more."""
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.03)
    plan = orientation_plan([[1.0, 0.0, 0.0]], ball.bounds, ANTENNA, MOUNT)
    # X >= -0.15: a tip that stands at x > -0.03 needs its base at x - 0.21 < -0.15 for all of the near side.
    low = np.array([-0.15, -np.inf, -np.inf, -np.inf, -np.inf])
    limited = Reach(lower=low, upper=np.full(5, np.inf))
    samples, found = _asked(
        ball, plan=orientation_plan([[1.0, 0.0, 0.0]], ball.bounds, ANTENNA, MOUNT, limited)
    )
    lean = np.rad2deg(np.arcsin(np.clip(-samples.normals[:, 0], -1.0, 1.0)))
    np.testing.assert_array_equal(found, np.abs(lean) <= 5.0)
    _, free = _asked(ball, plan=plan)
    np.testing.assert_array_equal(free, (lean >= -5.0) & (lean <= 48.0))


def test_beams_do_not_go_deeper_than_they_are_long():
    """A long plate and a short beam: only as far from the edge as the base, a tenth of L off the box, leaves."""
    plate = trimesh.creation.box(extents=(0.6, 0.02, 0.02))
    plan = orientation_plan([[1.0, 0.0, 0.0]], plate.bounds, ANTENNA, MOUNT)
    samples, found = _asked(plate, plan=plan)
    flank = np.abs(samples.normals[:, 0]) < 0.1
    deep = samples.points[:, 0] + 0.3
    np.testing.assert_array_equal(found[flank], deep[flank] <= 0.9 * ANTENNA.beam.length)


@pytest.mark.parametrize("floor,wanted", [(-np.inf, True), (0.0, False)])
def test_the_floor_hides_the_underside(floor, wanted):
    """A box that stands on the floor: no base may go below, so nothing touches it from below."""
    box = trimesh.creation.box(extents=(0.06, 0.05, 0.04))
    box.apply_translation([0.0, 0.0, 0.02])
    samples, found = _asked(box, reach=Reach.unlimited(floor=floor))
    assert found[samples.normals[:, 2] < -0.9].all() == wanted
    assert found[samples.normals[:, 2] < -0.9].any() == wanted
    assert found[samples.normals[:, 2] > 0.9].all()
