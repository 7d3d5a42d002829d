"""What a beam finds on bodies: kinds, normals, curvature, lines, silhouettes, and refusals in one line."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from contour import shapes
from contour.errors import UsageError
from contour.mesh_env import MeshEnvironment, TouchKind

LENGTH = 0.21  # [m]
X, Y, Z = np.eye(3)[:, None]


def unit(vectors):
    """Vectors (n, 3) of length one."""
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def sphere(radius=0.05, level=5):
    """An icosphere about the origin."""
    return MeshEnvironment(trimesh.creation.icosphere(subdivisions=level, radius=radius))


def box(**arguments):
    """A box of 100 x 120 x 80 mm about the origin."""
    return MeshEnvironment(trimesh.creation.box(extents=(0.1, 0.12, 0.08)), **arguments)


def rod(sections=64):
    """A rod along z, radius 6 mm, 100 mm long."""
    return MeshEnvironment(trimesh.creation.cylinder(radius=0.006, height=0.1, sections=sections))


def around(radius, n, rng):
    """Beams that come sideways at a ball about the origin: bases, directions, translations."""
    normal = unit(rng.normal(size=(n, 3)))
    direction = unit(np.cross(normal, rng.normal(size=(n, 3))))
    way = -unit(normal + 0.4 * np.cross(normal, direction) * rng.normal(size=(n, 1)))
    base = normal * radius - 0.1 * way - direction * rng.uniform(0.03, 0.18, n)[:, None]
    return base, direction, 0.2 * way


# -------------------------------------------------------------------------------- what is found


@pytest.mark.parametrize("radius", [0.0, 0.4e-3])
def test_sphere_has_its_normals_and_radii(radius, rng):
    """Normals are square to the beam, face it and are radial; both curvatures are those of the sphere."""
    base, direction, way = around(0.05, 400, rng)
    contact = sphere().first_contact(base, direction, LENGTH, translation=way, radius=radius)
    assert contact.hit.all()
    assert (contact.kind == TouchKind.SIDE).all()
    assert np.abs(np.einsum("ij,ij->i", contact.normal, direction)).max() < 1e-12
    assert (np.einsum("ij,ij->i", contact.normal, way) < 0.0).all()
    # The surface is met some 15 um sooner, which for skew motions is as far to the side: 0.02 deg on 50 mm.
    for normal in (contact.normal, contact.normal_smooth):
        cosine = np.einsum("ij,ij->i", normal, unit(contact.point))
        assert cosine.min() > np.cos(np.deg2rad(0.03))
    np.testing.assert_allclose(contact.curvature_along, 20.0, rtol=1e-3)
    np.testing.assert_allclose(contact.curvature_across, 20.0, rtol=1e-3)
    # The point is on the mesh: inside the sphere by at most a chord's sag, l^2 / (8 R) = 15 um.
    distance = np.linalg.norm(contact.point, axis=1)
    assert distance.max() < 0.05 + 1e-9
    assert distance.min() > 0.05 - 20e-6


def test_radius_lies_between_axis_and_surface(rng):
    """With a beam radius the axis passes the surface point at that distance."""
    base, direction, way = around(0.05, 200, rng)
    contact = sphere().first_contact(base, direction, LENGTH, translation=way, radius=2e-3)
    axis = base + contact.travel[:, None] * unit(way) + contact.distance[:, None] * direction
    # Exact up to the shares by which nearest points may miss their feature, 1e-9.
    np.testing.assert_allclose(np.linalg.norm(axis - contact.point, axis=1), 2e-3, atol=2e-9)


def test_distance_and_point_agree(rng):
    """Point = base + travel + s along the beam, for translations and for turns."""
    environment = sphere()
    base, direction, way = around(0.05, 200, rng)
    contact = environment.first_contact(base, direction, LENGTH, translation=way)
    at = base + contact.travel[:, None] * unit(way) + contact.distance[:, None] * direction
    np.testing.assert_allclose(at, contact.point, atol=1e-12)
    axis = unit(np.cross(direction, way))
    contact = environment.first_contact(base, direction, LENGTH, rotation=(axis, np.full(200, 1.2)))
    turned = np.cos(contact.travel)[:, None] * direction
    turned += np.sin(contact.travel)[:, None] * np.cross(axis, direction)
    hit = contact.hit
    assert hit.sum() > 100
    np.testing.assert_allclose(contact.direction[hit], turned[hit], atol=1e-12)
    at = base + contact.distance[:, None] * turned
    np.testing.assert_allclose(at[hit], contact.point[hit], atol=1e-12)


def test_a_turn_backwards_is_a_turn_about_the_opposite_axis(rng):
    """Negative angles turn the other way."""
    base, direction, way = around(0.05, 50, rng)
    axis = unit(np.cross(direction, way))
    environment = sphere(level=3)
    there = environment.first_contact(base, direction, LENGTH, rotation=(axis, np.full(50, 1.0)))
    back = environment.first_contact(base, direction, LENGTH, rotation=(-axis, np.full(50, -1.0)))
    np.testing.assert_array_equal(there.travel, back.travel)


def test_beam_along_a_face_touches_a_line():
    """Flush with a side of a box the contact is the end nearest the base, as an edge, exact in travel."""
    for radius in (0.0, 0.4e-3):
        contact = box().first_contact([[0.1, 0.01, 0.12]], -Z, LENGTH, translation=-0.1 * X, radius=radius)
        assert contact.line[0]
        assert contact.kind[0] == TouchKind.EDGE
        assert contact.travel[0] == pytest.approx(0.05 - radius, abs=1e-9)
        assert contact.distance[0] == pytest.approx(0.08, abs=1e-9)
        np.testing.assert_allclose(contact.point[0], [0.05, 0.01, 0.04], atol=1e-9)
        np.testing.assert_allclose(contact.normal[0], [1, 0, 0], atol=1e-9)
        assert np.isinf(contact.curvature_along[0])
        assert contact.curvature_across[0] == pytest.approx(0.0, abs=1e-9)


def test_beam_along_a_rod_touches_a_line_with_the_rods_profile():
    """Parallel to a generator: an edge along, the rod's radius across, the rod's smooth normal."""
    contact = rod().first_contact([[0.1, 0.0007, 0.11]], -Z, LENGTH, translation=-0.1 * X)
    assert contact.line[0]
    assert contact.distance[0] == pytest.approx(0.06, abs=1e-9)
    assert contact.curvature_across[0] == pytest.approx(1 / 0.006, rel=3e-3)
    # Linear between normals 5.6 degrees apart: within (5.6 deg)^2 / 8 of a radian or so.
    assert np.arctan2(contact.normal[0, 1], contact.normal[0, 0]) == pytest.approx(0.0007 / 0.006, abs=2e-3)


@pytest.mark.parametrize("name", ["gear", "box", "cylinder"])
@pytest.mark.parametrize("radius", [0.0, 0.4e-3])
def test_upright_walls_are_lines_to_upright_beams(name, radius, mesh_file, rng):
    """Whatever slivers a wall is cut into, with vertices rounded to single precision, and wherever the tip is."""
    environment = MeshEnvironment.load(mesh_file(name))
    low, high = environment.bounds
    turn = rng.uniform(0, 2 * np.pi, 60)
    way = -np.stack([np.cos(turn), np.sin(turn), np.zeros(60)], axis=1)
    middle = 0.5 * (low + high)
    reach = np.linalg.norm((high - low)[:2])
    base = middle - reach * way + (high[2] - middle[2] + 0.1) * Z
    # Every other beam ends on the wall, between its faces' corners.
    length = np.where(np.arange(60) % 2 == 0, LENGTH, 0.1 + 0.63 * (high[2] - low[2]))
    contact = environment.first_contact(
        base, np.repeat(-Z, 60, axis=0), length, translation=reach * way, radius=radius
    )
    assert contact.line.all()
    assert (contact.kind == TouchKind.EDGE).all()
    np.testing.assert_allclose(contact.distance, 0.1, atol=1e-7)


def test_a_facet_along_the_beam_is_no_line():
    """A facet of 13 mm that lies along the beam is no line: the drum it stands for is bent along the beam."""
    drum = trimesh.creation.cylinder(radius=0.05, height=0.1, sections=24)
    drum.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 24, [0, 0, 1]))
    drum.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    contact = MeshEnvironment(drum).first_contact([[0.1, 0.003, 0.1]], -Z, LENGTH, translation=-0.1 * X)
    assert contact.travel[0] == pytest.approx(0.1 - 0.05 * np.cos(np.pi / 24), abs=1e-9)
    assert not contact.line[0]
    assert contact.kind[0] == TouchKind.SIDE
    assert contact.curvature_along[0] == pytest.approx(20.0, rel=0.02)


def test_crease_has_its_direction_and_angle():
    """A tilted beam meets the box's rim: normal square to both, infinite curvature along, flat across."""
    direction = unit(np.array([[0.3, 0.1, -1.0]]))
    contact = box().first_contact([[0.12, 0.01, 0.12]], direction, LENGTH, translation=-0.1 * X)
    assert contact.kind[0] == TouchKind.EDGE
    assert not contact.line[0]
    assert abs(contact.edge_direction[0, 1]) == pytest.approx(1.0)
    assert contact.dihedral[0] == pytest.approx(np.pi / 2)
    np.testing.assert_allclose(contact.normal[0], unit(np.cross(-Y, direction))[0], atol=1e-12)
    assert np.isinf(contact.curvature_along[0])
    assert contact.curvature_across[0] == pytest.approx(0.0)
    # The rim runs from y = -60 to 60 mm and is touched at y = 18 mm; t = direction x normal is nearly y.
    assert np.ptp(contact.edge_interval[0]) == pytest.approx(
        0.12 * abs((np.cross(direction, contact.normal))[0, 1])
    )


