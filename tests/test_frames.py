"""Poses, the nested gimbal, pushes along great circles, the mount."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from contour.errors import LimitViolation, UsageError
from contour.frames import (
    SINGULAR_MARGIN,
    Mount,
    beam_direction,
    carried_push,
    great_circle,
    joint_angles,
    nested_theta,
    plane_angle,
    plane_direction,
    rotation_base_sensor,
    spun_push,
    wrap_angle,
)

ROUNDING = 1e-12
"""A few operations on numbers of order one keep at least this many digits."""


def _joints(rng, n, steepest=80.0):
    """Joint angles of ``n`` poses away from the singularity."""
    return np.column_stack((rng.uniform(-np.pi, np.pi, n), np.deg2rad(rng.uniform(-steepest, steepest, n))))


def _random_mount(rng):
    return Mount(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))


def test_gimbal_is_outer_about_z_then_inner_about_x(rng):
    """Rz(phi1) Rx(phi2), as scipy builds it from intrinsic turns."""
    joints = _joints(rng, 50)
    expected = Rotation.from_euler("ZX", joints).as_matrix()
    np.testing.assert_allclose(rotation_base_sensor(*joints.T), expected, atol=ROUNDING)


def test_beam_lies_along_y_of_the_sensor(rng):
    """The beam's direction is the second column of the sensor's rotation."""
    joints = _joints(rng, 50)
    np.testing.assert_allclose(
        beam_direction(*joints.T), rotation_base_sensor(*joints.T)[:, :, 1], atol=ROUNDING
    )


def test_joint_angles_invert_the_beam_direction(rng):
    """Every reachable direction is reached, by the joints that it came from."""
    joints = _joints(rng, 200, 84.0)
    # Near phi2 = 84 deg the arc sine loses 1/cos = 10 times the rounding.
    np.testing.assert_allclose(
        np.column_stack(joint_angles(beam_direction(*joints.T))), joints, atol=1e-13 * 100
    )


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_directions_near_the_outer_axis_are_refused(sign):
    """Within the margin of phi2 = +-90 deg the message gives the angle, the one allowed and a remedy."""
    inside, outside = np.pi / 2 - 0.99 * SINGULAR_MARGIN, np.pi / 2 - 1.01 * SINGULAR_MARGIN
    joint_angles(beam_direction(0.3, sign * outside))
    with pytest.raises(LimitViolation, match=r"85\.\d deg off .* allowed is 85\.0 deg .* mount the base"):
        joint_angles(beam_direction(0.3, sign * inside))


def test_wrapped_angles_are_the_same_angles(rng):
    """In [-pi, pi), and a whole number of turns away."""
    angle = rng.uniform(-50.0, 50.0, 1000)
    wrapped = wrap_angle(angle)
    assert np.all((wrapped >= -np.pi) & (wrapped < np.pi))
    turns = (angle - wrapped) / (2.0 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-12)
    assert wrap_angle(np.pi) == -np.pi


def test_angles_in_the_sensing_plane_run_from_x_to_z(rng):
    """phi = 0 is x_s, 90 deg is z_s, a negative turn about the beam; the angle of the direction is phi."""
    rotation = rotation_base_sensor(*_joints(rng, 30).T)
    np.testing.assert_allclose(plane_direction(np.zeros(30), rotation), rotation[:, :, 0], atol=ROUNDING)
    np.testing.assert_allclose(
        plane_direction(np.full(30, np.pi / 2), rotation), rotation[:, :, 2], atol=ROUNDING
    )
    phi = rng.uniform(-np.pi, np.pi, 30)
    turned = Rotation.from_rotvec(-phi[:, None] * rotation[:, :, 1]).apply(rotation[:, :, 0])
    np.testing.assert_allclose(plane_direction(phi, rotation), turned, atol=ROUNDING)
    # What lies along the beam does not count.
    tilted = 0.4 * plane_direction(phi, rotation) + 3.0 * rotation[:, :, 1]
    np.testing.assert_allclose(plane_angle(tilted, rotation), phi, atol=ROUNDING)


def test_great_circle_turns_about_the_axis_square_to_it(rng):
    """The direction after theta is a turn about beam x phi, as a rotation vector makes it."""
    rotation = rotation_base_sensor(*_joints(rng, 20).T)
    phi, theta = rng.uniform(-np.pi, np.pi, 20), rng.uniform(0.0, 0.3, (20, 4))
    axis = np.cross(rotation[:, :, 1], plane_direction(phi, rotation))
    found = great_circle(rotation, phi, theta)
    for k in range(4):
        turned = Rotation.from_rotvec(theta[:, k, None] * axis).apply(rotation[:, :, 1])
        np.testing.assert_allclose(found[:, k], turned, atol=ROUNDING)


def test_nested_theta_is_the_angle_between_the_beams():
    """Small turns of both joints turn the beam by nested_theta, to second order."""
    phi2, step = np.deg2rad(np.array([-60.0, 0.0, 30.0, 75.0])), 1e-4
    before, after = beam_direction(0.2, phi2), beam_direction(0.2 + step, phi2 - 0.7 * step)
    angle = np.arcsin(np.linalg.norm(np.cross(before, after), axis=1))
    # The error is of the order step tan(phi2), relative.
    np.testing.assert_allclose(angle, nested_theta(phi2, step, -0.7 * step), rtol=4.0 * step)


def test_printed_equation_12_misplaces_the_contact_by_15_percent():
    """At phi2 = 30 deg a turn of the outer axis counts 1/cos(30 deg) too much: s is 15.5 % off."""
    turn = 0.01
    printed = np.hypot(turn, 0.0)
    assert printed / nested_theta(np.deg2rad(30.0), turn, 0.0) == pytest.approx(
        1.0 / np.cos(np.pi / 6.0), rel=1e-12
    )


def _carried_frame(touch, joints):
    """Sensor axes at touch, taken along by the smallest turn of the beam, and the sensor's own; (m, 3, 3)."""
    before, now = rotation_base_sensor(*touch.T), rotation_base_sensor(*joints.T)
    axis = np.cross(before[:, :, 1], now[:, :, 1])
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, np.sum(before[:, :, 1] * now[:, :, 1], axis=1))
    smallest = Rotation.from_rotvec(axis * (angle / np.maximum(sine, 1e-300))[:, None]).as_matrix()
    return smallest @ before, now


