"""Rates of first contact on the 100k-face blob, in batches as a lockstep scan asks for them, on one core."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from contour import shapes
from contour.mesh_env import MeshEnvironment

BEAMS = 256
LENGTH = 0.21  # [m]


@pytest.fixture(scope="module")
def blob():
    """The blob as a trimesh mesh in metres."""
    mesh = shapes.load("blob").mesh()
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


@pytest.fixture(scope="module")
def environment(blob):
    """The blob to touch, its trees built."""
    return MeshEnvironment(blob)


def unit(vectors):
    """Vectors (n, 3) of length one."""
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


@pytest.fixture(scope="module")
def beams(environment):
    """Bases, directions and ways of beams that come sideways at faces of the blob from 60 mm away."""
    rng = np.random.default_rng(7)
    face = rng.integers(0, len(environment.topology.corners), BEAMS)
    normal = environment.topology.normals[face]
    direction = unit(np.cross(normal, rng.normal(size=(BEAMS, 3))))
    way = -unit(normal + 0.3 * np.cross(normal, direction) * rng.normal(size=(BEAMS, 1)))
    aim = environment.triangles[face].mean(axis=1)
    return aim - 0.06 * way - rng.uniform(0.03, 0.18, BEAMS)[:, None] * direction, direction, way


@pytest.mark.parametrize("radius", [0.0, 0.4e-3], ids=["line", "wire"])
def test_translations(benchmark, environment, beams, radius):
    """256 guarded moves of 100 mm."""
    base, direction, way = beams
    contact = benchmark(
        environment.first_contact, base, direction, LENGTH, translation=0.1 * way, radius=radius
    )
    benchmark.extra_info["contacts_per_s"] = BEAMS / benchmark.stats.stats.min
    assert contact.hit.all()


@pytest.mark.parametrize("radius", [0.0, 0.4e-3], ids=["line", "wire"])
def test_turns(benchmark, environment, beams, radius):
    """256 turns of 60 degrees."""
    base, direction, way = beams
    turns = (unit(np.cross(direction, way)), np.full(BEAMS, np.deg2rad(60.0)))
    contact = benchmark(environment.first_contact, base, direction, LENGTH, rotation=turns, radius=radius)
    benchmark.extra_info["contacts_per_s"] = BEAMS / benchmark.stats.stats.min
    assert contact.hit.mean() > 0.3


def test_profiles(benchmark, environment, beams):
    """Silhouettes of 64 contacts at 17 offsets within 8 mm."""
    base, direction, way = (part[:64] for part in beams)
    contact = environment.first_contact(base, direction, LENGTH, translation=0.1 * way)
    heights = benchmark(
        environment.profile,
        contact.point,
        direction,
        contact.distance,
        contact.normal,
        LENGTH,
        np.linspace(-8e-3, 8e-3, 17),
    )
    assert np.isfinite(heights).mean() > 0.9


def test_building(benchmark, blob):
    """Topology, curvature, both trees."""
    environment = benchmark.pedantic(MeshEnvironment, args=(blob,), rounds=3)
    assert len(environment.topology.corners) == len(blob.faces)