def test_corner_of_the_silhouette_has_no_radius():
    """A beam laid on an upright edge of the box: both curvatures infinite, the normal between its sides."""
    for radius in (0.0, 0.4e-3):
        contact = box().first_contact(
            [[0.1, 0.11, 0.12]], -Z, LENGTH, translation=[[-0.1, -0.1, 0]], radius=radius
        )
        assert contact.kind[0] == TouchKind.EDGE
        assert np.isinf(contact.curvature_across[0])
        np.testing.assert_allclose(contact.normal[0], [np.sqrt(0.5), np.sqrt(0.5), 0], atol=1e-6)


def test_rim_of_a_disc_is_round_across():
    """A beam tilted over a cylinder's rim slides on an ellipse: curvature n . curve, from the rim's own."""
    direction = unit(np.array([[-1.0, 0, 0.1]]))
    contact = rod().first_contact([[0.1, 0.0, 0.1]], direction, LENGTH, translation=-0.1 * Z)
    radial = contact.normal[0, 0]
    assert contact.kind[0] == TouchKind.EDGE
    # Seen along the beam a circle of radius r is an ellipse of curvature sin(tilt) / r at its flat side.
    assert contact.curvature_across[0] == pytest.approx(radial / 0.006, rel=5e-3)


def test_rim_met_askew_has_the_curvature_of_its_projection():
    """A beam skew over a rim slides on the projection of the rim: compared by finite differences."""
    drum = trimesh.creation.cylinder(radius=0.03, height=0.1, sections=512)
    direction = unit(np.array([[-1.0, 0.9, 0.2]]))
    contact = MeshEnvironment(drum).first_contact(
        [[0.12, -0.08, 0.1]], direction, LENGTH, translation=-0.1 * Z
    )
    assert contact.kind[0] == TouchKind.EDGE
    turn = np.arctan2(contact.point[0, 1], contact.point[0, 0]) + np.array([-1e-3, 0.0, 1e-3])
    rim = np.stack([0.03 * np.cos(turn), 0.03 * np.sin(turn), np.full(3, 0.05)], axis=1)
    across, up = rim @ np.cross(direction, contact.normal)[0], rim @ contact.normal[0]
    slope = np.diff(up) / np.diff(across)
    bend = np.diff(slope)[0] / (0.5 * (across[2] - across[0])) / (1.0 + slope.mean() ** 2) ** 1.5
    assert abs(np.einsum("ij,ij->i", contact.edge_direction, direction)[0]) > 0.3
    # Sides of 0.37 mm: the normal differs from the circle's by up to half a side, 0.4 degrees.
    assert contact.curvature_across[0] == pytest.approx(-bend, rel=0.02)


