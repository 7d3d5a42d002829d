"""A reconstructed surface against a true or nominal one, both directions apart.

Accuracy is how far the reconstructed surface lies from the nominal one, completeness how far the touchable part
of the nominal one lies from the reconstructed (:mod:`contour.touchable`). The first is large where a surface
was invented, the second where one is missing. Deviations are signed: plus is outside the nominal surface.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from contour import mesh_io
from contour.errors import UsageError
from contour.mesh_env import MeshEnvironment
from contour.nearest import Target, as_faces, sample_evenly
from contour.quantities import METRES_PER
from contour.results import Run, load_surface
from contour.scene import Body, Scene, load_scene, scene_of_record
from contour.surface import Surface, reconstruct, samples_of
from contour.touchable import touchable

__all__ = [
    "TOLERANCE",
    "Comparison",
    "Distances",
    "check_units",
    "compare",
    "compare_run",
    "reach_of",
    "surface_of",
    "surface_through",
]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
Reachable = Callable[[FloatArray, FloatArray], BoolArray]
"""``reachable(points, normals)``: which places (m, 3) [m] with outward normals (m, 3) count."""

TOLERANCE = 0.3e-3
"""Deviation that counts as good where nobody says another [m]."""
FAR_APART = 0.05
"""Mean distance of the surface from the mesh, over the mesh's length, from which it is asked whether the two belong
together.
"""
SAMPLES = 30_000
"""Samples of either surface."""
SEED = 0
"""Of the samples."""
FINE = 1e-3
"""Distance of the F-score [m]."""
NEAR = 5e-3
"""A place this near to a contact on its own side counts as touched [m]."""
ROUND = 32
"""Contacts among which one on the same side is looked for."""
CLOSE = 0.02
"""Surfaces this near, in the size, tell how the nominal one is wound."""
TURNED = 0.1
"""Share of them that may look the other way before the winding is said to be mixed."""
LIKE_SIZES = 1.8
"""Sizes that differ by less are not a matter of units."""
SAME_SIZE = 1.3
"""The right unit makes sizes agree within this factor."""
HOPELESS = 8.0
"""Sizes that differ by more are not compared, if no unit explains it."""
ON_SURFACE = 0.05
"""Points nearer to the nominal surface, in their extent, say that its unit is right."""
PROBES = 500
"""Points that are asked for that."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Distances:
    """How far samples of one surface are from the other, all of the same area."""

    mean: float
    """[m]"""
    rms: float
    """[m]"""
    hausdorff95: float
    """[m], 95 % are nearer: the 95 % Hausdorff distance of this direction."""
    largest: float
    """[m]"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """A surface against a nominal one; shares are 0 to 1, NaN where nothing can be said."""

    accuracy: Distances
    """From the surface to the nominal one."""
    completeness: Distances
    """From the reachable part of the nominal one to the surface."""
    f_score: float
    """Harmonic mean of the shares of both that lie within 1 mm of the other."""
    normal_median: float
    """rad, between the surface's normals and those of the nominal one nearby."""
    normal_p95: float
    """rad"""
    reachable: float
    """Share of the nominal area that counted for completeness."""
    touched: float
    """Share of the reachable area within 5 mm of a contact on its own side."""
    deviation: FloatArray
    """(v,) m, of the surface's vertices; plus is outside the nominal one."""
    notes: tuple[str, ...]
    """What to know before believing the numbers, a line each."""
    seconds: float
    """Processor time [s]."""

    def metrics(self) -> dict[str, Any]:
        """The numbers by flat names that end in their units, as ``metrics.json`` has them."""
        numbers: dict[str, Any] = {
            f"{name}_{part}_m": value
            for name, all_of in (("accuracy", self.accuracy), ("completeness", self.completeness))
            for part, value in (
                ("mean", all_of.mean),
                ("rms", all_of.rms),
                ("hausdorff95", all_of.hausdorff95),
                ("max", all_of.largest),
            )
        }
        numbers |= {
            "f_score_1mm": self.f_score,
            "normal_angle_median_rad": self.normal_median,
            "normal_angle_p95_rad": self.normal_p95,
            "reachable_share": self.reachable,
            "within_5mm_share": self.touched,
            "compare_s": self.seconds,
        }
        return numbers | ({"notes": list(self.notes)} if self.notes else {})


