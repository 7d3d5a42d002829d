"""A finished scan read back from its result folder, and its surface as a file in it.

``metrics.json`` is written last: a folder without it is half-written, and refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from contour.cloud import Table, read_csv, read_json, read_ply, replace_file
from contour.errors import UsageError
from contour.quantities import METRES_PER
from contour.surface import Surface

__all__ = ["SURFACE_FILE", "Run", "load_run", "load_surface", "write_surface"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Read = TypeVar("Read")

SURFACE_FILE = "surface.ply"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """A result folder."""

    folder: Path
    record: dict[str, Any]
    """``run.json``: resolved scene, versions, seed."""
    metrics: dict[str, Any]
    contacts: Table
    """``contacts.csv``, SI units, n rows."""
    unit: str
    """Of the point files and of the mesh."""

    @property
    def good(self) -> BoolArray:
        """(n,) contacts without flags."""
        return np.asarray(self.contacts["flags"] == 0)

    @property
    def points(self) -> FloatArray:
        """(n, 3) m, in the world."""
        return np.stack([self.contacts[f"{axis}_m"] for axis in "xyz"], axis=1)

    @property
    def normals(self) -> FloatArray:
        """(n, 3) outward unit normals: smoothed along the contours where the table has them, else as sensed."""
        prefix = "smooth_n" if "smooth_nx" in self.contacts else "n"
        return np.stack([self.contacts[f"{prefix}{axis}"] for axis in "xyz"], axis=1)

    @property
    def contour(self) -> IntArray:
        """(n,) number of the contour."""
        return np.asarray(self.contacts["contour"], dtype=np.int64)

    @property
    def order(self) -> IntArray:
        """(n,) place along the contour."""
        return np.asarray(self.contacts["sequence"], dtype=np.int64)


def load_run(folder: Path) -> Run:
    """The run in ``folder``; folders without a finished scan, and scans without contacts, are refused."""
    if not folder.is_dir():
        raise UsageError(f"{folder} is no folder: give the folder of a finished scan, such as results/mug")
    if not (folder / "metrics.json").is_file():
        half = any((folder / name).exists() for name in ("run.json", "contacts.csv", "readings.npz"))
        said = "was not finished" if half else "holds no scan"
        raise UsageError(f"{folder} {said}: it has no metrics.json; scan again into a new folder")
    contacts = _read(read_csv, folder / "contacts.csv")
    if contacts["id"].size == 0:
        raise UsageError(f"{folder} holds a scan without contacts: see how its contours ended in log.jsonl")
    points, unit = _read(read_ply, folder / "points.ply")
    if points["x"].size != contacts["id"].size:
        raise UsageError(
            f"{folder} is damaged: contacts.csv has {contacts['id'].size} contacts, points.ply "
            f"{points['x'].size}; scan again into a new folder"
        )
    return Run(
        folder=folder,
        record=_read(read_json, folder / "run.json"),
        metrics=_read(read_json, folder / "metrics.json"),
        contacts=contacts,
        unit=unit,
    )


def _read(reader: Callable[[Path], Read], path: Path) -> Read:
    """What ``reader`` makes of the file; damaged ones are refused by name."""
    try:
        return reader(path)
    except UsageError:
        raise
    except (ValueError, KeyError, IndexError) as error:
        raise UsageError(f"{path} is damaged ({error}): scan again into a new folder") from error


def write_surface(path: Path, surface: Surface, *, unit: str) -> None:
    """Write a surface as binary PLY in ``unit``, with normals, and trust and sigma as scalars at its vertices."""
    scale = 1.0 / METRES_PER[unit]
    columns = {
        **dict(zip("xyz", surface.vertices.T * scale, strict=True)),
        **dict(zip(("nx", "ny", "nz"), surface.normals.T, strict=True)),
        f"scalar_trust_{unit}": surface.trust * scale,
        f"scalar_sigma_{unit}": surface.sigma * scale,
    }
    kinds = {name: "<f8" if name in "xyz" else "<f4" for name in columns}
    vertices = np.zeros(len(surface.vertices), dtype=list(kinds.items()))
    for name, values in columns.items():
        vertices[name] = values
    faces = np.zeros(len(surface.faces), dtype=[("count", "u1"), ("corners", "<i4", (3,))])
    faces["count"], faces["corners"] = 3, surface.faces
    words = {"<f8": "double", "<f4": "float"}
    header = ["ply", "format binary_little_endian 1.0", f"comment unit {unit}"]
    header += [f"comment method {surface.method}", f"comment touched {surface.touched!r}"]
    header += [f"comment seconds {surface.seconds!r}", *(f"comment note {note}" for note in surface.notes)]
    header += [f"element vertex {len(vertices)}"]
    header += [f"property {words[kind]} {name}" for name, kind in kinds.items()]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    replace_file(path, "\n".join(header).encode("utf-8") + vertices.tobytes() + faces.tobytes())


def load_surface(run: Run) -> Surface | None:
    """The surface in a run's folder, as :func:`write_surface` wrote it; None if there is none."""
    path = run.folder / SURFACE_FILE
    if not path.is_file():
        return None
    columns, unit = read_ply(path)
    if unit not in METRES_PER or f"scalar_trust_{unit}" not in columns:
        raise UsageError(
            f"{path} is no surface with trust as a scan leaves it: move it away, and compare again"
        )
    content = path.read_bytes()
    head, _, body = content.partition(b"end_header\n")
    lines = head.decode("utf-8").split("\n")
    counts = {line.split()[1]: int(line.split()[2]) for line in lines if line.startswith("element")}
    size = counts["face"] * 13
    if len(body) < size + counts["vertex"] * sum(column.itemsize for column in columns.values()):
        raise UsageError(f"{path} is cut short: remove it, and contour compare makes it again")
    rows = np.frombuffer(body[len(body) - size :], dtype=[("count", "u1"), ("corners", "<i4", (3,))])
    scale = METRES_PER[unit]
    faces = rows["corners"].astype(np.int64)
    comments = [line.split(" ", 2)[1:] for line in lines if line.startswith("comment ")]
    said = {words[0]: words[1] for words in comments if words[0] != "note"}
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    return Surface(
        vertices=np.stack([columns[axis] for axis in "xyz"], axis=1) * scale,
        faces=faces,
        normals=np.stack([columns[name] for name in ("nx", "ny", "nz")], axis=1).astype(np.float64),
        trust=columns[f"scalar_trust_{unit}"].astype(np.float64) * scale,
        sigma=columns[f"scalar_sigma_{unit}"].astype(np.float64) * scale,
        method=said.get("method", ""),
        watertight=bool(np.all(uses == 2)),
        touched=float(said.get("touched", "nan")),
        notes=tuple(words[1] for words in comments if words[0] == "note"),
        seconds=float(said.get("seconds", "nan")),
    )