def test_silhouette_of_a_skew_rod_is_straight():
    """Across a beam that lies skew on a rod the section is bent, but the silhouette is not."""
    direction = unit(np.array([[-1.0, 0, -0.5]]))
    contact = rod().first_contact([[0.1, 0.05, 0.05]], direction, LENGTH, translation=-0.1 * Y)
    along = (1.0 - direction[0, 2] ** 2) / 0.006
    assert contact.kind[0] == TouchKind.SIDE
    assert contact.curvature_along[0] == pytest.approx(along, rel=2e-3)
    assert contact.curvature_across[0] == pytest.approx(0.0, abs=1e-3)


def test_tip_base_and_start():
    """The kinds that are no side: the tip on a face, the root on a face, a beam that stands in a body."""
    environment = box()
    tip = environment.first_contact([[0.0, 0.01, 0.3]], -Z, 0.1, translation=-0.2 * Z)
    assert tip.kind[0] == TouchKind.TIP
    assert tip.distance[0] == pytest.approx(0.1)
    np.testing.assert_allclose(tip.normal[0], [0, 0, 1], atol=1e-12)
    root = environment.first_contact([[0.1, 0.01, 0.0]], X, 0.1, translation=-0.2 * X)
    assert root.kind[0] == TouchKind.BASE
    inside = environment.first_contact([[0.0, 0.01, 0.2]], -Z, LENGTH, translation=-0.2 * X)
    assert inside.touching[0]
    assert inside.hit[0]
    assert inside.travel[0] == pytest.approx(0.0)
    assert inside.distance[0] == pytest.approx(0.16)
    still = environment.first_contact([[0.0, 0.01, 0.2]], -Z, LENGTH, translation=np.zeros((1, 3)))
    assert still.touching[0]


