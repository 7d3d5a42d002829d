"""Solids of revolution and extruded solids with sections of lines and arcs; boxes and brackets with holes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contour.shapes.base import Surface, TriangleMesh
from contour.shapes.meshing import grid_patch, oriented, ring_strip, weld
from contour.shapes.path import Path

__all__ = ["CHORD", "LONGEST", "Bore", "Box", "Bracket", "Extruded", "Revolved"]

FloatArray = NDArray[np.float64]

CHORD = 0.02e-3
"""Chords of a mesh stay this near to their arcs [m]."""
LONGEST = 5e-3
"""Longest side of a mesh's face along a line [m]."""
_STEP = np.deg2rad(10.0)
"""Largest angle between neighbouring faces of a round part, well below that of a sharp edge."""
_RIM = np.deg2rad(0.75)
"""Largest angle between neighbouring sides of a round crease."""
_SHORTEST = 25e-6
"""Sides of round creases are not made shorter than this [m]."""
_RINGED = 0.95
"""Part of the way from a bore to the outline's nearest point that is meshed in rings."""
_ON_AXIS = 1e-9
"""Nearer than this to the axis of revolution, directions around it mean nothing [m]."""


def _around(radius: float, step: float) -> FloatArray:
    """Angles of a full turn, both ends included, no farther apart than ``step`` [rad].

    They keep the chords of a circle within :data:`CHORD`.
    """
    count = int(np.ceil(2.0 * np.pi / min(step, 2.0 * np.arccos(1.0 - CHORD / radius)) - 1e-9))
    return np.linspace(0.0, 2.0 * np.pi, count + 1)


def _flat(grid: FloatArray) -> TriangleMesh:
    """A (rows, columns, 2) grid at z = 0."""
    return grid_patch(np.concatenate((grid, np.zeros((*grid.shape[:2], 1))), axis=2))


def _closed_ring(points: FloatArray) -> FloatArray:
    return np.concatenate((points, points[:1]))


@dataclass(frozen=True, slots=True, eq=False)
class Revolved:
    """A path in the half plane (r, z), turned about the z axis."""

    profile: Path
    """The section, body on its left: either from the axis to the axis, or closed and clear of it."""
    closed: bool = False
    """Whether the path is closed (a torus)."""

    def surface(self, points: FloatArray) -> Surface:
        """Closest points with normals and curvatures."""
        radius = np.hypot(points[:, 0], points[:, 1])
        off_axis = radius > _ON_AXIS
        outwards = np.zeros_like(points)
        outwards[:, 0] = 1.0
        outwards[off_axis, :2] = points[off_axis, :2] / radius[off_axis, None]
        near = self.profile.nearest(np.stack((radius, points[:, 2]), axis=1))
        up = np.array([0.0, 0.0, 1.0])
        point = near.point[:, :1] * outwards + near.point[:, 1:] * up
        normal = near.normal[:, :1] * outwards + near.normal[:, 1:] * up
        meridian = -near.normal[:, 1:] * outwards + near.normal[:, :1] * up
        about = np.stack((-outwards[:, 1], outwards[:, 0], outwards[:, 2]), axis=1)
        r = near.point[:, 0]
        around = np.where(r > _ON_AXIS, near.normal[:, 0] / np.maximum(r, _ON_AXIS), near.curvature)
        return Surface(
            point=point,
            normal=normal,
            axes=np.stack((meridian, about), axis=1),
            curvatures=np.stack((near.curvature, around), axis=1),
            edge_distance=near.corner,
            edge_tangent=about if len(self.profile.corners) else None,
        )

    def mesh(self) -> TriangleMesh:
        """Quads along meridians and parallels, cut in two."""
        section = self.profile.points_of(CHORD, LONGEST, _STEP, closed=self.closed)
        if self.closed:
            section = _closed_ring(section)
        angle = _around(float(np.max(section[:, 0])), _RIM if len(self.profile.corners) else _STEP)
        r, z = section[:, 0, None], np.broadcast_to(section[:, 1, None], (len(section), len(angle)))
        return oriented(weld([grid_patch(np.stack((r * np.cos(angle), r * np.sin(angle), z), axis=-1))]))


