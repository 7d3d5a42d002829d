"""Plans from a bounding box: directions, levels, first contacts and the gantry's reach."""

from __future__ import annotations

import numpy as np
import pytest

from contour.antenna import Antenna, Beam
from contour.errors import LimitViolation, UsageError
from contour.frames import Mount, joint_angles
from contour.plan import LARGEST_TILT, Plan, Reach, default_plan, levels_plan, orientation_plan

BOX = np.array([[-0.1, -0.06, 0.02], [0.1, 0.06, 0.12]])
"""An object of 200 mm, off the origin [m]."""
ANTENNA = Antenna()
LENGTH = ANTENNA.beam.length


def tilted_mount():
    """A base that hangs upside down and a little askew."""
    c, s = np.cos(0.3), np.sin(0.3)
    return Mount(np.array([[1.0, 0.0, 0.0], [0.0, -c, s], [0.0, -s, -c]]), np.array([0.1, -0.2, 0.9]))


def corners(box):
    """(8, 3) m."""
    return np.array([[box[i, 0], box[j, 1], box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


def plane_axes(plan: Plan, mount: Mount):
    """(n, 3, 2) x_s and z_s in the world."""
    return mount.rotation_world_sensor(mount.poses(np.zeros((plan.contours, 3)), plan.direction))[
        :, :, [0, 2]
    ]


@pytest.mark.parametrize("mount", [Mount.identity(), tilted_mount()], ids=["upright", "hanging"])
@pytest.mark.parametrize("contours", [1, 7, 60, 256])
def test_every_contour_starts_outside_the_box_and_ends_beyond_it(mount, contours):
    """The line of first contact begins and ends clear of the box's shadow and passes through its middle part."""
    plan = default_plan(BOX, ANTENNA, mount, contours=contours)
    assert 0.8 * contours <= plan.contours <= contours
    shadow = np.einsum("cj,njk->nck", corners(BOX), plane_axes(plan, mount))
    along = np.einsum("nck,nk->nc", shadow - plan.start[:, None], plan.heading)
    assert np.all(along.min(axis=1) > 2.0 * ANTENNA.beam.radius)
    assert np.all(along.max(axis=1) < plan.travel)
    aside = np.einsum("nck,nk->nc", shadow - plan.start[:, None], plan.heading[:, ::-1] * [-1.0, 1.0])
    assert np.all((aside.min(axis=1) < 0.0) & (aside.max(axis=1) > 0.0))


def test_the_base_stays_a_tenth_of_the_beam_off_the_box():
    """Contacts nearer than 0.1 L cannot happen: no corner of the box is less deep than that."""
    plan = default_plan(BOX, ANTENNA, Mount.identity(), contours=120)
    depth = corners(BOX) @ plan.direction.T - plan.level
    assert depth.min() >= 0.1 * LENGTH - 1e-12
    # And the tip gets into the box: something can be touched.
    assert np.all(depth.min(axis=0) < LENGTH)


def test_directions_avoid_the_singularity_and_blind_tips():
    """The inner joint keeps within 50 deg; no direction is nearer than 30 deg to the normal of a face of the box."""
    plan = default_plan(BOX, ANTENNA, tilted_mount(), contours=256)
    _, phi2 = joint_angles(plan.direction @ tilted_mount().rotation)
    assert np.abs(phi2).max() <= np.deg2rad(50.0) + 1e-12
    tilt = np.arcsin(np.abs(plan.direction).max(axis=1))
    assert tilt.max() <= np.deg2rad(60.0) + 1e-6


def test_directions_look_from_all_sides():
    """Whatever way a face points, some direction tips it at 30 to 90 deg off its normal, from outside."""
    plan = default_plan(BOX, ANTENNA, Mount.identity())
    rng = np.random.default_rng(1)
    normal = rng.standard_normal((500, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    facing = -normal @ plan.direction.T
    assert np.all(((facing > 0.05) & (facing < np.cos(np.deg2rad(30.0)))).any(axis=1))


def test_levels_cut_the_half_that_faces_the_base():
    """Of each direction, the planes of the tip lie apart, before the middle, but for the last one."""
    plan = default_plan(BOX, ANTENNA, Mount.identity())
    half, centre = 0.5 * (BOX[1] - BOX[0]), 0.5 * (BOX[0] + BOX[1])
    depth = (plan.level + LENGTH - plan.direction @ centre) / np.sqrt(plan.direction**2 @ half**2)
    for direction in np.unique(plan.direction, axis=0):
        of_it = np.sort(depth[np.all(plan.direction == direction, axis=1)])
        assert of_it.size == 3
        assert of_it[0] == pytest.approx(-np.sin(LARGEST_TILT))
        assert np.all(np.diff(of_it) > 0.1)
        assert np.all(of_it[:-1] < 0.0)


def test_contacts_of_a_ball_number_as_promised():
    """The docstring's 1000 to 3000 contacts for an object of 200 mm: sections of a ball over the step."""
    ball = np.array([[-0.1] * 3, [0.1] * 3])
    plan = default_plan(ball, ANTENNA, Mount.identity())
    depth = np.minimum(plan.level + LENGTH, 0.0)
    contacts = 2.0 * np.pi * np.sqrt(0.01 - depth**2).sum() / plan.step
    assert plan.step == pytest.approx(0.2 / 16)
    assert 1000 < contacts < 3000


def test_only_what_the_gantry_reaches_is_planned():
    """Within tight axis limits all starts are reachable, joints included; there are other directions instead."""
    reach = Reach(lower=np.array([-0.4, -0.5, 0.0, -2.0, -0.7]), upper=np.array([0.4, 0.1, 0.5, 2.0, 0.7]))
    mount = Mount.identity()
    plan = default_plan(BOX, ANTENNA, mount, reach)
    axes = plane_axes(plan, mount)
    for share in (0.0, 1.0):
        u = plan.start + share * plan.travel[:, None] * plan.heading
        base = np.einsum("njk,nk->nj", axes, u) + plan.level[:, None] * plan.direction
        assert np.all((base >= reach.lower[:3] - 1e-9) & (base <= reach.upper[:3] + 1e-9))
    phi1, phi2 = joint_angles(plan.direction)
    assert np.all(np.abs(phi1) < 2.0)
    assert np.all(np.abs(phi2) < 0.7)
    assert plan.contours >= 30


def test_neither_base_nor_tip_starts_under_the_floor():
    """With the object standing on a floor the lines of first contact stay above it."""
    mount = Mount.identity()
    plan = default_plan(BOX, ANTENNA, mount, Reach.unlimited(floor=0.02))
    axes = plane_axes(plan, mount)
    for share in (0.0, 1.0):
        u = plan.start + share * plan.travel[:, None] * plan.heading
        base = np.einsum("njk,nk->nj", axes, u) + plan.level[:, None] * plan.direction
        tip = base + LENGTH * plan.direction
        assert min(base[:, 2].min(), tip[:, 2].min()) >= 0.02 - 1e-9


def test_half_planes_are_the_limits():
    """A u <= b holds exactly where the base is within its limits and base and tip are above the floor."""
    rng = np.random.default_rng(2)
    mount = tilted_mount()
    reach = Reach(
        lower=np.array([-0.3, -0.4, -0.2, -9, -9]), upper=np.array([0.5, 0.3, 0.6, 9, 9]), floor=0.1
    )
    direction = np.array([[0.6, 0.64, 0.48], [-0.8, 0.0, 0.6]])
    level = np.array([-0.1, 0.05])
    rotation = mount.rotation_world_sensor(mount.poses(np.zeros((2, 3)), direction))
    a, b = reach.half_planes(rotation, level, LENGTH, mount)
    u = rng.uniform(-0.8, 0.8, (400, 2, 2))
    world = np.einsum("njk,qnk->qnj", rotation[:, :, [0, 2]], u) + level[:, None] * direction
    base = (world - mount.origin) @ mount.rotation
    within = ((base >= reach.lower[:3]) & (base <= reach.upper[:3])).all(axis=2)
    within &= np.minimum(world[..., 2], world[..., 2] + LENGTH * direction[:, 2]) >= 0.1
    assert np.array_equal(within, (np.einsum("nck,qnk->qnc", a, u) <= b).all(axis=2))
    assert 0 < within.sum() < within.size


def test_several_starts_share_their_plane():
    """Three starts of one outline come from different sides and are followed one after the other."""
    plan = default_plan(BOX, ANTENNA, Mount.identity(), contours=60, starts=3)
    for number in np.unique(plan.plane):
        rows = np.flatnonzero(plan.plane == number)
        assert rows.size == 3
        assert np.unique(plan.level[rows]).size == 1
        turns = plan.heading[rows] @ plan.heading[rows].T
        assert turns[~np.eye(3, dtype=bool)].max() < 0.8


def test_levels_put_the_tip_where_asked():
    """Levels along one axis: the tip's coordinate along it is the height."""
    plan = levels_plan([0.0, 1.0, 0.0], [-0.05, 0.0, 0.03], BOX, ANTENNA, Mount.identity())
    assert np.allclose(plan.level + LENGTH, [-0.05, 0.0, 0.03])
    assert np.allclose(plan.direction, [0.0, 1.0, 0.0])
    assert plan.label == ("level -50.0 mm", "level 0.0 mm", "level 30.0 mm")


def test_orientations_go_as_deep_as_the_box_allows():
    """One silhouette a direction, the base 0.1 L before the box."""
    plan = orientation_plan([[0.0, 2.0, 0.0], [1.0, 0.0, 0.0]], BOX, ANTENNA, Mount.identity(), step=0.004)
    assert np.allclose(plan.level, [-0.06 - 0.1 * LENGTH, -0.1 - 0.1 * LENGTH])
    assert plan.step == pytest.approx(0.004)


def test_taking_rows_keeps_them_whole():
    """A part of a plan is a plan."""
    plan = default_plan(BOX, ANTENNA, Mount.identity())
    part = plan.take(np.array([5, 2]))
    assert part.contours == 2
    assert part.label == (plan.label[5], plan.label[2])
    assert np.array_equal(part.start, plan.start[[5, 2]])


@pytest.mark.parametrize(
    "call, words",
    [
        (
            lambda: default_plan([[0, 0, 0], [np.nan, 1, 1]], ANTENNA, Mount.identity()),
            "bounds must be finite",
        ),
        (lambda: default_plan([[0, 0, 0], [0, 0, 0]], ANTENNA, Mount.identity()), "single point"),
        (lambda: default_plan(BOX, ANTENNA, Mount.identity(), step=-1.0), "step is"),
        (lambda: default_plan(BOX, ANTENNA, Mount.identity(), contours=0), "at least one contour"),
        (lambda: default_plan(10.0 * BOX, ANTENNA, Mount.identity()), "out of the beam's reach"),
        (
            lambda: default_plan(
                BOX,
                ANTENNA,
                Mount.identity(),
                Reach(lower=np.array([5.0, 5.0, 5.0, -3.0, -1.0]), upper=np.array([6.0, 6.0, 6.0, 3.0, 1.0])),
            ),
            "out of the beam's reach",
        ),
        (lambda: levels_plan([0, 1, 0], [0.2], BOX, ANTENNA, Mount.identity()), "heights reach"),
        (
            lambda: orientation_plan([[0, 0, 0]], BOX, ANTENNA, Mount.identity()),
            "directions must be non-zero",
        ),
        (lambda: Reach(lower=np.zeros(5), upper=np.zeros(5)), "reach of axis X is empty"),
        (lambda: Reach(lower=np.zeros(3), upper=np.ones(5)), "reach lower must be five numbers"),
    ],
    ids=["nan", "point", "step", "none", "large", "far", "deep", "zero", "empty", "short"],
)
def test_bad_input_is_refused_in_one_line(call, words):
    """The message names the thing; there is one line of it."""
    with pytest.raises(UsageError, match=words) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_directions_at_the_singularity_are_refused():
    """Beams along the outer axis cannot be planned."""
    with pytest.raises(LimitViolation):
        orientation_plan([[0.0, 0.0, 1.0]], BOX, ANTENNA, Mount.identity())


def test_a_short_beam_shares_out_what_it_reaches():
    """Where the beam cannot get through, levels divide the depth that it has."""
    short = Antenna(beam=Beam(length=0.12))
    plan = default_plan(BOX, short, Mount.identity())
    depth = corners(BOX) @ plan.direction.T - plan.level
    assert depth.min() >= 0.1 * 0.12 - 1e-12