def test_carried_push_takes_the_spin_out(rng):
    """Force and angle agree with rotation matrices: the smallest turn of the beam carries the frame along."""
    touch = _joints(rng, 300, 70.0)
    joints = touch + rng.uniform(-0.15, 0.15, touch.shape)
    phi, moment = rng.uniform(-np.pi, np.pi, 300), rng.normal(size=(300, 2))
    found = carried_push(*joints.T, moment, touch=touch, phi=phi)
    carried, now = _carried_frame(touch, joints)
    # m = s y x f, so s f = m x y.
    world = now @ np.column_stack((-moment[:, 1], np.zeros(300), moment[:, 0]))[..., None]
    force = (carried.transpose(0, 2, 1) @ world)[..., 0]
    np.testing.assert_allclose(found.force, force[:, [0, 2]], atol=1e-10)
    np.testing.assert_allclose(force[:, 1], 0.0, atol=1e-10)
    before = rotation_base_sensor(*touch.T)
    push, aside = plane_direction(phi, before), plane_direction(phi + np.pi / 2, before)
    beam = now[:, :, 1]
    ahead = np.arctan2(np.sum(beam * push, axis=1), np.sum(beam * before[:, :, 1], axis=1))
    np.testing.assert_allclose(found.theta, ahead, atol=1e-12)
    np.testing.assert_allclose(np.sin(found.sideways), np.sum(beam * aside, axis=1), atol=1e-12)


def test_spin_is_about_sin_phi2_times_the_outer_turn():
    """At phi2 = 40 deg a push by the outer axis turns the force it feels by sin(40 deg) of that turn."""
    touch, turn = np.deg2rad([[10.0, 40.0]]), np.deg2rad(2.0)
    joints = touch + np.array([[turn, 0.0]])
    force = carried_push(*joints.T, np.array([[0.0, -1.0]]), touch=touch, phi=np.array([np.pi])).force[0]
    spin = np.arctan2(force[1], force[0])
    # The direction also leaves the great circle by a part of second order in the turn.
    assert abs(spin) == pytest.approx(np.sin(np.deg2rad(40.0)) * turn, rel=2.0 * turn)