@dataclass(frozen=True, slots=True, eq=False)
class Extruded:
    """A plane outline, with a round bore or none, drawn along z."""

    outline: Path
    """Closed outer loop in (x, y), counter-clockwise."""
    low: float
    """z of the bottom [m]."""
    high: float
    """z of the top [m]."""
    bore: Path | None = None
    """A clockwise circle about the origin."""

    def surface(self, points: FloatArray) -> Surface:
        """Closest points with normals and curvatures."""
        flat = points[:, :2]
        near = self.outline.nearest(flat)
        if self.bore is not None:
            hole = self.bore.nearest(flat)
            inner = np.abs(hole.signed) < np.abs(near.signed)
            near = type(near)(
                *(
                    np.where(inner.reshape(-1, *[1] * (a.ndim - 1)), b, a)
                    for a, b in zip(near, hole, strict=True)
                )
            )
        z = points[:, 2]
        middle, half = 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)
        side = np.where(z < middle, -1.0, 1.0)
        above = np.abs(z - middle) - half  # positive beyond the caps
        rim = (near.signed > 0.0) & (above > 0.0)
        cap = ~rim & (above >= near.signed)
        point = np.column_stack(
            (np.where(cap[:, None], flat, near.point), np.where(cap | rim, middle + side * half, z))
        )
        up = np.zeros_like(points)
        up[:, 2] = side
        wall_normal = np.column_stack((near.normal, np.zeros(len(z))))
        away = points - point
        rim_normal = away / np.maximum(np.linalg.norm(away, axis=1), 1e-300)[:, None]
        normal = np.where(cap[:, None], up, np.where(rim[:, None], rim_normal, wall_normal))
        along = np.stack((-wall_normal[:, 1], wall_normal[:, 0], wall_normal[:, 2]), axis=1)
        x_axis, y_axis = np.eye(3)[0], np.eye(3)[1]
        axes = np.stack(
            (np.where(cap[:, None], x_axis, along), np.where(cap[:, None], y_axis, np.abs(up))), axis=1
        )
        bend = np.where(cap | rim, 0.0, near.curvature)
        wall_edge = np.minimum(near.corner, np.abs(half - np.abs(z - middle)))
        edge = np.where(rim, 0.0, np.where(cap, np.abs(near.signed), wall_edge))
        upright = ~(cap | rim) & (near.corner < np.abs(half - np.abs(z - middle)))
        return Surface(
            point=point,
            normal=normal,
            axes=axes,
            curvatures=np.column_stack((bend, np.zeros(len(z)))),
            edge_distance=edge,
            edge_tangent=np.where(upright[:, None], np.abs(up), along),
        )

    def mesh(self) -> TriangleMesh:
        """Walls in quads; caps as rings around the bore, or as rungs across an outline without one."""
        outline = self.outline.points_of(CHORD, LONGEST, _RIM, closed=True, shortest=_SHORTEST)
        if self.bore is None:
            half = len(outline) // 2
            # Rungs join points that face each other across the outline, which starts at one of its ends.
            rungs = np.stack((outline[: half + 1], np.roll(outline[::-1], 1, axis=0)[: half + 1]), axis=1)
            patches = [*self._caps([_flat(rungs)]), self._wall(outline)]
        else:
            radius, around = 1.0 / abs(float(self.bore.bend[0])), np.hypot(*outline.T)
            start = np.arctan2(outline[0, 1], outline[0, 0])
            turn = start + _around(radius, _RIM)
            circle = np.stack((np.cos(turn), np.sin(turn)), axis=1)
            # Rings as fine as the bore up to near the outline, which has many more points.
            near = radius + _RINGED * (float(around.min()) - radius)
            rings = np.linspace(radius, near, int(np.ceil((near - radius) / LONGEST)) + 1)
            inner = radius * circle[:-1]
            flat = [_flat(rings[:, None, None] * circle), ring_strip(near * circle[:-1], outline)]
            patches = [*self._caps(flat), self._wall(outline), self._wall(inner[::-1])]
        return oriented(weld(patches))

    def _caps(self, flat: list[TriangleMesh]) -> list[TriangleMesh]:
        """Flat patches put on both ends, turned outwards."""
        caps = []
        for z, order in ((self.high, 1.0), (self.low, -1.0)):
            for patch in flat:
                vertices = patch.vertices + np.array([0.0, 0.0, z])
                a, b, c = (vertices[patch.faces[:, k]] for k in range(3))
                outwards = order * np.sum(np.cross(b - a, c - a)[:, 2]) > 0.0
                caps.append(TriangleMesh(vertices, patch.faces if outwards else patch.faces[:, ::-1]))
        return caps

    def _wall(self, loop: FloatArray) -> TriangleMesh:
        levels = np.linspace(self.low, self.high, int(np.ceil((self.high - self.low) / LONGEST)) + 1)
        ring = _closed_ring(loop)
        shape = (len(ring), len(levels))
        grid = np.concatenate(
            (
                np.broadcast_to(ring[:, None], (*shape, 2)),
                np.broadcast_to(levels[None, :, None], (*shape, 1)),
            ),
            axis=2,
        )
        return grid_patch(grid)


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """A block about the origin."""

    size: tuple[float, float, float]
    """Sides along x, y, z [m]."""

    def surface(self, points: FloatArray) -> Surface:
        """Closest points with normals and curvatures."""
        x, y, z = (0.5 * side for side in self.size)
        outline = Path.rounded([(-x, -y), (x, -y), (x, y), (-x, y)], [0.0] * 4, closed=True)
        return Extruded(outline, -z, z).surface(points)

    def mesh(self) -> TriangleMesh:
        """A grid of nearly square cells on each side."""
        patches = []
        for axis in range(3):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            for sign in (-1.0, 1.0):
                first, second = (
                    np.linspace(
                        -0.5 * self.size[k], 0.5 * self.size[k], int(np.ceil(self.size[k] / LONGEST)) + 1
                    )
                    for k in (u, v)
                )
                grid = np.zeros((len(first), len(second), 3))
                grid[..., axis] = 0.5 * sign * self.size[axis]
                grid[..., u], grid[..., v] = np.meshgrid(first, second, indexing="ij")
                patches.append(grid_patch(grid if sign > 0.0 else grid.transpose(1, 0, 2)))
        return weld(patches)