def compare(
    surface: Surface,
    nominal: FloatArray | MeshEnvironment,
    *,
    points: FloatArray,
    normals: FloatArray | None = None,
    reachable: Reachable | None = None,
    unit: str = "m",
) -> Comparison:
    """``surface`` against ``nominal``.

    Samples are spread evenly over either area, always the same ones; distances are exact, from point to
    triangle. Which way the nominal mesh is wound does not matter: each connected piece is turned to look the
    way of the surface that lies on it.

    Args:
        surface: reconstructed.
        nominal: triangles (f, 3, 3) [m] in the world, or the environment that was scanned.
        points: the contacts (n, 3) [m]; without flagged ones.
        normals: of the contacts (n, 3), outward: tell the sides of walls apart.
        reachable: which of the nominal surface counts; all if not given.
        unit: what the nominal mesh was read in, for what is said about wrong ones.

    Raises:
        UsageError: the sizes say that the nominal mesh is in another unit.
    """
    begun = time.process_time()
    triangles = nominal.triangles if isinstance(nominal, MeshEnvironment) else np.asarray(nominal)
    target = Target(*as_faces(triangles))
    notes = check_units(target, points, unit=unit)
    made = sample_evenly(surface.vertices, surface.faces, SAMPLES, seed=SEED)
    near = target.closest(made.points)
    close = near.distance <= CLOSE * _size(target.vertices)
    target, mixed = _turned(target, near.face[close], made.normals[close])
    notes += mixed
    deviation = target.signed(surface.vertices)
    wanted = sample_evenly(target.vertices, target.faces, SAMPLES, seed=SEED)
    counts = np.ones(SAMPLES, dtype=bool)
    if reachable is not None:
        counts = reachable(wanted.points, wanted.normals)
    missing = Target(surface.vertices, surface.faces).closest(wanted.points[counts]).distance
    if not missing.size:
        notes += ("no beam of the plan reaches the nominal surface: completeness says nothing",)
    touched = _touched(wanted.points[counts], wanted.normals[counts], points, normals)
    cosine = np.einsum("mj,mj->m", made.normals, target.normals()[near.face])
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    return Comparison(
        accuracy=_distances(near.distance, float(np.abs(deviation).max())),
        completeness=_distances(missing),
        f_score=_f_score(near.distance, missing),
        normal_median=float(np.median(angle)),
        normal_p95=float(np.quantile(angle, 0.95)),
        reachable=float(counts.mean()),
        touched=float(touched.mean()) if touched.size else np.nan,
        deviation=deviation,
        notes=notes,
        seconds=time.process_time() - begun,
    )


