"""Smoothing of normals: what it gains on smooth outlines, that it stops at corners, and that its sigmas hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planar_bench import PlanarBench, follow, make_contacts, plane_plan, rounded_box

from contour.antenna import Antenna
from contour.contacts import Contacts, Flag, Kind
from contour.errors import UsageError
from contour.frames import wrap_angle
from contour.smoothing import smooth_normals

SENSED = np.deg2rad(0.5)
"""Sigma of a sensed normal [rad]."""
TOUCH = 20e-6
"""Sigma of a touch [m]."""


def noisy(touch, outward, contour, order, *, seed=0, sensed=SENSED) -> Contacts:
    """Contacts with readings of true ``touch`` and ``outward``."""
    rng = np.random.default_rng(seed)
    return make_contacts(
        contour,
        touch + TOUCH * rng.standard_normal(touch.shape),
        wrap_angle(outward + sensed * rng.standard_normal(outward.size)),
        sigma=sensed,
        order=order,
    )


def ellipses(a, b, *, points=60, contours=30):
    """Touches, normals, contours and order round ellipses of half axes a and b, evenly in the parameter."""
    t = 2.0 * np.pi * (np.arange(points) + np.linspace(0.0, 1.0, contours)[:, None]) / points
    touch = np.stack((a * np.cos(t), b * np.sin(t)), axis=2).reshape(-1, 2)
    outward = np.arctan2(a * np.sin(t), b * np.cos(t)).ravel()
    return touch, outward, np.repeat(np.arange(contours), points), np.tile(np.arange(points), contours)


def squares(radius, *, step=5e-3, half=0.03, contours=30):
    """The same along squares with rounded corners, evenly along the outline; also whether each lies on an arc."""
    straight, arc = 2.0 * (half - radius), 0.5 * np.pi * radius
    side = straight + arc
    count = round(4.0 * side / step)
    s = (np.arange(count) + np.linspace(0.0, 1.0, contours)[:, None]) * 4.0 * side / count
    number, along = np.divmod(s, side)
    outward = np.where(along < straight, 0.0, (along - straight) / max(radius, 1e-12))
    x = half - radius + radius * np.cos(outward)
    y = np.where(along < straight, along - 0.5 * straight, half - radius + radius * np.sin(outward))
    turn = 0.5 * np.pi * number
    touch = np.stack((x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)), axis=2)
    return (
        touch.reshape(-1, 2),
        wrap_angle(outward + turn).ravel(),
        np.repeat(np.arange(contours), count),
        np.tile(np.arange(count), contours),
        (along >= straight).ravel(),
    )


def errors(smoothed, outward):
    """(n,) rad, absolute."""
    return np.abs(wrap_angle(smoothed.outward - outward))


@pytest.mark.parametrize("a, b", [(0.06, 0.06), (0.015, 0.015), (0.06, 0.03)])
def test_smooth_outlines_gain_a_factor(a, b):
    """Sensed normals of 0.34 deg median become 0.2 deg or better, and about 95 % lie within 1.96 sigma."""
    touch, outward, contour, order = ellipses(a, b, points=20 if a < 0.02 else 60)
    smoothed = smooth_normals(
        noisy(touch, outward, contour, order), closed=np.ones(30, dtype=bool), touch_sigma=TOUCH
    )
    error = errors(smoothed, outward)
    assert np.median(error) < np.deg2rad(0.2)
    assert np.quantile(error, 0.95) < np.deg2rad(0.6)
    # Neighbours share readings: with 600 to 1800 contacts the share is known to about 2 %.
    assert 0.92 < np.mean(error < 1.96 * smoothed.sigma) < 0.99
    assert np.all(smoothed.sigma <= SENSED * 1.001)


@pytest.mark.parametrize("radius_mm", [0.0, 1.0, 5.0])
def test_corners_are_not_smoothed_over(radius_mm):
    """On squares, arcs and faces alike keep their coverage: no normal is pulled round a corner."""
    touch, outward, contour, order, arc = squares(radius_mm * 1e-3)
    smoothed = smooth_normals(
        noisy(touch, outward, contour, order), closed=np.ones(30, dtype=bool), touch_sigma=TOUCH
    )
    error = errors(smoothed, outward)
    good = error < 1.96 * smoothed.sigma
    assert np.mean(good[~arc]) > 0.93
    if arc.sum() > 30:
        # Some 60 to 190 contacts on arcs: three deviations of a share of 0.95 are 0.05 to 0.08.
        assert np.mean(good[arc]) > 0.88
    # Never worse than sensed by more than the tail of 3000 draws of 0.5 deg.
    assert error.max() < np.deg2rad(2.2)
    assert np.median(error[~arc]) < np.deg2rad(0.2)


def test_next_to_a_sharp_corner_one_side_still_tells():
    """The last contacts of a face gain from the face, though the corner may be anywhere on their link."""
    touch, outward, contour, order, _ = squares(0.0)
    smoothed = smooth_normals(
        noisy(touch, outward, contour, order), closed=np.ones(30, dtype=bool), touch_sigma=TOUCH
    )
    last = np.abs(touch).min(axis=1) > 0.025
    error = errors(smoothed, outward)[last]
    assert last.sum() > 200
    # 236 contacts: three deviations of a share of 0.95 are 0.04. Without corners sigma stays above 0.93.
    assert np.mean(error < 1.96 * smoothed.sigma[last]) > 0.91
    assert np.median(smoothed.sigma[last]) < 0.9 * SENSED
    assert np.sqrt(np.mean(error**2)) < 0.9 * SENSED


def test_coarse_steps_over_corners_lose_nothing():
    """Where the tracer's steps are longer than arcs, windows contradict themselves: normals stay as sensed."""
    start = np.column_stack((np.full(12, -0.2), np.linspace(-0.01, 0.01, 12)))
    bench = PlanarBench(plane_plan(12, 10e-3, start=start), [rounded_box([0.05, 0.05], 5e-3)] * 12, Antenna())
    true, trace, _ = follow(bench)
    contacts = noisy(true.touch, true.outward, true.which, true.sequence)
    smoothed = smooth_normals(contacts, closed=trace.closed, touch_sigma=TOUCH)
    arc = np.abs(wrap_angle(4.0 * true.outward)) > 0.01
    # The median of |sensed - true| is 0.674 sigma; with some 60 contacts on arcs it is known to 15 %.
    assert arc.sum() > 40
    assert np.median(errors(smoothed, true.outward)[arc]) < 1.15 * 0.674 * SENSED


