"""The tracer on analytic outlines: it closes, passes corners, ends where it must, and never goes on for ever."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from planar_bench import (
    EDGE,
    PlanarBench,
    circle,
    ellipse,
    follow,
    make_contacts,
    plane_plan,
    polygon,
    rounded_box,
    union,
)

from contour.antenna import Antenna
from contour.contacts import Flag
from contour.errors import UsageError
from contour.frames import Mount, wrap_angle
from contour.machine import MachineModel
from contour.mesh_env import MeshEnvironment
from contour.mesh_instrument import MeshInstrument
from contour.plan import Reach, default_plan
from contour.tracing import Status, Tracer, TraceSettings
from contour.truth import truth_of

STEP = 5e-3
"""Of most tests [m]."""
SMOOTH = {"large": circle(0.06), "small": circle(0.015), "ellipse": ellipse(0.06, 0.03)}
L_SHAPE = polygon([[-0.05, -0.05], [0.05, -0.05], [0.05, 0.01], [0.01, 0.01], [0.01, 0.05], [-0.05, 0.05]])
CORNERED = {
    "round corners": rounded_box([0.05, 0.05], 0.005),
    "nearly sharp": rounded_box([0.05, 0.05], 0.001),
    "sharp": rounded_box([0.05, 0.05]),
    "L": L_SHAPE,
    "fin, its side first": rounded_box([0.0002, 0.04]),
    "fin, its end first": rounded_box([0.04, 0.0002], centre=(0.0, 0.003)),
    "groove": polygon(
        [[-0.06, -0.06], [0.06, -0.06], [0.06, 0], [0.006, 0], [0, -0.04], [-0.006, 0], [-0.06, 0]]
    ),
    "wedge": polygon([[0, 0.003], [-0.08, 0.014], [-0.08, -0.008]]),
    "star": polygon(
        [
            ((0.06, 0.025)[k % 2] * np.cos(k * np.pi / 5), (0.06, 0.025)[k % 2] * np.sin(k * np.pi / 5))
            for k in range(10)
        ]
    ),
}


def outline(shape, radius, count=500):
    """(count, 2) m, points of a star-shaped dilated outline about the origin."""
    angle = 2.0 * np.pi * np.arange(count) / count
    ray = np.column_stack((np.cos(angle), np.sin(angle)))
    low, high = np.zeros(count), np.full(count, 0.2)
    for _ in range(30):
        middle = 0.5 * (low + high)
        inside = shape(middle[:, None] * ray) < radius
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    return high[:, None] * ray


def largest_gap(points, touches):
    """The farthest that any of ``points`` lies from the nearest touch [m]."""
    return np.linalg.norm(points[:, None] - touches, axis=2).min(axis=1).max()


@pytest.mark.parametrize("name", SMOOTH)
def test_smooth_outlines_close_at_one_approach_a_contact(name):
    """Nothing is missed or blocked on a smooth outline, and contacts lie one step apart."""
    bench = PlanarBench(plane_plan(1, STEP), [SMOOTH[name]], Antenna(), normal_sigma=np.deg2rad(0.5))
    contacts, trace, _ = follow(bench)
    points = outline(SMOOTH[name], bench.antenna.beam.radius)
    perimeter = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    assert trace.status[0] == Status.CLOSED
    assert trace.approaches[0] <= 1.02 * len(contacts)
    # Steps run along the tangent: the chord is a little longer, or shorter where the outline curves over 20 deg.
    assert 0.85 * perimeter / STEP < len(contacts) < 1.35 * perimeter / STEP + 2
    # Half a step to the nearest contact, and what the closing link may leave.
    assert largest_gap(points, contacts.touch) < 0.75 * STEP


@pytest.mark.parametrize("name", CORNERED)
@pytest.mark.parametrize("noise_deg", [0.0, 1.5])
def test_corners_fins_and_grooves_are_passed(name, noise_deg):
    """Outlines with convex and concave corners close, at few approaches beyond one a contact."""
    bench = PlanarBench(plane_plan(1, STEP), [CORNERED[name]], Antenna(), normal_sigma=np.deg2rad(noise_deg))
    contacts, trace, _ = follow(bench)
    assert trace.status[0] == Status.CLOSED
    assert trace.approaches[0] <= 1.2 * len(contacts)
    # All touches lie on the outline, within the bench's edge and the noise-free position.
    gap = bench.gap(contacts.which, contacts.touch)
    assert np.all((gap > 0.0) & (gap <= EDGE))


@pytest.mark.parametrize("name", ["round corners", "nearly sharp", "sharp", "L", "star"])
def test_no_stretch_of_a_cornered_outline_is_skipped(name):
    """Every point of the outline has a contact within about a step, the insides of corners too."""
    bench = PlanarBench(plane_plan(1, STEP), [CORNERED[name]], Antenna())
    contacts, _, _ = follow(bench)
    # A corner may fall between a contact 1 step before it and one 0.4 steps below it; a concave one is cut by h.
    assert largest_gap(outline(CORNERED[name], bench.antenna.beam.radius), contacts.touch) < 1.1 * STEP


@pytest.mark.parametrize("radius_mm", [0.2, 0.5, 1.0, 2.0, 4.0])
def test_rods_thinner_than_a_step_are_gone_round(radius_mm):
    """Steps shorten until a thin rod is followed; no more than 75 deg of it is left out."""
    shape = circle(radius_mm * 1e-3)
    plan = plane_plan(1, STEP, size=0.02, start=[[-0.02, 0.0001]])
    contacts, trace, _ = follow(PlanarBench(plan, [shape], Antenna()))
    angle = np.sort(np.mod(contacts.outward, 2.0 * np.pi))
    assert trace.status[0] == Status.CLOSED
    assert np.max(np.diff(angle, append=angle[0] + 2.0 * np.pi)) < np.deg2rad(75.0)
    assert trace.approaches[0] < 40


def test_a_wire_thinner_than_the_look_below_is_found_by_shorter_steps():
    """Walking round with the first step passes beneath the wire: steps shorten until they do not."""
    plan = plane_plan(1, 2.0 * STEP, size=0.02, start=[[-0.02, 0.0001]])
    contacts, trace, _ = follow(PlanarBench(plan, [circle(1e-4)], Antenna()))
    assert trace.status[0] == Status.CLOSED
    assert len(contacts) >= 4


@pytest.mark.parametrize("name", ["fin, its side first", "fin, its end first"])
def test_both_sides_of_a_thin_fin_are_followed_to_its_ends(name):
    """A fin of 0.4 mm is thinner than what passes for the same place: its normals tell its sides apart."""
    bench = PlanarBench(plane_plan(1, STEP), [CORNERED[name]], Antenna())
    contacts, _, _ = follow(bench)
    long_axis = int(np.argmax(np.ptp(contacts.touch, axis=0)))
    across = np.column_stack((np.cos(contacts.outward), np.sin(contacts.outward)))[:, 1 - long_axis]
    for side in (-1.0, 1.0):
        reach = np.sort(contacts.touch[side * across > 0.9, long_axis])
        # At one end up to a step is left, at the other the quarter that walking round goes back as well.
        assert np.ptp(reach) > 0.08 - 2.25 * STEP
        assert np.diff(reach).max() < 1.2 * STEP


@pytest.mark.parametrize("seed", range(3))
def test_a_narrow_groove_is_left_again(seed):
    """At the bottom of a groove of 15 deg the gap is narrower than the clearance: it still comes out beyond it."""
    h, x = 0.04, 0.04 * np.tan(np.deg2rad(7.5))
    groove = polygon([[-0.06, -0.06], [0.06, -0.06], [0.06, 0], [x, 0], [0, -h], [-x, 0], [-0.06, 0]])
    plan = plane_plan(1, STEP, start=[[-0.2, -0.03]])
    contacts, trace, _ = follow(
        PlanarBench(plan, [groove], Antenna(), normal_sigma=np.deg2rad(1.0), seed=seed)
    )
    top = contacts.touch[contacts.touch[:, 1] > 0.0, 0]
    assert trace.reason[0] == "closed"
    assert np.count_nonzero(top < -x) > 5
    assert np.count_nonzero(top > x) > 5


def test_no_contour_is_longer_than_its_box_explains():
    """The bound on the number of contacts ends a contour and says so."""
    plan = plane_plan(1, STEP)
    contacts, trace, _ = follow(PlanarBench(plan, [circle(0.08)], Antenna()), TraceSettings(turns=0.2))
    # The bound is rounded up.
    assert len(contacts) == pytest.approx(12 + 0.2 * 0.8 / STEP, abs=1.0)
    assert trace.status[0] == Status.LOST
    assert "more contacts than" in trace.reason[0]


def test_small_arcs_of_corners_get_contacts():
    """On corners of 5 mm radius, followed at steps of 5 mm, contacts fall on the arcs themselves."""
    bench = PlanarBench(plane_plan(1, STEP), [CORNERED["round corners"]], Antenna())
    contacts, _, _ = follow(bench)
    off_axis = np.abs(wrap_angle(4.0 * contacts.outward)) > 0.05
    assert np.count_nonzero(off_axis) >= 8


def open_bench(**limits):
    """A box that the gantry reaches only above z = -20 mm."""
    lower = np.array([-np.inf, limits.get("y", -np.inf), -0.02, -np.inf, -np.inf])
    plan = plane_plan(1, STEP, reach=Reach(lower=lower, upper=np.full(5, np.inf)))
    return PlanarBench(plan, [rounded_box([0.05, 0.05], 0.002)], Antenna())


def test_a_body_that_goes_out_of_reach_is_followed_both_ways():
    """From the first contact both ways to the limit, never beyond it, and in order along the outline."""
    contacts, trace, _ = follow(open_bench())
    assert trace.status[0] == Status.ENDED
    assert contacts.touch[:, 1].min() >= -0.02
    # Both sides down to within a step and a clearance of the limit.
    for side in (-1.0, 1.0):
        on_side = side * contacts.touch[:, 0] > 0.05
        assert contacts.touch[on_side, 1].min() < -0.02 + 1.4 * STEP
    order = np.argsort(contacts.sequence)
    assert np.array_equal(contacts.sequence[order], np.arange(len(contacts)))
    # Neighbours in sequence are neighbours on the outline: nothing jumps from one way to the other.
    assert np.linalg.norm(np.diff(contacts.touch[order], axis=0), axis=1).max() < 1.2 * STEP


def test_without_room_to_withdraw_one_way_is_all():
    """The tracer does not cross the object to get back: it says why it ends."""
    _, trace, _ = follow(open_bench(y=-0.2))
    assert trace.status[0] == Status.ENDED
    assert "no room to withdraw" in trace.reason[0]


def test_a_return_withdraws_before_it_moves_aside():
    """On the way back to the first contact the beam moves within Pi only when clear of the object's box."""
    bench = open_bench()
    tracer = Tracer(bench.plan, bench.mount, bench.antenna)
    legs, stood = [], np.zeros(2)
    while tracer.active.size:
        move = tracer.ask()
        if move.pose[0, 1] < bench.plan.level[0] - 1e-6 and not any(
            p[1] < bench.plan.level[0] - 1e-6 for p, _ in legs
        ):
            stood = tracer._position[0].copy()
        reading = bench.approach(*move)
        rows = tracer.touched(reading)
        legs.append((move.pose[0, :3].copy(), rows.size))
        if rows.size:
            tracer.tell(bench.localise(reading.which[rows]))
            bench.release(reading.which[rows], tracer.clearance(reading.which[rows]))
    depth = np.array([pose[1] for pose, _ in legs])
    away = np.flatnonzero(depth < bench.plan.level[0] - 1e-6)
    lift, over = away
    tip = depth[away] + bench.antenna.beam.length
    assert np.all(tip < bench.plan.near[0])
    # The first leg leaves from where the antenna stood.
    assert np.allclose(legs[lift][0][[0, 2]], stood, atol=1e-9)
    # The last leg comes down where the second one went to: along the beam only.
    assert np.allclose(legs[over][0][[0, 2]], legs[over + 1][0][[0, 2]], atol=2e-4)
    assert depth[over + 1] == pytest.approx(bench.plan.level[0])