def check_units(target: Target, points: FloatArray, *, unit: str) -> tuple[str, ...]:
    """Refuse a nominal mesh whose size says that it is not in ``unit``; what else is odd about its size.

    Points of a part of a large object lie on it all the same, and are no matter of units.
    """
    whole, felt = _size(target.vertices), _size(points)
    times = whole / felt
    if 1.0 / LIKE_SIZES < times < LIKE_SIZES:
        return ()
    some = points[:: max(1, len(points) // PROBES)]
    if np.median(target.closest(some).distance) <= ON_SURFACE * felt:
        return ()
    sizes = f"nominal mesh is {whole * 1e3:.4g} mm long, the points of the run {felt * 1e3:.4g} mm"
    fits = {name: abs(np.log(times * metres / METRES_PER[unit])) for name, metres in METRES_PER.items()}
    best = min(fits, key=lambda name: fits[name])
    if fits[best] < np.log(SAME_SIZE):
        raise UsageError(f"{sizes}: it looks like it is in {best}, not in {unit}; give --unit {best}")
    if not 1.0 / HOPELESS < times < HOPELESS:
        raise UsageError(f"{sizes}: they are not of one object; check the mesh and its unit")
    return (f"{sizes}: are they of one object?",)


def compare_run(run: Run, mesh: Path, *, unit: str | None = None) -> tuple[Surface, Comparison]:
    """The surface of ``run``, made from its contacts if it has none, against the file ``mesh``.

    The mesh of a scan's only object is placed as the scan's scene places it; otherwise the mesh is in the
    world's frame, or is a scene file, which places its meshes itself.

    Raises:
        UsageError: no such mesh, no surface through the contacts, or sizes that do not fit.
    """
    scanned = _scene(run)
    triangles, read_in = _nominal(mesh, unit, scanned)
    points, normals = run.points[run.good], run.normals[run.good]
    check_units(Target(*as_faces(triangles)), points, unit=read_in)
    surface = surface_of(run)
    notes: tuple[str, ...] = ()
    reachable: Reachable | None = None
    try:
        reachable = reach_of(scanned, triangles)
    except UsageError as error:
        notes = (f"all of the nominal surface counts as reachable, since no plan suits it: {error}",)
    found = compare(surface, triangles, points=points, normals=normals, reachable=reachable, unit=read_in)
    if found.accuracy.mean > FAR_APART * float(np.ptp(triangles.reshape(-1, 3), axis=0).max()):
        notes += ("surface and mesh lie far apart: are they of one object, in one place?",)
    return surface, replace(found, notes=notes + found.notes)


def surface_of(run: Run, *, method: str = "auto") -> Surface:
    """The surface in the folder of ``run``, or else a new one through its unflagged contacts."""
    kept = load_surface(run)
    return kept if kept is not None else surface_through(run.contacts, method)


def surface_through(columns: Mapping[str, NDArray[Any]], method: str) -> Surface:
    """The surface through the unflagged contacts of a table."""
    samples = samples_of(columns)
    return reconstruct(
        samples.points,
        samples.normals,
        unseen=samples.unseen,
        sigma_normal=samples.sigma_normal,
        sigma_point=samples.sigma_point,
        method=method,
    )


def reach_of(scene: Scene, triangles: FloatArray) -> Reachable:
    """What the plan of ``scene`` for an object of ``triangles`` (f, 3, 3) [m] could touch."""
    corners = triangles.reshape(-1, 3)
    plan = scene.build_plan(np.stack([corners.min(axis=0), corners.max(axis=0)]))

    def reachable(points: FloatArray, normals: FloatArray) -> BoolArray:
        return touchable(points, normals, triangles, plan, scene.antenna, scene.mount)

    return reachable


def _scene(run: Run) -> Scene:
    """What was scanned, as the run wrote it down."""
    try:
        return scene_of_record(run.record["scene"], run.folder)
    except (KeyError, TypeError, IndexError) as error:
        raise UsageError(
            f"{run.folder / 'run.json'} does not say what was scanned ({error!r}): scan again"
        ) from error


def _nominal(mesh: Path, unit: str | None, scanned: Scene) -> tuple[FloatArray, str]:
    """Triangles (f, 3, 3) [m] of a mesh or scene file in the world, and the unit they were read in."""
    bodies: tuple[Body, ...]
    if mesh.suffix.lower() == ".toml":
        bodies = load_scene(mesh, unit=unit).bodies
    else:
        only = scanned.bodies[0].placement if len(scanned.bodies) == 1 else np.eye(4)
        bodies = (Body(mesh=mesh, unit=unit, placement=only, friction_angle=0.0),)
    parts = [
        mesh_io.as_triangles(mesh_io.load_scene(body.mesh, unit=body.unit, transform=body.placement))
        for body in bodies
    ]
    triangles = np.concatenate([part.vertices[part.faces] for part in parts])
    return triangles, mesh_io.unit_of(bodies[0].mesh, bodies[0].unit)


def _turned(target: Target, face: IntArray, normals: FloatArray) -> tuple[Target, tuple[str, ...]]:
    """``target`` with the pieces turned round that look against ``normals`` (k, 3) of the surface that lies
    on their faces ``face`` (k,); a line if the faces of a piece do not agree.
    """
    like = np.einsum("kj,kj->k", target.normals()[face], normals)
    piece = target.pieces()
    against = np.bincount(piece[face], like, int(piece.max()) + 1) < 0.0
    wrong = (like * np.where(against[piece[face]], -1.0, 1.0))[np.abs(like) > 0.5] < 0.0
    notes: tuple[str, ...] = ()
    if wrong.size and wrong.mean() > TURNED:
        share = f"{100.0 * wrong.mean():.0f} %"
        notes = (f"{share} of the nominal mesh are wound the other way: signs are not sure there; mend it",)
    if not against.any():
        return target, notes
    return Target(
        target.vertices, np.where(against[piece][:, None], target.faces[:, ::-1], target.faces)
    ), notes


def _touched(
    places: FloatArray, outward: FloatArray, points: FloatArray, normals: FloatArray | None
) -> BoolArray:
    """Which of ``places`` (m, 3) [m] have a contact within :data:`NEAR`, one that faces their side."""
    apart, who = KDTree(points).query(places, k=np.arange(1, min(ROUND, len(points)) + 1))
    near = np.asarray(apart) <= NEAR
    if normals is not None:
        near &= np.einsum("mj,mkj->mk", outward, normals[who]) > 0.0
    return np.asarray(near.any(axis=1))


def _distances(values: FloatArray, at_least: float = 0.0) -> Distances:
    if not values.size:
        return Distances(mean=np.nan, rms=np.nan, hausdorff95=np.nan, largest=np.nan)
    return Distances(
        mean=float(values.mean()),
        rms=float(np.sqrt(np.mean(values**2))),
        hausdorff95=float(np.quantile(values, 0.95)),
        largest=max(float(values.max()), at_least),
    )


def _f_score(made: FloatArray, wanted: FloatArray) -> float:
    """Harmonic mean of the shares of distances [m] within :data:`FINE`."""
    if not wanted.size:
        return float("nan")
    right, found = float(np.mean(made <= FINE)), float(np.mean(wanted <= FINE))
    return 2.0 * right * found / (right + found) if right + found > 0.0 else 0.0


def _size(points: FloatArray) -> float:
    """Longest edge of the box round ``points`` (m, 3)."""
    return float(np.ptp(points, axis=0).max())
