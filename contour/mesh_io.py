"""From mesh files and trimesh scenes to plain triangles in metres, one body per placed geometry.

Meshes come as they are: open, flipped, several bodies, transforms. What cannot be touched is dropped (faces
without area); what makes no sense is refused in one line that names the file and the remedy.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from contour.errors import UsageError

__all__ = ["METRES_PER", "Triangles", "as_triangles", "load_scene", "unit_of"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

METRES_PER: Mapping[str, float] = MappingProxyType(
    {"m": 1.0, "dm": 1e-1, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048}
)
"""Length of the units a mesh file may be in [m]."""
_SPELLINGS: Mapping[str, str] = MappingProxyType(
    {
        "meter": "m",
        "metre": "m",
        "decimeter": "dm",
        "centimeter": "cm",
        "centimetre": "cm",
        "millimeter": "mm",
        "millimetre": "mm",
        "micron": "um",
        "micrometer": "um",
        "inch": "in",
        "inche": "in",
        "foot": "ft",
        "feet": "ft",
    }
)
_NO_AREA = 1e-14
"""Faces with less than this share of the squared extent have no area: rounding decides their normal."""
_HEADER = 4096  # [bytes] in which a PLY header names its unit


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Triangles:
    """Bodies as triangles."""

    vertices: FloatArray
    """(v, 3) [m]."""
    faces: IntArray
    """(f, 3)."""
    body: IntArray
    """The body of each face (f,)."""
    names: tuple[str, ...]
    """The bodies' names."""


def load_scene(
    path: str | Path, *, unit: str | None = None, transform: ArrayLike | None = None
) -> trimesh.Scene:
    """A mesh or scene file as a scene in metres.

    Args:
        path: any file trimesh reads as a mesh or a scene.
        unit: unit of its numbers, a key of :data:`METRES_PER`; may be left out where the file names one.
        transform: pose of the file's frame in the world (4, 4), with metres in its last column.
    """
    path = Path(path)
    scale = METRES_PER[unit_of(path, unit)]
    scene = _read(path)
    declared = _canonical(scene.units)
    if declared is not None:
        if unit is not None and declared != unit:
            raise UsageError(f"mesh {path} says it is in {declared}, not in {unit}: leave out --unit")
        scale = METRES_PER[declared]
    placed = np.eye(4) if transform is None else np.asarray(transform, dtype=np.float64)
    if placed.shape != (4, 4) or not np.isfinite(placed).all():
        raise UsageError(f"transform of mesh {path} is {placed.shape}: it must be a finite 4 x 4 matrix")
    scene.apply_transform(placed @ np.diag([scale, scale, scale, 1.0]))  # type: ignore[no-untyped-call]
    for geometry in scene.geometry.values():
        geometry.units = "m"
    return scene


def unit_of(path: Path, unit: str | None) -> str:
    """The unit asked for or written in the file; formats with a fixed or stored unit pass as metres here."""
    if not path.is_file():
        raise UsageError(f"mesh {path} does not exist: check the path")
    if path.stat().st_size == 0:
        raise UsageError(f"mesh {path} is empty: export it again")
    if unit is not None:
        if unit not in METRES_PER:
            raise UsageError(f"--unit {unit!r} of mesh {path} is unknown: use one of {', '.join(METRES_PER)}")
        return unit
    if path.suffix.lower() in {".glb", ".gltf", ".3mf"}:
        return "m"
    written = _written_unit(path)
    if written is None:
        raise UsageError(f"mesh {path} does not say what its numbers are: give --unit mm (or m, cm, in, ...)")
    return written


def _written_unit(path: Path) -> str | None:
    """What a PLY header says in a comment such as 'comment unit mm'."""
    if path.suffix.lower() != ".ply":
        return None
    with path.open("rb") as file:
        head = file.read(_HEADER).split(b"end_header")[0].decode("ascii", errors="replace")
    for line in head.splitlines():
        words = line.replace(":", " ").replace("=", " ").split()
        if len(words) == 3 and words[0] == "comment" and words[1] in {"unit", "units"}:
            return _canonical(words[2])
    return None


def _canonical(unit: str | None) -> str | None:
    if unit is None:
        return None
    plain = unit.lower()
    plain = plain if plain in METRES_PER else _SPELLINGS.get(plain.removesuffix("s"), plain)
    return plain if plain in METRES_PER else None


def _read(path: Path) -> trimesh.Scene:
    try:
        # Unprocessed: processing would drop what should be refused, such as vertices that are not numbers.
        scene = trimesh.load_scene(path, process=False)
    except Exception as error:
        # trimesh raises whatever its many readers raise; one line of it says what is wrong with the file.
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise UsageError(f"mesh {path} cannot be read ({reason}): export it again, as PLY or STL") from error
    if not any(isinstance(geometry, trimesh.Trimesh) for geometry in scene.geometry.values()):
        raise UsageError(f"mesh {path} has no triangles: export a surface, not points or curves")
    return scene


def as_triangles(mesh_or_scene: trimesh.Trimesh | trimesh.Scene) -> Triangles:
    """The bodies of a mesh or scene in metres, poses applied, faces without area dropped."""
    scene = mesh_or_scene if isinstance(mesh_or_scene, trimesh.Scene) else trimesh.Scene(mesh_or_scene)
    vertices: list[FloatArray] = []
    faces: list[IntArray] = []
    body: list[IntArray] = []
    names: list[str] = []
    count = 0
    for node in scene.graph.nodes_geometry:
        pose, key = scene.graph[node]
        geometry: Any = scene.geometry[key]
        if not isinstance(geometry, trimesh.Trimesh) or not len(geometry.faces):
            continue
        at = np.asarray(geometry.vertices, dtype=np.float64) @ pose[:3, :3].T + pose[:3, 3]
        used = np.asarray(geometry.faces, dtype=np.int64)
        if not np.isfinite(at[used]).all():
            raise UsageError(f"mesh {node} has vertices that are not numbers: repair or export it again")
        vertices.append(at)
        faces.append(used + count)
        body.append(np.full(len(used), len(names), dtype=np.int64))
        names.append(str(node))
        count += len(at)
    if not names:
        raise UsageError("the mesh has no triangles: export a surface, not points or curves")
    return _with_area(np.concatenate(vertices), np.concatenate(faces), np.concatenate(body), tuple(names))


def _with_area(vertices: FloatArray, faces: IntArray, body: IntArray, names: tuple[str, ...]) -> Triangles:
    corners = vertices[faces]
    double = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    extent = np.ptp(corners.reshape(-1, 3), axis=0).max()
    solid = double > _NO_AREA * extent * extent
    empty = [name for i, name in enumerate(names) if not solid[body == i].any()]
    if empty:
        raise UsageError(f"mesh {empty[0]} has no area: check its unit and export it again")
    return Triangles(vertices=vertices, faces=faces[solid], body=body[solid], names=names)