def test_a_miss_travels_all_the_way():
    """Nothing met: hit is false, the travel is the whole motion, indices are -1."""
    contact = box().first_contact([[0.2, 0, 0.2]], -Z, LENGTH, translation=0.3 * X)
    assert not contact.hit[0]
    assert contact.travel[0] == pytest.approx(0.3)
    assert contact.face[0] == contact.body[0] == contact.kind[0] == TouchKind.NONE
    assert (
        len(box().first_contact(np.zeros((0, 3)), np.zeros((0, 3)), LENGTH, translation=np.zeros((0, 3))).hit)
        == 0
    )


@pytest.mark.parametrize("name", ["sphere", "torus", "blob"])
def test_normals_and_curvature_follow_the_analytic_shape(name, mesh_file, rng):
    """On meshes of known shapes contacts have the shape's normal, section and silhouette."""
    environment, truth = MeshEnvironment.load(mesh_file(name)), shapes.load(name)
    topology = environment.topology
    face = rng.integers(0, len(topology.corners), 400)
    normal = topology.normals[face]
    direction = unit(np.cross(normal, rng.normal(size=(400, 3))))
    base = environment.triangles[face].mean(axis=1) + 0.02 * normal - 0.1 * direction
    contact = environment.first_contact(base, direction, LENGTH, translation=-0.05 * normal)
    side = (contact.kind == TouchKind.SIDE) & ~contact.touching
    assert side.sum() > 250
    surface = truth.surface(contact.point[side])
    cosine = np.einsum("ij,ij->i", contact.normal_smooth[side], surface.normal)
    assert np.quantile(np.arccos(np.clip(np.abs(cosine), -1, 1)), 0.95) < np.deg2rad(0.05)
    d = contact.direction[side]
    t = np.cross(d, contact.normal[side])
    on_d = np.einsum("nij,nj->ni", surface.axes, d)
    on_t = np.einsum("nij,nj->ni", surface.axes, t)
    a, b, c = (
        (p * q * surface.curvatures).sum(axis=1) for p, q in ((on_d, on_d), (on_d, on_t), (on_t, on_t))
    )
    largest = np.abs(surface.curvatures).max(axis=1)
    assert np.quantile(np.abs(contact.curvature_along[side] - a) / largest, 0.95) < 3e-3
    # The silhouette divides by the section along the beam: only where that is not nearly flat is it a test.
    bent = a > 0.2 * largest
    error = np.abs(contact.curvature_across[side] - (c - b * b / np.where(bent, a, 1.0))) / largest
    assert np.quantile(error[bent], 0.95) < 1e-2


