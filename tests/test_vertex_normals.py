"""Normals at the vertices of meshes whose surfaces are known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from contour import shapes
from contour.mesh_env import MeshEnvironment


def lean_at_corners(environment, truth):
    """Angle (f, 3) [deg] between vertex normals and the shape's own, on each face's side of creases."""
    corners, middles = environment.triangles, environment.triangles.mean(axis=1)
    inside = 0.999 * corners + 0.001 * middles[:, None]
    true = truth.surface(inside.reshape(-1, 3)).normal
    found = environment.surface.normals[environment.topology.patch_corners].reshape(-1, 3)
    sine = np.linalg.norm(np.cross(true, found), axis=1)
    return np.rad2deg(np.arctan2(sine, np.abs((true * found).sum(axis=1)))).reshape(-1, 3)


@pytest.mark.parametrize("name", ["gear", "shaft", "vase"])
def test_flats_stay_flat_up_to_fillets(name, mesh_file):
    """Where curvature jumps on a mesh's edges normals are the shape's; weights alone miss by 3 degrees."""
    lean = lean_at_corners(MeshEnvironment.load(mesh_file(name)), shapes.load(name))
    # What stays is below the threshold for turning, 0.05 degrees, twice.
    assert lean.max() < 0.1


@pytest.mark.parametrize("name, most", [("torus", 0.005), ("blob", 0.02), ("sphere", 0.005)])
def test_smoothly_bent_surfaces_are_left_to_their_weights(name, most, mesh_file):
    """Without jumps nothing is turned: the error stays that of Max1999, of second order."""
    lean = lean_at_corners(MeshEnvironment.load(mesh_file(name)), shapes.load(name))
    assert lean.max() < most


def test_uneven_triangles_on_a_sphere_hardly_matter(rng):
    """Vertices moved about by a quarter of an edge: chords of arcs hold whatever the triangles look like."""
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.06)
    edge = np.median(mesh.edges_unique_length)
    moved = mesh.vertices + 0.2 * edge * rng.normal(size=mesh.vertices.shape)
    moved *= 0.06 / np.linalg.norm(moved, axis=1)[:, None]
    environment = MeshEnvironment(trimesh.Trimesh(moved, mesh.faces, process=False))
    lean = lean_at_corners(environment, shapes.load("sphere"))
    assert np.quantile(lean, 0.95) < 0.2


def test_noise_turns_nothing(rng):
    """With vertices 0.02 mm off, chords tell nothing: normals err no more than those of the faces' mean."""
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=0.06)
    noisy = mesh.vertices + 2e-5 * rng.normal(size=mesh.vertices.shape)
    environment = MeshEnvironment(trimesh.Trimesh(noisy, mesh.faces, process=False))
    lean = lean_at_corners(environment, shapes.load("sphere"))
    # Facets of 2 mm lean by 0.02 / 2 or 0.6 degrees; six of them about a vertex average to half of that.
    assert np.median(lean) < 0.4
    assert np.quantile(lean, 0.99) < 1.2
