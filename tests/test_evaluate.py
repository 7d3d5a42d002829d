"""Figures of a scan from contacts and truths whose errors are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from contour.contacts import Contacts, Flag, Kind, flag_names
from contour.evaluate import ERROR_FIGURES, errors_of, figures, true_columns
from contour.virtual import TrueContact

LENGTH = 0.21
"""Of the beam [m]: 1 % is 2.1 mm."""


def _truth(n):
    return TrueContact(
        distance=np.full(n, 0.1),
        outward=np.full(n, 3.1),
        tilt=np.zeros(n),
        kind=np.full(n, np.int8(Kind.SIDE)),
        radius_along=np.full(n, 0.03),
        radius_across=np.full(n, 0.05),
        friction=np.full(n, np.tan(0.2)),
        point=np.tile([0.3, -0.2, 0.1], (n, 1)),
        normal=np.tile([0.0, 0.0, 1.0], (n, 1)),
        body=np.arange(n),
        region=np.full(n, np.int8(-1)),
        extent=np.full(n, np.inf),
        depth=np.zeros(n),
    )


def _contacts(off, turn, *, sigma=1e-4, sigma_normal=0.01):
    """Contacts with errors ``off`` (n,) in s and ``turn`` (n,) in the normal."""
    off, turn = np.broadcast_arrays(np.asarray(off, dtype=np.float64), np.asarray(turn, dtype=np.float64))
    n = off.size
    truth = _truth(n)
    return replace(
        Contacts.none(),
        which=np.arange(n),
        touch=np.zeros((n, 2)),
        point=truth.point + off[:, None] * [0.6, 0.0, 0.8],
        normal=truth.normal,
        distance=truth.distance + off,
        sigma_distance=np.full(n, sigma),
        outward=truth.outward + turn,
        sigma_normal=np.full(n, sigma_normal),
        friction_angle=np.full(n, 0.2),
        sigma_friction=np.full(n, 0.01),
        radius_along=truth.radius_along,
        curvature_across=1.0 / truth.radius_across,
        kind=truth.kind,
        pushes=np.ones(n, dtype=np.int64),
        flags=np.zeros(n, dtype=np.int64),
        machine_time=np.ones(n),
        sequence=np.arange(n),
    )


def test_errors_are_estimate_less_truth():
    """Signed in s, relative to the true s; between the points; wrapped in the normal."""
    contacts = _contacts([1e-3, -2e-3], [0.2, 2.0 * np.pi - 0.1])
    errors = errors_of(contacts, _truth(2), LENGTH)
    np.testing.assert_allclose(errors.distance, [1e-3, -2e-3], atol=1e-15)
    np.testing.assert_allclose(errors.distance_relative, [0.01, -0.02], rtol=1e-9)
    np.testing.assert_allclose(errors.point, [1e-3, 2e-3], rtol=1e-9)
    np.testing.assert_allclose(errors.normal, [0.2, -0.1], atol=1e-12)


def test_ninety_five_percent_of_normal_errors_are_covered(rng):
    """Errors drawn with the sigmas claimed lie within the interval as often as they should."""
    n = 20_000
    contacts = _contacts(1e-4 * rng.standard_normal(n), 0.01 * rng.standard_normal(n))
    result = figures(contacts, errors_of(contacts, _truth(n), LENGTH))
    # Binomial: sqrt(0.95 x 0.05/20000) = 0.0015, four of them.
    assert result["coverage_95"] == pytest.approx(0.95, abs=0.0062)
    assert result["coverage_95_normal"] == pytest.approx(0.95, abs=0.0062)
    assert result["silently_wrong"] == 0


@pytest.mark.parametrize(
    "off,turn,sigma,sigma_normal,wrong",
    [
        (2.0e-3, 0.0, 1e-4, 0.01, False),  # beyond 4 sigma, within 1 % of L
        (2.2e-3, 0.0, 1e-4, 0.01, True),  # beyond both
        (-2.2e-3, 0.0, 1e-4, 0.01, True),
        (2.2e-3, 0.0, 6e-4, 0.01, False),  # within 4 sigma
        (0.0, np.deg2rad(4.9), 1e-4, 0.01, False),  # beyond 4 sigma, within 5 deg
        (0.0, np.deg2rad(-5.1), 1e-4, 0.01, True),
        (0.0, np.deg2rad(5.1), 1e-4, np.deg2rad(1.3), False),  # within 4 sigma
    ],
)
def test_silently_wrong_is_beyond_four_sigmas_and_the_allowance(off, turn, sigma, sigma_normal, wrong):
    """Unflagged, and above max(4 sigma, 1 % of L) in s or max(4 sigma, 5 deg) in the normal."""
    contacts = _contacts([off], [turn], sigma=sigma, sigma_normal=sigma_normal)
    assert errors_of(contacts, _truth(1), LENGTH).wrong[0] == wrong
    flagged = replace(contacts, flags=np.array([int(Flag.UNRESOLVED)]))
    assert not errors_of(flagged, _truth(1), LENGTH).wrong[0]


def test_figures_are_of_unflagged_contacts():
    """Errors of flagged contacts count nowhere; contacts, flags and pushes do."""
    contacts = _contacts([1e-4, -3e-4, 0.05], [0.01, -0.03, 1.0], sigma=2e-4, sigma_normal=0.01)
    contacts = replace(contacts, flags=np.array([0, 0, int(Flag.LOST)]), pushes=np.array([1, 2, 6]))
    result = figures(contacts, errors_of(contacts, _truth(3), LENGTH))
    assert result["contacts"] == 3
    assert result["flagged"] == 1
    assert result["pushes_per_contact"] == pytest.approx(3.0)
    assert result["s_error_rms_rel"] == pytest.approx(np.sqrt(5.0) * 1e-3)
    assert result["point_error_rms_m"] == pytest.approx(np.sqrt(5.0) * 1e-4)
    assert result["point_error_p99_m"] == pytest.approx(1e-4 + 0.99 * 2e-4)
    assert result["s_error_p99_rel"] == pytest.approx(1e-3 + 0.99 * 2e-3)
    assert result["normal_error_median_rad"] == pytest.approx(0.02)
    assert result["normal_error_p95_rad"] == pytest.approx(0.01 + 0.95 * 0.02)
    assert result["coverage_95"] == 1.0
    assert result["coverage_95_normal"] == 0.5
    assert result["silently_wrong"] == 0


@pytest.mark.parametrize("case", ["no truth", "nothing good", "no contacts"])
def test_unknown_figures_are_none(case):
    """Every key is there in any case; what nothing is known of has no value."""
    contacts = _contacts([1e-4, 1e-4], [0.0, 0.0])
    if case == "nothing good":
        contacts = replace(contacts, flags=np.ones(2, dtype=np.int64))
    if case == "no contacts":
        contacts = Contacts.none()
    errors = None if case == "no truth" else errors_of(contacts, _truth(len(contacts)), LENGTH)
    result = figures(contacts, errors)
    assert all(result[name] is None for name in ERROR_FIGURES)
    assert result["contacts"] == len(contacts)
    assert (result["pushes_per_contact"] is None) == (case == "no contacts")


def test_true_columns_tell_the_truth():
    """Positions, normals, s, friction, radii, kind, body and rung, under names that begin with true_."""
    truth = _truth(3)
    columns = true_columns(truth, np.array([0, 1, 3], dtype=np.int8))
    assert all(name.startswith("true_") and column.shape == (3,) for name, column in columns.items())
    np.testing.assert_array_equal(columns["true_y_m"], truth.point[:, 1])
    np.testing.assert_array_equal(columns["true_nz"], 1.0)
    np.testing.assert_array_equal(columns["true_s_m"], 0.1)
    np.testing.assert_allclose(columns["true_friction_angle_rad"], 0.2)
    np.testing.assert_array_equal(columns["true_rung"], [0, 1, 3])
    np.testing.assert_array_equal(columns["true_body"], [0, 1, 2])


def test_flags_have_words():
    """Joined by a bar, empty for none, all of them nameable."""
    assert flag_names(0) == ""
    assert flag_names(int(Flag.SLIP_OFF | Flag.OVER_MOMENT)) == "slip-off|over-moment"
    everything = sum(int(flag) for flag in Flag)
    assert flag_names(everything) == "slip-off|unresolved|over-moment|lost|soft-or-tip"


def test_contacts_are_taken_and_joined_row_by_row():
    """By indices or mask; nothing joined to something changes nothing."""
    contacts = _contacts([1e-3, 2e-3, 3e-3], [0.0, 0.1, 0.2])
    np.testing.assert_array_equal(contacts.take(np.array([2, 0])).distance, contacts.distance[[2, 0]])
    np.testing.assert_array_equal(contacts.take(contacts.distance > 0.1015).which, [1, 2])
    joined = Contacts.concatenate([contacts.take(np.array([1])), Contacts.none(), contacts])
    np.testing.assert_array_equal(joined.which, [1, 0, 1, 2])
    assert joined.point.shape == (4, 3)
    assert len(Contacts.concatenate([])) == 0
    for name in ("which", "kind", "flags", "point", "sequence"):
        assert getattr(Contacts.none(), name).dtype == getattr(contacts, name).dtype
