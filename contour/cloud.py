"""Contacts as a table, and the table as files: CSV in SI units, PLY and VTP in the unit of the mesh.

A table is a dict of equally long columns, in the order of ``contacts.csv``; :func:`table` makes it from
contacts, the ``true_`` columns of a simulation beside them. :func:`read_csv` and :func:`read_ply` read it.
Files appear whole or not at all: each is written under another name first.
"""

from __future__ import annotations

import base64
import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from contour.contacts import Contacts, Flag, Kind, flag_names
from contour.errors import UsageError
from contour.quantities import METRES_PER

__all__ = [
    "Table",
    "read_csv",
    "read_json",
    "read_ply",
    "replace_file",
    "table",
    "write_csv",
    "write_json",
    "write_ply",
    "write_vtp",
]

Column = NDArray[Any]
Table = dict[str, Column]


_WHOLE = frozenset({"id", "contour", "sequence", "pushes"})
_POINT = ("x_m", "y_m", "z_m")
_NORMAL = ("nx", "ny", "nz")
_PLY_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "<i2",
    "ushort": "<u2",
    "int": "<i4",
    "uint": "<u4",
    "float": "<f4",
    "double": "<f8",
}
_VTK_TYPES = {"<f8": "Float64", "<i8": "Int64"}


def table(contacts: Contacts, truth: Mapping[str, NDArray[np.float64]] | None = None) -> Table:
    """Columns of ``contacts.csv``, one row a contact.

    Args:
        contacts: what was sensed.
        truth: columns (n,) whose names begin with ``true_``, known in simulation only.
    """
    columns: Table = {
        "id": np.arange(len(contacts)),
        "contour": contacts.which,
        **dict(zip(_POINT, contacts.point.T, strict=True)),
        **dict(zip(_NORMAL, contacts.normal.T, strict=True)),
        "s_m": contacts.distance,
        "sigma_s_m": contacts.sigma_distance,
        "sigma_normal_rad": contacts.sigma_normal,
        "pushes": contacts.pushes,
        "kind": contacts.kind.astype(np.int64),
        "flags": contacts.flags,
        "machine_time_s": contacts.machine_time,
        "sequence": contacts.sequence,
        "friction_angle_rad": contacts.friction_angle,
        "sigma_friction_rad": contacts.sigma_friction,
        "radius_along_m": contacts.radius_along,
        "curvature_across_1_m": contacts.curvature_across,
    }
    for name, column in (truth or {}).items():
        if not name.startswith("true_") or column.shape != (len(contacts),):
            raise UsageError(
                f"column {name!r} of shape {column.shape}: a true column is called true_... and has the "
                f"{len(contacts)} rows of the contacts"
            )
        columns[name] = column
    return columns


def write_csv(path: Path, columns: Table) -> None:
    """Write a table; numbers with all their digits, kind and flags as words."""
    texts: list[list[str]] = []
    for name, column in columns.items():
        if name == "kind":
            texts.append([Kind(k).name.lower() for k in column.tolist()])
        elif name == "flags":
            texts.append([flag_names(f) for f in column.tolist()])
        else:
            texts.append([repr(value) for value in column.tolist()])
    lines = [",".join(columns), *(",".join(row) for row in zip(*texts, strict=True))]
    replace_file(path, ("\n".join(lines) + "\n").encode("ascii"))


def read_csv(path: Path) -> Table:
    """The table that :func:`write_csv` wrote, bit for bit."""
    with _open(path).open(newline="", encoding="ascii") as file:
        rows = list(csv.reader(file))
    names, texts = rows[0], list(zip(*rows[1:], strict=True)) or [()] * len(rows[0])
    return {name: _column(name, text) for name, text in zip(names, texts, strict=True)}


def _column(name: str, texts: tuple[str, ...]) -> Column:
    if name == "kind":
        return np.array([Kind[text.upper()] for text in texts], dtype=np.int64)
    if name == "flags":
        words = {flag_names(flag): int(flag) for flag in Flag if flag}
        return np.array([sum(words[w] for w in text.split("|") if w) for text in texts], dtype=np.int64)
    return np.array([float(text) for text in texts], dtype=np.int64 if name in _WHOLE else np.float64)


def write_ply(path: Path, columns: Table, *, unit: str) -> None:
    """Write the points with normals and scalars as binary PLY, for CloudCompare, MeshLab and ParaView.

    Positions and the scalars that are lengths are in ``unit``, which the header names.
    """
    scalars = {f"scalar_{name}": column for name, column in _scalars(columns, unit).items()}
    point, normal = _points(columns, unit), np.stack([columns[n] for n in _NORMAL], axis=1)
    fields = [*((axis, "<f8") for axis in "xyz"), *((axis, "<f4") for axis in _NORMAL)]
    fields += [(name, "<f4") for name in scalars]
    rows = np.zeros(len(point), dtype=fields)
    for names, values in (("xyz", point), (_NORMAL, normal)):
        for name, value in zip(names, values.T, strict=True):
            rows[name] = value
    for name, value in scalars.items():
        rows[name] = value
    kinds = {"<f8": "double", "<f4": "float"}
    header = ["ply", "format binary_little_endian 1.0", f"comment unit {unit}", f"element vertex {len(rows)}"]
    header += [f"property {kinds[kind]} {name}" for name, kind in fields]
    replace_file(path, "\n".join([*header, "end_header", ""]).encode("ascii") + rows.tobytes())


