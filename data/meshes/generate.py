"""Writes the meshes of this folder: every shape of contour.shapes as binary PLY, in millimetres.

    python data/meshes/generate.py            write those that are absent
    python data/meshes/generate.py --force    write all of them again

The same numbers come out every time. The header names the unit and the shape; the truth that a mesh was made
from is ``contour.shapes.load(name)``.
"""

from __future__ import annotations

import sys
from pathlib import Path

from contour import shapes

__all__ = ["FOLDER", "main"]

FOLDER = Path(__file__).resolve().parent


def main(arguments: list[str]) -> int:
    """Write what is absent, or all with --force; 0 when done, 2 on an argument that means nothing."""
    if set(arguments) - {"--force"}:
        print(f"generate.py knows --force only, not {' '.join(arguments)}", file=sys.stderr)
        return 2
    for name in shapes.NAMES:
        path = FOLDER / f"{name}.ply"
        if "--force" in arguments or not path.exists():
            mesh = shapes.load(name).mesh()
            shapes.write_mesh(path, mesh, name)
            print(f"{path.name}: {len(mesh.faces)} faces")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
