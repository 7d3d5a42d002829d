"""Creases that are polygons behave as the curves they stand for; corners stay corners."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from contour import shapes
from contour.mesh_env import MeshEnvironment, TouchKind

LENGTH = 0.21  # [m]
Z = np.array([0.0, 0.0, 1.0])
HEIGHT = 0.1  # of the drums [m]


def unit(vectors):
    """Vectors (n, 3) of length one."""
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def drum(sections, radius=0.05):
    """A drum about the z axis whose rims are polygons."""
    return MeshEnvironment(trimesh.creation.cylinder(radius=radius, height=HEIGHT, sections=sections))


def over_the_rim(rng, n, drum_radius, beam_radius):
    """Beams that touch the upper rim's circle: bases, directions, ways, tangents and normals, 20 mm before it."""
    turn = rng.uniform(0.0, 2.0 * np.pi, n)
    radial = np.stack([np.cos(turn), np.sin(turn), np.zeros(n)], axis=1)
    tangent = np.stack([-np.sin(turn), np.cos(turn), np.zeros(n)], axis=1)
    outward = radial * rng.uniform(0.3, 1.0, (n, 1)) + Z * rng.uniform(0.3, 1.0, (n, 1))
    direction = unit(np.cross(tangent, unit(outward)) + tangent * rng.uniform(-0.7, 0.7, (n, 1)))
    normal = unit(np.cross(tangent, direction))
    normal *= np.sign(np.einsum("ij,ij->i", normal, outward))[:, None]
    way = -unit(normal + 0.3 * np.cross(normal, direction) * rng.uniform(-1.0, 1.0, (n, 1)))
    axis = drum_radius * radial + 0.5 * HEIGHT * Z + beam_radius * normal
    return axis - 0.1 * direction - 0.02 * way, direction, way, tangent, normal


@pytest.mark.parametrize("radius", [0.0, 0.4e-3])
@pytest.mark.parametrize("size", [0.05, 0.006, 0.6e-3])
@pytest.mark.parametrize("sections", [24, 60, 200])
def test_polygonal_rim_has_the_normals_of_its_circle(sections, size, radius, rng):
    """Normals, tangents, curvature and height are those of the circle to high order in half a side's angle a."""
    base, direction, way, tangent, normal = over_the_rim(rng, 300, size, radius)
    contact = drum(sections, size).first_contact(
        base, direction, LENGTH, translation=0.03 * way, radius=radius
    )
    half = np.pi / sections
    assert (contact.kind == TouchKind.EDGE).all()
    assert np.abs(np.einsum("ij,ij->i", contact.normal, direction)).max() < 1e-12
    off = np.linalg.norm(contact.normal - normal, axis=1)
    assert off.max() < 0.25 * half**2  # the polygon's own are off by up to a / sin(skew) and more
    lean = np.linalg.norm(np.cross(contact.edge_direction, tangent), axis=1)
    assert lean.max() < 0.25 * half**2
    square = 1.0 - np.einsum("ij,ij->i", direction, tangent) ** 2
    bend = np.linalg.norm(normal[:, :2], axis=1) / size / square
    np.testing.assert_allclose(contact.curvature_across, bend, rtol=0.1 * half**2 + 1e-9)
    # The polygon is met late by up to 1 - cos a of the radius; the lift makes good for it.
    met = contact.travel + contact.lift / np.einsum("ij,ij->i", way, contact.normal)
    assert np.abs(met - 0.02).max() < 0.2 * size * half**4 + 1e-10
    assert (contact.travel - 0.02).max() > 0.2 * size * half**2


def test_travel_and_point_stay_on_the_polygon(rng):
    """The circle is for normals; first touch is that of the triangles, on the straight side of the polygon."""
    base, direction, way, _, _ = over_the_rim(rng, 100, 0.05, 0.0)
    contact = drum(24).first_contact(base, direction, LENGTH, translation=0.03 * way)
    at = base + contact.travel[:, None] * way + contact.distance[:, None] * direction
    np.testing.assert_allclose(at, contact.point, atol=1e-12)
    step = 2.0 * np.pi / 24
    turn = np.arctan2(contact.point[:, 1], contact.point[:, 0])
    aside = np.mod(turn, step) - 0.5 * step
    np.testing.assert_allclose(
        np.hypot(contact.point[:, 0], contact.point[:, 1]),
        0.05 * np.cos(0.5 * step) / np.cos(aside),
        atol=1e-9,
    )
    np.testing.assert_allclose(contact.point[:, 2], 0.5 * HEIGHT, atol=1e-9)