# -------------------------------------------------------------------------------- bodies as they come


def test_winding_does_not_matter(rng):
    """Faces turned over, some or all, give the same contacts, normals and curvatures."""
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.05)
    base, direction, way = around(0.05, 100, rng)
    expected = MeshEnvironment(mesh).first_contact(base, direction, LENGTH, translation=way)
    for part in (slice(None), slice(None, None, 3)):
        faces = mesh.faces.copy()
        faces[part] = faces[part, ::-1]
        flipped = MeshEnvironment(trimesh.Trimesh(mesh.vertices, faces, process=False))
        contact = flipped.first_contact(base, direction, LENGTH, translation=way)
        np.testing.assert_allclose(contact.travel, expected.travel, atol=1e-12)
        np.testing.assert_allclose(contact.normal, expected.normal, atol=1e-9)
        np.testing.assert_allclose(contact.curvature_along, expected.curvature_along, rtol=1e-9)


def test_open_sheet_is_touched_from_both_sides():
    """A single sheet, open and thin: the normal faces the beam on either side; its rim is a crease."""
    sheet = trimesh.Trimesh(
        [[0, -0.05, -0.05], [0, 0.05, -0.05], [0, 0.05, 0.05], [0, -0.05, 0.05]], [[0, 1, 2], [0, 2, 3]]
    )
    environment = MeshEnvironment(sheet)
    direction = unit(np.array([[0.0, 0.2, -1.0]]))
    for side in (1.0, -1.0):
        contact = environment.first_contact(
            [[0.05 * side, 0.0, 0.1]], direction, LENGTH, translation=-0.1 * side * X
        )
        assert contact.hit[0]
        np.testing.assert_allclose(contact.normal[0], [side, 0, 0], atol=1e-12)
    rim = environment.first_contact([[-0.05, 0.0, 0.1]], X, LENGTH, translation=-0.1 * Z)
    assert rim.kind[0] == TouchKind.EDGE
    assert rim.dihedral[0] == pytest.approx(np.pi)


