"""What this machine can and cannot do: packages, their versions, and whether pictures can be drawn.

VTK may crash the interpreter where the OpenGL libraries are absent, so it is tried in a child process.
"""

from __future__ import annotations

import ctypes
import platform
import signal
import subprocess
import sys
from dataclasses import dataclass
from importlib import metadata

__all__ = ["Finding", "examine"]

_NEEDED = (
    "numpy",
    "scipy",
    "trimesh",
    "embreex",
    "cyclopts",
    "rich",
    "pymodbus",
    "pyvista",
    "vtk",
    "matplotlib",
)
_MODBUS = (3, 16)
"""Major and minor version of pymodbus that the link is written for; the others break its interface."""
_LIBRARIES = {
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libX11.so.6": "libx11-6",
    "libXrender.so.1": "libxrender1",
}
"""What VTK may load to draw, and the Debian package of each."""
_RAY = """
import numpy as np
from embreex import rtcore_scene, mesh_construction
scene = rtcore_scene.EmbreeScene()
corners = np.array([[[0, 0, 1], [1, 0, 1], [0, 1, 1]]], dtype=np.float32)
mesh_construction.TriangleMesh(scene, corners)
ray = np.array([[0.2, 0.2, 0]], dtype=np.float32), np.array([[0, 0, 1]], dtype=np.float32)
raise SystemExit(int(scene.run(*ray)[0] != 0))
"""
_DRAW = """
import pyvista
plotter = pyvista.Plotter(off_screen=True, window_size=(64, 64))
plotter.add_mesh(pyvista.Sphere(), color="red")
image = plotter.screenshot(None, return_img=True)
raise SystemExit(int(image.std() == 0))
"""
_PATIENCE = 120.0
"""A child that has not answered by then never will [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One thing that was looked at."""

    what: str
    """Its name."""
    found: str
    """What was found."""
    good: bool
    """Whether that is enough."""
    remedy: str = ""
    """What to do if not."""


def examine() -> list[Finding]:
    """Look at the interpreter, the packages, rays and pictures."""
    return [_python(), *(_package(name) for name in _NEEDED), _rays(), _pictures()]


def _python() -> Finding:
    good = sys.version_info >= (3, 11)
    found = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    return Finding(what="python", found=found, good=good, remedy="install Python 3.11 or newer")


def _package(name: str) -> Finding:
    try:
        version = metadata.version(name)
    except metadata.PackageNotFoundError:
        return Finding(what=name, found="not installed", good=False, remedy=f"pip install {name}")
    good = name != "pymodbus" or tuple(int(part) for part in version.split(".")[:2]) == _MODBUS
    return Finding(what=name, found=version, good=good, remedy="pip install 'pymodbus>=3.16.1,<3.17'")


def _rays() -> Finding:
    trouble = _child(_RAY)
    return Finding(
        what="rays (embree)",
        found=trouble or "a ray hits a triangle",
        good=not trouble,
        remedy="pip install --force-reinstall embreex (there are no wheels for aarch64)",
    )


def _pictures() -> Finding:
    trouble = _child(_DRAW)
    packages = [package for library, package in _LIBRARIES.items() if not _loads(library)]
    # Where all are there and drawing still fails, it is the software renderer that is absent.
    wanted = packages or ["libgl1-mesa-dri", "libegl-mesa0"]
    return Finding(
        what="pictures (VTK)",
        found=trouble or "a sphere was drawn off screen",
        good=not trouble,
        remedy=f"apt install {' '.join(wanted)}; scans and tables work without",
    )


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _child(program: str) -> str:
    """Run ``program`` in a process of its own; empty if all went well, else what went wrong."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", program], check=False, capture_output=True, text=True, timeout=_PATIENCE
        )
    except subprocess.TimeoutExpired:
        return f"no answer within {_PATIENCE:g} s"
    if done.returncode < 0:
        return f"crashed ({signal.Signals(-done.returncode).name})"
    if done.returncode:
        return (done.stderr.strip().splitlines() or ["wrong answer"])[-1]
    return ""