def test_a_change_of_orientation_changes_nothing():
    """Turned by any angle, and followed the other way round, an outline gets the same normals, turned."""
    touch, outward, contour, order = ellipses(0.06, 0.03, contours=2)
    contacts = noisy(touch, outward, contour, order)
    plain = smooth_normals(contacts, touch_sigma=TOUCH)
    c, s = np.cos(2.0), np.sin(2.0)
    turned = replace(
        contacts,
        touch=contacts.touch @ np.array([[c, s], [-s, c]]),
        outward=wrap_angle(contacts.outward + 2.0),
        sequence=59 - contacts.sequence,
    )
    again = smooth_normals(turned, touch_sigma=TOUCH)
    assert np.allclose(wrap_angle(again.outward - plain.outward - 2.0), 0.0, atol=1e-9)
    assert np.allclose(again.sigma, plain.sigma, rtol=1e-6)


def test_order_of_rows_does_not_matter():
    """Contacts of all contours in any order of rows."""
    touch, outward, contour, order = ellipses(0.05, 0.04, contours=4)
    contacts = noisy(touch, outward, contour, order)
    mixed = np.random.default_rng(3).permutation(len(contacts))
    plain = smooth_normals(contacts)
    again = smooth_normals(contacts.take(mixed))
    assert np.allclose(again.outward, plain.outward[mixed], atol=1e-12)


def test_flagged_normals_come_from_the_neighbours():
    """A flagged contact lends its touch only, and gets a better normal than it had."""
    touch, outward, contour, order = ellipses(0.06, 0.06, contours=10)
    contacts = noisy(touch, outward, contour, order)
    flags = np.where(order % 10 == 4, int(Flag.UNRESOLVED), 0)
    wrong = np.where(flags > 0, contacts.outward + 0.5, contacts.outward)
    # Their sigma is as confident as any: it is the flag that counts.
    flagged = replace(contacts, flags=flags, outward=wrong)
    smoothed = smooth_normals(flagged, closed=np.ones(10, dtype=bool), touch_sigma=TOUCH)
    error = errors(smoothed, outward)
    assert error[flags > 0].max() < np.deg2rad(1.0)
    assert np.median(error) < np.deg2rad(0.2)


