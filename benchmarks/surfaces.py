"""How good surfaces are, by method, shape and number of points: the table of docs/surface.md.

Made contours: the shape, 200 mm long, cut by planes of 20 and more directions at 3 levels each, points along the
sections with noise. Scans: result folders of ``contour scan data/meshes/NAME.ply``, called NAME.

    python benchmarks/surfaces.py --shapes sphere torus --points 500 2000 10000
    python benchmarks/surfaces.py --runs results/vase results/mug
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import surface_methods as tried
import trimesh
from numpy.typing import NDArray
from scipy.spatial import KDTree

from contour import cloud, shapes
from contour.errors import ContourError
from contour.hermite import fit_layers
from contour.isosurface import Triangles, closed
from contour.surface import Samples, observations, reconstruct, samples_of

FloatArray = NDArray[np.float64]

SIZE = 0.2
"""Longest edge of the made contours' bodies [m]."""
LEVELS = (-0.62, -0.05, 0.55)
"""Cuts along each direction, in half the depth."""
NOISE = {"small": (0.05e-3, 0.3), "default": (0.1e-3, 0.5), "large": (0.2e-3, 1.0)}
"""Standard deviations of points [m] and of normals [deg]."""
ASKED = 20_000
"""Samples of either surface."""
BAND = np.deg2rad(50.0)
"""Elevation of the beam, at most, as in the default plan."""
LEAN = np.deg2rad(60.0)
"""Between the sensing plane and the normal, at most."""
BEAMS = 150
CLEAR = 0.2e-3
"""Where rays along the beam start, above the surface [m]."""
NEAR = 10e-3
"""Touched: a point with a like normal nearer than this [m]."""
HERMITE = 2000
"""Points up to which the global one is tried."""

