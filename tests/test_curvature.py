"""Creases, normals and curvature of meshes against the surfaces they were made from."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from contour.curvature import SmoothSurface
from contour.topology import build_topology


def topology_of(mesh):
    """Topology of a trimesh mesh of one body."""
    faces = np.asarray(mesh.faces, dtype=np.int64)
    return build_topology(np.asarray(mesh.vertices), faces, np.zeros(len(faces), dtype=np.int64))


def torus(ring, tube, n, m, rng=None, jitter=0.0):
    """A torus about z; with jitter its vertices slide on the surface by that share of the mesh's pitch."""
    u, v = np.meshgrid(np.arange(n) / n, np.arange(m) / m, indexing="ij")
    if rng is not None:
        u = u + jitter / n * rng.normal(size=u.shape)
        v = v + jitter / m * rng.normal(size=v.shape)
    u, v = 2 * np.pi * u, 2 * np.pi * v
    r = ring + tube * np.cos(v)
    points = np.stack([r * np.cos(u), r * np.sin(u), tube * np.sin(v)], axis=-1).reshape(-1, 3)
    i, j = np.arange(n)[:, None], np.arange(m)[None]
    a, b = i * m + j, (i + 1) % n * m + j
    c, d = (i + 1) % n * m + (j + 1) % m, i * m + (j + 1) % m
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return trimesh.Trimesh(points, faces, process=False)


def torus_errors(topology, surface, ring, tube, rng, n=4000):
    """Errors of the normal [rad] and of the curvature in random directions, as a share of the largest."""
    face = rng.integers(0, len(topology.corners), n)
    weight = rng.dirichlet([1, 1, 1], n)
    p = np.einsum("kc,kcj->kj", weight, topology.vertices[topology.corners[face]])
    u = np.arctan2(p[:, 1], p[:, 0])
    v = np.arctan2(p[:, 2], np.hypot(p[:, 0], p[:, 1]) - ring)
    zero = np.zeros(n)
    around = np.stack([-np.sin(u), np.cos(u), zero], axis=1)
    normal = np.stack([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)], axis=1)
    over = np.cross(normal, around)
    turn = rng.uniform(0, np.pi, n)
    t = np.cos(turn)[:, None] * around + np.sin(turn)[:, None] * over
    true = np.cos(v) / (ring + tube * np.cos(v)) * np.cos(turn) ** 2 + np.sin(turn) ** 2 / tube
    got = np.einsum("ki,kij,kj->k", t, surface.shape_operator(face, weight), t)
    cosine = np.einsum("kj,kj->k", surface.normal(face, weight), normal)
    return np.arccos(np.clip(cosine, -1, 1)), np.abs(got - true) * tube


def test_no_crease_on_spheres_however_coarse():
    """Icospheres of 80 to 5120 faces have no sharp edge."""
    for level in (1, 2, 3, 4):
        assert not topology_of(trimesh.creation.icosphere(subdivisions=level)).sharp.any()


@pytest.mark.parametrize("sections", [8, 12, 24, 64])
def test_creases_of_cylinders_are_their_rims(sections):
    """A cylinder of 8 sides has edges of 45 degrees along it, and still only its rims are sharp."""
    topology = topology_of(trimesh.creation.cylinder(radius=1.0, height=3.0, sections=sections))
    ends = topology.vertices[topology.edge_vertices[topology.sharp]]
    assert topology.sharp.sum() == 2 * sections
    assert np.ptp(ends[..., 2], axis=1).max() < 1e-12


def test_creases_of_a_box_are_its_edges():
    """Subdivided twice, twelve edges are 48 segments of 90 degrees, all else is smooth."""
    topology = topology_of(trimesh.creation.box(extents=(1, 2, 3)).subdivide().subdivide())
    assert topology.sharp.sum() == 48
    np.testing.assert_allclose(topology.dihedral[topology.sharp], np.pi / 2, atol=1e-12)
    assert topology.dihedral[~topology.sharp].max() < 1e-12


def test_flat_sides_are_flat_up_to_their_edges():
    """A box has no curvature anywhere, and its normals do not blend over its edges."""
    topology = topology_of(trimesh.creation.box(extents=(1, 2, 3)).subdivide())
    surface = SmoothSurface(topology)
    assert np.abs(surface.tensors).max() < 1e-12
    assert np.abs(np.abs(surface.normals).max(axis=1) - 1.0).max() < 1e-12


def test_normals_of_spheres_are_exact(rng):
    """Weights of Max1999 give the radius as normal at each vertex of an irregular sphere."""
    sphere = trimesh.creation.icosphere(subdivisions=3)
    points = sphere.vertices + 0.01 * rng.normal(size=sphere.vertices.shape)
    mesh = trimesh.Trimesh(points / np.linalg.norm(points, axis=1)[:, None], sphere.faces, process=False)
    topology = topology_of(mesh)
    surface = SmoothSurface(topology)
    at = np.zeros((topology.patch_count, 3))
    at[topology.patch_corners] = topology.vertices[topology.corners]
    assert np.abs(np.einsum("ij,ij->i", surface.normals, at) - 1.0).max() < 1e-12


