"""Writes the meshes of this folder: every shape of contour.shapes as binary PLY, in millimetres.

    python data/meshes/generate.py            write those that are absent
    python data/meshes/generate.py --force    write all of them again

The same numbers come out every time. The header names the unit and the shape; the truth that a mesh was made from
is ``contour.shapes.load(name)``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from contour import shapes

__all__ = ["FOLDER", "main", "write_ply"]

FOLDER = Path(__file__).resolve().parent
MM_PER_M = 1e3


def write_ply(path: Path, mesh: shapes.TriangleMesh, name: str) -> None:
    """Write ``mesh`` (metres) in millimetres, single precision: 8e-6 mm at 100 mm."""
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


def main(arguments: list[str]) -> int:
    """Write what is absent, or all with --force; 0 when done, 2 on an argument that means nothing."""
    if set(arguments) - {"--force"}:
        print(f"generate.py knows --force only, not {' '.join(arguments)}", file=sys.stderr)
        return 2
    for name in shapes.NAMES:
        path = FOLDER / f"{name}.ply"
        if "--force" in arguments or not path.exists():
            mesh = shapes.load(name).mesh()
            write_ply(path, mesh, name)
            print(f"{path.name}: {len(mesh.faces)} faces")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
