"""Surfaces from points on contours: where they run, what they rest on, what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import pyvista
import trimesh

from contour import cloud, shapes
from contour.contacts import Contacts, Flag, Kind
from contour.errors import UsageError
from contour.isosurface import Triangles
from contour.scan import prepare, run
from contour.scene import load_scene
from contour.surface import MINIMUM, _supported, _thinnest, observations, reconstruct, samples_of

COARSE = 4e-3
"""Grid of quick tests [m]."""


def _contours(name, count, rng, *, noise=0.1e-3, turn=0.5, cuts=36):
    """Points and normals of the shape ``name`` on ``cuts`` plane sections, with noise [m, deg]."""
    mesh = shapes.load(name).mesh()
    truth = trimesh.Trimesh(np.array(mesh.vertices), np.array(mesh.faces), process=False)
    middle, ways = truth.bounds.mean(axis=0), rng.normal(size=(cuts, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    lines = np.concatenate(
        [
            trimesh.intersections.mesh_plane(
                truth, way, middle + rng.uniform(-0.45, 0.45) * np.ptp(truth.vertices @ way) * way
            )
            for way in ways
        ]
    )
    long = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1)
    at = (np.arange(count) + 0.5) * long.sum() / count
    near = shapes.load(name).project(lines[np.searchsorted(np.cumsum(long), at)].mean(axis=1))
    normals = near.normal + np.deg2rad(turn) * rng.normal(size=(count, 3))
    return near.point + noise * rng.normal(size=(count, 1)) * near.normal, normals


def _off(name, vertices):
    """Distance (v,) from vertices to the shape."""
    return np.linalg.norm(shapes.load(name).project(vertices).point - vertices, axis=1)


def _mesh(made):
    return trimesh.Trimesh(made.vertices, made.faces, process=False)


@pytest.mark.parametrize("count,method", [(200, "auto"), (400, "layers"), (1200, "auto")])
def test_a_torus_keeps_its_hole(rng, count, method):
    """Closed, Euler number 0, outward, and the accuracy asked of surfaces, from 200 points on."""
    made = reconstruct(*_contours("torus", count, rng), method=method, spacing=COARSE)
    assert made.watertight
    assert _mesh(made).euler_number == 0
    assert _mesh(made).volume == pytest.approx(2.0 * np.pi**2 * 0.06 * 0.025**2, rel=0.02)
    off = _off("torus", made.vertices)
    assert off.mean() < (0.3e-3 if count < 500 else 0.1e-3)
    assert np.all(np.sum(made.normals * shapes.load("torus").project(made.vertices).normal, axis=1) > 0.9)
    assert made.method == ("hermite" if count == 200 else "layers")
    assert np.mean(off < 1.96 * made.sigma) > 0.85
    assert made.touched == pytest.approx(1.0, abs=1e-9 if count == 1200 else 0.1)
    assert (made.notes == ()) == (made.touched > 0.995)


@pytest.mark.slow
def test_thin_walls_and_handles_stay_apart(rng):
    """The mug: one body, a handle (Euler number 0), walls of 4 mm between contacts on both sides."""
    made = reconstruct(*_contours("mug", 2500, rng, cuts=80))
    assert made.watertight
    assert _mesh(made).euler_number == 0
    assert _mesh(made).body_count == 1
    assert _off("mug", made.vertices).mean() < 0.15e-3


def test_bodies_stay_apart(rng):
    """Two spheres make two closed bodies."""
    points, normals = _contours("sphere", 300, rng)
    both = np.concatenate((points, 0.5 * points + [0.15, 0.0, 0.02]))
    made = reconstruct(both, np.tile(normals, (2, 1)), spacing=COARSE)
    assert made.watertight
    assert _mesh(made).body_count == 2


def test_motions_move_the_surface_along(rng):
    """Turned and shifted points give the same surface there, up to the grid's."""
    points, normals = _contours("torus", 300, rng)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    one = reconstruct(points, normals, spacing=COARSE)
    two = reconstruct(points @ turn.T + 0.3, normals @ turn.T, spacing=COARSE)
    there = pyvista.PolyData((two.vertices - 0.3) @ turn)
    mesh = pyvista.PolyData.from_regular_faces(one.vertices, one.faces)
    gap = np.abs(there.compute_implicit_distance(mesh)["implicit_distance"])
    assert gap.max() < 3.0 * COARSE**2 / (8.0 * 0.025)  # chords are up to a cell's diagonal long


def test_vertices_lie_on_the_surface_whatever_the_grid(rng):
    """On a grid of 6 mm a torus' vertices are as near as on one of 3 mm: chords cost faces, not vertices."""
    points, normals = _contours("torus", 500, rng, noise=1e-6, turn=0.02)
    fine, coarse = (reconstruct(points, normals, spacing=h) for h in (3e-3, 6e-3))
    assert _off("torus", fine.vertices).mean() < 50e-6
    assert _off("torus", coarse.vertices).mean() < 1.5 * _off("torus", fine.vertices).mean()


