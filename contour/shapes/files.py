"""Meshes of shapes as files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from contour.shapes.base import TriangleMesh

__all__ = ["write_mesh"]

MM_PER_M = 1e3


def write_mesh(path: Path, mesh: TriangleMesh, name: str) -> None:
    """Write ``mesh`` (metres) as binary PLY in millimetres, single precision: 8e-6 mm at 100 mm."""
    header = "\n".join(
        (
            "ply",
            "format binary_little_endian 1.0",
            "comment unit mm",
            f"comment shape {name}",
            f"element vertex {len(mesh.vertices)}",
            *(f"property float {axis}" for axis in "xyz"),
            f"element face {len(mesh.faces)}",
            "property list uchar int vertex_indices",
            "end_header\n",
        )
    )
    faces = np.zeros(len(mesh.faces), dtype=[("count", "u1"), ("index", "<i4", 3)])
    faces["count"], faces["index"] = 3, mesh.faces
    vertices = (mesh.vertices * MM_PER_M).astype("<f4")
    path.write_bytes(header.encode("ascii") + vertices.tobytes() + faces.tobytes())