def test_a_normal_that_is_silently_wrong_spoils_no_neighbour():
    """Windows that contradict themselves are dropped: neighbours of a normal 6 deg off stay within their sigma."""
    touch, outward, contour, order = ellipses(0.06, 0.06, contours=40)
    contacts = noisy(touch, outward, contour, order)
    wrong = replace(contacts, outward=wrap_angle(contacts.outward + np.deg2rad(6.0) * (order == 30)))
    smoothed = smooth_normals(wrong, closed=np.ones(40, dtype=bool), touch_sigma=TOUCH)
    beside = (order != 30) & (np.abs(order - 30) <= 2)
    error = errors(smoothed, outward)
    assert np.median(error[beside]) < np.deg2rad(0.3)
    # 160 contacts: three deviations of a share of 0.95 are 0.05.
    assert np.mean(error[beside] < 1.96 * smoothed.sigma[beside]) > 0.9
    # And on a stretch as gentle as this, 6 deg a step, it is outvoted itself.
    assert np.median(error[order == 30]) < np.deg2rad(0.5)
    assert error[order == 30].max() < np.deg2rad(1.5)


def test_linear_curvature_is_met_exactly():
    """On a clothoid read without error the polynomial is the truth: the smoothed normal is the normal."""
    s = np.linspace(-0.05, 0.05, 4001)
    heading = 30.0 * s + 150.0 * s**2
    curve = np.cumsum(np.column_stack((np.cos(heading), np.sin(heading))), axis=0) * (s[1] - s[0])
    every = np.arange(0, 4001, 200)
    outward = wrap_angle(heading[every] - 0.5 * np.pi)
    contacts = make_contacts(
        np.zeros(21, dtype=np.int64), curve[every], outward, sigma=SENSED, order=np.arange(21)
    )
    smoothed = smooth_normals(contacts, touch_sigma=TOUCH)
    # Chords of 5 mm that turn by 13 deg at most are 0.4 % shorter than their arcs: 0.02 deg over a step.
    assert np.abs(wrap_angle(smoothed.outward - outward))[2:-2].max() < np.deg2rad(0.05)
    assert np.all(smoothed.neighbours[2:-2] == 4)
    # Five normals and five touches of 20 um every 5 mm: better than the sensed one by a good factor.
    assert np.all(smoothed.sigma[2:-2] < 0.4 * SENSED)


def test_contacts_that_felt_nothing_take_no_part():
    """A LOST contact in mid-air changes no neighbour, and keeps what it has."""
    touch, outward, contour, order = ellipses(0.06, 0.06, contours=1)
    contacts = noisy(touch, outward, contour, order)
    lost = contacts.take(np.array([7]))
    stray = replace(lost, touch=lost.touch + 0.01, flags=np.array([int(Flag.LOST)]), sequence=np.array([60]))
    both = smooth_normals(Contacts.concatenate([contacts, stray]), touch_sigma=TOUCH)
    alone = smooth_normals(contacts, touch_sigma=TOUCH)
    assert np.allclose(both.outward[:60], alone.outward, atol=1e-12)
    assert both.outward[60] == stray.outward[0]
    assert both.neighbours[60] == 0


def test_ends_meet_where_contours_are_closed():
    """The first contact of a closed contour gains from the last; of an open one it has one side only."""
    touch, outward, contour, order = ellipses(0.06, 0.06, contours=40)
    contacts = noisy(touch, outward, contour, order)
    closed = smooth_normals(contacts, closed=np.ones(40, dtype=bool), touch_sigma=TOUCH)
    left_open = smooth_normals(contacts, touch_sigma=TOUCH)
    assert np.all(closed.sigma[order == 0] < left_open.sigma[order == 0])


def test_few_contacts_are_no_trouble():
    """None, one, and two contacts of a contour."""
    touch, outward, contour, order = ellipses(0.06, 0.06, points=60, contours=1)
    contacts = noisy(touch, outward, contour, order)
    for count in (0, 1, 2):
        smoothed = smooth_normals(contacts.take(np.arange(count)), closed=np.ones(1, dtype=bool))
        assert smoothed.outward.shape == (count,)
        assert np.all(np.isfinite(smoothed.outward))
    assert smooth_normals(contacts.take(np.arange(1))).outward[0] == pytest.approx(contacts.outward[0])