def test_grids_resolve_the_thinnest_part(rng):
    """Points on both sides of a plate tell its thickness; those of a ball tell nothing near."""
    x, y = rng.uniform(-0.05, 0.05, (2, 400))
    side = np.where(np.arange(400) % 2, 1.0, -1.0)
    plate = np.stack((x, y, 2e-3 * side), axis=1)
    up = side[:, None] * [0.0, 0.0, 1.0]
    assert 4e-3 <= _thinnest(observations(plate, up)) < 5e-3
    ball = _good(rng)
    assert _thinnest(observations(**ball)) > 0.08


def test_pieces_without_points_are_dropped():
    """Of two spheres one has points on it: the other is the field's invention."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.05)
    both = np.concatenate((ball.vertices, ball.vertices + 0.2))
    faces = np.concatenate((ball.faces, ball.faces + len(ball.vertices)))
    kept = _supported(Triangles(vertices=both, faces=faces), ball.vertices[:10] + 1e-4, 2e-3)
    assert np.array_equal(kept.vertices[kept.faces], both[ball.faces])
    none = _supported(Triangles(vertices=both, faces=faces), ball.vertices[:2], 2e-3)
    assert len(none.faces) == 0


def test_trust_is_the_distance_to_support_on_the_same_side(rng):
    """A wedge without points; and a plate touched on one side, where the other side's contacts do not count."""
    points, normals = _contours("torus", 800, rng)
    keep = np.abs(np.arctan2(points[:, 1], points[:, 0])) > 0.4
    made = reconstruct(points[keep], normals[keep], spacing=COARSE)
    assert made.watertight
    around = np.abs(np.arctan2(made.vertices[:, 1], made.vertices[:, 0]))
    assert made.trust[around < 0.03].min() > 0.01
    assert np.median(made.sigma[around < 0.03]) > 5.0 * np.median(made.sigma[around > 0.6])
    apart = np.linalg.norm(points[keep][:, None] - made.vertices[::50], axis=2)
    like = normals[keep] @ made.normals[::50].T > 0.0
    assert made.trust[::50] == pytest.approx(np.where(like, apart, np.inf).min(axis=0))
    x, y = rng.uniform(-0.05, 0.05, (2, 400))
    plate = np.stack((x, y, np.where(np.arange(400) % 2, 0.002, -0.002)), axis=1)
    up = np.array([0.0, 0.0, 1.0]) * np.sign(plate[:, 2:])
    part = (plate[:, 2] > 0.0) | (plate[:, 0] < 0.0)
    made = reconstruct(plate[part], up[part], spacing=1.5e-3)
    below = (made.normals[:, 2] < -0.9) & (np.abs(made.vertices[:, :2]) < 0.04).all(axis=1)
    assert made.trust[below & (made.vertices[:, 0] > 0.02)].min() > 0.015
    assert made.trust[below & (made.vertices[:, 0] < -0.01)].max() < 0.015


def test_what_was_not_touched_is_told(rng):
    """A torus without its underside closes by a guess, a tube without ends does not close: both are said."""
    points, normals = _contours("torus", 700, rng)
    upper = points[:, 2] > 0.0
    made = reconstruct(points[upper], normals[upper], spacing=COARSE)
    assert made.touched < 0.85
    assert "a guess" in made.notes[0]
    assert made.trust.max() > 0.02
    turn, z = rng.uniform([[0.0], [-0.05]], [[2.0 * np.pi], [0.05]], (2, 300))
    out = np.stack((np.cos(turn), np.sin(turn), 0.0 * turn), axis=1)
    tube = reconstruct(0.03 * out + z[:, None] * [0.0, 0.0, 1.0], out, spacing=COARSE)
    assert not tube.watertight
    assert "open" in tube.notes[-1]