def test_edges_of_a_hexagonal_prism_stay_sharp(rng):
    """Its rim turns by 60 deg at every corner: normals are square to straight sides, and nothing bends."""
    base, direction, way, _, _ = over_the_rim(rng, 200, 0.05, 0.0)
    contact = drum(6).first_contact(base, direction, LENGTH, translation=0.06 * way)
    rim = (contact.kind == TouchKind.EDGE) & (np.abs(contact.point[:, 2] - 0.5 * HEIGHT) < 1e-9)
    inside = np.hypot(contact.point[:, 0], contact.point[:, 1]) < 0.0499
    rim &= inside
    assert rim.sum() > 100
    side = np.floor(np.mod(np.arctan2(contact.point[:, 1], contact.point[:, 0]), 2.0 * np.pi) / (np.pi / 3.0))
    middle = (side + 0.5) * np.pi / 3.0
    along = np.stack([-np.sin(middle), np.cos(middle), np.zeros(len(side))], axis=1)
    expected = unit(np.cross(along, direction))
    cosine = np.abs(np.einsum("ij,ij->i", contact.normal, expected))
    assert np.abs(cosine[rim] - 1.0).max() < 1e-12
    assert np.abs(contact.curvature_across[rim]).max() < 1e-9
    assert np.abs(contact.lift[rim]).max() < 1e-12


def test_a_straight_side_does_not_bend_towards_the_arc_beside_it(mesh_file):
    """On the gear's rim flanks stay straight up to their roundings; tangents are those of the outline."""
    environment, truth = MeshEnvironment.load(mesh_file("gear")), shapes.load("gear")
    topology = environment.topology
    ends = topology.vertices[topology.edge_vertices] + environment.bounds.mean(axis=0)
    top = topology.sharp & (np.abs(ends[:, :, 2] - 0.028).max(axis=1) < 1e-7)
    outer = top & (np.hypot(ends[:, 0, 0], ends[:, 0, 1]) > 0.04)
    edge = np.nonzero(outer)[0]
    middle = ends[edge].mean(axis=1)
    tangent, curve = environment.creases.at(
        edge, topology.vertices[topology.edge_vertices[edge]].mean(axis=1)
    )
    wall = truth.surface(middle - 0.005 * Z)
    assert np.abs(np.einsum("ij,ij->i", tangent, wall.normal)).max() < np.deg2rad(0.05)
    bend = -np.einsum("ij,ij->i", curve, wall.normal)
    np.testing.assert_allclose(bend, wall.curvatures[:, 0], atol=0.05 / 0.002)


def test_rims_know_their_own_curvature():
    """The crease round a cylinder bends with its radius, towards the axis; those of a box do not."""
    environment = drum(64, 2.0)
    topology = environment.topology
    edge = np.nonzero(topology.sharp)[0]
    point = topology.vertices[topology.edge_vertices[edge]].mean(axis=1)
    _, curve = environment.creases.at(edge, point)
    toward = -unit(point * np.array([1.0, 1.0, 0.0]))
    np.testing.assert_allclose(curve, toward / 2.0, atol=1e-5)
    box = MeshEnvironment(trimesh.creation.box())
    edge = np.nonzero(box.topology.sharp)[0]
    assert (
        np.abs(box.creases.at(edge, box.topology.vertices[box.topology.edge_vertices[edge, 0]])[1]).max()
        < 1e-12
    )


def test_the_rim_of_an_open_sheet_is_round_too():
    """A disc without thickness has one surface only: the circle through three vertices tells the tangent."""
    turn = np.arange(40) * (2.0 * np.pi / 40)
    ring = 0.05 * np.stack([np.cos(turn), np.sin(turn), np.zeros(40)], axis=1)
    faces = [(40, i, (i + 1) % 40) for i in range(40)]
    disc = MeshEnvironment(trimesh.Trimesh([*ring, (0, 0, 0)], faces, process=False))
    at = turn + 0.03
    radial = np.stack([np.cos(at), np.sin(at), np.zeros(40)], axis=1)
    tangent = np.stack([-np.sin(at), np.cos(at), np.zeros(40)], axis=1)
    direction = unit(Z + 0.4 * tangent)
    contact = disc.first_contact(
        0.06 * radial - 0.1 * direction, direction, LENGTH, translation=-0.03 * radial
    )
    assert (contact.kind == TouchKind.EDGE).all()
    np.testing.assert_allclose(contact.normal, radial, atol=2e-3)  # half a side is 0.079
    np.testing.assert_allclose(contact.travel + contact.lift / -1.0, 0.01, atol=1e-6)


