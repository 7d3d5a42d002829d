"""How fast mechanics and scans are, one core. Times report and never fail; ``per_second`` is in the extra info.

make bench
"""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from pytest_benchmark.fixture import BenchmarkFixture

from contour import contact, elastica, shapes
from contour.antenna import Antenna
from contour.frames import Mount
from contour.machine import MachineModel
from contour.mesh_env import MeshEnvironment
from contour.mesh_instrument import MeshInstrument
from contour.model import ModelStrategy
from contour.plan import default_plan
from contour.scan import follow
from contour.tracing import Tracer

FRICTION = float(np.tan(np.deg2rad(10.0)))


def pushes(n):
    """Eps and keywords of n pushes of all sorts."""
    rng = np.random.default_rng(1)
    body = {
        "distance": rng.uniform(0.03, 0.2, n),
        "friction": np.tan(np.deg2rad(rng.uniform(3.0, 25.0, n))),
        "radius_along": rng.uniform(0.0, 0.06, n),
        "radius_across": rng.uniform(0.015, 0.08, n),
    }
    return np.deg2rad(rng.uniform(-20.0, 20.0, n)), body


def cycle(n):
    """Sixteen angles out to 3 deg and back, (n, 16) rad."""
    shares = np.concatenate((np.linspace(0.125, 1.0, 8), np.linspace(0.9, 0.05, 8)))
    return np.tile(np.deg2rad(3.0) * shares, (n, 1))


def blob():
    """The smooth blob of 100k faces as something to touch."""
    mesh = shapes.load("blob").mesh()
    return MeshEnvironment(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False), friction=FRICTION)


def rate(benchmark: BenchmarkFixture, count: int) -> None:
    """Note how many a second; nothing where benchmarks are switched off."""
    if benchmark.stats is not None:
        benchmark.extra_info["per_second"] = round(count / benchmark.stats["min"])


def test_single_pushes(benchmark: BenchmarkFixture) -> None:
    """The reduced rod, one angle a push: at least 100,000 a second."""
    n = 20_000
    eps, body = pushes(n)
    benchmark.pedantic(lambda: contact.push_response(eps, np.deg2rad(3.0), **body), rounds=3, warmup_rounds=1)
    rate(benchmark, n)


def test_cycles(benchmark: BenchmarkFixture) -> None:
    """The reduced rod out and back over 16 angles: at least 30,000 a second."""
    n = 8_192
    eps, body = pushes(n)
    benchmark.pedantic(lambda: contact.push_cycle(eps, cycle(n), **body), rounds=3, warmup_rounds=1)
    rate(benchmark, n)


def test_exact_pushes(benchmark: BenchmarkFixture) -> None:
    """The exact rod, one angle a push, in a batch: at most 5 ms each."""
    n = 256
    eps, body = pushes(n)
    benchmark.pedantic(lambda: elastica.push_response(eps, np.deg2rad(3.0), **body), rounds=2)
    rate(benchmark, n)


@pytest.mark.slow
def test_scan_in_lockstep(benchmark: BenchmarkFixture) -> None:
    """256 contours of the blob, samples made and fitted: at least 2,000 contacts a second."""
    environment = blob()
    antenna, mount = Antenna(), Mount.identity()
    plan = default_plan(environment.bounds, antenna, mount, contours=256)

    def scan():
        instrument = MeshInstrument(
            environment, antennas=plan.contours, antenna=antenna, machine=MachineModel(), mount=mount
        )
        strategy = ModelStrategy(plan.contours, antenna, mount)
        return follow(instrument, strategy, Tracer(plan, mount, antenna))[0]

    contacts = benchmark.pedantic(scan, rounds=1)
    assert len(contacts) > plan.contours
    rate(benchmark, len(contacts))