def test_bad_arguments_are_refused_by_name():
    """No spread of touches, and too few contours."""
    touch, outward, contour, order = ellipses(0.06, 0.06, contours=2)
    contacts = noisy(touch, outward, contour, order)
    with pytest.raises(UsageError, match="touch_sigma"):
        smooth_normals(contacts, touch_sigma=0.0)
    with pytest.raises(UsageError, match="closed has 1 contours"):
        smooth_normals(contacts, closed=np.ones(1, dtype=bool))


def stadiums(radius, *, straight=0.04, step=5e-3, contours=60):
    """Touches, normals, contours and order round two half circles joined by lines; also the distance to a joint."""
    half = np.pi * radius
    count = round(2.0 * (straight + half) / step)
    s = (np.arange(count) + np.linspace(0.0, 1.0, contours)[:, None]) * 2.0 * (straight + half) / count
    number, along = np.divmod(s, straight + half)
    turn = np.clip(along - straight, 0.0, None) / radius
    x = np.clip(along, None, straight) - 0.5 * straight + radius * np.sin(turn)
    y = -radius * np.cos(turn)
    flip = 1.0 - 2.0 * (number % 2)
    outward = wrap_angle(turn - 0.5 * np.pi + np.pi * number)
    length = straight + half
    joint = np.minimum(np.minimum(along, length - along), np.abs(along - straight))
    return (
        np.stack((flip * x, flip * y), axis=2).reshape(-1, 2),
        outward.ravel(),
        np.repeat(np.arange(contours), count),
        np.tile(np.arange(count), contours),
        joint.ravel(),
    )


@pytest.mark.parametrize("radius_mm", [8.0, 15.0, 30.0])
@pytest.mark.parametrize("sensed_deg", [0.2, 1.0])
def test_curvature_that_jumps_between_two_touches_keeps_its_coverage(radius_mm, sensed_deg):
    """Where an arc goes over into a line, sigmas hold on both sides, and no normal gets worse."""
    touch, outward, contour, order, joint = stadiums(radius_mm * 1e-3)
    sigma = np.deg2rad(sensed_deg)
    contacts = noisy(touch, outward, contour, order, sensed=sigma)
    smoothed = smooth_normals(contacts, closed=np.ones(60, dtype=bool), touch_sigma=TOUCH)
    error, before = errors(smoothed, outward), np.abs(wrap_angle(contacts.outward - outward))
    near = joint < 5e-3
    # Some 480 contacts lie within a step of a joint: three deviations of a share of 0.95 are 0.03.
    assert near.sum() > 400
    assert np.mean(error[near] < 1.96 * smoothed.sigma[near]) > 0.92
    assert np.mean(error[near] ** 2) < np.mean(before[near] ** 2)
    assert np.mean(error[~near] ** 2) < 0.6 * np.mean(before[~near] ** 2)


def test_side_and_end_of_the_beam_are_smoothed_apart():
    """They touch different curves: side contacts get what they get alone, whatever the tips between say."""
    touch, outward, contour, order = ellipses(0.06, 0.06, contours=1)
    contacts = noisy(touch, outward, contour, order)
    tip = (order >= 20) & (order < 30)
    kind = np.where(tip, int(Kind.TIP), int(Kind.SIDE)).astype(np.int8)
    moved = np.where(tip[:, None], contacts.touch * 1.05, contacts.touch)
    mixed = smooth_normals(replace(contacts, kind=kind, touch=moved), touch_sigma=TOUCH)
    for part in (order < 20, tip, order >= 30):
        alone = smooth_normals(replace(contacts, kind=kind, touch=moved).take(part), touch_sigma=TOUCH)
        assert np.allclose(mixed.outward[part], alone.outward, atol=1e-12)
        assert np.allclose(mixed.sigma[part], alone.sigma, rtol=1e-9)


def test_a_lone_corner_contact_keeps_its_sensed_normal():
    """A contact on an arc that is much shorter than the steps keeps the sensed normal, or one as sharp."""
    touch, outward, contour, order, arc = squares(1e-3)
    contacts = noisy(touch, outward, contour, order)
    smoothed = smooth_normals(contacts, closed=np.ones(30, dtype=bool), touch_sigma=TOUCH)
    kept = arc & (smoothed.neighbours == 0)
    assert kept.sum() > 0.3 * arc.sum() > 10
    assert np.array_equal(smoothed.outward[kept], contacts.outward[kept])
    assert np.array_equal(smoothed.sigma[kept], contacts.sigma_normal[kept])
    assert np.all(smoothed.sigma[arc] <= SENSED * (1.0 + 1e-9))
