"""The sensing planes of a plan's contours: between coordinates u in Pi, the world, and poses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contour.frames import Mount
from contour.plan import Plan

__all__ = ["SensingPlanes"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class SensingPlanes:
    """Pi of each of n contours: x_s and z_s stand still in the world while a contour is followed."""

    def __init__(self, plan: Plan, mount: Mount, length: float) -> None:
        self._mount, self._reach, self._direction = mount, plan.reach, plan.direction
        poses = mount.poses(np.zeros_like(plan.direction), plan.direction)
        rotation = mount.rotation_world_sensor(poses)
        self._joints = poses[:, 3:]
        self._axes = rotation[:, :, [0, 2]]  # (n, 3, 2)
        self._a, self._b = plan.reach.half_planes(rotation, plan.level, length, mount)

    def poses(self, which: IntArray, u: FloatArray, depth: FloatArray) -> FloatArray:
        """Poses (k, 5) of the contours ``which`` at ``u`` (k, 2) m and ``depth`` (k,) m along the beam."""
        return np.column_stack((self._base(which, u, depth), self._joints[which]))

    def in_plane(self, pose: FloatArray, which: IntArray) -> FloatArray:
        """u (k, 2) m of poses (k, 5)."""
        return self.flat(self._mount.position_world(pose), which)

    def flat(self, vector: FloatArray, which: IntArray) -> FloatArray:
        """Components (k, 2) along x_s and z_s of world vectors (k, 3)."""
        return np.asarray(np.einsum("nj,njk->nk", vector, self._axes[which]))

    def world(self, vector: FloatArray, which: IntArray) -> FloatArray:
        """World vectors (k, 3) of vectors (k, 2) in Pi."""
        return np.asarray(np.einsum("njk,nk->nj", self._axes[which], vector))

    def room(self, which: IntArray, start: FloatArray, heading: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How far within reach ``start`` (k, 2) m lies, negative outside, and how far ``heading`` may go on.

        Both (k,) m, at the contours' own levels.
        """
        slack = self._b[which] - np.einsum("nck,nk->nc", self._a[which], start)
        rate = np.einsum("nck,nk->nc", self._a[which], heading)
        ahead = rate > 1e-12
        return slack.min(axis=1), np.where(ahead, slack / np.where(ahead, rate, 1.0), np.inf).min(axis=1)

    def reachable(self, which: IntArray, u: FloatArray, depth: FloatArray) -> BoolArray:
        """(k,) whether the base may stand at ``u`` (k, 2) m and ``depth`` (k,) m: axes and floor."""
        world = self.world(u, which) + depth[:, None] * self._direction[which]
        base = self._base(which, u, depth)
        within = (base >= self._reach.lower[:3]) & (base <= self._reach.upper[:3])
        return np.asarray(within.all(axis=1) & (world[:, 2] >= self._reach.floor))

    def _base(self, which: IntArray, u: FloatArray, depth: FloatArray) -> FloatArray:
        """(k, 3) m, position in the base frame."""
        world = self.world(u, which) + depth[:, None] * self._direction[which]
        return np.asarray((world - self._mount.origin) @ self._mount.rotation)
