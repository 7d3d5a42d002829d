"""First contacts against brute force in other formulas, thin features, capsules, and the work they take."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from contour import shapes
from contour.bvh import Bvh, Regions
from contour.first_contact import FirstContactSolver
from contour.motions import Motions, slides, turns
from contour.sweep import Where

LENGTH = 0.21  # [m]
EXACT = 1e-9
"""[m] or [rad]: the promise. Coordinates below 0.5 m and condition numbers to 1e4 give 0.5 * 2e-16 * 1e4 =
1e-12.
"""


def unit(vectors):
    """Vectors (n, 3) of length one."""
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def needles(rng, count=150):
    """A bed of upright needles 0.1 to 1 mm thick, 20 to 60 mm tall, as bare triangles (f, 3, 3)."""
    parts = []
    for _ in range(count):
        needle = trimesh.creation.cylinder(
            radius=rng.uniform(0.05e-3, 0.5e-3), height=rng.uniform(0.02, 0.06), sections=6
        )
        needle.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
        needle.apply_translation(rng.uniform(-0.05, 0.05, 3))
        parts.append(needle.triangles)
    return np.concatenate(parts)


def motions_at(triangles, n, rng, *, miss=0.5):
    """Beams aimed near faces, sideways with a lean, as translations and as turns."""
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    size = np.linalg.norm(high - low)
    aim = triangles[rng.integers(0, len(triangles), n)].mean(axis=1) + rng.normal(size=(n, 3)) * 0.02 * size
    direction = unit(rng.normal(size=(n, 3)))
    way = unit(np.cross(direction, rng.normal(size=(n, 3))) + miss * rng.normal(size=(n, 3)))
    along = rng.uniform(0.02, 0.2, n)
    length = np.full(n, LENGTH)
    start = aim - way * size - direction * along[:, None]
    slide = slides(start, direction, length, way * 1.7 * size)
    axis = unit(np.cross(direction, way))
    angle = np.full(n, np.deg2rad(100.0))
    back = np.cos(-0.7 * angle)[:, None] * direction + np.sin(-0.7 * angle)[:, None] * np.cross(
        axis, direction
    )
    turn = turns(aim - direction * along[:, None], back, length, axis, angle)
    return slide, turn


def ray_face(origin, way, triangles):
    """Least positive way along a ray to any triangle (Moeller-Trumbore)."""
    one, two = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    p = np.cross(way, two)
    det = np.einsum("ij,ij->i", one, p)
    ok = np.abs(det) > 1e-30
    det = np.where(ok, det, 1.0)
    u = np.einsum("ij,ij->i", origin - triangles[:, 0], p) / det
    q = np.cross(origin - triangles[:, 0], one)
    v = np.einsum("j,ij->i", way, q) / det
    t = np.einsum("ij,ij->i", two, q) / det
    t = t[ok & (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0)]
    return t.min(initial=np.inf)


def brute_slide(triangles, motions, i):
    """Edges met by the side as 3 x 3 systems, faces met by the ends as rays, faces pierced at the start."""
    base, d, w = motions.base[i], motions.direction[i], motions.advance[i]
    length, limit = motions.length[i], motions.limit[i]
    best = np.inf
    pierced = ray_face(base, d, triangles)
    if pierced <= length:
        return 0.0
    for end in (base, base + length * d):
        best = min(best, ray_face(end, w, triangles))
    start = triangles.reshape(-1, 3)
    side = np.roll(triangles, -1, axis=1).reshape(-1, 3) - start
    # base + x d + t w = start + u side: Cramer's rule.
    normal = np.cross(d, w)
    det = side @ normal
    ok = np.abs(det) > 1e-30
    det = np.where(ok, det, 1.0)
    u = ((base - start) @ normal) / det
    offset = start + u[:, None] * side - base
    square = 1.0 - (d @ w) ** 2
    t = (offset @ w - (offset @ d) * (d @ w)) / square
    x = (offset @ d - (offset @ w) * (d @ w)) / square
    t = t[ok & (u >= 0) & (u <= 1) & (x >= 0) & (x <= length) & (t >= 0)]
    best = min(best, t.min(initial=np.inf))
    return best if best <= limit else np.inf


def brute_turn(triangles, motions, i):
    """Edges in polar coordinates of the swept plane, and the circle of the tip against the faces."""
    base, d, e = motions.base[i], motions.direction[i], motions.advance[i]
    length, limit = motions.length[i], motions.limit[i]
    axis = np.cross(d, e)
    if ray_face(base, d, triangles) <= length:
        return 0.0
    start = triangles.reshape(-1, 3) - base
    side = np.roll(triangles, -1, axis=1).reshape(-1, 3) - base - start
    rate = side @ axis
    ok = np.abs(rate) > 1e-30
    u = -(start @ axis) / np.where(ok, rate, 1.0)
    at = start + u[:, None] * side
    angle = np.mod(np.arctan2(at @ e, at @ d), 2 * np.pi)
    met = ok & (u >= 0) & (u <= 1) & (np.linalg.norm(at, axis=1) <= length)
    best = angle[met].min(initial=np.inf)
    # Tip: n . (L (d cos + e sin)) = n . P.
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    a, b = length * (normal @ d), length * (normal @ e)
    level = np.einsum("ij,ij->i", normal, triangles[:, 0] - base) / np.hypot(a, b)
    for sign in (1.0, -1.0):
        q = np.mod(np.arctan2(b, a) + sign * np.arccos(np.clip(level, -1, 1)), 2 * np.pi)
        tip = base + length * (np.cos(q)[:, None] * d + np.sin(q)[:, None] * e)
        parts = [
            np.einsum("ij,ij->i", np.cross(triangles[:, j] - tip, triangles[:, (j + 1) % 3] - tip), normal)
            for j in range(3)
        ]
        inside = (np.abs(level) <= 1) & (np.min(parts, axis=0) >= 0)
        best = min(best, q[inside].min(initial=np.inf))
    return best if best <= limit else np.inf


def check_exact(triangles, n, rng, **aim):
    """Both motions agree with brute force on every beam; returns the share of beams that touch."""
    solver = FirstContactSolver(triangles)
    hits = []
    for motions in motions_at(triangles, n, rng, **aim):
        brute = brute_turn if motions.turning else brute_slide
        expected = np.array([brute(triangles, motions, i) for i in range(n)])
        touches = solver.solve(motions)
        found = np.isfinite(expected)
        np.testing.assert_array_equal(np.isfinite(touches.travel), found)
        assert np.abs(touches.travel[found] - expected[found]).max(initial=0.0) < EXACT
        hits.append(found.mean())
    return np.mean(hits)


@pytest.mark.parametrize("name", [n for n in shapes.NAMES if n not in {"blob", "mug", "gear", "vase"}])
def test_equals_brute_force_on_every_mesh(name, rng):
    """Translations and turns touch when and where float64 brute force over all edges and faces says."""
    mesh = shapes.load(name).mesh()
    assert check_exact(mesh.vertices[mesh.faces], 25, rng) > 0.3


@pytest.mark.slow
@pytest.mark.parametrize("name", shapes.NAMES)
def test_equals_brute_force_on_every_mesh_at_length(name, rng):
    """The same with more beams, the large meshes included."""
    mesh = shapes.load(name).mesh()
    assert check_exact(mesh.vertices[mesh.faces], 150, rng) > 0.3


def test_equals_brute_force_among_needles(rng):
    """Needles far thinner than the pitch of any fan of rays are not passed through."""
    triangles = needles(rng)
    assert check_exact(triangles, 150, rng, miss=0.2) > 0.3


def test_needle_between_rays_is_felt():
    """One needle of 0.1 mm, placed between all rays of the fan, stops the beam."""
    needle = trimesh.creation.cylinder(radius=0.05e-3, height=0.02, sections=8)
    solver = FirstContactSolver(needle.triangles)
    # The beam lies along x, the needle stands along z, and the beam comes down z onto its end.
    base = np.array([[-0.0937, 0.0, 0.1]])
    motions = slides(base, np.array([[1.0, 0, 0]]), np.array([LENGTH]), np.array([[0, 0, -0.2]]))
    touches = solver.solve(motions)
    assert touches.travel[0] == pytest.approx(0.09, abs=EXACT)
    assert abs(touches.distance[0] - 0.0937) <= 0.05e-3 + EXACT


def test_face_nearest_along_the_motion_wins_over_the_hint(rng, monkeypatch):
    """The answer does not depend on what the rays propose, only the time does."""
    triangles = needles(rng, 40)
    solver = FirstContactSolver(triangles)
    motions, turning = motions_at(triangles, 100, rng)
    expected, turned = solver.solve(motions), solver.solve(turning)
    for hint in ("_slide_hint", "_turn_hint"):
        monkeypatch.setattr(
            FirstContactSolver,
            hint,
            lambda _, m: np.random.default_rng(1).integers(-1, len(triangles), len(m.base)),
        )
    np.testing.assert_array_equal(solver.solve(motions).travel, expected.travel)
    np.testing.assert_array_equal(solver.solve(turning).travel, turned.travel)


def segment_triangle_gap(start, stop, triangles):
    """Distance between one segment and each triangle (f,), for references only."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])

    def inside(point):
        parts = [
            np.einsum(
                "ij,ij->i", np.cross(triangles[:, j] - point, triangles[:, (j + 1) % 3] - point), normal
            )
            for j in range(3)
        ]
        return np.min(parts, axis=0) >= 0

    heights = [
        np.einsum("ij,ij->i", end - triangles[:, 0], normal) / np.linalg.norm(normal, axis=1)
        for end in (start, stop)
    ]
    gap = np.min(
        [np.where(inside(e), np.abs(h), np.inf) for e, h in zip((start, stop), heights, strict=True)], axis=0
    )
    drop = np.where(heights[0] == heights[1], 1.0, heights[0] - heights[1])
    crossing = start + (heights[0] / drop)[:, None] * (stop - start)
    gap = np.where((heights[0] * heights[1] <= 0) & inside(crossing), 0.0, gap)
    u = stop - start
    for j in range(3):
        c, v = triangles[:, j], triangles[:, (j + 1) % 3] - triangles[:, j]
        w = start - c
        uu, uv, vv, uw, vw = u @ u, v @ u, np.sum(v * v, 1), w @ u, np.sum(v * w, 1)
        det = uu * vv - uv * uv
        s = np.where(
            det > 1e-16 * uu * vv, np.clip((uv * vw - vv * uw) / np.where(det > 0, det, 1), 0, 1), 0.0
        )
        t = (uv * s + vw) / vv
        s = np.where(t < 0, np.clip(-uw / uu, 0, 1), np.where(t > 1, np.clip((uv - uw) / uu, 0, 1), s))
        t = np.clip(t, 0, 1)
        gap = np.minimum(gap, np.linalg.norm(w + s[:, None] * u - t[:, None] * v, axis=1))
    return gap


