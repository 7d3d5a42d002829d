"""How good a scan was, where the truth is known: errors, coverage, silently wrong contacts, by region.

Silently wrong means unflagged with an error above max(4 sigma, 1 % of L) in s, or max(4 sigma, 5 deg) in the
normal.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contour.contacts import Contacts
from contour.frames import wrap_angle
from contour.virtual import TrueContact

__all__ = ["Errors", "errors_of", "figures", "true_columns"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

WITHIN = 1.959963984540054
"""Half width of the 95 % interval in sigmas."""
WRONG_SIGMAS = 4.0
WRONG_SHARE_OF_LENGTH = 0.01
WRONG_NORMAL = np.deg2rad(5.0)


ERROR_FIGURES = (
    "s_error_rms_rel",
    "s_error_p99_rel",
    "point_error_rms_m",
    "point_error_p99_m",
    "normal_error_median_rad",
    "normal_error_p95_rad",
    "coverage_95",
    "coverage_95_normal",
    "silently_wrong",
)
"""Figures that need the truth."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Errors:
    """Errors of n contacts against the truth."""

    distance: FloatArray
    """(n,) m, of s."""
    distance_relative: FloatArray
    """(n,) of s, over its true value."""
    point: FloatArray
    """(n,) m, distance between the points."""
    normal: FloatArray
    """(n,) rad, of the normal's angle in Pi."""
    distance_covered: BoolArray
    """(n,) whether the true s lies in its 95 % interval."""
    normal_covered: BoolArray
    """(n,)"""
    wrong: BoolArray
    """(n,) silently wrong."""


def errors_of(contacts: Contacts, truth: TrueContact, length: float) -> Errors:
    """Errors of ``contacts`` against ``truth``, row by row; ``length`` is the beam's [m]."""
    off = contacts.distance - truth.distance
    turn = wrap_angle(contacts.outward - truth.outward)
    far = np.abs(off) > np.maximum(WRONG_SIGMAS * contacts.sigma_distance, WRONG_SHARE_OF_LENGTH * length)
    askew = np.abs(turn) > np.maximum(WRONG_SIGMAS * contacts.sigma_normal, WRONG_NORMAL)
    return Errors(
        distance=off,
        distance_relative=off / truth.distance,
        point=np.linalg.norm(contacts.point - truth.point, axis=1),
        normal=turn,
        distance_covered=np.abs(off) <= WITHIN * contacts.sigma_distance,
        normal_covered=np.abs(turn) <= WITHIN * contacts.sigma_normal,
        wrong=contacts.good & (far | askew),
    )


def figures(contacts: Contacts, errors: Errors | None = None) -> dict[str, Any]:
    """Metrics of a scan; errors are of the unflagged contacts, None where nothing is known."""
    good = contacts.good
    result: dict[str, Any] = {
        "contacts": len(contacts),
        "flagged": int(np.count_nonzero(~good)),
        "pushes_per_contact": float(contacts.pushes.mean()) if len(contacts) else None,
    }
    known = errors is not None and bool(good.any())
    if known and errors is not None:
        relative, normal, point = (
            errors.distance_relative[good],
            np.abs(errors.normal[good]),
            errors.point[good],
        )
        result |= {
            "s_error_rms_rel": float(np.sqrt(np.mean(relative**2))),
            "s_error_p99_rel": float(np.quantile(np.abs(relative), 0.99)),
            "point_error_rms_m": float(np.sqrt(np.mean(point**2))),
            "point_error_p99_m": float(np.quantile(point, 0.99)),
            "normal_error_median_rad": float(np.median(normal)),
            "normal_error_p95_rad": float(np.quantile(normal, 0.95)),
            "coverage_95": float(errors.distance_covered[good].mean()),
            "coverage_95_normal": float(errors.normal_covered[good].mean()),
            "silently_wrong": int(errors.wrong.sum()),
        }
    else:
        result |= dict.fromkeys(ERROR_FIGURES)
    return result


def true_columns(truth: TrueContact, rung: NDArray[np.int8]) -> Mapping[str, NDArray[np.float64]]:
    """Columns of ``contacts.csv`` that only a simulation has."""
    columns = {f"true_{name}": truth.point[:, i] for i, name in enumerate(("x_m", "y_m", "z_m"))}
    columns |= {f"true_{name}": truth.normal[:, i] for i, name in enumerate(("nx", "ny", "nz"))}
    return columns | {
        "true_s_m": truth.distance,
        "true_outward_rad": truth.outward,
        "true_friction_angle_rad": np.arctan(truth.friction),
        "true_radius_along_m": truth.radius_along,
        "true_radius_across_m": truth.radius_across,
        "true_kind": truth.kind.astype(np.float64),
        "true_body": truth.body.astype(np.float64),
        "true_rung": rung.astype(np.float64),
    }