Method = Callable[[Samples, FloatArray], Triangles | None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """Points on a known surface."""

    name: str
    samples: Samples
    truth: trimesh.Trimesh
    """[m]"""


def _own(method: str) -> Method:
    def made(samples: Samples, _: FloatArray) -> Triangles | None:
        if method == "hermite" and len(samples.points) > HERMITE:
            return None
        found = reconstruct(
            samples.points,
            samples.normals,
            unseen=samples.unseen,
            sigma_normal=samples.sigma_normal,
            sigma_point=samples.sigma_point,
            method=method,
        )
        return Triangles(vertices=found.vertices, faces=found.faces)

    return made


def _of(function: Callable[[FloatArray, FloatArray], Triangles | None]) -> Method:
    return lambda samples, whole: function(samples.points, whole)


def _thinned(samples: Samples, whole: FloatArray) -> Triangles:
    found = reconstruct(*tried.thinned(samples.points, whole, 700), method="hermite")
    return Triangles(vertices=found.vertices, faces=found.faces)


METHODS: dict[str, Method] = {
    "layers": _own("layers"),
    "hermite": _own("hermite"),
    "hermite of 700": _thinned,
    "poisson": _of(tried.poisson),
    "apss": _of(tried.apss),
    "winding": _of(tried.winding),
    "vtk": lambda samples, _: tried.vtk(samples.points),
}


def made_contours(name: str, count: int, noise: str, *, gap: bool, rng: np.random.Generator) -> Case:
    """About ``count`` points on cuts of the shape ``name``; with ``gap`` a wedge of 40 deg is left out."""
    mesh = shapes.load(name).mesh()
    scale = SIZE / float(np.max(np.ptp(mesh.vertices, axis=0)))
    truth = trimesh.Trimesh(np.array(mesh.vertices) * scale, np.array(mesh.faces), process=False)
    middle = truth.bounds.mean(axis=0)
    directions = _directions(
        max(8, round(20 * min(1.0, count / 2000) ** 0.5 * max(1.0, count / 10_000) ** 0.5))
    )
    pieces = []
    for direction in directions:
        depth = np.ptp(truth.vertices @ direction) / 2.0
        pieces += [
            trimesh.intersections.mesh_plane(truth, direction, middle + level * depth * direction)
            for level in LEVELS
        ]
    ends = np.concatenate(pieces)
    long = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    # Evenly along all cuts laid end to end.
    at = (np.arange(count) + 0.5) * long.sum() / count
    which = np.searchsorted(np.cumsum(long), at)
    part = (at - (np.cumsum(long) - long)[which]) / long[which]
    points = ends[which, 0] + part[:, None] * (ends[which, 1] - ends[which, 0])
    rough, turned = NOISE[noise]
    near = shapes.load(name).project(points / scale)
    points = near.point * scale + rng.normal(0.0, rough, (count, 1)) * near.normal
    normal = near.normal + rng.normal(0.0, np.deg2rad(turned), (count, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    keep = np.ones(count, dtype=bool)
    if gap:
        around = np.arctan2(*(points - middle)[:, [1, 0]].T)
        keep = np.abs(around - 0.4) > np.deg2rad(20.0)
    samples = Samples(
        points=points[keep],
        normals=normal[keep],
        unseen=np.zeros((int(keep.sum()), 3)),
        sigma_normal=np.full(int(keep.sum()), np.deg2rad(turned)),
        sigma_point=np.full(int(keep.sum()), rough),
    )
    return Case(name=name + (" gap" if gap else ""), samples=samples, truth=truth)


def scanned(folder: Path) -> Case:
    """The contacts of a result folder called like the shape."""
    mesh = shapes.load(folder.name).mesh()
    truth = trimesh.Trimesh(np.array(mesh.vertices), np.array(mesh.faces), process=False)
    samples = samples_of(cloud.read_csv(folder / "contacts.csv"))
    return Case(name=folder.name, samples=samples, truth=truth)


def asked_of(case: Case) -> tuple[FloatArray, NDArray[np.bool_], NDArray[np.bool_]]:
    """Points (m, 3) of the true surface; which a beam could reach; which have a contact near."""
    q, m = _spread(case.truth)
    return q, _reachable(q, m, case.truth), _touched(q, m, case.samples)


def figures(
    case: Case,
    made: Triangles,
    seconds: float,
    asked: tuple[FloatArray, NDArray[np.bool_], NDArray[np.bool_]],
) -> str:
    """A row of the table: mm, s."""
    mesh = trimesh.Trimesh(made.vertices, made.faces, process=False)
    p, n = _spread(mesh)
    accuracy = _distance(p, case.truth) * 1e3
    near = _touched(p, n, case.samples)
    q, reached, touched = asked
    completeness = _distance(q, mesh) * 1e3
    numbers = (
        accuracy.mean(),
        accuracy[near].mean() if near.any() else np.nan,
        np.quantile(accuracy[near], 0.95) if near.any() else np.nan,
        completeness[reached].mean(),
        completeness[reached & touched].mean(),
        100.0 * touched[reached].mean(),
    )
    cells = " | ".join(f"{v:.3f}" if k < 5 else f"{v:.0f}" for k, v in enumerate(numbers))
    return f"{cells} | {'yes' if closed(made.faces) else 'no'} | {seconds:.1f}"


def _directions(count: int) -> FloatArray:
    """Unit vectors (count, 3), even over the sphere."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    turn = k * np.pi * (3.0 - np.sqrt(5.0))
    return np.stack((np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z), axis=1)


def _spread(mesh: trimesh.Trimesh) -> tuple[FloatArray, FloatArray]:
    p, face = trimesh.sample.sample_surface(mesh, ASKED, seed=0)
    return np.array(p), np.array(mesh.face_normals[face])


def _distance(points: FloatArray, mesh: trimesh.Trimesh) -> FloatArray:
    import pyvista

    target = pyvista.PolyData.from_regular_faces(np.array(mesh.vertices), np.array(mesh.faces))
    return np.abs(pyvista.PolyData(points).compute_implicit_distance(target)["implicit_distance"])


def _touched(p: FloatArray, n: FloatArray, samples: Samples) -> NDArray[np.bool_]:
    """Whether a point of ``samples`` on the same side is near (a thin wall has two)."""
    k = min(32, len(samples.points))
    apart, who = KDTree(samples.points).query(p, k=k)
    like = np.einsum("mj,mkj->mk", n, samples.normals[who]) > 0.3
    return ((apart < NEAR) & like).any(axis=1)


def _reachable(p: FloatArray, n: FloatArray, mesh: trimesh.Trimesh) -> NDArray[np.bool_]:
    """Whether a straight beam of some direction of the plan's band touches there, with its side or its end."""
    beams = _directions(4 * BEAMS)
    beams = beams[np.abs(beams[:, 2]) <= np.sin(BAND)]
    found = np.zeros(len(p), dtype=bool)
    for beam in beams:
        lean = -(n @ beam)
        rows = np.flatnonzero(~found & (lean >= 0.0) & (lean < np.sin(LEAN)))
        if rows.size:
            start = p[rows] + CLEAR * n[rows]
            found[rows] = ~mesh.ray.intersects_any(start, np.tile(-beam, (rows.size, 1)))
    return found


def main(arguments: list[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shapes", nargs="*", default=[], choices=shapes.NAMES)
    parser.add_argument("--points", nargs="*", type=int, default=[500, 2000, 10_000])
    parser.add_argument("--noise", default="default", choices=tuple(NOISE))
    parser.add_argument("--gap", action="store_true", help="leave a wedge of 40 deg out")
    parser.add_argument("--runs", nargs="*", type=Path, default=[])
    parser.add_argument("--methods", nargs="*", default=list(METHODS), choices=tuple(METHODS))
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(arguments)
    rng = np.random.default_rng(asked.seed)
    cases = [
        made_contours(name, count, asked.noise, gap=asked.gap, rng=rng)
        for name in asked.shapes
        for count in asked.points
    ]
    cases += [scanned(folder) for folder in asked.runs]
    print(
        "| shape | points | method | accuracy | touched | 95 % | completeness | touched | touched % | watertight "
        "| s |\n|---|---:|---|---:|---:|---:|---:|---:|---:|---|---:|"
    )
    for case in cases:
        whole, truth = _whole_normals(case.samples), asked_of(case)
        for name in asked.methods:
            begun = time.process_time()
            try:
                made = METHODS[name](case.samples, whole)
            except ContourError as error:
                print(f"{case.name}, {name}: {error}", file=sys.stderr)
                continue
            spent = time.process_time() - begun
            if made is not None and len(made.faces):
                row = figures(case, made, spent, truth)
                print(f"| {case.name} | {len(case.samples.points)} | {name} | {row} |", flush=True)
    return 0


def _whole_normals(samples: Samples) -> FloatArray:
    """Normals of which no part is missing, for methods that need them."""
    partly = np.linalg.norm(samples.unseen, axis=1) > 0.5
    if not partly.any():
        return samples.normals
    field = fit_layers(
        observations(
            samples.points, samples.normals, samples.unseen, samples.sigma_normal, samples.sigma_point
        )
    )
    slope = field.gradient(samples.points)
    whole = np.where(partly[:, None], slope, samples.normals)
    return np.asarray(whole / np.linalg.norm(whole, axis=1)[:, None])


if __name__ == "__main__":
    sys.exit(main())