@dataclass(frozen=True, slots=True, eq=False)
class Bore:
    """A round hole right through a plate of the bracket."""

    start: tuple[float, float, float]
    """Centre of one mouth [m]."""
    axis: tuple[float, float, float]
    """Unit vector from there to the other mouth."""
    depth: float
    """Distance between the mouths [m]."""
    radius: float
    """[m]."""

    def wall(self, points: FloatArray) -> Surface:
        """Closest points of the wall, its two mouths included."""
        axis = np.array(self.axis)
        offset = points - np.array(self.start)
        along = offset @ axis
        lateral = offset - along[:, None] * axis
        size = np.linalg.norm(lateral, axis=1)
        outwards = lateral / np.maximum(size, 1e-300)[:, None]
        at = np.clip(along, 0.0, self.depth)
        point = np.array(self.start) + at[:, None] * axis + self.radius * outwards
        beyond = at != along
        away = points - point
        mouth_normal = away / np.maximum(np.linalg.norm(away, axis=1), 1e-300)[:, None]
        around = np.cross(axis, outwards)
        return Surface(
            point=point,
            normal=np.where(beyond[:, None], mouth_normal, -outwards),
            axes=np.stack((around, np.broadcast_to(axis, points.shape)), axis=1),
            curvatures=np.column_stack((np.full(len(points), -1.0 / self.radius), np.zeros(len(points)))),
            edge_distance=np.minimum(at, self.depth - at),
        )

    def mouth_gap(self, points: FloatArray) -> FloatArray:
        """Distance (n,) m of points in a mouth's plane from its rim, negative in the hole; inf elsewhere."""
        offset = points - np.array(self.start)
        along = offset @ np.array(self.axis)
        lateral = np.linalg.norm(offset - along[:, None] * np.array(self.axis), axis=1)
        in_plane = np.minimum(np.abs(along), np.abs(along - self.depth)) < 1e-9
        return np.where(in_plane, lateral - self.radius, np.inf)


