"""Poses, the two-axis gimbal, and pushes along great circles.

Frames: ``world``; ``base``, the gantry's (``T_world_base`` is part of the scene); ``sensor``, at the centre
of rotation with the undeformed beam along +y_s. A pose is (X, Y, Z, phi1, phi2) and

    T_base_sensor = Trans(X, Y, Z) Rz(phi1) Rx(phi2),

phi1 the outer axis about +Z of the base, phi2 the inner one about x_s. Directions in the sensing plane
Pi = span(x_s, z_s) are angles that run from +x_s to +z_s, which is a negative rotation about +y_s.

During a push the beam's direction runs along a great circle; the nested axes then spin the sensor about the
beam. :func:`carried_push` takes that spin out sample by sample, and its theta replaces the printed (12) of
Kaneko1998, which holds only while both axes are perpendicular to the beam.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contour.errors import LimitViolation, UsageError

__all__ = [
    "SINGULAR_MARGIN",
    "CarriedPush",
    "Mount",
    "beam_direction",
    "carried_push",
    "great_circle",
    "joint_angles",
    "nested_theta",
    "plane_angle",
    "plane_direction",
    "rotation_base_sensor",
    "spun_push",
    "wrap_angle",
]

FloatArray = NDArray[np.float64]

SINGULAR_MARGIN = np.deg2rad(5.0)
"""Poses nearer than this to phi2 = +-90 deg are refused: phi1 would have to turn without bound [rad]."""


def wrap_angle(angle: ArrayLike) -> FloatArray:
    """The same angle in [-pi, pi).

    >>> float(wrap_angle(np.deg2rad(190.0)) / np.pi * 180.0).__round__(6)
    -170.0
    """
    return np.mod(np.asarray(angle, dtype=np.float64) + np.pi, 2.0 * np.pi) - np.pi


def rotation_base_sensor(phi1: ArrayLike, phi2: ArrayLike) -> FloatArray:
    """Rotation (..., 3, 3) that maps sensor coordinates to base coordinates: Rz(phi1) Rx(phi2)."""
    phi1, phi2 = np.broadcast_arrays(np.asarray(phi1, dtype=np.float64), np.asarray(phi2, dtype=np.float64))
    c1, s1, c2, s2 = np.cos(phi1), np.sin(phi1), np.cos(phi2), np.sin(phi2)
    rotation = np.zeros((*phi1.shape, 3, 3))
    rotation[..., 0, 0], rotation[..., 0, 1], rotation[..., 0, 2] = c1, -s1 * c2, s1 * s2
    rotation[..., 1, 0], rotation[..., 1, 1], rotation[..., 1, 2] = s1, c1 * c2, -c1 * s2
    rotation[..., 2, 1], rotation[..., 2, 2] = s2, c2
    return rotation


def beam_direction(phi1: ArrayLike, phi2: ArrayLike) -> FloatArray:
    """Direction (..., 3) of the undeformed beam in the base frame.

    >>> np.round(beam_direction(np.pi / 2, 0.0), 12) + 0.0
    array([-1.,  0.,  0.])
    """
    phi1, phi2 = np.asarray(phi1, dtype=np.float64), np.asarray(phi2, dtype=np.float64)
    cos2 = np.cos(phi2)
    return np.stack(np.broadcast_arrays(-np.sin(phi1) * cos2, np.cos(phi1) * cos2, np.sin(phi2)), axis=-1)


def joint_angles(direction_base: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Joint angles (phi1, phi2), rad, that point the beam along ``direction_base`` (..., 3).

    Raises:
        LimitViolation: a direction within :data:`SINGULAR_MARGIN` of the outer axis.
    """
    d = np.asarray(direction_base, dtype=np.float64)
    phi2 = np.arcsin(np.clip(d[..., 2], -1.0, 1.0))
    worst = float(np.max(np.abs(phi2), initial=0.0))
    if worst > np.pi / 2 - SINGULAR_MARGIN:
        raise LimitViolation(
            f"beam direction {np.rad2deg(worst):.1f} deg off the horizontal of the base, allowed is "
            f"{90.0 - np.rad2deg(SINGULAR_MARGIN):.1f} deg (the gimbal is singular at 90): "
            "tilt it, or mount the base another way"
        )
    return np.arctan2(-d[..., 0], d[..., 1]), phi2