def test_corners_of_an_open_sheet_stay_sharp():
    """The rim of an oblong sheet has corners; its sides, long and short, are straight right up to them."""
    sheet = MeshEnvironment(
        trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0.1, 0.01, 0], [0, 0.01, 0]], [[0, 1, 2], [0, 2, 3]])
    )
    assert not sheet.creases.joined.any()
    place = np.array(
        [[0.001, 0, 0], [0.03, 0, 0], [0.099, 0, 0], [0, 0.001, 0], [0, 0.004, 0], [0, 0.009, 0]]
    )
    outward = np.array([[0.0, -1.0, 0.0]] * 3 + [[-1.0, 0.0, 0.0]] * 3)
    contact = sheet.first_contact(
        place + 0.02 * outward - 0.1 * Z, np.tile(Z, (6, 1)), LENGTH, translation=-0.05 * outward
    )
    np.testing.assert_allclose(contact.normal, outward, atol=1e-12)
    np.testing.assert_allclose(contact.travel, 0.02, atol=1e-12)


def test_the_normal_stays_between_the_two_surfaces(rng):
    """Nearly along the rim a side of the polygon is met where the circle's wall would be: the normal is the wall's."""
    n, half = 2000, np.pi / 24
    turn = rng.uniform(0.0, 2.0 * np.pi, n)
    radial = np.stack([np.cos(turn), np.sin(turn), np.zeros(n)], axis=1)
    tangent = np.stack([-np.sin(turn), np.cos(turn), np.zeros(n)], axis=1)
    skew = rng.uniform(-1.0, 3.0, (n, 1)) * half
    direction = unit(np.cos(skew) * tangent - np.sin(skew) * radial + rng.uniform(0.005, 0.3, (n, 1)) * Z)
    way = -unit(radial * rng.uniform(0.1, 1.0, (n, 1)) + Z * rng.uniform(0.1, 1.0, (n, 1)))
    base = 0.05 * radial + 0.5 * HEIGHT * Z - 0.1 * direction - 0.02 * way
    contact = drum(24).first_contact(base, direction, LENGTH, translation=0.04 * way)
    edge = contact.kind == TouchKind.EDGE
    assert edge.sum() > 1000
    own = unit(contact.point[edge] * np.array([1.0, 1.0, 0.0]))
    # Neither into the wall nor into the cap; without the bound both come to -0.6.
    assert np.einsum("ij,ij->i", contact.normal[edge], own).min() > -0.05
    assert contact.normal[edge, 2].min() > -0.05


@pytest.mark.parametrize("radius", [0.0, 0.4e-3])
@pytest.mark.parametrize("sections", [24, 60, 200])
def test_silhouettes_over_a_polygonal_rim_have_the_slopes_of_the_circle(sections, radius):
    """Seen along skew beams a rim is an ellipse, without kinks; at touch it fits normal and curvature."""
    n, offsets = 20, np.linspace(-6e-3, 6e-3, 61)
    rng = np.random.default_rng(4)
    base, direction, way, tangent, normal = over_the_rim(rng, n, 0.05, radius)
    touch = base + 0.1 * direction + 0.02 * way
    heights = drum(sections).profile(
        touch, direction, np.full(n, 0.1), normal, LENGTH, offsets, radius=radius
    )
    turn = np.arctan2(-tangent[:, 0], tangent[:, 1])[:, None] + np.linspace(-0.5, 0.5, 20001)
    rim = np.stack([0.05 * np.cos(turn), 0.05 * np.sin(turn), np.full(turn.shape, 0.5 * HEIGHT)], axis=2)
    place = rim - (touch - radius * normal)[:, None]
    x = np.einsum("nmj,nj->nm", place, np.cross(direction, normal))
    y = np.einsum("nmj,nj->nm", place, normal)
    step = np.pi / sections
    for i in range(n):
        slope = np.gradient(y[i], x[i])
        cosine = 1.0 / np.hypot(1.0, slope)
        outer, height = x[i] - radius * slope * cosine, y[i] + radius * (cosine - 1.0)
        order = np.argsort(outer)
        true = np.interp(offsets, outer[order], height[order])
        assert np.abs(np.diff(heights[i] - true) / np.diff(offsets)).max() < 0.3 * step**2 + 1e-6
        bend = np.diff(heights[i], 2)[29] / (offsets[1] - offsets[0]) ** 2
        exact = np.diff(true, 2)[29] / (offsets[1] - offsets[0]) ** 2
        assert bend == pytest.approx(exact, rel=step, abs=0.2)