def test_degenerate_faces_are_left_out():
    """Faces without area change nothing."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.05)
    faces = np.concatenate([ball.faces, [[0, 0, 1], [3, 3, 3]], [[0, 1, 1]]])
    environment = MeshEnvironment(trimesh.Trimesh(ball.vertices, faces, process=False))
    assert len(environment.topology.corners) == len(ball.faces)
    assert not environment.topology.sharp.any()


def test_bodies_keep_their_pose_name_and_friction():
    """A scene of two placed boxes: each contact knows its body, each body its friction."""
    scene = trimesh.Scene()
    cube = trimesh.creation.box(extents=(0.02, 0.02, 0.02))
    scene.add_geometry(cube, node_name="near", geom_name="cube")
    scene.add_geometry(
        cube,
        node_name="far",
        geom_name="cube",
        transform=trimesh.transformations.translation_matrix([0.1, 0, 0]),
    )
    environment = MeshEnvironment(scene, friction=(0.1, 0.4))
    np.testing.assert_allclose(environment.bounds, [[-0.01, -0.01, -0.01], [0.11, 0.01, 0.01]])
    contact = environment.first_contact(
        [[0.0, 0.05, 0.1], [0.1, 0.05, 0.1]], [[0, 0, -1]] * 2, LENGTH, translation=[[0, -0.1, 0]] * 2
    )
    names = [environment.body_names[i] for i in contact.body]
    assert names == ["near", "far"]
    np.testing.assert_allclose(environment.friction[contact.body], [0.1, 0.4])


def test_segments_are_blocked_by_bodies_only_between_their_ends():
    """Any body between the ends blocks; beyond them, or beside the segment, none does."""
    environment = box()
    hit = environment.segments_hit(
        [[-0.2, 0, 0], [-0.2, 0, 0], [-0.2, 0, 0.05]], [[0.2, 0, 0], [-0.06, 0, 0], [0.2, 0, 0.05]]
    )
    np.testing.assert_array_equal(hit, [True, False, False])
    assert environment.rays_cast == 3


# -------------------------------------------------------------------------------- silhouettes


@pytest.mark.parametrize("radius", [0.0, 0.4e-3])
def test_profile_of_a_sphere_is_a_circle(radius, rng):
    """Facets sag by 13 um; the profile is the smooth sphere's within 0.5 um, and has no kinks."""
    normal = unit(rng.normal(size=(60, 3)))
    direction = unit(np.cross(normal, rng.normal(size=(60, 3))))
    offsets = np.linspace(-0.01, 0.01, 15)
    heights = sphere().profile(
        (0.05 + radius) * normal, direction, np.full(60, 0.1), normal, LENGTH, offsets, radius=radius
    )
    true = np.sqrt((0.05 + radius) ** 2 - offsets**2) - 0.05 - radius
    assert np.abs(heights - true).max() < 0.5e-6


def test_profile_follows_t_which_is_direction_cross_normal():
    """On a box the silhouette falls off beyond the corner, on the side of positive offsets."""
    # Beam along -z on the side x = 50 mm, normal x: t = -z cross x = -y, so the end y = -60 mm is at +60 mm.
    heights = box().profile(
        [[0.05, 0.0, 0.04]],
        -Z,
        [0.08],
        X,
        LENGTH,
        np.array([-0.061, -0.03, 0.0, 0.03, 0.059, 0.061]),
        depth=0.02,
    )[0]
    np.testing.assert_allclose(heights[1:5], 0.0, atol=1e-9)
    assert heights[0] == heights[5] == -np.inf
    shifted = box().profile(
        [[0.05, -0.05, 0.04]], -Z, [0.08], X, LENGTH, np.array([-0.02, 0.02]), depth=0.02
    )[0]
    assert shifted[0] == pytest.approx(0.0, abs=1e-9)
    assert shifted[1] == -np.inf


def test_profile_of_a_hollow_rises_to_the_sides(rng):
    """Inside the ring of a torus, beams along its axis lie in a hollow of the hole's radius."""
    truth = shapes.load("torus")
    mesh = truth.mesh()
    environment = MeshEnvironment(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False))
    hole = truth.project(np.array([[0.036, 0.0, 0.0]])).point[0, 0]
    turn = rng.uniform(0, 2 * np.pi, 20)
    normal = -np.stack([np.cos(turn), np.sin(turn), np.zeros(20)], axis=1)
    offsets = np.linspace(-0.2, 0.2, 9) * hole
    heights = environment.profile(
        -hole * normal, np.repeat(-Z, 20, axis=0), np.full(20, 0.1), normal, LENGTH, offsets
    )
    # A rise above the start counts as standing there, so the start is as high as the widest offset.
    true = hole - np.sqrt(hole**2 - offsets**2)
    assert np.abs(heights - true).max() < 2e-6
    contact = environment.first_contact(
        -hole * normal + 0.01 * normal + 0.1 * Z,
        np.repeat(-Z, 20, axis=0),
        LENGTH,
        translation=-0.02 * normal,
    )
    np.testing.assert_allclose(contact.curvature_across, -1.0 / hole, rtol=5e-3)


# -------------------------------------------------------------------------------- loading and refusals