def read_ply(path: Path) -> tuple[Table, str]:
    """The vertex columns of a binary little-endian PLY, and the unit its header names."""
    content = _open(path).read_bytes()
    head, mark, body = content.partition(b"end_header\n")
    lines = head.decode("ascii", errors="replace").split("\n")
    if not mark or "format binary_little_endian 1.0" not in lines:
        raise UsageError(
            f"{path} is not a binary little-endian PLY file: write it with contour.cloud.write_ply"
        )
    unit, count, fields = "", 0, []
    element = ""
    for line in lines:
        words = line.split()
        if words[:2] == ["comment", "unit"]:
            unit = words[2]
        elif words[:1] == ["element"]:
            element = words[1]
            count = int(words[2]) if element == "vertex" else count
        elif words[:1] == ["property"] and element == "vertex":
            fields.append((words[2], _PLY_TYPES[words[1]]))
    if len(body) < count * np.dtype(fields).itemsize:
        raise UsageError(f"{path} is cut short: it has not the {count} points it speaks of; make it again")
    rows = np.frombuffer(body, dtype=np.dtype(fields), count=count)
    return {name: rows[name].copy() for name, _ in fields}, unit


def write_vtp(path: Path, columns: Table, *, unit: str) -> None:
    """Write the points with normals and all columns as VTK XML polydata; VTK itself is not needed.

    Positions and the columns that are lengths are in ``unit``, which a field array names.
    """
    point, normal = _points(columns, unit), np.stack([columns[n] for n in _NORMAL], axis=1)
    count = len(point)
    data = [_array("normals", normal), *(_array(name, c) for name, c in _scalars(columns, unit).items())]
    cells = _array("connectivity", np.arange(count)) + _array("offsets", np.arange(1, count + 1))
    codes = " ".join(str(code) for code in [*unit.encode("ascii"), 0])
    xml = (
        '<?xml version="1.0"?>\n'
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">\n<PolyData>\n'
        f'<FieldData><DataArray type="String" Name="unit" NumberOfTuples="1" format="ascii">{codes}'
        "</DataArray></FieldData>\n"
        f'<Piece NumberOfPoints="{count}" NumberOfVerts="{count}" NumberOfLines="0" NumberOfStrips="0" '
        'NumberOfPolys="0">\n'
        f'<PointData Normals="normals">\n{"".join(data)}</PointData>\n'
        f"<Points>\n{_array('Points', point)}</Points>\n<Verts>\n{cells}</Verts>\n"
        "</Piece>\n</PolyData>\n</VTKFile>\n"
    )
    replace_file(path, xml.encode("utf-8"))


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write a JSON object; numbers that are not finite become null, since JSON has none."""
    replace_file(path, (json.dumps(_plain(values), indent=2, allow_nan=False) + "\n").encode("utf-8"))


def read_json(path: Path) -> dict[str, Any]:
    """The object that :func:`write_json` wrote."""
    values: dict[str, Any] = json.loads(_open(path).read_text(encoding="utf-8"))
    return values


def _plain(value: Any) -> Any:
    """``value`` in the types that JSON knows."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value


def _scale(unit: str) -> float:
    if unit not in METRES_PER:
        raise UsageError(f"unit {unit!r} is unknown: choose one of {', '.join(METRES_PER)}")
    return 1.0 / METRES_PER[unit]


def _points(columns: Table, unit: str) -> NDArray[np.float64]:
    return np.stack([columns[name] for name in _POINT], axis=1) * _scale(unit)


def _scalars(columns: Table, unit: str) -> Table:
    """What is neither position nor normal; lengths in ``unit``, their names with it."""
    scalars: Table = {}
    for name, column in columns.items():
        if name in _POINT or name in _NORMAL:
            continue
        if name.endswith("_m") and not name.endswith("_1_m"):
            scalars[f"{name[:-2]}_{unit}"] = column * _scale(unit)
        else:
            scalars[name] = column
    return scalars


def _array(name: str, values: Column) -> str:
    """One binary array of a VTK XML file: its size in bytes, then the bytes, together in base 64."""
    kind = "<i8" if values.dtype.kind in "iu" else "<f8"
    raw = np.ascontiguousarray(values, dtype=kind).tobytes()
    coded = base64.b64encode(len(raw).to_bytes(8, "little") + raw).decode("ascii")
    width = values.shape[1] if values.ndim == 2 else 1
    return (
        f'<DataArray type="{_VTK_TYPES[kind]}" Name={quoteattr(name)} NumberOfComponents="{width}" '
        f'format="binary">{coded}</DataArray>\n'
    )


def _open(path: Path) -> Path:
    if not path.is_file():
        raise UsageError(f"{path} does not exist: scan first, or check the path")
    return path


def replace_file(path: Path, content: bytes) -> None:
    """Put ``content`` at ``path`` in one step, so that a reader never sees half of it."""
    partial = path.with_name(path.name + ".part")
    partial.write_bytes(content)
    partial.replace(path)