def advance_capsule(triangles, motions, radius, i):
    """Conservative advancement: no point moves faster than 1 (translation) or L (turn)."""
    one = motions.rows(slice(i, i + 1))
    speed = motions.length[i] if motions.turning else 1.0
    travel = 0.0
    for _ in range(20000):
        base, d, _ = one.moved(np.array([travel]))
        gap = segment_triangle_gap(base[0], base[0] + motions.length[i] * d[0], triangles).min() - radius
        if gap < 1e-12:
            return travel
        travel += gap / speed
        if travel > motions.limit[i]:
            return np.inf
    return travel


@pytest.mark.parametrize("radius", [0.4e-3, 4e-3, 20e-3])
@pytest.mark.parametrize("axial", [False, True])
def test_capsule_equals_conservative_advancement(radius, axial, rng):
    """Beams with a radius touch when the distance of segment and triangles falls to it."""
    triangles = rng.normal(size=(14, 1, 3)) * 0.05 + rng.normal(size=(14, 3, 3)) * 0.03
    n = 25
    base = rng.normal(size=(n, 3)) * 0.12
    direction = unit(rng.normal(size=(n, 3)))
    way = direction * rng.choice([-0.2, 0.2], size=(n, 1)) if axial else -1.2 * base
    length = rng.uniform(0.03, 0.2, n)
    axis = unit(np.cross(direction, rng.normal(size=(n, 3))))
    solver = FirstContactSolver(triangles)
    ends = 0
    for motions in (
        slides(base, direction, length, way),
        turns(base, direction, length, axis, rng.uniform(0.5, np.pi, n)),
    ):
        touches = solver.solve(motions, radius)
        expected = np.array([advance_capsule(triangles, motions, radius, i) for i in range(n)])
        found = np.isfinite(expected)
        np.testing.assert_array_equal(np.isfinite(touches.travel), found)
        # The reference stops within 1e-12 m; a grazing angle of 1e-2 makes 1e-10 of it.
        assert np.abs(touches.travel[found] - expected[found]).max(initial=0.0) < EXACT
        ends += np.isin(touches.where, [Where.TIP, Where.BASE]).sum()
    assert ends > 0 or radius < 4e-3  # thin beams seldom meet few faces with their ends