@pytest.mark.parametrize("radius", [0.0, 0.4e-3])
@pytest.mark.parametrize("sections", [24, 60, 200])
def test_silhouettes_along_a_faceted_wall_have_the_slopes_of_the_circle(sections, radius):
    """Beams along the generators lie on lines; the wall's profile is round all the same."""
    turn = np.linspace(0.0, 1.0, 30)
    normal = np.stack([np.cos(turn), np.sin(turn), np.zeros(30)], axis=1)
    offsets = np.linspace(-6e-3, 6e-3, 41)
    ball = 0.05 + radius
    heights = drum(sections).profile(
        ball * normal + 0.5 * HEIGHT * Z,
        -Z[None].repeat(30, 0),
        np.full(30, 0.1),
        normal,
        LENGTH,
        offsets,
        radius=radius,
    )
    off = heights - (np.sqrt(ball**2 - offsets**2) - ball)
    step = np.pi / sections
    assert np.abs(off).max() < 0.2 * 0.05 * step**4 + 1e-9
    assert np.abs(np.diff(off, axis=1) / np.diff(offsets)).max() < 0.3 * step**2


def test_silhouette_keeps_the_kink_at_a_corner_of_the_rim():
    """Over the hexagonal prism's rim the slope jumps at its corner, and is constant on both sides."""
    direction = np.array([[-np.sqrt(0.5), 0.0, np.sqrt(0.5)]])
    normal = np.array([[np.sqrt(0.5), 0.0, np.sqrt(0.5)]])
    corner = np.array([[0.05, 0.0, 0.5 * HEIGHT]])
    offsets = np.linspace(-6e-3, 6e-3, 41)
    heights = drum(6).profile(corner, direction, [0.1], normal, LENGTH, offsets)[0]
    slope = np.diff(heights) / np.diff(offsets)
    # From the corner both sides fall back by 1 / sqrt(3) of the way aside, which from 45 deg looks less.
    np.testing.assert_allclose(np.abs(slope), np.sqrt(0.5) / np.sqrt(3.0), atol=1e-6)
    np.testing.assert_allclose(slope[:20], -slope[20:], atol=1e-6)


def test_a_line_that_ends_at_a_crease_keeps_its_end():
    """Facets of 0.4 mm that run down from a rim on a ball: the line's near end is felt, not the facet's middle."""
    polar = np.deg2rad(45.0) + 0.008 * np.arange(40)
    section = 0.05 * np.stack([np.sin(polar), np.cos(polar)], axis=1)
    section = np.concatenate([[(0.0, section[-1, 1])], section[::-1], [(0.0, section[0, 1])]])
    environment = MeshEnvironment(trimesh.creation.revolve(section, sections=64))
    turn = np.pi / 64
    radial = np.array([np.cos(turn), np.sin(turn), 0.0])
    # The facet's middle meridian begins on the chord of the rim.
    rim = 0.05 * np.sin(polar[0]) * np.cos(turn) * radial + 0.05 * np.cos(polar[0]) * Z
    facet = 0.05 * np.array([np.sin(polar[1]) * np.cos(turn), np.cos(polar[1])])
    down = facet[0] * radial + facet[1] * Z - rim
    direction = down / np.linalg.norm(down)
    normal = np.cross(direction, np.cross(radial, Z))
    normal *= np.sign(normal @ Z)
    base = rim + 0.01 * normal - 0.1 * direction
    contact = environment.first_contact(base[None], direction[None], LENGTH, translation=-0.02 * normal[None])
    assert contact.line[0]
    assert contact.distance[0] == pytest.approx(0.1, abs=1e-7)
    assert contact.travel[0] == pytest.approx(0.01, abs=1e-9)
    np.testing.assert_allclose(contact.point[0], rim, atol=1e-7)


def test_a_round_beam_rolls_about_a_corner():
    """Touching a vertex of a box its normals are all those between the edges', from the vertex to the axis."""
    environment = MeshEnvironment(trimesh.creation.box(extents=(0.1, 0.1, 0.1)))
    direction = unit(np.tile([1.0, -0.8, -0.1], (9, 1)))
    # Square to the beam, from the upright edge's normal towards that of the upper edge along y.
    one, two = np.cross(Z, direction), np.cross(np.array([0.0, 1.0, 0.0]), direction)
    one, two = (unit(v) * np.sign(v @ np.ones(3))[:, None] for v in (one, two))
    share = np.linspace(0.1, 0.9, 9)[:, None]
    normal = unit((1.0 - share) * one + share * two)
    base = 0.05 + 0.022 * normal - 0.1 * direction
    contact = environment.first_contact(base, direction, LENGTH, translation=-0.03 * normal, radius=2e-3)
    np.testing.assert_allclose(contact.travel, 0.02, atol=1e-9)
    np.testing.assert_allclose(contact.point, 0.05, atol=1e-7)
    np.testing.assert_allclose(contact.normal, normal, atol=1e-5)
