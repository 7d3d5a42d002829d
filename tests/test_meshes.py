"""The meshes of data/meshes and the truth they were made from."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import trimesh

from contour import shapes
from contour.errors import UsageError
from contour.shapes import Region
from contour.shapes.meshing import ring_strip
from contour.shapes.path import Path as PlanePath


@functools.cache
def _mesh(name):
    """The mesh of a shape as trimesh, metres."""
    mesh = shapes.load(name).mesh()
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


@pytest.fixture(params=shapes.NAMES)
def shape(request):
    """Each shape with its mesh."""
    return shapes.load(request.param), _mesh(request.param)


def _samples(mesh, count, rng):
    """Points spread over the mesh's area."""
    points, faces = trimesh.sample.sample_surface(mesh, count, seed=int(rng.integers(1 << 30)))
    return np.asarray(points), np.asarray(faces)


def test_meshes_are_closed_and_turned_outwards(shape):
    """Watertight, consistently wound, of positive volume, without a triangle of no area."""
    _, mesh = shape
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0.0
    assert mesh.area_faces.min() > 1e-10  # 1e-4 mm^2: far above rounding, far below the smallest face made


def test_vertices_lie_on_the_true_surface(shape):
    """The truth projects every vertex onto itself; the Newton shapes stop at 1e-12 m."""
    truth, mesh = shape
    vertices = mesh.vertices[:: 1 + len(mesh.vertices) // 10_000]
    point, _ = truth.project(vertices)
    assert np.max(np.linalg.norm(point - vertices, axis=1)) < 1e-11


def test_chords_stay_near_the_true_surface(shape):
    """Middles of edges and faces are within 0.05 mm of the surface, but for a few of the level sets'."""
    truth, mesh = shape
    middles = np.concatenate((mesh.triangles_center, mesh.vertices[mesh.edges_unique].mean(axis=1)))
    middles = middles[:: 1 + len(middles) // 20_000]
    gap = np.linalg.norm(truth.project(middles).point - middles, axis=1)
    if truth.name not in {"blob", "mug"}:
        assert gap.max() < 0.05e-3
    else:  # a level set has a few longer edges on its tightest rim
        assert np.percentile(gap, 99.9) < 0.05e-3
        assert gap.max() < 0.07e-3


def test_true_normals_point_as_the_mesh_does(shape, rng):
    """Off the edges, face normals differ from the truth by no more than a chord's half angle."""
    truth, mesh = shape
    points, faces = _samples(mesh, 4000, rng)
    surface = truth.surface(points)
    cosine = np.sum(surface.normal * mesh.face_normals[faces], axis=1)
    away = surface.edge_distance > 0.1e-3
    # Faces turn by at most 10 deg against each other; level sets have slivers on their rims.
    assert np.min(cosine[away]) > np.cos(np.deg2rad(14.0 if truth.name == "mug" else 6.0))


def test_points_off_the_surface_come_back_to_their_foot(shape, rng):
    """A point 0.2 mm along the normal, either way, projects to its foot, with the normal there."""
    truth, mesh = shape
    foot = truth.surface(_samples(mesh, 2000, rng)[0])
    clear = foot.edge_distance > 0.3e-3  # nearer, another face is nearer
    for height in (0.2e-3, -0.2e-3):
        back = truth.project(foot.point[clear] + height * foot.normal[clear])
        assert np.max(np.linalg.norm(back.point - foot.point[clear], axis=1)) < 1e-10
        assert np.max(np.linalg.norm(back.normal - foot.normal[clear], axis=1)) < 1e-7


def test_curvature_is_the_turn_of_the_normal(shape, rng):
    """A step h along a tangent turns the normal by curvature times h; central differences leave O(h^2)."""
    truth, mesh = shape
    foot = truth.surface(_samples(mesh, 2000, rng)[0])
    tangent = np.cross(foot.normal, rng.normal(size=foot.normal.shape))
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    step = 1e-6
    ahead, behind = (truth.surface(foot.point + sign * step * tangent) for sign in (1.0, -1.0))
    turn = np.sum((ahead.normal - behind.normal) * tangent, axis=1) / (2.0 * step)
    # Steps over an edge, or over the joint of a line and an arc, mix two curvatures.
    same = np.all(
        np.abs(ahead.curvatures - behind.curvatures) < 1e-3 * (1.0 + np.abs(foot.curvatures)), axis=1
    )
    same &= foot.edge_distance > 10.0 * step
    assert same.mean() > 0.9
    curvature = truth.curvature(foot.point, tangent)
    assert np.max(np.abs(turn - curvature)[same] / (1.0 + np.abs(curvature[same]))) < 1e-3


@pytest.mark.parametrize(
    "name,volume",
    [
        ("box", 0.160 * 0.120 * 0.100),
        ("cylinder", np.pi * 0.050**2 * 0.120),
        ("rod2", np.pi * 0.002**2 * 0.150),
        ("sphere", 4.0 / 3.0 * np.pi * 0.060**3),
        ("torus", 2.0 * np.pi**2 * 0.060 * 0.025**2),
        ("fin", (0.119 * 0.001 + np.pi * 0.0005**2) * 0.100),
    ],
)
def test_volumes_are_the_text_book_ones(name, volume):
    """Chords within 0.02 mm cost a body at most 0.04 mm / radius of its volume."""
    found = _mesh(name).volume
    loss = {"rod2": 0.01, "fin": 0.001}.get(name, 0.002)
    assert volume * (1.0 - loss) < found < volume * (1.0 + 1e-9)


def test_bracket_loses_its_holes():
    """The volume is that of the plates less three inscribed 480-sided holes."""
    found = _mesh("bracket").volume
    plates = 0.120 * 0.010 * (0.090 + 0.080)
    polygon = 0.5 * 480 * np.sin(2.0 * np.pi / 480)
    assert found == pytest.approx(plates - 0.010 * polygon * (2 * 0.008**2 + 0.012**2), rel=1e-9)


@pytest.mark.parametrize("name", ["rod12", "rod2", "cylinder", "gear", "shaft", "bracket", "fin"])
def test_round_creases_are_fine_polygons(name):
    """Where two sides of a crease meet without a corner they turn by at most 0.75 deg, or are 25 um short."""
    mesh = _mesh(name)
    sharp = mesh.face_adjacency_angles > np.deg2rad(30.0)
    edges = mesh.face_adjacency_edges[sharp]
    at, other = edges.reshape(-1), edges[:, ::-1].reshape(-1)
    order = np.argsort(at, kind="stable")
    vertex, head, count = np.unique(at[order], return_index=True, return_counts=True)
    vertex, head = vertex[count == 2], head[count == 2]
    assert len(vertex) > 300
    back, ahead = (mesh.vertices[other[order[head + i]]] - mesh.vertices[vertex] for i in (0, 1))
    short = np.minimum(np.linalg.norm(back, axis=1), np.linalg.norm(ahead, axis=1))
    cosine = -np.sum(back * ahead, axis=1) / (np.linalg.norm(back, axis=1) * np.linalg.norm(ahead, axis=1))
    turn = np.arccos(np.clip(cosine, -1.0, 1.0))
    assert np.max(turn[short > 26e-6], initial=0.0) < np.deg2rad(0.751)
    assert turn.max() < np.deg2rad(3.0)  # the ends of the fin


@pytest.mark.parametrize("sides", [(7, 40), (40, 7), (480, 64)])
def test_a_strip_between_two_loops_covers_the_ring_once(sides):
    """Whatever their numbers of points: faces turned alike, their areas add up to that between the polygons."""
    m, n = sides
    inner, outer = (
        r * np.stack((np.cos(a), np.sin(a)), axis=1)
        for r, a in ((1.0, 0.1 + np.arange(m) * (2 * np.pi / m)), (3.0, np.arange(n) * (2 * np.pi / n)))
    )
    strip = ring_strip(inner, outer)
    a, b, c = (strip.vertices[strip.faces[:, k], :2] for k in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert area.min() > 0.0
    ring = 0.5 * (9.0 * n * np.sin(2 * np.pi / n) - m * np.sin(2 * np.pi / m))
    assert area.sum() == pytest.approx(ring, rel=1e-12)
    assert len(strip.faces) == m + n


def test_nothing_touches_the_bracket_inside_its_holes():
    """From a hole's middle the nearest surface is its wall, from over its mouth the mouth's rim: an edge."""
    bracket = shapes.load("bracket")
    axis = np.array([0.020, 0.070])
    inside = bracket.surface(np.array([[axis[0] + 1e-3, axis[1], 0.0098]]))
    assert inside.point[0] == pytest.approx([0.028, 0.070, 0.0098])
    assert inside.normal[0] == pytest.approx([-1.0, 0.0, 0.0])
    over = bracket.surface(np.array([[axis[0] + 7e-3, axis[1], 0.011]]))
    assert over.point[0] == pytest.approx([0.028, 0.070, 0.010])
    assert over.normal[0] == pytest.approx(np.array([-1.0, 0.0, 1.0]) / np.sqrt(2.0))
    assert over.edge_distance[0] == 0.0


def test_regions_tell_faces_arcs_corners_and_edges():
    """Known places of the shaft, the gear and the box have the region that a drawing would give them."""
    box = shapes.load("box").region(np.array([[0.080, 0.0, 0.0], [0.080, 0.060, 0.0], [0.080, 0.060, 0.050]]))
    assert box.tolist() == [Region.FACE, Region.EDGE, Region.EDGE]
    gear = shapes.load("gear")
    mesh = _mesh("gear").vertices
    tooth = mesh[np.abs(mesh[:, 2] - 0.014) < 3e-3]
    codes = gear.region(tooth)
    assert set(codes.tolist()) == {
        Region.FACE,
        Region.ARC,
        Region.CORNER,
    }  # flank, bore, rounded tips and roots
    bore = np.hypot(tooth[:, 0], tooth[:, 1]) < 0.015
    assert (codes[bore] == Region.ARC).all()


def test_curvature_signs_follow_the_solid():
    """Convex is positive: the torus is 1/25 mm outside along its tube and -1/35 mm inside around its axis."""
    torus = shapes.load("torus")
    around, tube = np.array([[0.0, 1.0, 0.0]]), np.array([[0.0, 0.0, 1.0]])
    inner = np.array([[0.035, 0.0, 0.0]])
    assert torus.curvature(inner, around)[0] == pytest.approx(-1.0 / 0.035)
    assert torus.curvature(inner, tube)[0] == pytest.approx(1.0 / 0.025)
    bore = shapes.load("bracket").surface(np.array([[0.020, 0.070 - 0.0079, 0.005]]))
    assert bore.curvatures.min() == pytest.approx(-1.0 / 0.008)


@pytest.mark.parametrize("name", shapes.NAMES)
def test_files_are_what_the_generator_makes(name, mesh_file, tmp_path):
    """Stored or written now, a file is the mesh to single precision, in millimetres, and says so."""
    made = _mesh(name)
    shapes.write_mesh(tmp_path / "new.ply", shapes.TriangleMesh(made.vertices, made.faces), name)
    for path in (mesh_file(name), tmp_path / "new.ply"):
        assert b"comment unit mm\n" in path.read_bytes()[:200]
        stored = trimesh.load(path, process=False)
        assert np.array_equal(stored.faces, made.faces)
        assert np.max(np.abs(stored.vertices - 1e3 * made.vertices)) < 2e-5  # float32 at 200 mm


def test_unknown_shape_is_named_with_the_closest():
    """A misspelt name is refused with what was meant."""
    with pytest.raises(UsageError, match=r"'tours'.*'torus'"):
        shapes.load("tours")


def test_points_must_be_rows_of_three():
    """Points of another shape are refused with what is wanted."""
    with pytest.raises(UsageError, match=r"\(n, 3\)"):
        shapes.load("box").project(np.zeros(3))


def test_nearest_point_of_a_path_beats_every_sample(rng):
    """No sample of a rounded polygon is nearer than the closest point found, and some come as near."""
    path = PlanePath.rounded([(0, 0), (9, 0), (9, 5), (4, 2), (0, 6)], [0.0, 1.0, 0.7, 0.9, 0.0], closed=True)
    samples = path.points_of(1e-5, 5e-3, 1.0, closed=True)
    points = rng.uniform(-3.0, 12.0, size=(100, 2))
    near = path.nearest(points)
    sampled = np.min(np.linalg.norm(points[:, None] - samples, axis=2), axis=1)
    found = np.linalg.norm(near.point - points, axis=1)
    assert np.all(found <= sampled + 1e-12)
    assert np.all(sampled - found < 2.6e-3)  # half a step of the samples


def test_overlapping_fillets_are_refused():
    """Two radii that do not fit on one side are an error, not a tangle."""
    with pytest.raises(ValueError, match="overlap"):
        PlanePath.rounded([(0, 0), (1, 0), (1, 1), (0, 1)], [0.6] * 4, closed=True)
