"""The antenna at a contact: where it stood, which way it pushed and what it felt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from picture_runs import copied_run

from contour.results import load_run
from contour.scene import scene_of_record
from contour.stance import READINGS, beam_directions, stance_of


@pytest.fixture
def run(tmp_path):
    """A small scan."""
    return load_run(copied_run(tmp_path))


def _turn(a, b):
    return np.arccos(np.clip(np.sum(a * b, axis=-1), -1.0, 1.0))


def test_beams_are_square_to_the_normals(run):
    """Pi is square to the beam, and the sensed normals lie in it."""
    direction = beam_directions(run)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1.0, atol=1e-12)
    assert np.abs(np.sum(direction * run.normals, axis=1)).max() < 1e-9
    assert len(np.unique(direction.round(6), axis=0)) == 3


def test_the_beam_passes_by_the_contact(run):
    """From the base s along the beam, and a radius down to the surface: the contact, but for the touch's bending."""
    for row in range(0, run.contour.size, 7):
        stance = stance_of(run, row)
        along = (stance.tip - stance.base) / np.linalg.norm(stance.tip - stance.base)
        point = stance.base + stance.distance * along - stance.radius * stance.normal
        assert np.linalg.norm(point - stance.point) < 0.3e-3
        assert np.linalg.norm(stance.tip - stance.base) == pytest.approx(0.21)


def test_push_and_force_obey_the_mechanics(run):
    """Pushes go inwards. The force comes outwards within friction, about 3 EI theta / s^2."""
    scene = scene_of_record(run.record["scene"])
    checked = 0
    for row in range(run.contour.size):
        stance = stance_of(run, row)
        if stance.kind != "side":
            continue
        force = np.linalg.norm(stance.force)
        assert stance.push @ stance.normal < -0.8
        # The friction angle is 10 deg; the weight of the wire, which is not taken out, turns it a little.
        assert _turn(stance.force / force, stance.normal) < np.deg2rad(13.0)
        edge = scene.antenna.stiffness3 * stance.angle / stance.distance**2
        assert force == pytest.approx(edge, rel=0.1)
        checked += 1
    assert checked > 20


def test_without_readings_the_normals_tell_the_beam(run):
    """The same base within 0.5 mm and the same direction; no push is made up, and it is said."""
    known = [stance_of(run, row) for row in (0, 30, 60)]
    (run.folder / READINGS).unlink()
    for before in known:
        after = stance_of(run, before.row)
        np.testing.assert_allclose(after.base, before.base, atol=0.5e-3)
        np.testing.assert_allclose(after.tip, before.tip, atol=0.5e-3)
        assert after.push is None
        assert after.force is None
        assert READINGS in after.source


def test_parallel_normals_without_readings_tell_nothing(run):
    """All normals alike: no direction, rather than any."""
    (run.folder / READINGS).unlink()
    columns = dict(run.contacts)
    for axis, value in zip("xyz", (0.0, 0.0, 1.0), strict=True):
        columns[f"smooth_n{axis}"] = np.full(run.contour.size, value)
    flat = replace(run, contacts=columns)
    assert np.isnan(beam_directions(flat)).all()
    assert stance_of(flat, 3) is None