def _good(rng):
    way = rng.normal(size=(60, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    return {"points": 0.05 * way, "normals": way}


FAULTS = {
    "too few": (lambda a: {k: v[: MINIMUM - 1] for k, v in a.items()}, "19 points are too few"),
    "one plane": (lambda a: a | {"points": a["points"] * [1.0, 1.0, 0.0]}, "lie on one plane"),
    "nan": (
        lambda a: a | {"points": np.where(np.arange(60)[:, None] == 7, np.nan, a["points"])},
        "of point 7",
    ),
    "nan normal": (lambda a: a | {"normals": np.full((60, 3), np.inf)}, "normals of 60 points"),
    "zero normal": (
        lambda a: a | {"normals": a["normals"] * (np.arange(60) != 3)[:, None]},
        "point 3 is zero",
    ),
    "shape": (lambda a: a | {"points": np.zeros((60, 2))}, r"give \(n, 3\)"),
    "other shape": (lambda a: a | {"sigma_point": np.ones(3)}, r"sigma_point have shape \(3,\)"),
    "negative": (lambda a: a | {"sigma_normal": -np.ones(60)}, "negative"),
    "method": (lambda a: a | {"method": "vtk"}, "choose one of auto, hermite, layers"),
    "spacing": (lambda a: a | {"spacing": 1.0}, "above 0 and below"),
    "inwards": (lambda a: a | {"normals": -a["normals"]}, "point into the body|contradict"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_bad_input_is_told_in_one_line(rng, fault):
    """What is wrong, and the remedy."""
    spoil, message = FAULTS[fault]
    with pytest.raises(UsageError, match=message) as caught:
        reconstruct(**spoil(_good(rng)))
    assert "\n" not in str(caught.value)


def test_hermite_refuses_what_would_take_minutes(rng):
    """The dense equations of thousands of points."""
    way = rng.normal(size=(2500, 3))
    with pytest.raises(UsageError, match="at most 2000 points"):
        reconstruct(way, way, method="hermite")


def test_noise_is_as_told(rng):
    """The gradient's covariance: sigma across the normal, slack along it, half a unit where nothing was seen."""
    points, normal = rng.normal(size=(30, 3)), np.tile([0.0, 0.0, 2.0], (30, 1))
    unseen = np.zeros((30, 3))
    unseen[0] = [3.0, 0.0, 0.0]
    made = observations(points, normal, unseen, np.full(30, 0.02), np.full(30, 1e-3))
    assert made.value_noise == pytest.approx(1e-6)
    across = made.gradient_noise[:, [0, 1], [0, 1]]
    assert across[1:] == pytest.approx(4e-4)
    assert across[0] == pytest.approx([0.25 + 4e-4, 4e-4])
    assert made.gradients[1] == pytest.approx([0.0, 0.0, 1.0])
    assert np.sum(made.gradients[0] ** 2) < 1.0


def _table(direction):
    """A contour square to ``direction`` with tips, and one of a single tip."""
    count = 40
    turn = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    one = np.cross(direction, [0.0, 0.0, 1.0])
    one /= np.linalg.norm(one)
    normal = np.cos(turn)[:, None] * one + np.sin(turn)[:, None] * np.cross(direction, one)
    contacts = Contacts(
        which=np.where(np.arange(count) == 39, 1, 0),
        touch=np.zeros((count, 2)),
        point=0.05 * normal,
        normal=normal,
        distance=np.full(count, 0.1),
        sigma_distance=np.full(count, 0.2e-3),
        outward=turn,
        sigma_normal=np.full(count, 0.01),
        friction_angle=np.zeros(count),
        sigma_friction=np.zeros(count),
        radius_along=np.zeros(count),
        curvature_across=np.zeros(count),
        kind=np.where(np.arange(count) % 3 == 0, Kind.TIP, Kind.SIDE).astype(np.int8),
        pushes=np.ones(count, dtype=np.int64),
        flags=np.where(np.arange(count) == 5, Flag.LOST, 0).astype(np.int64),
        machine_time=np.ones(count),
        sequence=np.arange(count),
    )
    return cloud.table(contacts)


def test_contacts_become_samples(tmp_path):
    """Flagged ones and tips of unknown direction are left out; a tip's normal is unknown along the beam."""
    direction = np.array([0.6, 0.64, 0.48])
    cloud.write_csv(tmp_path / "contacts.csv", _table(direction))
    made = samples_of(cloud.read_csv(tmp_path / "contacts.csv"))
    assert len(made.points) == 38
    tip = np.delete(np.arange(40) % 3 == 0, [5, 39])
    assert np.abs(made.unseen[tip] @ direction) == pytest.approx(1.0)
    assert np.all(made.unseen[~tip] == 0.0)
    assert made.sigma_point[tip].min() > 0.08e-3 > made.sigma_point[~tip].max()
    assert made.sigma_normal == pytest.approx(0.01)


@pytest.mark.slow
def test_a_scan_becomes_a_surface(mesh_file, tmp_path):
    """A third of a default scan of the sphere: accuracy 0.3 mm, closed."""
    scene = load_scene(mesh_file("sphere"), unit="mm")
    scene = replace(scene, plan=replace(scene.plan, contours=20))
    run(prepare(scene), tmp_path / "sphere")
    made = samples_of(cloud.read_csv(tmp_path / "sphere" / "contacts.csv"))
    found = reconstruct(
        made.points,
        made.normals,
        unseen=made.unseen,
        sigma_normal=made.sigma_normal,
        sigma_point=made.sigma_point,
    )
    assert found.watertight
    assert np.mean(_off("sphere", found.vertices)) < 0.3e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["vase", "gear", "blob"])
@pytest.mark.parametrize("count", [2000, 10_000])
def test_test_objects_are_as_accurate_as_asked(rng, name, count):
    """Mean accuracy within 0.3 mm, closed, the gear with its bore."""
    made = reconstruct(*_contours(name, count, rng, cuts=60))
    assert made.watertight
    assert _mesh(made).euler_number == (0 if name == "gear" else 2)
    assert _off(name, made.vertices).mean() < 0.3e-3


@pytest.mark.slow
def test_fifty_thousand_points_are_no_trouble(rng):
    """Accuracy gains by them."""
    made = reconstruct(*_contours("mug", 50_000, rng, cuts=200))
    assert made.watertight
    assert _off("mug", made.vertices).mean() < 0.05e-3