def test_capsule_shrinks_to_the_line(rng):
    """As the radius goes to zero the capsule touches when the line does."""
    mesh = shapes.load("torus").mesh()
    triangles = mesh.vertices[mesh.faces]
    solver = FirstContactSolver(triangles)
    for motions in motions_at(triangles, 200, rng, miss=0.1):
        line, capsule = solver.solve(motions), solver.solve(motions, 1e-9)
        both = np.isfinite(line.travel) & np.isfinite(capsule.travel)
        assert both.sum() > 50
        scale = 0.02 if motions.turning else 1.0
        # A radius r moves the touch by r / cos(incidence); grazing touches are left out below 1/50.
        gap = (line.travel[both] - capsule.travel[both]) * scale
        assert np.quantile(np.abs(gap), 0.9) < 50e-9


def test_narrow_needle_beside_the_axis_is_felt_by_the_radius():
    """A needle of 0.1 mm that passes the axis at 0.3 mm touches a beam of 0.4 mm radius, exactly then."""
    needle = trimesh.creation.box(extents=(0.1e-3, 0.1e-3, 0.02))
    needle.apply_translation([0.03, 0.35e-3, 0.0])
    solver = FirstContactSolver(needle.triangles)
    # Its near side stands at y = 0.3 mm, its top at z = 10 mm; the axis comes down along z at y = 0.
    motions = slides(
        np.array([[-0.05, 0.0, 0.1]]), np.array([[1.0, 0, 0]]), np.array([LENGTH]), np.array([[0, 0, -0.2]])
    )
    assert not np.isfinite(solver.solve(motions).travel[0])
    height = np.sqrt(0.4e-3**2 - 0.3e-3**2)
    assert solver.solve(motions, 0.4e-3).travel[0] == pytest.approx(0.09 - height, abs=EXACT)