@dataclass(frozen=True, slots=True, eq=False)
class Bracket:
    """Two plates at a right angle with holes: an L in (y, z), drawn along x, less its bores.

    Its mesh is made of square cells; a cell with a hole is a ring between the square and the circle.
    """

    cells: tuple[int, int]
    """Square cells along x, and away from the inner corner on each plate."""
    cell: float
    """Side of a cell [m]."""
    thickness: float
    """Of both plates [m]."""
    base_holes: dict[tuple[int, int], float]
    """Radius [m] of the hole in cell (i along x, j along y) of the plate that lies at z = 0."""
    wall_holes: dict[tuple[int, int], float]
    """Radius [m] of the hole in cell (i along x, j along z) of the plate that stands at y = 0."""

    _FINE = 16
    """Divisions of a cell's side."""
    _RIM_SIDES = 480
    """Sides of a hole's mouth."""

    def bores(self) -> list[Bore]:
        """All holes."""
        t, c = self.thickness, self.cell
        lying = [
            Bore(((i + 0.5) * c, t + (j + 0.5) * c, 0.0), (0.0, 0.0, 1.0), t, radius)
            for (i, j), radius in self.base_holes.items()
        ]
        standing = [
            Bore(((i + 0.5) * c, 0.0, t + (j + 0.5) * c), (0.0, 1.0, 0.0), t, radius)
            for (i, j), radius in self.wall_holes.items()
        ]
        return lying + standing

    def surface(self, points: FloatArray) -> Surface:
        """Closest points with normals and curvatures."""
        reach = self.thickness + self.cells[1] * self.cell
        t = self.thickness
        outline = Path.rounded(
            [(0.0, 0.0), (reach, 0.0), (reach, t), (t, t), (t, reach), (0.0, reach)], [0.0] * 6, closed=True
        )
        # The L's plane (y, z) and its direction x are the (x, y) and z of an extruded solid: a cycle.
        solid = Extruded(outline, 0.0, self.cells[0] * self.cell).surface(points[:, [1, 2, 0]])
        back = [2, 0, 1]
        assert solid.edge_tangent is not None
        tangent = solid.edge_tangent[:, back]
        result = Surface(
            point=solid.point[:, back],
            normal=solid.normal[:, back],
            axes=solid.axes[:, :, back],
            curvatures=solid.curvatures,
            edge_distance=solid.edge_distance,
        )
        gap = np.linalg.norm(points - result.point, axis=1)
        for bore in self.bores():
            mouth = bore.mouth_gap(result.point)
            gap = np.where(mouth < 0.0, np.inf, gap)  # the plate is not there
            wall = bore.wall(points)
            wall_gap = np.linalg.norm(points - wall.point, axis=1)
            nearer = wall_gap < gap
            gap = np.where(nearer, wall_gap, gap)
            round_edge = nearer | (np.abs(mouth) < result.edge_distance)
            tangent = np.where(round_edge[:, None], wall.axes[:, 0], tangent)
            result = Surface(
                point=np.where(nearer[:, None], wall.point, result.point),
                normal=np.where(nearer[:, None], wall.normal, result.normal),
                axes=np.where(nearer[:, None, None], wall.axes, result.axes),
                curvatures=np.where(nearer[:, None], wall.curvatures, result.curvatures),
                edge_distance=np.where(
                    nearer, wall.edge_distance, np.minimum(result.edge_distance, np.abs(mouth))
                ),
            )
        return replace(result, edge_tangent=tangent)

    def mesh(self) -> TriangleMesh:
        """Cells, strips of the plates' thickness, and the walls of the holes."""
        nx, nr = self.cells
        t, c = self.thickness, self.cell
        reach = t + nr * c
        patches: list[TriangleMesh] = []
        for holes, plane in ((self.base_holes, 0), (self.wall_holes, 1)):
            for i in range(nx):
                for j in range(nr):
                    radius = holes.get((i, j))
                    cell = (
                        self._square(i * c, t + j * c)
                        if radius is None
                        else self._ring(i * c, t + j * c, radius)
                    )
                    patches.append(_placed(cell, plane, 0.0, outwards=False))
                    patches.append(_placed(cell, plane, t, outwards=True))
        strip = self._rectangle(0.0, 0.0, nx * c, t)
        for plane in (0, 1):
            patches.append(_placed(strip, plane, 0.0, outwards=False))
            patches.append(_placed(strip, plane, reach, outwards=True))
        for x, outwards in ((0.0, False), (nx * c, True)):
            patches.extend(
                _placed(self._rectangle(*box), 2, x, outwards=outwards)
                for box in ((0.0, 0.0, t, t), (t, 0.0, nr * c, t), (0.0, t, t, nr * c))
            )
        patches.extend(self._hole_wall(bore) for bore in self.bores())
        return weld(patches)

    def _rectangle(self, u0: float, v0: float, width: float, height: float) -> TriangleMesh:
        step = self.cell / self._FINE
        u = u0 + np.linspace(0.0, width, round(width / step) + 1)
        v = v0 + np.linspace(0.0, height, round(height / step) + 1)
        return grid_patch(np.stack((*np.meshgrid(u, v, indexing="ij"), np.zeros((len(u), len(v)))), axis=-1))

    def _square(self, u0: float, v0: float) -> TriangleMesh:
        return self._rectangle(u0, v0, self.cell, self.cell)

    def _ring(self, u0: float, v0: float, radius: float) -> TriangleMesh:
        half = 0.5 * self.cell
        side = np.linspace(-half, half, self._FINE, endpoint=False)
        full = np.full(self._FINE, half)
        square = np.concatenate(
            [np.stack(pair, axis=1) for pair in ((side, -full), (full, side), (-side, full), (-full, -side))]
        )
        circle = radius * _directions(len(square))
        share = np.linspace(0.0, 1.0, 7)[1:, None, None]
        rings = _closed_ring(circle)[None] * (1.0 - share) + _closed_ring(square)[None] * share
        mouth = ring_strip(radius * _directions(self._RIM_SIDES), rings[0, :-1])
        ring = weld([mouth, _flat(rings)])
        return TriangleMesh(ring.vertices + np.array([u0 + half, v0 + half, 0.0]), ring.faces)

    def _hole_wall(self, bore: Bore) -> TriangleMesh:
        axis = np.array(bore.axis)
        first = np.array([1.0, 0.0, 0.0])  # every bore is square to x
        second = np.abs(np.cross(axis, first))
        circle = bore.radius * _closed_ring(_directions(self._RIM_SIDES))
        around = np.array(bore.start) + circle[:, :1] * first + circle[:, 1:] * second
        depth = np.linspace(0.0, bore.depth, round(bore.depth * self._FINE / self.cell) + 1)
        grid = around[:, None] + depth[None, :, None] * axis
        inwards = float(np.dot(np.cross(first, second), axis)) < 0.0
        return grid_patch(grid if inwards else grid.transpose(1, 0, 2))


def _directions(count: int) -> FloatArray:
    """Unit vectors at equal angles, from the diagonal of the third quadrant on, where a square starts."""
    angle = -0.75 * np.pi + np.arange(count) * (2.0 * np.pi / count)
    return np.stack((np.cos(angle), np.sin(angle)), axis=1)


def _placed(flat: TriangleMesh, plane: int, height: float, *, outwards: bool) -> TriangleMesh:
    """A flat patch (u, v, 0) put into the plane z, y or x = height (0, 1, 2), normal along +axis or -axis.

    u runs along x for the first two and along y for the third; v along y, z, z.
    """
    u, v = flat.vertices[:, 0], flat.vertices[:, 1]
    w = np.full(len(u), height)
    vertices = np.stack(((u, v, w), (u, w, v), (w, u, v))[plane], axis=1)
    a, b, c = (vertices[flat.faces[:, k]] for k in range(3))
    axis = (2, 1, 0)[plane]
    positive = np.sum(np.cross(b - a, c - a)[:, axis]) > 0.0
    return TriangleMesh(vertices, flat.faces if positive == outwards else flat.faces[:, ::-1])