def test_a_first_contact_on_an_outline_followed_before_ends_the_contour():
    """Two bodies, three lines of one plane: two outlines, and the third line finds one of them again."""
    shape = union(circle(0.02, (-0.04, 0.0)), circle(0.02, (0.04, 0.0)))
    plan = plane_plan(
        3, STEP, start=[[-0.1, 0.0], [0.1, 0.0], [-0.04, 0.1]], heading=[[1, 0], [-1, 0], [0, -1]]
    )
    contacts, trace, _ = follow(
        PlanarBench(replace(plan, plane=np.zeros(3, dtype=np.int64)), [shape] * 3, Antenna())
    )
    assert trace.status.tolist() == [Status.CLOSED, Status.CLOSED, Status.DUPLICATE]
    assert trace.contacts[2] == 0
    for i, centre in enumerate((-0.04, 0.04)):
        assert np.allclose(np.abs(contacts.touch[contacts.which == i, 0] - centre) < 0.021, True)


def test_parallel_lines_find_what_the_first_one_misses():
    """A small body off the middle of its box is found; an empty box is given up with its reason."""
    shapes = [circle(0.006, (0.01, 0.035)), circle(0.005, (0.0, 0.5))]
    _, trace, _ = follow(PlanarBench(plane_plan(2, STEP, size=0.1), shapes, Antenna()))
    assert trace.status.tolist() == [Status.CLOSED, Status.LOST]
    assert trace.reason[1] == "no contact"
    assert trace.contacts[1] == 0


