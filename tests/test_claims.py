"""Errors over claimed sigmas, taken from a run's table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_run import FLAGGED, WRONG, small_run, spoilt_run

from contour.claims import beam_directions, claims_of, covered
from contour.results import load_run

LENGTH = 0.21


def test_claims_are_the_errors_that_the_scan_itself_measured(tmp_path):
    """Normals in the sensing plane, s, points and coverage agree with metrics.json, made from other data."""
    run = load_run(small_run(tmp_path))
    claims, good, metrics = claims_of(run, LENGTH), run.good, run.metrics
    assert np.median(claims.normal[good]) == pytest.approx(metrics["normal_error_median_rad"], abs=1e-9)
    assert np.quantile(claims.normal[good], 0.95) == pytest.approx(metrics["normal_error_p95_rad"], abs=1e-9)
    smooth = metrics["smooth_normal_error_median_rad"]
    assert np.median(claims.smooth_normal[good]) == pytest.approx(smooth, abs=1e-9)
    assert np.sqrt(np.mean(claims.point[good] ** 2)) == pytest.approx(metrics["point_error_rms_m"], rel=1e-9)
    assert covered(claims.distance_ratio[good]) == pytest.approx(metrics["coverage_95"], abs=1e-12)
    assert covered(claims.normal_ratio[good]) == pytest.approx(metrics["coverage_95_normal"], abs=1e-12)
    assert claims.wrong.sum() == metrics["silently_wrong"]


def test_beams_are_those_of_the_plan(tmp_path):
    """The scene's two directions come out of the normals, up to their sign."""
    run = load_run(small_run(tmp_path))
    beam = np.abs(beam_directions(run))
    wanted = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    np.testing.assert_allclose(beam, wanted[run.contour], atol=1e-9)


def test_normals_are_judged_in_the_sensing_plane(tmp_path):
    """What a true normal has along the beam, as under a tip, is not held against the sensed one."""
    run = load_run(small_run(tmp_path))
    before, beam = claims_of(run, LENGTH).normal, beam_directions(run)
    for i, axis in enumerate("xyz"):
        run.contacts[f"true_n{axis}"] += 0.8 * beam[:, i]
    np.testing.assert_allclose(claims_of(run, LENGTH).normal, before, atol=1e-9)


def test_beam_of_a_single_contact_is_not_told(tmp_path):
    """One normal leaves the beam's direction open."""
    run = load_run(small_run(tmp_path))
    first = replace(run, contacts={name: column[:1] for name, column in run.contacts.items()})
    assert not beam_directions(first).any()


def test_only_unflagged_contacts_are_silently_wrong(tmp_path):
    """8 mm off and unflagged is wrong; the same with a flag is not."""
    run = load_run(spoilt_run(tmp_path))
    assert np.flatnonzero(claims_of(run, LENGTH).wrong).tolist() == [WRONG]
    run.contacts["true_s_m"][FLAGGED] -= 8e-3
    assert not claims_of(run, LENGTH).wrong[FLAGGED]


def test_no_truth_no_claims(tmp_path):
    """A machine's run has no true columns."""
    run = load_run(small_run(tmp_path))
    sensed = {name: column for name, column in run.contacts.items() if not name.startswith("true_")}
    assert claims_of(replace(run, contacts=sensed), LENGTH) is None


def test_no_sigma_is_infinitely_bold(tmp_path):
    """A contact that claims no deviation at all is never covered, and divides nothing by zero."""
    run = load_run(small_run(tmp_path))
    run.contacts["sigma_s_m"][0] = 0.0
    assert np.isinf(claims_of(run, LENGTH).distance_ratio[0])
