"""Draws docs/figures/conventions.svg: axes, angles and signs; the same file every time (make figures)."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, Wedge

__all__ = ["main"]

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "figures"
BEAM, BODY, FORCE, PUSH, QUIET = "#1f4e79", "#d9d9d9", "#c0392b", "#2e7d32", "#555555"
EPS, ALPHA = 20.0, 10.0
"""Pushing direction off the inner normal and friction angle of the drawing [deg]."""


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], color: str) -> None:
    axes.annotate("", xy=end, xytext=start, arrowprops={"arrowstyle": "-|>", "color": color, "lw": 1.6})


def _polar(degrees: float, radius: float = 1.0) -> tuple[float, float]:
    angle = np.deg2rad(degrees)
    return float(radius * np.cos(angle)), float(radius * np.sin(angle))


def _angle(axes: Axes, start: float, end: float, radius: float, label: str, color: str) -> None:
    """An arc from ``start`` to ``end`` deg, counter-clockwise, with its name in the middle."""
    axes.add_patch(Arc((0, 0), 2 * radius, 2 * radius, theta1=start, theta2=end, color=color, lw=1.1))
    x, y = _polar(0.5 * (start + end), radius + 0.13)
    axes.text(x, y, label, color=color, ha="center", va="center")


def _bare(axes: Axes, title: str, span: tuple[float, float, float, float]) -> None:
    axes.set_title(title, fontsize=10)
    axes.set_aspect("equal")
    axes.axis("off")
    axes.set_xlim(span[0], span[1])
    axes.set_ylim(span[2], span[3])


def _draw_gimbal(axes: Axes) -> None:
    _bare(
        axes, r"pose: $T_{base,sensor}$ = Trans(X, Y, Z) $R_z(\phi_1)\,R_x(\phi_2)$", (-0.9, 2.5, -1.0, 1.6)
    )
    _arrow(axes, (0, -0.8), (0, 1.35), QUIET)
    axes.text(0.06, 1.35, r"$Z$ of the base: axis of $\phi_1$ (outer)", va="center")
    _arrow(axes, (0, 0), (-0.62, -0.5), QUIET)
    axes.text(-0.6, -0.72, r"$x_s$: axis of $\phi_2$ (inner)", ha="center")
    axes.plot([0, 1.9], [0, 0.42], color=BEAM, lw=3, solid_capstyle="round")
    _arrow(axes, (1.9, 0.42), (2.3, 0.508), BEAM)
    axes.text(2.32, 0.62, r"$y_s$, beam", ha="center", color=BEAM)
    axes.add_patch(Arc((0, 0.95), 0.55, 0.2, theta1=200, theta2=520, color=QUIET))
    axes.text(0.4, 0.95, r"$\phi_1$", va="center")
    axes.plot([0, 1.5], [0, 0], color=QUIET, lw=0.8, ls=":")
    axes.add_patch(Arc((0, 0), 2.4, 2.4, theta1=0, theta2=12.5, color=QUIET))
    axes.text(1.33, 0.12, r"$\phi_2$", va="center")
    axes.add_patch(Circle((0, 0), 0.05, color=BEAM, zorder=5))
    axes.text(0.1, -0.3, "centre of rotation", color=BEAM)
    axes.text(0.35, -0.75, r"singular at $\phi_2 = \pm 90^\circ$: refused", color=QUIET)


def _draw_plane(axes: Axes) -> None:
    _bare(axes, r"sensing plane $\Pi$, seen along the beam ($y_s$ into the page)", (-1.6, 1.7, -1.5, 1.5))
    axes.add_patch(Circle((0, -1.5), 1.5, facecolor=BODY, edgecolor=QUIET))
    axes.text(-1.05, -1.35, r"body, profile radius $R_l > 0$ (convex)", color=QUIET)
    axes.add_patch(Wedge((0, 0), 1.1, 90 - ALPHA, 90 + ALPHA, color=FORCE, alpha=0.12))
    phi, psi = 270 + EPS, 90 + ALPHA
    for degrees, color, label, where in (
        (90.0, QUIET, r"$\nu_+$ outer normal", (0.08, 1.28)),
        (270.0, QUIET, r"$\nu_-$", (-0.16, -1.05)),
        (phi, PUSH, r"$\varphi$: contact is pushed this way", (0.45, -0.93)),
        (psi, FORCE, r"$\psi$: force ON the beam", (-1.45, 1.1)),
    ):
        _arrow(axes, (0, 0), _polar(degrees, 1.15), color)
        axes.text(*where, label, color=color)
    _arrow(axes, (-1.5, -0.35), (-1.05, -0.35), QUIET)
    axes.text(-1.0, -0.35, r"$x_s$", va="center")
    _arrow(axes, (-1.5, -0.35), (-1.5, 0.1), QUIET)
    axes.text(-1.5, 0.18, r"$z_s$", ha="center")
    _angle(axes, 270, phi, 0.85, r"$\varepsilon$", PUSH)
    _angle(axes, 90, psi, 0.75, "", FORCE)
    axes.text(-0.13, 0.9, r"$\alpha$", color=FORCE, ha="center")
    _angle(axes, psi, phi, 0.42, "", QUIET)
    axes.text(-0.48, 0.22, r"$\delta = \varphi - \psi$", color=QUIET, ha="right")
    axes.add_patch(Circle((0, 0), 0.05, color=BEAM, zorder=5))
    axes.text(0.62, 0.45, "angles run from\n$+x_s$ to $+z_s$", color=QUIET)


def _draw_push(axes: Axes) -> None:
    _bare(axes, r"push: the base turns by $\theta$, the contact holds the beam", (-0.15, 2.3, -0.75, 0.95))
    s, length, theta = 1.25, 2.0, np.deg2rad(16.0)
    axes.plot([0, length], [0, 0], color=QUIET, lw=0.8, ls=":")
    x = np.linspace(0.0, s, 60)
    turned = -np.tan(theta) * x
    bent = turned + s * np.tan(theta) * (3.0 * (x / s) ** 2 - (x / s) ** 3) / 2.0
    slope = -np.tan(theta) + 1.5 * np.tan(theta)
    axes.plot([*x, length], [*bent, slope * (length - s)], color=BEAM, lw=2.5)
    axes.plot([0, 1.5], [0, -1.5 * np.tan(theta)], color=BEAM, lw=0.9, ls="--")
    axes.add_patch(Arc((0, 0), 2.0, 2.0, theta1=-16, theta2=0, color=QUIET))
    axes.text(1.03, -0.13, r"$\theta$")
    axes.add_patch(Circle((s, -0.21), 0.2, facecolor=BODY, edgecolor=QUIET))
    axes.text(s + 0.26, -0.3, "R along the beam", color=QUIET)
    _arrow(axes, (s, 0), (s, 0.62), FORCE)
    axes.text(s + 0.05, 0.55, "force ON the beam", color=FORCE)
    axes.annotate("", xy=(0, -0.6), xytext=(s, -0.6), arrowprops={"arrowstyle": "<->", "color": QUIET})
    axes.text(0.5 * s, -0.7, "$s$, undeformed, at zero force", ha="center", color=QUIET)
    axes.text(0.0, 0.62, r"$M = s\,y_s \times f$ = $s\,(f_z, 0, -f_x)$", color=FORCE)
    axes.text(0.0, 0.42, r"$C = \theta/|M|$,  $s \approx 3EI\,C$", color=QUIET)
    axes.add_patch(Circle((0, 0), 0.04, color=BEAM, zorder=5))


def main() -> None:
    """Write the figure."""
    mpl.rcParams.update({"svg.hashsalt": "contour", "svg.fonttype": "path", "font.size": 9})
    figure = Figure(figsize=(14.0, 4.6), layout="constrained")
    for axes, draw in zip(figure.subplots(1, 3), (_draw_gimbal, _draw_plane, _draw_push), strict=True):
        draw(axes)
    FOLDER.mkdir(parents=True, exist_ok=True)
    figure.savefig(FOLDER / "conventions.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