def test_motion_along_the_beam_touches_with_the_tip():
    """A beam pushed along itself touches when its tip reaches the face, drawn back when its base does."""
    solver = FirstContactSolver(trimesh.creation.box(extents=(0.1, 0.1, 0.1)).triangles)
    base, down = np.array([[0.01, 0.02, 0.3]]), np.array([[0.0, 0, -1.0]])
    touches = solver.solve(slides(base, down, np.array([LENGTH]), 0.1 * down))
    assert touches.travel[0] == pytest.approx(0.3 - LENGTH - 0.05, abs=EXACT)
    assert touches.where[0] == Where.TIP
    touches = solver.solve(slides(base, -down, np.array([LENGTH]), 0.3 * down))
    assert touches.travel[0] == pytest.approx(0.25, abs=EXACT)
    assert touches.where[0] == Where.BASE


@pytest.mark.parametrize("turning", [False, True])
def test_root_inside_its_radius_touches_at_the_start(turning):
    """A beam whose root stands nearer to a face than its radius, and leads away from it, touches at once."""
    solver = FirstContactSolver(trimesh.creation.box(extents=(0.1, 0.1, 0.1)).triangles)
    base, up, side = np.array([[0.01, 0.02, 0.051]]), np.array([[0.0, 0, 1.0]]), np.array([[1.0, 0, 0]])
    length = np.array([LENGTH])
    motions = (
        turns(base, up, length, np.array([[0.0, 1.0, 0]]), np.array([0.5]))
        if turning
        else slides(base, up, length, 0.1 * side)
    )
    assert not np.isfinite(solver.solve(motions, 0.9e-3).travel[0])
    touches = solver.solve(motions, 1.1e-3)
    assert touches.travel[0] == 0.0
    assert touches.where[0] == Where.BASE


