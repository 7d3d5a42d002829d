"""Closest points, signed distances and even samples, against brute force and closed forms."""

from __future__ import annotations

import time

import numpy as np
import pytest
import trimesh

from contour.errors import UsageError
from contour.nearest import Target, as_faces, sample_evenly


def _brute(points, vertices, faces):
    """Distance of each point to the nearest triangle, by trimesh's exact point-to-triangle function."""
    corners = vertices[faces]
    best = np.full(len(points), np.inf)
    for row, point in enumerate(points):
        near = trimesh.triangles.closest_point(corners, np.tile(point, (len(corners), 1)))
        best[row] = np.linalg.norm(near - point, axis=1).min()
    return best


def test_distances_are_those_to_every_triangle(rng):
    """Triangles of very different sizes, points near and far: exact to rounding."""
    triangles = rng.normal(0.0, 0.05, (300, 1, 3)) + rng.normal(0.0, 1.0, (300, 3, 3)) * rng.choice(
        [1e-4, 1e-2, 0.1], (300, 1, 1)
    )
    target = Target(*as_faces(triangles))
    points = rng.normal(0.0, 0.1, (200, 3)) * rng.choice([0.1, 1.0, 20.0], (200, 1))
    found = target.closest(points)
    np.testing.assert_allclose(found.distance, _brute(points, target.vertices, target.faces), atol=1e-12)
    np.testing.assert_allclose(np.abs(target.signed(points)), found.distance, atol=1e-12)
    corners = target.vertices[target.faces[found.face]]
    on = trimesh.triangles.closest_point(corners, points)
    np.testing.assert_allclose(on, found.point, atol=1e-12)


def test_signs_hold_beside_sharp_edges(rng):
    """A box, points nearest to its faces, edges and corners: plus outside, minus inside."""
    box = trimesh.creation.box(extents=(0.2, 0.1, 0.02))
    target = Target(np.array(box.vertices), np.array(box.faces))
    points = rng.uniform(-0.15, 0.15, (4000, 3))
    inside = (np.abs(points) < np.array([0.1, 0.05, 0.01])).all(axis=1)
    over = np.maximum(np.abs(points) - np.array([0.1, 0.05, 0.01]), 0.0)
    signed = target.signed(points)
    assert 20 < inside.sum() < 3000
    np.testing.assert_array_equal(signed < 0.0, inside)
    np.testing.assert_allclose(signed[~inside], np.linalg.norm(over, axis=1)[~inside], atol=1e-12)


def test_samples_are_even_and_always_the_same():
    """A box's faces get samples by their area, to one sample; the seed decides where."""
    box = trimesh.creation.box(extents=(0.2, 0.1, 0.05))
    vertices, faces = np.array(box.vertices), np.array(box.faces)
    samples = sample_evenly(vertices, faces, 7000, seed=1)
    count = np.bincount(samples.face, minlength=12)
    assert np.abs(count - 7000 * box.area_faces / box.area).max() <= 1.0
    np.testing.assert_allclose(np.abs(samples.points / (0.5 * np.array([0.2, 0.1, 0.05]))).max(axis=1), 1.0)
    np.testing.assert_allclose(samples.normals, box.face_normals[samples.face], atol=1e-12)
    for face in range(12):
        rows = samples.face == face
        middle = samples.points[rows].mean(axis=0) - box.triangles_center[face]
        assert np.linalg.norm(middle) < 0.1 * np.sqrt(box.area_faces[face])
    again, other = (sample_evenly(vertices, faces, 7000, seed=seed) for seed in (1, 2))
    np.testing.assert_array_equal(again.points, samples.points)
    assert not np.allclose(other.points, samples.points)


def test_faces_share_corners_and_pieces_are_told_apart():
    """A soup of two boxes: 16 vertices, two pieces; a face without area is dropped."""
    box = trimesh.creation.box(extents=(0.1, 0.1, 0.1))
    soup = np.concatenate((box.triangles, box.triangles + np.array([0.3, 0.0, 0.0]), np.zeros((1, 3, 3))))
    vertices, faces = as_faces(soup)
    assert faces.shape == (24, 3)
    target = Target(vertices, faces)
    assert len(np.unique(faces)) == 16
    np.testing.assert_array_equal(np.bincount(target.pieces()), [12, 12])
    assert len(np.unique(target.pieces()[:12])) == 1


def test_bad_triangles_are_refused():
    """Nothing, the wrong shape, and numbers that are none."""
    with pytest.raises(UsageError, match="no triangles"):
        Target(*as_faces(np.zeros((0, 3, 3))))
    with pytest.raises(UsageError, match=r"\(4, 3\)"):
        as_faces(np.zeros((4, 3)))
    with pytest.raises(UsageError, match="finite"):
        as_faces(np.full((1, 3, 3), np.nan))


def test_many_points_on_many_faces_take_seconds(rng):
    """80,000 faces, 50,000 points: below 10 s of one core (0.4 s in fact)."""
    ball = trimesh.creation.icosphere(subdivisions=6, radius=0.1)
    points = rng.normal(size=(50_000, 3))
    points *= 0.103 / np.linalg.norm(points, axis=1)[:, None]
    begun = time.process_time()
    target = Target(np.array(ball.vertices), np.array(ball.faces))
    found = target.closest(points).distance
    assert time.process_time() - begun < 10.0
    np.testing.assert_allclose(found, 0.003, atol=0.02e-3)