def test_units_of_files(tmp_path):
    """A file that names its unit needs none, others need one, and a wrong one is refused."""
    ball = trimesh.creation.icosphere(subdivisions=1, radius=50.0)
    plain = tmp_path / "ball.stl"
    ball.export(plain)
    environment = MeshEnvironment.load(plain, unit="mm")
    np.testing.assert_allclose(np.ptp(environment.bounds, axis=0), 0.1, rtol=0.02)
    shift = trimesh.transformations.translation_matrix([0.3, 0, 0])
    moved = MeshEnvironment.load(plain, unit="mm", transform=shift)
    np.testing.assert_allclose(moved.bounds - environment.bounds, [[0.3, 0, 0]] * 2, atol=1e-9)
    with pytest.raises(UsageError, match=r"ball\.stl .*--unit"):
        MeshEnvironment.load(plain)
    with pytest.raises(UsageError, match="furlong"):
        MeshEnvironment.load(plain, unit="furlong")
    metric = tmp_path / "ball.glb"
    trimesh.creation.icosphere(subdivisions=1, radius=0.05).export(metric)
    np.testing.assert_allclose(np.ptp(MeshEnvironment.load(metric).bounds, axis=0), 0.1, rtol=0.02)
    with pytest.raises(UsageError, match="not in mm"):
        MeshEnvironment.load(metric, unit="mm")


def test_ply_header_names_the_unit(mesh_file):
    """The project's own meshes carry their unit in the header."""
    environment = MeshEnvironment.load(mesh_file("sphere"))
    truth = shapes.load("sphere").mesh()
    # Single precision in the file: 1e-7 of 0.1 m.
    np.testing.assert_allclose(environment.bounds, [truth.vertices.min(0), truth.vertices.max(0)], atol=1e-8)


def test_files_that_are_no_meshes_are_refused_by_name(tmp_path):
    """Missing, empty, unreadable, without triangles, not numbers, without area: one line, with the name."""
    missing = tmp_path / "missing.stl"
    empty = tmp_path / "empty.stl"
    empty.touch()
    broken = tmp_path / "broken.ply"
    broken.write_text("no mesh")
    flat = tmp_path / "flat.obj"
    flat.write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    points = tmp_path / "points.obj"
    points.write_text("v 0 0 0\nv 1 0 0\n")
    lost = tmp_path / "lost.off"
    lost.write_text("OFF\n3 1 0\n0 0 0\n1 0 0\nnan 1 0\n3 0 1 2\n")
    for path, remedy in (
        (missing, "does not exist"),
        (empty, "is empty"),
        (broken, "cannot be read"),
        (flat, "no area"),
        (points, "no triangles"),
        (lost, "not numbers"),
    ):
        with pytest.raises(UsageError, match=remedy) as caught:
            MeshEnvironment.load(path, unit="mm")
        assert path.name in str(caught.value)
        assert "\n" not in str(caught.value)


def test_requests_without_sense_are_refused():
    """Shapes, zero directions, both motions or none, leaning axes, bad radii and frictions."""
    environment = box()
    base = [[0.0, 0.0, 0.2]]
    for arguments, remedy in (
        ({}, "exactly one"),
        ({"translation": X, "rotation": (X, 0.1)}, "exactly one"),
        ({"translation": [[1.0, 0.0]]}, r"\(n, 3\)"),
        ({"translation": [[np.nan, 0.0, 0.0]]}, "finite"),
        ({"rotation": (Z, 0.1)}, "square to the beams"),
        ({"rotation": (X, 4.0)}, "half a turn"),
        ({"translation": X, "radius": -1.0}, "radius"),
    ):
        with pytest.raises(UsageError, match=remedy):
            environment.first_contact(base, -Z, LENGTH, **arguments)
    with pytest.raises(UsageError, match="zero vector"):
        environment.first_contact(base, 0 * Z, LENGTH, translation=X)
    with pytest.raises(UsageError, match="length"):
        environment.first_contact(base, -Z, 0.0, translation=X)
    with pytest.raises(UsageError, match="friction"):
        box(friction=(0.1, 0.2))
    with pytest.raises(UsageError, match="friction"):
        box(friction=-0.1)
