"""What a scan claimed against what was true: each contact's errors over the sigmas it came with.

Only a simulation knows (the ``true_`` columns of ``contacts.csv``). Definitions are those of contour.evaluate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contour.evaluate import WITHIN, WRONG_NORMAL, WRONG_SHARE_OF_LENGTH, WRONG_SIGMAS
from contour.results import Run

__all__ = ["Claims", "beam_directions", "claims_of", "covered"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

LEAST_TURN = 1e-3
"""Normals of a contour that differ by less than this do not tell its beam's direction [rad]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Claims:
    """Errors of n contacts, flagged ones too, and what was claimed of them."""

    distance: FloatArray
    """(n,) m, error of s."""
    sigma_distance: FloatArray
    """(n,) m"""
    normal: FloatArray
    """(n,) rad, at least 0: error of the sensed normal in the sensing plane."""
    sigma_normal: FloatArray
    """(n,) rad"""
    smooth_normal: FloatArray | None
    """(n,) rad, the same of the normals smoothed along the contours; None where there are none."""
    sigma_smooth_normal: FloatArray | None
    """(n,) rad"""
    point: FloatArray
    """(n,) m, at least 0: distance between sensed and true point."""
    wrong: BoolArray
    """(n,) silently wrong."""

    @property
    def distance_ratio(self) -> FloatArray:
        """(n,) error of s over its sigma, at least 0; infinite where the sigma is 0, as of contacts that were lost."""
        return _ratio(np.abs(self.distance), self.sigma_distance)

    @property
    def normal_ratio(self) -> FloatArray:
        """(n,) error of the sensed normal over its sigma."""
        return _ratio(self.normal, self.sigma_normal)

    @property
    def smooth_normal_ratio(self) -> FloatArray | None:
        """(n,) error of the smoothed normal over its sigma."""
        if self.smooth_normal is None or self.sigma_smooth_normal is None:
            return None
        return _ratio(self.smooth_normal, self.sigma_smooth_normal)


def claims_of(run: Run, length: float) -> Claims | None:
    """Errors of the contacts of ``run``, made with a beam of ``length`` [m]; None where the truth is not known."""
    table = run.contacts
    if "true_s_m" not in table:
        return None
    beam = beam_directions(run)
    smooth = "smooth_nx" in table
    true_normal = _vectors(table, "true_n{}")
    distance, normal = table["s_m"] - table["true_s_m"], _turn(_vectors(table, "n{}"), true_normal, beam)
    far = np.abs(distance) > np.maximum(WRONG_SIGMAS * table["sigma_s_m"], WRONG_SHARE_OF_LENGTH * length)
    askew = normal > np.maximum(WRONG_SIGMAS * table["sigma_normal_rad"], WRONG_NORMAL)
    return Claims(
        distance=distance,
        sigma_distance=table["sigma_s_m"],
        normal=normal,
        sigma_normal=table["sigma_normal_rad"],
        smooth_normal=_turn(_vectors(table, "smooth_n{}"), true_normal, beam) if smooth else None,
        sigma_smooth_normal=table["sigma_smooth_normal_rad"] if smooth else None,
        point=np.linalg.norm(run.points - _vectors(table, "true_{}_m"), axis=1),
        wrong=run.good & (far | askew),
    )


def beam_directions(run: Run) -> FloatArray:
    """Directions (n, 3) of the beam at each contact, of either sign; zero where they cannot be told.

    All sensed normals of a contour are square to its beam. A contour whose normals are all alike (fewer than two
    contacts, a flat side) does not tell where along its plane the beam lies.
    """
    sensed = _vectors(run.contacts, "n{}")
    beam = np.zeros_like(sensed)
    for contour in np.unique(run.contour):
        rows = np.flatnonzero(run.contour == contour)
        _, spread, axes = np.linalg.svd(sensed[rows])
        if rows.size > 1 and spread[1] > LEAST_TURN * np.sqrt(rows.size):
            beam[rows] = axes[2]
    return beam


def covered(ratio: FloatArray) -> float:
    """Share of errors within their 95 % interval, given as errors over sigma."""
    return float(np.mean(ratio <= WITHIN)) if ratio.size else np.nan


def _ratio(error: FloatArray, sigma: FloatArray) -> FloatArray:
    return np.divide(error, sigma, out=np.full_like(error, np.inf), where=sigma > 0.0)


def _turn(sensed: FloatArray, true: FloatArray, beam: FloatArray) -> FloatArray:
    """Angles (n,) [rad] between sensed normals and the part of the true ones that is square to the beam."""
    inside = true - np.einsum("ij,ij->i", true, beam)[:, None] * beam
    cross = np.linalg.norm(np.cross(sensed, inside), axis=1)
    return np.asarray(np.arctan2(cross, np.einsum("ij,ij->i", sensed, inside)))


def _vectors(table: dict[str, NDArray[np.float64]], pattern: str) -> FloatArray:
    return np.stack([table[pattern.format(axis)] for axis in "xyz"], axis=1)
