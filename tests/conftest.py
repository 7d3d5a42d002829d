"""Fixtures that several test modules share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from contour import shapes

MESHES = Path(__file__).resolve().parents[1] / "data" / "meshes"


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers, the same in every run."""
    return np.random.default_rng(20)


@pytest.fixture(scope="session")
def mesh_file() -> Callable[[str], Path]:
    """The file of a named mesh, made if it is absent."""

    def file(name: str) -> Path:
        path = MESHES / f"{name}.ply"
        if not path.exists():
            shapes.write_mesh(path, shapes.load(name).mesh(), name)
        return path

    return file
