"""Zero levels of fields as triangles: complete, closed, outward, and asked for only where they are."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from contour.errors import UsageError
from contour.isosurface import closed, sample, triangles

LOW, HIGH = np.array([-0.12, -0.12, -0.07]), np.array([0.12, 0.12, 0.07])
SPACING = 2e-3


def _torus(p):
    """Signed distance to a torus of radii 80 and 20 mm."""
    return np.hypot(np.hypot(p[:, 0], p[:, 1]) - 0.08, p[:, 2]) - 0.02


def test_a_torus_is_closed_outward_and_in_place():
    """Euler number 0, volume 2 pi^2 R r^2 within a percent, chords within h^2 / (8 r)."""
    made = triangles(sample(_torus, LOW, HIGH, SPACING))
    mesh = trimesh.Trimesh(made.vertices, made.faces, process=False)
    assert closed(made.faces)
    assert mesh.euler_number == 0
    assert mesh.volume == pytest.approx(2.0 * np.pi**2 * 0.08 * 0.02**2, rel=0.01)
    assert np.abs(_torus(made.vertices)).max() < 2.0 * SPACING**2 / (8.0 * 0.02)


def test_only_the_neighbourhood_is_asked():
    """The mesh is that of a grid asked everywhere, of which a fifth was asked."""
    asked = 0

    def counted(p):
        nonlocal asked
        asked += len(p)
        return _torus(p)

    grid = sample(counted, LOW, HIGH, SPACING)
    index = np.argwhere(np.ones(grid.values.shape, dtype=bool))
    full = _torus(grid.origin + SPACING * index).reshape(grid.values.shape)
    assert asked < 0.2 * full.size
    crossed = np.zeros(full.shape, dtype=bool)
    for axis in range(3):
        first, last = ([slice(None)] * 3 for _ in range(2))
        first[axis], last[axis] = slice(None, -1), slice(1, None)
        change = full[tuple(first)] * full[tuple(last)] < 0.0
        crossed[tuple(first)] |= change
        crossed[tuple(last)] |= change
    assert np.allclose(grid.values[crossed], full[crossed])
    assert np.array_equal(grid.values > 0.0, full > 0.0)


def test_a_field_without_zero_has_no_triangles():
    """Nothing, rather than an error."""
    made = triangles(sample(lambda p: np.ones(len(p)), LOW, HIGH, 0.01))
    assert made.vertices.shape == (0, 3)
    assert made.faces.shape == (0, 3)
    assert not closed(made.faces)


def test_what_leaves_the_box_is_open():
    """A cylinder along the whole box has no ends."""
    made = triangles(sample(lambda p: np.hypot(p[:, 0], p[:, 1]) - 0.05, LOW, HIGH, 4e-3))
    assert len(made.faces)
    assert not closed(made.faces)


def test_closed_counts_every_edge():
    """A tetrahedron is; without a face, or with one turned over, or twice, it is not."""
    whole = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    assert closed(whole)
    assert not closed(whole[1:])
    assert not closed(np.concatenate((whole[:1, ::-1], whole[1:])))
    assert not closed(np.concatenate((whole, whole[:1])))


def test_grids_too_large_are_refused():
    """Before anything is allocated, with the spacing that would do."""
    with pytest.raises(UsageError, match=r"choose a spacing of at least 0\.5\d mm"):
        sample(_torus, LOW, HIGH, 0.05e-3)
