"""Smooth solids given by a function that is negative inside: a sphere, a blob and a mug with a handle.

Closest points come from Newton's method, curvatures from the Hessian: with n = grad F / |grad F| the shape
operator is (I - n n') Hess F (I - n n') / |grad F|.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contour.shapes.base import Surface, TriangleMesh
from contour.shapes.meshing import geodesic_sphere, oriented, surface_nets
from contour.shapes.path import Path

__all__ = ["Blob", "Implicit", "Mug", "Sphere"]

FloatArray = NDArray[np.float64]

_DIFFERENCE = 1e-6
"""Step of the gradient's central differences [m]: truncation and rounding stay below 1e-7 of a curvature."""
_ROUNDS = 60
"""Newton steps at most; the tangential error shrinks by the ratio of distance and radius in each."""
_SETTLED = 1e-12
"""A closest point that moves less than this has been found [m]."""


class Implicit(ABC):
    """A solid {F < 0} with F twice differentiable near its surface."""

    @abstractmethod
    def value(self, points: FloatArray) -> FloatArray:
        """F (n,) at points (n, 3), about a distance in m near the surface."""

    @abstractmethod
    def gradient(self, points: FloatArray) -> FloatArray:
        """Gradient of F (n, 3)."""

    @abstractmethod
    def mesh(self) -> TriangleMesh:
        """The mesh that stands for it; all vertices lie on the surface."""

    def surface(self, points: FloatArray) -> Surface:
        """Closest points with normals and curvatures."""
        at = self.onto(points)
        for _ in range(_ROUNDS):
            normal = _unit(self.gradient(at))
            away = points - at
            moved = self.onto(at + away - np.sum(away * normal, axis=1)[:, None] * normal)
            change = float(np.max(np.linalg.norm(moved - at, axis=1), initial=0.0))
            at = moved
            if change < _SETTLED:
                break
        normal = _unit(self.gradient(at))
        axes, curvatures = self._principal(at, normal)
        return Surface(
            point=at,
            normal=normal,
            axes=axes,
            curvatures=curvatures,
            edge_distance=np.full(len(points), np.inf),
        )

    def onto(self, points: FloatArray) -> FloatArray:
        """Points (n, 3) moved along the gradient onto the surface."""
        at = points.copy()
        for _ in range(_ROUNDS):
            gradient = self.gradient(at)
            step = (self.value(at) / np.sum(gradient**2, axis=1))[:, None] * gradient
            at -= step
            if float(np.max(np.linalg.norm(step, axis=1), initial=0.0)) < _SETTLED:
                break
        return at

    def _principal(self, at: FloatArray, normal: FloatArray) -> tuple[FloatArray, FloatArray]:
        size = np.linalg.norm(self.gradient(at), axis=1)
        hessian = np.stack(
            [
                (self.gradient(at + shift) - self.gradient(at - shift)) / (2.0 * _DIFFERENCE)
                for shift in _DIFFERENCE * np.eye(3)
            ],
            axis=2,
        )
        frame = _tangents(normal)
        shape_operator = np.einsum("nai,nij,nbj->nab", frame, hessian, frame) / size[:, None, None]
        curvatures, directions = np.linalg.eigh(0.5 * (shape_operator + shape_operator.transpose(0, 2, 1)))
        return np.einsum("nak,nai->nki", directions, frame), curvatures


@dataclass(frozen=True, slots=True)
class Sphere:
    """A ball about the origin, its closest points in closed form."""

    radius: float
    """[m]."""
    frequency: int = 27
    """Divisions of the icosahedron's sides: 20 frequency^2 faces."""

    def surface(self, points: FloatArray) -> Surface:
        """Closest points with normals and curvatures."""
        normal = _unit(points)
        return Surface(
            point=self.radius * normal,
            normal=normal,
            axes=_tangents(normal),
            curvatures=np.full((len(points), 2), 1.0 / self.radius),
            edge_distance=np.full(len(points), np.inf),
        )

    def mesh(self) -> TriangleMesh:
        """A geodesic sphere."""
        sphere = geodesic_sphere(self.frequency)
        return TriangleMesh(self.radius * sphere.vertices, sphere.faces)


@dataclass(frozen=True, slots=True)
class Blob(Implicit):
    """A star-shaped body, |p| = rho(p / |p|) with rho a sphere and a sum of plane waves."""

    radius: float = 60e-3
    """Mean radius [m]."""
    frequency: int = 71
    """Divisions of the icosahedron's sides: 20 frequency^2 faces."""

    def value(self, points: FloatArray) -> FloatArray:
        """|p| - rho."""
        size = np.linalg.norm(points, axis=1)
        phase = (points / size[:, None]) @ _WAVES.T + _PHASES
        return np.asarray(size - self.radius * (1.0 + np.sin(phase) @ _HEIGHTS))

    def gradient(self, points: FloatArray) -> FloatArray:
        """p / |p| - (I - u u') grad rho / |p|."""
        size = np.linalg.norm(points, axis=1)[:, None]
        u = points / size
        slope = self.radius * (np.cos(u @ _WAVES.T + _PHASES) * _HEIGHTS) @ _WAVES
        return np.asarray(u - (slope - np.sum(slope * u, axis=1)[:, None] * u) / size)

    def mesh(self) -> TriangleMesh:
        """A geodesic sphere pulled onto the surface along its rays."""
        sphere = geodesic_sphere(self.frequency)
        height = 1.0 + np.sin(sphere.vertices @ _WAVES.T + _PHASES) @ _HEIGHTS
        return TriangleMesh(self.radius * height[:, None] * sphere.vertices, sphere.faces)


