"""One view of a scan as plain arrays, colours and words, its camera, and its file; render and sketch draw it.

A panel has layers (meshes, lines, dots, ellipsoids, rods, arrows), a camera direction, a colour bar and texts.
Everything is in m in the world; values that colours stand for are in the unit that the bar names. Panels pass
from process to process as a file, so that whatever draws them may crash alone.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "UNTOUCHED",
    "VIEWS",
    "Bar",
    "Camera",
    "Layer",
    "Panel",
    "camera_of",
    "framed_points",
    "load_panels",
    "save_panels",
]

FloatArray = NDArray[np.float64]

VIEWS = ("points", "contours", "surface", "uncertainty", "antenna")
"""Names that panels have."""
UNTOUCHED = "#8c8c8c"
"""Colour where a value is nan: of surface that nothing touched."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layer:
    """Things of one sort."""

    kind: str
    """mesh, lines, dots, ellipsoids, rods or arrows."""
    points: FloatArray
    """(k, 3) m: vertices, ends, places, centres."""
    cells: NDArray[Any]
    """Of a mesh (f, 3) int; of lines, rods and arrows (c, 2) int, from and to; of ellipsoids (k, 3, 3) half axes
    as rows, the longest first [m]; of dots (0,)."""
    facing: FloatArray
    """(k, 3) outward normals, or (0, 3) where things face nowhere."""
    values: FloatArray
    """(k,) what colours stand for, nan for none known; (0,) where all have ``colour``."""
    colour: str
    """Where there are no values."""
    size: float
    """Radius of dots, rods and arrows [m]; width of lines [points]."""
    label: str = ""
    """In the legend; none if empty."""
    framed: bool = True
    """Whether the picture is made large enough for it; what is not may lie outside."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bar:
    """What the colours of a panel mean."""

    label: str
    """With unit."""
    cmap: str
    low: float
    high: float
    ticks: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Panel:
    """One view."""

    name: str
    """One of VIEWS."""
    title: str
    caption: str
    """One line below; may be empty."""
    layers: tuple[Layer, ...]
    view: FloatArray
    """(3,) unit, from the object to the camera."""
    bar: Bar | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Camera:
    """A parallel projection, z of the world up."""

    centre: FloatArray
    """(3,) m, in the middle of the picture."""
    axes: FloatArray
    """(3, 3) rows: right, up, towards the camera."""
    half_height: float
    """m, from the middle of the picture to its upper edge."""

    def project(self, points: FloatArray) -> FloatArray:
        """(k, 3) m right of the middle, above it, and towards the camera."""
        return np.asarray((points - self.centre) @ self.axes.T)


def framed_points(panel: Panel) -> FloatArray:
    """Points (k, 3) m that the picture must show."""
    framed = [layer for layer in panel.layers if layer.framed]
    longest = [
        layer.points + sign * layer.cells[:, 0]
        for layer in framed
        if layer.kind == "ellipsoids"
        for sign in (-1, 1)
    ]
    points = np.concatenate([layer.points for layer in framed] + longest)
    return points if len(points) else np.zeros((1, 3))  # nothing at all was felt


def camera_of(panel: Panel, aspect: float) -> Camera:
    """The camera that shows the whole of ``panel`` in a picture ``aspect`` times as wide as high."""
    right = np.cross((0.0, 0.0, 1.0), panel.view)
    right /= np.linalg.norm(right)
    axes = np.stack((right, np.cross(panel.view, right), panel.view))
    seen = framed_points(panel) @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    half = 0.5 * (high - low)
    height = 1.08 * max(float(half[1]), float(half[0]) / aspect, 1e-6)
    return Camera(centre=0.5 * (low + high) @ axes, axes=axes, half_height=height)


def save_panels(path: Path, panels: Sequence[Panel]) -> None:
    """Write ``panels`` as one .npz file."""
    arrays: dict[str, NDArray[Any]] = {}

    def stored(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            arrays[f"a{len(arrays)}"] = value
            return {"array": f"a{len(arrays) - 1}"}
        if isinstance(value, dict):
            return {name: stored(item) for name, item in value.items()}
        return [stored(item) for item in value] if isinstance(value, list | tuple) else value

    told = json.dumps([stored(asdict(panel)) for panel in panels])
    np.savez(path, allow_pickle=False, panels=np.array(told), **arrays)


def load_panels(path: Path) -> list[Panel]:
    """The panels that :func:`save_panels` wrote."""
    with np.load(path) as file:

        def restored(value: Any) -> Any:
            if isinstance(value, dict):
                if set(value) == {"array"}:
                    return file[value["array"]]
                return {name: restored(item) for name, item in value.items()}
            return tuple(restored(item) for item in value) if isinstance(value, list) else value

        panels = [restored(panel) for panel in json.loads(str(file["panels"]))]
    return [
        Panel(
            **{
                **panel,
                "layers": tuple(Layer(**layer) for layer in panel["layers"]),
                "bar": None if panel["bar"] is None else Bar(**panel["bar"]),
            }
        )
        for panel in panels
    ]