class Unreliable(PlanarBench):
    """One contact in eight is flagged, its normal anywhere; every fourth of those felt nothing."""

    def localise(self, which):
        """As the bench's, but worse."""
        good = super().localise(which)
        draw = self.rng.random(which.size)
        flags = np.where(draw < 0.03, int(Flag.LOST), np.where(draw < 0.12, int(Flag.UNRESOLVED), 0))
        outward = np.where(flags > 0, self.rng.uniform(-np.pi, np.pi, which.size), good.outward)
        return make_contacts(which, good.touch, outward, sigma=0.01, order=good.sequence, flags=flags)


def test_flagged_contacts_do_not_steer():
    """With normals of flagged contacts pointing anywhere, all outlines still close."""
    shapes = [*SMOOTH.values(), *(CORNERED[k] for k in ("round corners", "sharp", "L", "star"))] * 4
    _, trace, _ = follow(Unreliable(plane_plan(len(shapes), STEP), shapes, Antenna(), seed=5))
    assert np.all(trace.status == Status.CLOSED)


def test_every_contour_ends_even_where_each_normal_is_wrong():
    """Unflagged nonsense cannot make the tracer go on for ever."""
    shapes = list(CORNERED.values())
    bench = PlanarBench(plane_plan(len(shapes), STEP), shapes, Antenna(), normal_sigma=1.0)
    contacts, trace, _ = follow(bench)
    assert np.all(trace.status >= Status.CLOSED)
    # The bound that the box gives: 4 perimeters of 0.8 m and 12 more.
    assert np.bincount(contacts.which).max() <= 12 + 4 * 0.8 / STEP