@pytest.mark.parametrize("jitter", [0.0, 0.12])
def test_curvature_of_a_torus(jitter, rng):
    """Regular meshes give it to second order of the pitch, irregular ones to about one percent."""
    mesh = torus(1.0, 0.4, 180, 90, rng, jitter)
    topology = topology_of(mesh)
    normal, curvature = torus_errors(topology, SmoothSurface(topology), 1.0, 0.4, rng)
    # Regular: chords of 4 degrees err by (4 deg)^2 / 6 = 0.0008 in curvature; irregular: the published 0.04
    # p95.
    assert np.quantile(curvature, 0.95) < (0.0016 if jitter == 0.0 else 0.05)
    assert np.quantile(normal, 0.95) < np.deg2rad(0.05 if jitter == 0.0 else 0.3)


def test_curvature_converges_with_the_square_of_the_pitch(rng):
    """Halving the pitch of a regular torus quarters the error."""
    errors = []
    for n in (60, 120):
        topology = topology_of(torus(1.0, 0.4, n, n // 2))
        errors.append(np.median(torus_errors(topology, SmoothSurface(topology), 1.0, 0.4, rng)[1]))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.15)


def test_smoothing_takes_the_noise_out(rng):
    """Three rounds of averaging cut the error from vertex noise at least to a half."""
    mesh = torus(1.0, 0.4, 120, 60)
    mesh = trimesh.Trimesh(
        mesh.vertices + 0.02 * 0.05 * rng.normal(size=mesh.vertices.shape), mesh.faces, process=False
    )
    topology = topology_of(mesh)
    errors = [
        np.median(torus_errors(topology, SmoothSurface(topology, smoothing=k), 1.0, 0.4, rng)[1])
        for k in (0, 3)
    ]
    assert errors[1] < 0.5 * errors[0]


def test_winding_does_not_matter():
    """Turning a third of the faces over changes no crease, and curvature only by its side's sign."""
    mesh = torus(1.0, 0.4, 60, 30)
    faces = mesh.faces.copy()
    faces[::3] = faces[::3, ::-1]
    plain = topology_of(mesh)
    mixed = topology_of(trimesh.Trimesh(mesh.vertices, faces, process=False))
    assert not mixed.sharp.any()
    side = np.einsum("ij,ij->i", plain.normals, mixed.normals)
    np.testing.assert_allclose(side, side[0] * np.ones(len(faces)), atol=1e-12)
    third = np.full((len(faces), 3), 1 / 3)
    every = np.arange(len(faces))
    # The corners of a face are listed in another order: sums differ by rounding alone.
    np.testing.assert_allclose(
        SmoothSurface(mixed).shape_operator(every, third) * side[0],
        SmoothSurface(plain).shape_operator(every, third),
        atol=1e-9,
    )


def test_unmerged_faces_are_joined():
    """Triangles that come with their own vertices each, as in STL files, are one surface."""
    sphere = trimesh.creation.icosphere(subdivisions=2)
    soup = trimesh.Trimesh(
        sphere.triangles.reshape(-1, 3), np.arange(3 * len(sphere.faces)).reshape(-1, 3), process=False
    )
    topology = topology_of(soup)
    assert len(topology.vertices) == len(sphere.vertices)
    assert not topology.sharp.any()


def test_open_rims_are_creases():
    """The rim of a sheet is sharp, with the angle of a fold."""
    x, y = np.meshgrid(np.arange(4.0), np.arange(3.0), indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), np.zeros(12)], axis=1)
    quads = [(3 * i + j, 3 * i + j + 3, 3 * i + j + 4, 3 * i + j + 1) for i in range(3) for j in range(2)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    topology = topology_of(trimesh.Trimesh(points, faces, process=False))
    assert topology.sharp.sum() == 10
    np.testing.assert_allclose(topology.dihedral[topology.sharp], np.pi)


def test_a_wide_flat_keeps_its_normal_beside_a_fillet():
    """Where a flat of 20 meets facets of 0.35, its normal tilts by less than a tenth of a facet's turn."""
    angles = np.deg2rad(np.arange(0, 91, 4.5))
    arc = np.stack([5 * np.sin(angles), 5 * np.cos(angles) - 5], axis=1)
    profile = np.concatenate([[[-20.0, 0.0]], arc])
    k = len(profile)
    points = np.concatenate(
        [np.column_stack([profile[:, 0], np.full(k, y), profile[:, 1]]) for y in (0.0, 5.0)]
    )
    strips = [(i, i + 1, i + 1 + k, i + k) for i in range(k - 1)]
    faces = [t for a, b, c, d in strips for t in ((a, b, c), (a, c, d))]
    surface = SmoothSurface(topology_of(trimesh.Trimesh(points, faces, process=False)))
    flat = surface.normal(np.array([0, 1]), np.full((2, 3), 1 / 3))
    assert np.arccos(np.abs(flat[:, 2]).min()) < np.deg2rad(0.45)
