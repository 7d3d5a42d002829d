"""Panels drawn by VTK through PyVista, off screen or in a window: ``python -m contour.render FOLDER``.

VTK may crash the process where OpenGL is absent, so nothing here is called by a process that has something to
lose: :mod:`contour.view` starts one for it. FOLDER holds ``panels.npz``; a picture of each panel is put there,
or a window is opened with ``--window``.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contour.panel import UNTOUCHED, Bar, Layer, Panel, camera_of, load_panels

__all__ = ["PANELS", "add_layer", "build_layer", "main", "picture_name", "render_panels", "show_panels"]

FloatArray = NDArray[np.float64]

PANELS = "panels.npz"
_ROUND = 12
"""Corners round a sphere."""
_FINE = 2.0
"""Pictures are drawn this many times larger than they are shown."""
_WINDOW = (1400, 1000)
_ROOM = 1.3
"""Views in a window are this much smaller, for the words over them."""
_BAR = {"height": 0.11, "width": 0.5, "position_x": 0.25, "position_y": 0.01, "fmt": "%.3g", "color": "black"}


def picture_name(number: int) -> str:
    """File of the picture of panel ``number``."""
    return f"panel-{number}.png"


def build_layer(layer: Layer) -> Any:
    """The geometry of a layer, a pyvista.PolyData, with its values as point data ``value`` if it has any."""
    pv = _pyvista()
    if layer.kind == "mesh":
        body = pv.PolyData.from_regular_faces(layer.points, layer.cells)
        body.point_data["Normals"] = layer.facing
        body.point_data.active_normals_name = "Normals"
        return _valued(body, layer.values)
    if layer.kind == "lines":
        pairs = np.column_stack((np.full(len(layer.cells), 2), layer.cells)).ravel()
        return _valued(pv.PolyData(layer.points, lines=pairs), layer.values)
    if layer.kind in {"dots", "ellipsoids"}:
        axes = layer.cells
        if layer.kind == "dots":
            axes = np.repeat(layer.size * np.eye(3)[None], len(layer.points), axis=0)
        ball = pv.Sphere(radius=1.0, theta_resolution=_ROUND, phi_resolution=_ROUND)
        corners = layer.points[:, None, :] + np.asarray(ball.points, dtype=np.float64) @ axes
        faces = ball.regular_faces[None] + ball.n_points * np.arange(len(layer.points))[:, None, None]
        many = pv.PolyData.from_regular_faces(corners.reshape(-1, 3), faces.reshape(-1, 3))
        return _valued(many, np.repeat(layer.values, ball.n_points))
    starts, ends = layer.points[layer.cells[:, 0]], layer.points[layer.cells[:, 1]]
    return pv.merge([_rod(layer, a, b) for a, b in zip(starts, ends, strict=True)])


def _pyvista() -> Any:
    """PyVista, whose own types say less than its documents allow."""
    import pyvista

    return pyvista


def _valued(geometry: Any, values: FloatArray) -> Any:
    if values.size:
        geometry.point_data["value"] = values
    return geometry


def _rod(layer: Layer, start: FloatArray, end: FloatArray) -> Any:
    pv = _pyvista()
    way = end - start
    length = float(np.linalg.norm(way))
    if layer.kind == "rods":
        return pv.Cylinder(center=0.5 * (start + end), direction=way, radius=layer.size, height=length)
    share = layer.size / length
    return pv.Arrow(
        start=start,
        direction=way,
        scale=length,
        shaft_radius=share,
        tip_radius=2.6 * share,
        tip_length=min(8.0 * share, 0.6),
        shaft_resolution=24,
        tip_resolution=24,
    )


def add_layer(plotter: Any, layer: Layer, bar: Bar | None, *, window: bool = False) -> None:
    """Put a layer into a pyvista.Plotter, in a window with its colour bar; layers of no size are for legends."""
    if layer.kind != "mesh" and not len(layer.points):
        return
    if layer.kind == "dots" and layer.size <= 0.0:
        return
    style: dict[str, Any] = {"color": layer.colour, "show_scalar_bar": False}
    if layer.values.size and bar is not None:
        style = {
            "scalars": "value",
            "cmap": bar.cmap,
            "clim": (bar.low, bar.high),
            "nan_color": UNTOUCHED,
            "show_scalar_bar": window,
            "scalar_bar_args": {
                "title": bar.label + "\n",
                "n_labels": 5,
                "label_font_size": 12,
                "title_font_size": 13,
                **_BAR,
            },
        }
    if layer.kind == "lines":
        style |= {"line_width": layer.size * (1.0 if window else _FINE), "render_lines_as_tubes": True}
    else:
        style |= {"smooth_shading": True, "ambient": 0.3, "diffuse": 0.7, "specular": 0.04}
    plotter.add_mesh(build_layer(layer), **style)


def _aim(plotter: Any, panel: Panel, aspect: float) -> None:
    """Set the camera of the plotter's present view."""
    camera = camera_of(panel, aspect)
    plotter.set_background("white")
    plotter.enable_parallel_projection()
    away = 10.0 * camera.half_height * max(aspect, 1.0)
    plotter.camera_position = (camera.centre + away * camera.axes[2], camera.centre, camera.axes[1])
    plotter.camera.parallel_scale = camera.half_height
    plotter.reset_camera_clipping_range()