def test_spun_push_inverts_carried_push(rng):
    """Joints and moments made for a push along a great circle give back angle and force, and stay on it."""
    touch = _joints(rng, 500, 75.0)
    phi, theta = rng.uniform(-np.pi, np.pi, 500), rng.uniform(-0.15, 0.2, 500)
    force = rng.normal(size=(500, 2))
    joints, moment = spun_push(theta, force, touch=touch, phi=phi)
    back = carried_push(*joints.T, moment, touch=touch, phi=phi)
    # Up to 87 deg of phi2, where arc sine loses 1/cos(87 deg) = 20 times the rounding.
    np.testing.assert_allclose(back.theta, theta, atol=1e-12)
    np.testing.assert_allclose(back.sideways, 0.0, atol=1e-12)
    np.testing.assert_allclose(back.force, force, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(moment, axis=1), np.linalg.norm(force, axis=1), rtol=1e-12)


def test_spun_push_follows_the_great_circle(rng):
    """The joints of a push point the beam where great_circle says."""
    touch = _joints(rng, 60, 70.0)
    phi, theta = rng.uniform(-np.pi, np.pi, 60), rng.uniform(0.0, 0.2, 60)
    joints, _ = spun_push(theta, np.zeros((60, 2)), touch=touch, phi=phi)
    expected = great_circle(rotation_base_sensor(*touch.T), phi, theta[:, None])[:, 0]
    np.testing.assert_allclose(beam_direction(*joints.T), expected, atol=ROUNDING)


def test_forces_carry_their_signs():
    """A force towards +x_s is a negative moment about z_s, one towards +z_s a positive one about x_s."""
    none, phi = np.zeros((2, 2)), np.zeros(2)
    _, moment = spun_push(np.zeros(2), np.eye(2), touch=none, phi=phi)
    np.testing.assert_allclose(moment, [[0.0, -1.0], [1.0, 0.0]], atol=ROUNDING)


def test_mount_poses_put_the_beam_where_asked(rng):
    """Position and direction in the world come back from the pose, for any mount."""
    mount = _random_mount(rng)
    position = rng.normal(size=(40, 3))
    direction = beam_direction(*_joints(rng, 40).T) @ mount.rotation.T
    pose = mount.poses(position, direction)
    np.testing.assert_allclose(mount.position_world(pose), position, atol=1e-12)
    np.testing.assert_allclose(mount.rotation_world_sensor(pose)[:, :, 1], direction, atol=1e-12)


def test_identity_mount_changes_nothing():
    """Base and world coincide."""
    pose = Mount.identity().poses(np.array([[1.0, 2.0, 3.0]]), np.array([[0.0, 1.0, 0.0]]))
    np.testing.assert_allclose(pose, [[1.0, 2.0, 3.0, 0.0, 0.0]], atol=ROUNDING)


@pytest.mark.parametrize(
    "rotation",
    [np.diag([1.0, 1.0, -1.0]), 2.0 * np.eye(3), np.eye(2), np.array([[1.0, 0.1, 0], [0, 1, 0], [0, 0, 1]])],
    ids=["mirror", "scaled", "flat", "sheared"],
)
def test_mounts_that_are_no_rotation_are_refused(rotation):
    """Mirrors, scales, wrong shapes and shears: one line with the remedy."""
    with pytest.raises(UsageError, match="give three orthonormal right-handed axes"):
        Mount(rotation, np.zeros(3))


def test_mounts_keep_their_own_arrays():
    """What the caller changes later does not move the gantry, and the stored arrays are read-only."""
    rotation, origin = np.eye(3), np.zeros(3)
    mount = Mount(rotation, origin)
    rotation[0, 0] = origin[0] = 7.0
    assert mount.rotation[0, 0] == 1.0
    assert mount.origin[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        mount.origin[0] = 1.0