def plane_direction(phi: ArrayLike, rotation: FloatArray) -> FloatArray:
    """Unit 3-vector of the angle ``phi`` in Pi, in the frame that ``rotation`` (..., 3, 3) maps to."""
    phi = np.asarray(phi, dtype=np.float64)
    return np.asarray(
        np.cos(phi)[..., None] * rotation[..., :, 0] + np.sin(phi)[..., None] * rotation[..., :, 2]
    )


def plane_angle(direction: FloatArray, rotation: FloatArray) -> FloatArray:
    """Angle in Pi, rad, of the part of ``direction`` (..., 3) in Pi; inverse of :func:`plane_direction`."""
    along_x = np.sum(direction * rotation[..., :, 0], axis=-1)
    along_z = np.sum(direction * rotation[..., :, 2], axis=-1)
    return np.asarray(np.arctan2(along_z, along_x))


def great_circle(rotation: FloatArray, phi: FloatArray, theta: FloatArray) -> FloatArray:
    """Beam direction after turning by ``theta`` towards ``phi`` in Pi, from the orientation ``rotation``.

    Args:
        rotation: (n, 3, 3), sensor to base (or world) at touch.
        phi: (n,) rad, direction in Pi.
        theta: (n, k) rad, angles along the great circle.

    Returns:
        (n, k, 3) unit directions in the frame that ``rotation`` maps to.
    """
    start = rotation[:, None, :, 1]
    towards = plane_direction(phi, rotation)[:, None, :]
    return np.asarray(np.cos(theta)[..., None] * start + np.sin(theta)[..., None] * towards)