def render_panels(folder: Path, panels: list[Panel], size: tuple[int, int]) -> list[Path]:
    """Draw each panel off screen, ``size`` pixels wide and high, twice as fine; the pictures' files."""
    pv = _pyvista()
    paths = []
    for number, panel in enumerate(panels):
        fine = (round(_FINE * size[0]), round(_FINE * size[1]))
        plotter = pv.Plotter(off_screen=True, window_size=fine, lighting="none")
        plotter.enable_anti_aliasing("msaa", multi_samples=4)
        for layer in panel.layers:
            add_layer(plotter, layer, panel.bar)
        _aim(plotter, panel, size[0] / size[1])
        plotter.add_light(pv.Light(light_type="headlight", intensity=1.0))
        paths.append(folder / picture_name(number))
        plotter.screenshot(str(paths[-1]))
        plotter.close()
    return paths


def show_panels(panels: list[Panel], title: str) -> None:
    """Open a window with all panels; comes back when it is closed."""
    pv = _pyvista()
    across = 1 if len(panels) == 1 else 2
    down = -(-len(panels) // across)
    plotter = pv.Plotter(shape=(down, across), window_size=_WINDOW, title=title, lighting="none")
    for number, panel in enumerate(panels):
        plotter.subplot(number // across, number % across)
        for layer in panel.layers:
            add_layer(plotter, layer, panel.bar, window=True)
        plotter.add_text(f"{panel.title}\n{panel.caption}", font_size=8, color="black")
        keys = [
            (layer.label, "grey" if layer.values.size else layer.colour)
            for layer in panel.layers
            if layer.label
        ]
        for line, (label, colour) in enumerate(keys):
            spot = (0.01, 0.88 - 0.04 * line)
            plotter.add_text(
                label.replace("\n", " "), position=spot, viewport=True, font_size=6, color=colour
            )
        plotter.add_axes(color="black")
        _aim(plotter, panel, _WINDOW[0] / across / (_WINDOW[1] / down))
        plotter.camera.parallel_scale *= _ROOM
    plotter.add_light(pv.Light(light_type="headlight", intensity=1.0))  # it shines in all views
    plotter.show()


def main(arguments: list[str] | None = None) -> int:
    """The child process of :mod:`contour.view`."""
    parser = argparse.ArgumentParser(prog="python -m contour.render", description="Draws panels by VTK.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--size", type=int, nargs=2, default=(800, 600))
    parser.add_argument("--window", default="", help="title of a window to open, instead of pictures")
    asked = parser.parse_args(arguments)
    panels = load_panels(asked.folder / PANELS)
    if asked.window:
        show_panels(panels, asked.window)
    else:
        render_panels(asked.folder, panels, (asked.size[0], asked.size[1]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
