"""Where beams touch the smooth surface behind the facets."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from contour import shapes
from contour.mesh_env import MeshEnvironment, TouchKind

LENGTH = 0.21  # [m]


def unit(vectors):
    """Vectors (n, 3) of length one."""
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def dot(one, two):
    """Row by row (n,)."""
    return np.einsum("ij,ij->i", one, two)


def skew_beams(n, rng, least=0.2):
    """Beams that come skew at a rod along z: bases, directions, unit motions."""
    turn = rng.uniform(0, 2 * np.pi, n)
    out = np.stack([np.cos(turn), np.sin(turn), np.zeros(n)], axis=1)
    round_about = np.cross([0.0, 0.0, 1.0], out)
    lean = rng.uniform(least, np.pi - least, n)[:, None]
    direction = np.cos(lean) * np.array([0.0, 0.0, 1.0]) + np.sin(lean) * round_about
    way = -unit(out + 0.4 * np.cross(out, direction) * rng.normal(size=(n, 1)))
    place = 0.01 * rng.uniform(-1, 1, n)[:, None] * np.array([0.0, 0.0, 1.0])
    return place - 0.05 * way - 0.1 * direction, direction, way


@pytest.mark.parametrize("sections", [24, 64])
@pytest.mark.parametrize("radius", [0.0, 0.4e-3])
def test_a_skew_beam_finds_the_rod_behind_its_facets(sections, radius, rng):
    """Normal, place along the beam and travel are those of the round rod, not of its nearest mesh edge."""
    rod = MeshEnvironment(trimesh.creation.cylinder(radius=0.006, height=0.2, sections=sections))
    base, direction, way = skew_beams(300, rng)
    contact = rod.first_contact(base, direction, LENGTH, translation=0.1 * way, radius=radius)
    side = contact.kind == TouchKind.SIDE
    assert side.sum() > 250
    base, direction, way = base[side], direction[side], way[side]
    normal = unit(np.cross(direction, [0.0, 0.0, 1.0]))
    normal *= -np.sign(dot(normal, way))[:, None]
    # The facets turn by 0.26 and 0.1.
    np.testing.assert_allclose(contact.normal[side], normal, atol=5e-5)
    np.testing.assert_allclose(contact.normal_smooth[side], normal, atol=5e-5)
    # Where two skew lines are nearest, at the travel that brings them to the sum of the radii.
    travel = (0.006 + radius - dot(base, normal)) / dot(way, normal)
    at = base + travel[:, None] * way
    level = direction[:, :2]
    place = -dot(at[:, :2], level) / dot(level, level)
    np.testing.assert_allclose(contact.distance[side], place, atol=5e-6)
    facing = -dot(way, contact.normal[side])
    # The paraboloid leaves the circle by sag^2 / (2 radius): 51 um of sag with 24 sections, 0.22 um.
    found = contact.travel[side] - contact.lift[side] / facing
    np.testing.assert_allclose((found - travel) * facing, 0.0, atol=0.3e-6)


@pytest.mark.parametrize("name", ["torus", "blob", "rod12", "rod2", "cylinder"])
def test_smooth_meshes_are_touched_where_their_shapes_are(name, mesh_file, rng):
    """On doubly curved shapes the point is on the shape and its normal square to the beam there."""
    environment, truth = MeshEnvironment.load(mesh_file(name)), shapes.load(name)
    face = rng.integers(0, len(environment.topology.corners), 400)
    start = truth.surface(environment.triangles[face].mean(axis=1))
    direction = unit(np.cross(start.normal, rng.normal(size=(400, 3))))
    base = start.point + 0.02 * start.normal - 0.1 * direction
    contact = environment.first_contact(
        base, direction, LENGTH, translation=-0.05 * start.normal, radius=0.4e-3
    )
    side = (contact.kind == TouchKind.SIDE) & ~contact.touching
    smooth = contact.point[side] + contact.lift[side, None] * contact.normal[side]
    surface = truth.surface(smooth)
    far = surface.edge_distance > 1e-3
    bent = truth.curvature(smooth, direction[side]) > 2.0
    rows = far & bent
    assert rows.sum() > 100
    lean = np.abs(dot(surface.normal, direction[side]))[rows]
    turned = np.linalg.norm(np.cross(surface.normal, contact.normal[side]), axis=1)[rows]
    # Half a facet turns by 1 to 7 degrees on these meshes; what stays is a few hundredths of that.
    assert np.quantile(lean, 0.95) < np.deg2rad(0.1)
    assert np.quantile(turned, 0.95) < np.deg2rad(0.1)
    height = np.abs(dot(smooth - surface.point, surface.normal))[rows]
    assert np.quantile(height, 0.95) < 0.5e-6


def test_no_smooth_surface_is_followed_over_a_crease(rng):
    """Near a rod's end the contact stays on the rod: the beam does not find its place beyond the rim."""
    rod = MeshEnvironment(trimesh.creation.cylinder(radius=0.006, height=0.05, sections=24))
    base, direction, way = skew_beams(400, rng, least=0.02)
    base[:, 2] += rng.choice([-1.0, 1.0], 400) * rng.uniform(0.01, 0.02, 400)
    contact = rod.first_contact(base, direction, LENGTH, translation=0.1 * way)
    side = contact.kind == TouchKind.SIDE
    assert side.sum() > 100
    assert np.abs(contact.point[side, 2]).max() < 0.025 + 1e-9
    assert np.abs(dot(contact.normal[side], direction[side])).max() < 1e-12


def test_flat_faces_leave_contacts_where_they_are(rng):
    """Coplanar triangles along the beam tell nothing: the contact stays in the beam's path, without lift."""
    mesh = trimesh.creation.box(extents=(0.1, 0.12, 0.08)).subdivide().subdivide()
    environment = MeshEnvironment(mesh)
    turn = rng.uniform(0, 2 * np.pi, 50)
    direction = np.stack([np.zeros(50), np.cos(turn), np.sin(turn)], axis=1)
    base = np.array([0.08, 0.001, 0.002]) - 0.02 * direction
    contact = environment.first_contact(base, direction, 0.03, translation=np.tile([-0.05, 0, 0], (50, 1)))
    assert contact.hit.all()
    np.testing.assert_allclose(contact.travel, 0.03, atol=1e-9)
    np.testing.assert_allclose(contact.lift, 0.0, atol=1e-12)
    np.testing.assert_allclose(contact.normal, np.tile([1.0, 0, 0], (50, 1)), atol=1e-12)


def test_a_rod_and_its_cone_keep_their_contacts(rng):
    """Over the crease between them neither surface is followed into the other's part."""
    narrow = 0.006 - 0.004 * np.tan(np.deg2rad(40.0))
    outline = [[0, -0.05], [0.006, -0.05], [0.006, 0.0], [narrow, 0.004], [0, 0.004]]
    environment = MeshEnvironment(trimesh.creation.revolve(np.array(outline), sections=24))
    base, direction, way = skew_beams(2000, rng, least=0.02)
    base[:, 2] += rng.uniform(-0.012, 0.008, 2000)
    contact = environment.first_contact(base, direction, LENGTH, translation=0.1 * way)
    slope = environment.topology.normals[contact.face, 2]
    side = contact.kind == TouchKind.SIDE
    rod, cone = side & (np.abs(slope) < 1e-6), side & (slope > 0.1) & (slope < 0.9)
    assert rod.sum() > 500
    assert cone.sum() > 50
    assert contact.point[rod, 2].max() < 1e-9
    # Chords of the rim lie 51 um inside it, where the round cone stands by that much lower.
    assert contact.point[cone, 2].min() > -0.2e-3
