"""Hermite interpolation as a Gaussian process: what it passes through, what it says of itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from contour import hermite
from contour.errors import NotConverged
from contour.hermite import Observations, farthest_first, fit_compact, fit_layers, fit_wide, nearest_sigma

RADIUS = 0.1


def _directions(rng, count):
    way = rng.normal(size=(count, 3))
    return way / np.linalg.norm(way, axis=1)[:, None]


def _observed(points, normals, *, point=20e-6, normal=0.005):
    count = len(points)
    return Observations(
        points=points,
        values=np.zeros(count),
        gradients=normals,
        value_noise=np.full(count, point**2),
        gradient_noise=np.tile(normal**2 * np.eye(3), (count, 1, 1)),
    )


def _bumpy(rng, count):
    """Points and normals of a sphere with waves of 20 mm length and 0.5 mm height, and where it is zero."""
    wave, high = 2.0 * np.pi / 0.02, 0.5e-3

    def level(p):
        return np.linalg.norm(p, axis=1) - RADIUS - high * np.sin(wave * p[:, 2])

    way = _directions(rng, count)
    points = RADIUS * way
    for _ in range(20):
        points = points - level(points)[:, None] * way
    slope = way.copy()
    slope[:, 2] -= high * wave * np.cos(wave * points[:, 2])
    return points, slope / np.linalg.norm(slope, axis=1)[:, None]


def _differences(field, points, step=1e-6):
    return np.stack(
        [(field(points + step * e) - field(points - step * e)) / (2 * step) for e in np.eye(3)], 1
    )


def test_a_sphere_is_its_signed_distance(rng):
    """With 300 points on a sphere the field is r - R within 7 %, a fifth of the radius to either side."""
    way = _directions(rng, 300)
    field = fit_wide(_observed(RADIUS * way, way))
    for r in (0.8, 0.9, 1.1, 1.2):
        ratio = field(r * RADIUS * _directions(rng, 200)) / ((r - 1.0) * RADIUS)
        assert np.abs(ratio - 1.0).max() < 0.07
    on = field(RADIUS * _directions(rng, 500))
    assert np.abs(on).max() < 0.1e-3


@pytest.mark.parametrize("noise", [1e-6, 0.2e-3])
def test_points_are_passed_as_closely_as_their_noise_allows(rng, noise):
    """What is left at the points is of the size of their noise: no more, and not fitted where it is large."""
    way = _directions(rng, 400)
    off = rng.normal(0.0, noise, (400, 1))
    observed = _observed((RADIUS + off) * way, way, point=noise)
    field = fit_wide(observed)
    assert np.sqrt(np.mean(field(observed.points) ** 2)) < 1.1 * noise
    true = field(RADIUS * way)
    assert np.sqrt(np.mean(true**2)) < (0.5 * noise if noise > 1e-5 else 2 * noise)


def test_gradients_are_those_of_the_fields(rng):
    """Central differences agree with both gradients, away from the centres' kinks."""
    points, normals = _bumpy(rng, 1200)
    field = fit_layers(_observed(points, normals))
    assert len(field.corrections) == 1
    asked = 1.05 * RADIUS * _directions(rng, 200)
    for part in (field.wide, field.corrections[0], field):
        assert np.abs(part.gradient(asked) - _differences(part, asked)).max() < 1e-5


def test_corrections_end_at_their_radius(rng):
    """The compact field is zero beyond it and not within."""
    way = _directions(rng, 300)
    observed = replace(_observed(RADIUS * way, 0.1 * way), values=np.full(300, 1e-3))
    field = fit_compact(observed, radius=0.03)
    assert np.all(field((RADIUS + 0.0301) * way) == 0.0)
    assert np.abs(field(RADIUS * way) - 1e-3).max() < 0.2e-3


def test_layers_follow_what_the_spread_points_miss(rng):
    """Waves too short for the wide process: the corrections take what it leaves, where there was no point too."""
    points, normals = _bumpy(rng, 6000)
    field = fit_layers(_observed(points, normals))
    asked, _ = _bumpy(rng, 1000)
    coarse, fine = (np.sqrt(np.mean(f(asked) ** 2)) for f in (field.wide, field))
    assert coarse > 50e-6
    assert fine < 0.25 * coarse


def test_a_part_of_the_normal_that_was_not_seen_is_found(rng):
    """Normals known within a plane only, 30 deg off on average otherwise: neighbours tell the rest."""
    way = _directions(rng, 400)
    beam = np.cross(way, _directions(rng, 400))
    beam /= np.linalg.norm(beam, axis=1)[:, None]
    lean = rng.uniform(-0.8, 0.8, (400, 1))
    hidden = np.cos(lean) * beam + np.sin(lean) * way
    seen = way - np.sum(way * hidden, axis=1)[:, None] * hidden
    seen /= np.linalg.norm(seen, axis=1)[:, None]
    observed = _observed(RADIUS * way, 0.9 * seen)
    noise = observed.gradient_noise + 0.5**2 * hidden[:, :, None] * hidden[:, None, :]
    noise += 0.2**2 * seen[:, :, None] * seen[:, None, :]
    slope = fit_wide(replace(observed, gradient_noise=noise)).gradient(RADIUS * way)
    off = np.arccos(np.clip(np.sum(slope * way, axis=1) / np.linalg.norm(slope, axis=1), -1.0, 1.0))
    blind = np.arccos(np.clip(np.sum(seen * way, axis=1), -1.0, 1.0))
    assert np.rad2deg(np.median(blind)) > 15.0
    assert np.rad2deg(np.quantile(off, 0.95)) < 1.0


def test_spread_points_leave_no_gap(rng):
    """None of the chosen is nearer to another than the farthest point is to them; rows are a prefix of longer."""
    points = rng.uniform(size=(800, 3))
    rows = farthest_first(points, 60)
    assert len(set(rows.tolist())) == 60
    apart = np.linalg.norm(points[rows, None] - points[rows], axis=2)
    gap = np.linalg.norm(points[:, None] - points[rows], axis=2).min(axis=1).max()
    assert apart[~np.eye(60, dtype=bool)].min() >= gap
    assert np.array_equal(farthest_first(points, 20), rows[:20])
    assert np.array_equal(farthest_first(points, 900), np.arange(800))


def test_sigma_covers_and_grows_in_a_gap(rng):
    """About 95 % of the true surface is within 1.96 sigma of the field's zero; where nothing is, sigma is large."""
    points, normals = _bumpy(rng, 1500)
    keep = points[:, 2] < 0.06
    points = points[keep] + rng.normal(0.0, 50e-6, (keep.sum(), 1)) * normals[keep]
    observed = _observed(points, normals[keep], point=50e-6)
    field = fit_layers(observed)
    asked, _ = _bumpy(rng, 2000)
    sigma = nearest_sigma(observed, asked)
    touched = asked[:, 2] < 0.055
    covered = np.abs(field(asked)) < 1.96 * sigma
    assert 0.9 < covered[touched].mean() <= 1.0
    assert np.median(sigma[touched]) < 0.2e-3
    assert np.median(sigma[asked[:, 2] > 0.09]) > 5.0 * np.median(sigma[touched])


def test_unsolved_equations_are_told(rng, monkeypatch):
    """One iteration is not enough."""
    monkeypatch.setattr(hermite, "ITERATIONS", 1)
    way = _directions(rng, 300)
    with pytest.raises(NotConverged, match="after 1 iterations"):
        fit_compact(_observed(RADIUS * way, way), radius=0.03)