def test_random_polygons_close():
    """Star polygons with spikes and notches of any angle, sharp or rounded: every one closes, at few extra moves."""
    rng = np.random.default_rng(0)
    shapes = []
    for _ in range(16):
        k = int(rng.integers(3, 12))
        angle = (np.arange(k) + rng.uniform(0.0, 0.8, k)) * 2.0 * np.pi / k
        reach = rng.uniform(0.015, 0.08, k)[:, None]
        rounding = float(rng.choice([0.0, 0.002]))
        body = polygon(reach * np.column_stack((np.cos(angle), np.sin(angle))))
        shapes.append(lambda p, body=body, rounding=rounding: body(p) - rounding)
    bench = PlanarBench(plane_plan(len(shapes), STEP), shapes, Antenna(), normal_sigma=np.deg2rad(0.7))
    contacts, trace, _ = follow(bench)
    assert np.all(trace.status == Status.CLOSED)
    assert trace.approaches.sum() < 1.15 * len(contacts)


def test_expected_normals_cover_the_true_ones():
    """Priors of contacts with neighbours hold: about 95 % within 1.96 sigma, and they are useful."""
    shapes = [SMOOTH["large"], SMOOTH["ellipse"], CORNERED["round corners"], CORNERED["nearly sharp"]] * 8
    bench = PlanarBench(plane_plan(len(shapes), STEP), shapes, Antenna(), normal_sigma=np.deg2rad(0.5))
    _, _, priors = follow(bench)
    fresh = np.concatenate([prior.fresh for _, prior, _ in priors])
    error = np.concatenate([wrap_angle(true - prior.outward) for _, prior, true in priors])
    sigma = np.concatenate([prior.sigma for _, prior, _ in priors])
    known = ~fresh
    # Some 2500 priors: one deviation of the share is 0.5 %; a tenth of the errors are corners' heavy tails.
    assert np.mean(np.abs(error[known]) < 1.96 * sigma[known]) > 0.93
    assert np.median(np.abs(error[known])) < np.deg2rad(0.7)
    assert np.median(sigma[known]) < np.deg2rad(3.0)
    # Corners by themselves, where sigmas must grow with the change that the chords see.
    cornered = known & np.concatenate([which % 4 >= 2 for which, _, _ in priors])
    assert np.mean(np.abs(error[cornered]) < 1.96 * sigma[cornered]) > 0.95
    # In units of sigma: without that growth it is 1.5, with errors of 10 sigma where arcs begin.
    assert np.sqrt(np.mean((error[cornered] / sigma[cornered]) ** 2)) < 1.15
    # Fresh ones: first contacts, and those beyond corners; the side is right.
    assert np.all(np.abs(error[fresh]) < 0.5 * np.pi)
    assert fresh.mean() < 0.1