def test_answers_do_not_depend_on_the_batch(rng):
    """Beams asked one by one get, bit for bit, what they get among others."""
    triangles = needles(rng, 60)
    solver = FirstContactSolver(triangles)
    for motions in motions_at(triangles, 40, rng):
        for radius in (0.0, 0.4e-3):
            together = solver.solve(motions, radius)
            alone = [solver.solve(motions.rows(np.array([i])), radius) for i in range(40)]
            np.testing.assert_array_equal(together.travel, [one.travel[0] for one in alone])
            np.testing.assert_array_equal(together.distance, [one.distance[0] for one in alone])


def test_contacts_move_with_the_scene(rng):
    """Turned and shifted rigidly, scene and beams touch after the same travel."""
    mesh = shapes.load("fin").mesh()
    triangles = mesh.vertices[mesh.faces]
    rotation = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    shift = np.array([0.03, -0.02, 0.05])
    for motions in motions_at(triangles, 100, rng):
        moved = Motions(
            turning=motions.turning,
            base=motions.base @ rotation.T + shift,
            direction=motions.direction @ rotation.T,
            advance=motions.advance @ rotation.T,
            frame=motions.frame @ rotation.T,
            length=motions.length,
            limit=motions.limit,
        )
        here = FirstContactSolver(triangles).solve(motions).travel
        there = FirstContactSolver(triangles @ rotation.T + shift).solve(moved).travel
        found = np.isfinite(here)
        np.testing.assert_array_equal(np.isfinite(there), found)
        assert np.abs(here[found] - there[found]).max() < EXACT


def test_a_contact_takes_a_fixed_number_of_rays(rng):
    """Work is counted: 18 rays for a translation, 28 for a turn, whatever the mesh."""
    mesh = shapes.load("torus").mesh()
    triangles = mesh.vertices[mesh.faces]
    solver = FirstContactSolver(triangles)
    for motions, rays in zip(motions_at(triangles, 50, rng), (18, 28), strict=True):
        before = solver.rays.rays_cast
        solver.solve(motions)
        assert solver.rays.rays_cast - before == 50 * rays


def test_the_tree_holds_every_face_and_loses_none(rng):
    """Leaves hold all faces, and a search returns every leaf whose faces meet the region."""
    triangles = rng.normal(size=(1000, 1, 3)) + 0.1 * rng.normal(size=(1000, 3, 3))
    tree = Bvh(triangles)
    assert set(tree.leaf_faces.reshape(-1)) == set(range(1000))
    g = rng.normal(size=(20, 2, 3))
    low = rng.normal(size=(20, 2)) - 0.3
    regions = Regions(slabs=g, low=low, high=low + 0.6)
    region, leaf = tree.leaves_in(regions)
    found = set(zip(region.tolist(), leaf.tolist(), strict=True))
    value = np.einsum("nsj,fvj->nsfv", g, triangles)
    inside = ((value >= low[..., None, None]) & (value <= low[..., None, None] + 0.6)).all(axis=1).any(axis=2)
    home = np.zeros(1000, dtype=int)
    home[tree.leaf_faces] = np.arange(len(tree.leaf_faces))[:, None]
    for i, face in zip(*np.nonzero(inside), strict=True):
        assert any((i, at) in found for at in np.nonzero((tree.leaf_faces == face).any(axis=1))[0])
    assert len(found) < 20 * len(tree.leaf_faces) / 2