_WAVES = np.array(
    [
        [1.7, 0.6, -1.1],
        [-0.9, 2.3, 0.4],
        [0.5, -1.4, 2.6],
        [3.1, 0.8, 0.9],
        [-1.2, -2.9, 1.6],
        [0.7, 1.9, 3.2],
    ]
)
"""Wave vectors of the blob's radius over the unit sphere."""
_PHASES = np.array([0.3, 1.9, 4.1, 2.2, 5.3, 0.9])
"""rad, phases of the waves."""
_HEIGHTS = np.array([0.07, 0.06, 0.05, 0.035, 0.03, 0.025])
"""Heights of the waves as shares of the mean radius."""


@dataclass(frozen=True, slots=True)
class Mug(Implicit):
    """A thick cup and a bent handle, joined by a smooth union of their distances.

    With a, b the distances and h = max(1 - |a - b|/k, 0) the union is min(a, b) - k h^3 / 6, which has two
    derivatives.
    """

    cell: float = 0.95e-3
    """Grid of the mesh [m]."""

    def value(self, points: FloatArray) -> FloatArray:
        """Smooth union."""
        cup, handle = _cup(points)[0], _handle(points)[0]
        blend = np.maximum(1.0 - np.abs(cup - handle) / _BLEND, 0.0)
        return np.minimum(cup, handle) - _BLEND * blend**3 / 6.0

    def gradient(self, points: FloatArray) -> FloatArray:
        """The nearer part's, mixed with the other's where they blend."""
        (cup, of_cup), (handle, of_handle) = _cup(points), _handle(points)
        share = 0.5 * np.maximum(1.0 - np.abs(cup - handle) / _BLEND, 0.0) ** 2
        near, far = np.where(cup < handle, (of_cup.T, of_handle.T), (of_handle.T, of_cup.T))
        return np.asarray((near * (1.0 - share) + far * share).T)

    def mesh(self) -> TriangleMesh:
        """Surface nets, pulled onto the surface."""
        low, high = np.array([-41.7e-3, -42.2e-3, -6.3e-3]), np.array([70e-3, 42e-3, 86e-3])
        net = surface_nets(self.value, low, high, self.cell)
        return oriented(TriangleMesh(self.onto(net.vertices), net.faces))


_BLEND = 12e-3
"""Width of the joint between cup and handle [m]."""
_CUP = Path.rounded(
    [(0.0, 0.0), (36e-3, 0.0), (36e-3, 80e-3), (27e-3, 80e-3), (27e-3, 9e-3), (0.0, 9e-3)],
    [0.0, 6e-3, 4.5e-3, 4.5e-3, 8e-3, 0.0],
    closed=False,
)
"""Section of the cup in (r, z), with a full round rim."""
_HANDLE_CENTRE, _HANDLE_BEND, _HANDLE_TUBE = np.array([37e-3, 0.0, 42e-3]), 20e-3, 5.5e-3
"""Centre and radius of the handle's half ring in the plane y = 0, and radius of its tube [m]."""


def _cup(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Signed distance (n,) to the cup and its gradient (n, 3)."""
    radius = np.hypot(points[:, 0], points[:, 1])
    near = _CUP.nearest(np.stack((radius, points[:, 2]), axis=1))
    outwards = points[:, :2] / np.maximum(radius, 1e-12)[:, None]
    return near.signed, np.column_stack((near.normal[:, :1] * outwards, near.normal[:, 1]))


def _handle(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Signed distance (n,) to the half ring with round ends and its gradient (n, 3)."""
    offset = points - _HANDLE_CENTRE
    along = np.hypot(offset[:, 0], offset[:, 2])
    spine = np.zeros_like(offset)
    spine[:, ::2] = _HANDLE_BEND * offset[:, ::2] / np.maximum(along, 1e-12)[:, None]
    ended = offset[:, 0] < 0.0
    spine[ended] = 0.0
    spine[ended, 2] = np.where(offset[ended, 2] < 0.0, -_HANDLE_BEND, _HANDLE_BEND)
    away = offset - spine
    gap = np.linalg.norm(away, axis=1)
    return gap - _HANDLE_TUBE, away / np.maximum(gap, 1e-300)[:, None]


def _unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


def _tangents(normal: FloatArray) -> FloatArray:
    """Two unit tangents (n, 2, 3) square to each other."""
    helper = np.where(np.abs(normal[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = _unit(np.cross(normal, helper))
    return np.stack((first, np.cross(normal, first)), axis=1)