def test_releases_stay_on_the_way_that_was_come():
    """A touch after 0.3 mm is released by no more than that: behind the start there may be something."""
    bench = PlanarBench(plane_plan(1, STEP), [circle(0.06)], Antenna())
    tracer = Tracer(bench.plan, bench.mount, bench.antenna)
    reading = replace(bench.approach(*tracer.ask()), travel=np.array([3e-4]))
    rows = tracer.touched(reading)
    tracer.tell(bench.localise(reading.which[rows]))
    assert tracer.clearance(reading.which[rows])[0] == pytest.approx(3e-4)


def test_lockstep_changes_nothing():
    """A contour followed alone makes the same contacts as among others."""
    shapes = [CORNERED["L"], SMOOTH["ellipse"], CORNERED["sharp"]]
    together, _, _ = follow(PlanarBench(plane_plan(3, STEP), shapes, Antenna()))
    for i, shape in enumerate(shapes):
        alone, _, _ = follow(PlanarBench(plane_plan(1, STEP), [shape], Antenna()))
        assert np.allclose(together.touch[together.which == i], alone.touch, atol=1e-12)


def test_settings_that_cannot_work_are_refused_by_name():
    """Zero shares, and steps that could never grow back."""
    with pytest.raises(UsageError, match="tracing clearance"):
        TraceSettings(clearance=0.0)
    with pytest.raises(UsageError, match="tracing growth"):
        TraceSettings(growth=1.0)


@pytest.mark.slow
@pytest.mark.parametrize("body", ["cylinder", "torus", "box"])
def test_default_plans_close_on_meshes(body):
    """With the simulated instrument's approaches on meshes: nearly all contours close, at few extra moves."""
    make = {
        "cylinder": lambda: trimesh.creation.cylinder(radius=0.05, height=0.12, sections=128),
        "torus": lambda: trimesh.creation.torus(0.06, 0.02, major_sections=96, minor_sections=48),
        "box": lambda: trimesh.creation.box((0.16, 0.12, 0.1)),
    }
    environment = MeshEnvironment(make[body]())
    antenna, mount = Antenna(), Mount.identity()
    plan = default_plan(environment.bounds, antenna, mount)
    instrument = MeshInstrument(
        environment, antennas=plan.contours, antenna=antenna, machine=MachineModel(seed=1), mount=mount
    )
    tracer = Tracer(plan, mount, antenna)
    order = np.zeros(plan.contours, dtype=np.int64)
    while tracer.active.size:
        reading = instrument.approach(*tracer.ask())
        rows = tracer.touched(reading)
        if rows.size:
            which = reading.which[rows]
            truth, _ = truth_of(instrument, which)
            axes = mount.rotation_world_sensor(reading.pose[rows])[:, :, [0, 2]]
            touch = np.einsum("nj,njk->nk", mount.position_world(reading.pose[rows]), axes)
            tracer.tell(make_contacts(which, touch, truth.outward, sigma=5e-3, order=order[which].copy()))
            order[which] += 1
            instrument.release(which, tracer.clearance(which))
    trace = tracer.summary()
    # Where a tip meets a sharp rim its normal may be that of either face: a contour in fifty may end there.
    assert np.mean(trace.status == Status.CLOSED) >= 0.95
    assert trace.approaches.sum() < 1.15 * trace.contacts.sum()