def nested_theta(phi2: ArrayLike, dphi1: ArrayLike, dphi2: ArrayLike) -> FloatArray:
    """Angle of a small turn of the beam made by the nested axes: (12) of Kaneko1998 as it should be.

    theta^2 = (cos(phi2) dphi1)^2 + dphi2^2; the printed form leaves out the cosine.

    >>> float(nested_theta(np.deg2rad(60.0), 0.02, 0.0)).__round__(9)
    0.01
    """
    phi2 = np.asarray(phi2, dtype=np.float64)
    return np.asarray(np.hypot(np.cos(phi2) * np.asarray(dphi1), np.asarray(dphi2, dtype=np.float64)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CarriedPush:
    """Samples of a push in the frame at touch, carried along without spin."""

    theta: FloatArray
    """(m,) rad, angle between the beam's direction now and at touch; measured along the push, so signed."""
    sideways: FloatArray
    """(m,) rad, angle of the direction off the great circle, positive towards phi + 90 deg."""
    force: FloatArray
    """(m, 2) N m: (s f_x, s f_z) = (-m_z, m_x) in the carried frame, s times the force ON the beam in Pi."""


def carried_push(
    phi1: FloatArray,
    phi2: FloatArray,
    moment: FloatArray,
    *,
    touch: FloatArray,
    phi: FloatArray,
) -> CarriedPush:
    """Angle of push and force direction of each sample, with the sensor's spin about the beam taken out.

    Args:
        phi1: (m,) rad, outer joint angle of each sample.
        phi2: (m,) rad, inner joint angle of each sample.
        moment: (m, 2) N m, (m_x, m_z) in the sensor frame of each sample.
        touch: (m, 2) rad, joint angles at touch of the push that the sample belongs to.
        phi: (m,) rad, direction of that push in Pi at touch.

    Signs as in (13)-(14) of Kaneko1998: m = s y x f = s (f_z, 0, -f_x).
    """
    turn = phi1 - touch[:, 0]
    d, cos_spin, sin_spin = _direction_and_spin(turn, phi2, touch[:, 1])
    now_x, now_z = -moment[:, 1], moment[:, 0]
    force = np.empty_like(moment)
    # x_s(now) = cos_spin x + sin_spin z in the carried frame, and z_s(now) = -sin_spin x + cos_spin z.
    force[:, 0] = cos_spin * now_x - sin_spin * now_z
    force[:, 1] = sin_spin * now_x + cos_spin * now_z
    cp, sp = np.cos(phi), np.sin(phi)
    ahead, aside = d[0] * cp + d[2] * sp, d[2] * cp - d[0] * sp
    return CarriedPush(
        theta=np.arctan2(ahead, d[1]), sideways=np.arcsin(np.clip(aside, -1.0, 1.0)), force=force
    )


def spun_push(
    theta: FloatArray, force: FloatArray, *, touch: FloatArray, phi: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Joint angles and sensed moments of a push from the carried frame; inverse of :func:`carried_push`.

    Args:
        theta: (m,) rad, angle along the great circle.
        force: (m, 2) N m, (s f_x, s f_z) in the carried frame.
        touch: (m, 2) rad, joint angles at touch.
        phi: (m,) rad, direction of the push in Pi at touch.

    Returns:
        Joint angles (m, 2) rad and moments (m_x, m_z) (m, 2) N m in the sensor frame of each sample.
    """
    t2 = touch[:, 1]
    ahead, ca, sa = np.sin(theta), np.cos(t2), np.sin(t2)
    dx, dy, dz = ahead * np.cos(phi), np.cos(theta), ahead * np.sin(phi)
    turn = np.arctan2(-dx, ca * dy - sa * dz)
    phi2 = np.arcsin(np.clip(sa * dy + ca * dz, -1.0, 1.0))
    _, cos_spin, sin_spin = _direction_and_spin(turn, phi2, t2)
    moment = np.empty_like(force)
    moment[:, 1] = -(cos_spin * force[:, 0] + sin_spin * force[:, 1])
    moment[:, 0] = cos_spin * force[:, 1] - sin_spin * force[:, 0]
    return np.stack((touch[:, 0] + turn, phi2), axis=1), moment


def _direction_and_spin(
    turn: FloatArray, phi2: FloatArray, touch2: FloatArray
) -> tuple[tuple[FloatArray, FloatArray, FloatArray], FloatArray, FloatArray]:
    """Beam direction in the sensor frame at touch, cosine and sine of the spin about the beam.

    The rotation from touch to now is Rx(-touch2) Rz(turn) Rx(phi2). The frame carried without spin is the
    smallest rotation that takes y to d; its x axis is e_x - dx (y + d)/(1 + dy),
    its z axis e_z - dz (y + d)/(1 + dy).
    """
    ct, st = np.cos(turn), np.sin(turn)
    ca, sa = np.cos(touch2), np.sin(touch2)
    cb, sb = np.cos(phi2), np.sin(phi2)
    dx, dy, dz = -st * cb, ca * ct * cb + sa * sb, -sa * ct * cb + ca * sb
    xx, xy, xz = ct, ca * st, -sa * st  # x_s now
    common = (dx * xx + (1.0 + dy) * xy + dz * xz) / (1.0 + dy)
    return (dx, dy, dz), xx - dx * common, xz - dz * common


@dataclass(frozen=True, slots=True, eq=False)
class Mount:
    """How the gantry's base stands in the world: ``p_world = rotation p_base + origin``."""

    rotation: FloatArray
    """(3, 3) proper rotation, base to world."""
    origin: FloatArray
    """(3,) m, the base's origin in the world."""

    def __post_init__(self) -> None:
        r = np.array(self.rotation, dtype=np.float64)
        if r.shape != (3, 3) or not np.allclose(r @ r.T, np.eye(3), atol=1e-9) or np.linalg.det(r) < 0.0:
            raise UsageError(
                "mount rotation must be a proper 3 x 3 rotation: give three orthonormal right-handed axes"
            )
        r.setflags(write=False)
        origin = np.array(self.origin, dtype=np.float64)
        origin.setflags(write=False)
        object.__setattr__(self, "rotation", r)
        object.__setattr__(self, "origin", origin)

    @classmethod
    def identity(cls) -> Mount:
        """Base and world coincide."""
        return cls(np.eye(3), np.zeros(3))

    def poses(self, position_world: FloatArray, direction_world: FloatArray) -> FloatArray:
        """Poses (n, 5) of a centre of rotation and a direction of the beam, both in the world."""
        position = (np.atleast_2d(position_world) - self.origin) @ self.rotation
        phi1, phi2 = joint_angles(np.atleast_2d(direction_world) @ self.rotation)
        return np.column_stack((position, phi1, phi2))

    def position_world(self, pose: FloatArray) -> FloatArray:
        """(n, 3) m, the centre of rotation in the world."""
        return np.asarray(pose[:, :3] @ self.rotation.T + self.origin)

    def rotation_world_sensor(self, pose: FloatArray) -> FloatArray:
        """(n, 3, 3) rotation from sensor to world coordinates."""
        return np.asarray(self.rotation @ rotation_base_sensor(pose[:, 3], pose[:, 4]))
