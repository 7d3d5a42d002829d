"""The pipeline from end to end: the result folder, its figures, and the same contacts from its log."""

from __future__ import annotations

import json
from dataclasses import fields

import numpy as np
import pytest

from contour import __version__, cloud, scan, shapes
from contour.cli import OK, main
from contour.contacts import Contacts
from contour.errors import UsageError
from contour.evaluate import ERROR_FIGURES
from contour.ladder import Rung
from contour.scan import Job, prepare, replay, run
from contour.scene import STRATEGIES as SCENE_STRATEGIES
from contour.scene import load_scene
from contour.strategy import STRATEGIES, make_strategy
from contour.trace import Status, Trace

SCENE = """
[[object]]
mesh = "ball.ply"
friction_angle_deg = 17
[scan]
seed = 3
[plan]
family = "silhouettes"
directions = [[0, 1, 0]]
step_mm = 40
"""
METRICS = {
    "contacts",
    "flagged",
    "pushes_per_contact",
    "s_error_rms_rel",
    "point_error_rms_m",
    "point_error_p99_m",
    "normal_error_median_rad",
    "normal_error_p95_rad",
    "coverage_95",
    "silently_wrong",
    "rays_cast",
    "scan_s",
    "contacts_per_s",
    "machine_time_s",
    "rungs",
}
COLUMNS = [
    *("id", "contour", "x_m", "y_m", "z_m", "nx", "ny", "nz", "s_m", "sigma_s_m", "sigma_normal_rad"),
    *("pushes", "kind", "flags", "machine_time_s"),
]
FILES = {
    "contacts.csv",
    "points.ply",
    "points.vtp",
    "readings.npz",
    "log.jsonl",
    "run.json",
    "metrics.json",
}


@pytest.fixture(scope="module")
def scene_file(tmp_path_factory):
    """A ball of 120 mm and a scene with one contour round it."""
    folder = tmp_path_factory.mktemp("scene")
    shapes.write_mesh(folder / "ball.ply", shapes.load("sphere").mesh(), "ball")
    (folder / "ball.toml").write_text(SCENE, encoding="utf-8")
    return folder / "ball.toml"


@pytest.fixture(scope="module")
def results(scene_file, tmp_path_factory):
    """The folder of one scan with the default strategy, made by the command line."""
    folder = tmp_path_factory.mktemp("results") / "ball"
    assert main(["scan", str(scene_file), "--out", str(folder)]) == OK
    return folder


@pytest.fixture(scope="module")
def quick(scene_file):
    """The same scene with a strategy that takes no time."""
    return prepare(load_scene(scene_file, strategy="one-push"))


def _events(folder):
    return [json.loads(line) for line in (folder / "log.jsonl").read_text(encoding="utf-8").splitlines()]


def test_a_scan_writes_its_whole_folder(results):
    """All files, picture and report too, and none half-written beside them."""
    assert {path.name for path in results.iterdir()} == FILES | {"view.png", "report.html"}


def test_metrics_have_all_figures(results):
    """Every figure by its name, with values that fit each other."""
    metrics, columns = cloud.read_json(results / "metrics.json"), cloud.read_csv(results / "contacts.csv")
    assert set(metrics) >= METRICS
    n = columns["id"].size
    assert metrics["contacts"] == n > 8
    assert metrics["flagged"] == np.count_nonzero(columns["flags"])
    assert metrics["pushes_per_contact"] == pytest.approx(columns["pushes"].mean())
    assert set(metrics["rungs"]) == {rung.name.lower() for rung in Rung}
    assert sum(metrics["rungs"].values()) == n
    assert metrics["rays_cast"] > 0
    assert metrics["contacts_per_s"] == pytest.approx(n / metrics["scan_s"])
    assert metrics["machine_time_s"] >= columns["machine_time_s"].sum() > 0.0


def test_figures_follow_from_the_table(results):
    """Errors computed anew from the columns and the true ones beside them."""
    metrics, columns = cloud.read_json(results / "metrics.json"), cloud.read_csv(results / "contacts.csv")
    assert list(columns)[: len(COLUMNS)] == COLUMNS
    good = columns["flags"] == 0
    assert good.any()
    off = (columns["s_m"] - columns["true_s_m"])[good]
    assert metrics["s_error_rms_rel"] == pytest.approx(
        np.sqrt(np.mean((off / columns["true_s_m"][good]) ** 2))
    )
    covered = np.abs(off) <= 1.96 * columns["sigma_s_m"][good]
    assert metrics["coverage_95"] == pytest.approx(covered.mean())
    apart = [columns[f"true_{axis}"] - columns[axis] for axis in ("x_m", "y_m", "z_m")]
    apart = np.linalg.norm(apart, axis=0)[good]
    assert metrics["point_error_rms_m"] == pytest.approx(np.sqrt(np.mean(apart**2)))


def test_contacts_lie_on_the_ball(results):
    """Every true point is on the surface; the sensed ones of good contacts are near it, normals pointing outwards."""
    columns = cloud.read_csv(results / "contacts.csv")
    radius = 0.06
    true = np.column_stack([columns[f"true_{axis}"] for axis in ("x_m", "y_m", "z_m")])
    sensed = np.column_stack([columns[axis] for axis in ("x_m", "y_m", "z_m")])
    normal = np.column_stack([columns[axis] for axis in ("nx", "ny", "nz")])
    np.testing.assert_allclose(np.linalg.norm(true, axis=1), radius, atol=0.1e-3)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-9)
    good = columns["flags"] == 0
    np.testing.assert_allclose(np.linalg.norm(sensed, axis=1)[good], radius, atol=1e-3)
    assert np.all(np.sum(normal * sensed, axis=1)[good] > 0.0)


def test_the_run_is_recorded(results):
    """Versions, seed and every number of the scene in SI."""
    record = cloud.read_json(results / "run.json")
    assert record["versions"]["contour"] == __version__
    assert {"python", "numpy", "scipy", "trimesh", "embreex"} <= set(record["versions"])
    assert record["seed"] == 3
    assert record["scene"]["antenna"]["beam"]["length"] == 0.21
    assert record["scene"]["plan"]["step"] == pytest.approx(0.04)
    assert record["scene"]["objects"][0]["friction_angle"] == pytest.approx(np.deg2rad(17.0))
    assert set(record) == {"versions", "commit", "seed", "scene"}


def test_the_log_tells_every_call_flag_and_contour(results):
    """Counts of the events agree with the table and the metrics."""
    events, columns = _events(results), cloud.read_csv(results / "contacts.csv")
    kinds = {"approach", "push", "release", "zero", "flagged", "contour"}
    assert {event["event"] for event in events} <= kinds
    calls = [event for event in events if "call" in event]
    assert [event["call"] for event in calls] == list(range(len(calls)))
    pushes = [event for event in events if event["event"] == "push"]
    assert sum(event["contours"] for event in pushes) == columns["pushes"].sum()
    assert all(e["stop_angle"] + e["stop_moment"] + e["stop_watch"] == e["contours"] for e in pushes)
    for event in events:
        if event["event"] == "approach":
            assert (
                sum(event[name] for name in ("found", "not_found", "touching", "blocked"))
                == event["contours"]
            )
    flagged = [event["contact"] for event in events if event["event"] == "flagged"]
    np.testing.assert_array_equal(flagged, np.flatnonzero(columns["flags"]))
    contours = [event for event in events if event["event"] == "contour"]
    assert [event["status"] for event in contours] == ["closed"]
    assert contours[0]["contacts"] == columns["id"].size


def test_the_log_replayed_gives_the_same_contacts(results, scene_file):
    """Bit for bit, every column of the table."""
    contacts, trace = replay(prepare(load_scene(scene_file)), results / "readings.npz")
    assert contacts is not None
    columns = cloud.read_csv(results / "contacts.csv")
    for name, values in cloud.table(contacts).items():
        np.testing.assert_array_equal(values, columns[name], err_msg=name)
    assert trace.status[0] == Status.CLOSED


def test_points_lie_over_the_mesh(results):
    """They are in its unit, which the header names: millimetres here, metres in the table."""
    points, unit = cloud.read_ply(results / "points.ply")
    assert unit == "mm"
    np.testing.assert_allclose(points["x"], 1e3 * cloud.read_csv(results / "contacts.csv")["x_m"], rtol=1e-12)
    assert "109 109 0" in (results / "points.vtp").read_text(encoding="utf-8")  # "mm" in ASCII, ended by zero


def test_smoothed_normals_stand_beside_the_sensed_ones(results):
    """Unit vectors within Pi, at most a few of their sigmas off the ball's, and figures for them."""
    columns, metrics = cloud.read_csv(results / "contacts.csv"), cloud.read_json(results / "metrics.json")
    smooth = np.column_stack([columns[f"smooth_n{axis}"] for axis in "xyz"])
    np.testing.assert_allclose(np.linalg.norm(smooth, axis=1), 1.0, atol=1e-9)
    np.testing.assert_allclose(smooth[:, 1], 0.0, atol=1e-9)  # the beam lies along y
    true = np.column_stack([columns[f"true_{axis}"] for axis in ("nx", "ny", "nz")])
    true[:, 1] = 0.0
    off = np.arccos(np.clip(np.sum(smooth * true, axis=1) / np.linalg.norm(true, axis=1), -1.0, 1.0))
    good = columns["flags"] == 0
    assert metrics["smooth_normal_error_median_rad"] == pytest.approx(np.median(off[good]), rel=0.05)


def test_the_seed_decides(quick, tmp_path):
    """The same seed gives the same table bit for bit, another one another."""
    tables = []
    for number, seed in enumerate((3, 3, 4)):
        scene = quick.scene
        machine = type(scene.machine)(seed=seed)
        job = Job(
            scene=type(scene)(
                **{f.name: getattr(scene, f.name) for f in fields(scene)} | {"machine": machine}
            ),
            environment=quick.environment,
            plan=quick.plan,
        )
        run(job, tmp_path / str(number))
        tables.append((tmp_path / str(number) / "contacts.csv").read_bytes())
    assert tables[0] == tables[1]
    assert tables[0] != tables[2]


def test_metrics_are_written_last(quick, tmp_path, monkeypatch):
    """When they appear all else is there; a scan that fails while writing leaves none."""
    write, seen = cloud.write_json, {}

    def watched(path, values):
        seen[path.name] = {other.name for other in path.parent.iterdir()}
        write(path, values)

    monkeypatch.setattr(cloud, "write_json", watched)
    run(quick, tmp_path / "one")
    assert seen["metrics.json"] == FILES - {"metrics.json"}

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(cloud, "write_vtp", full)
    with pytest.raises(OSError, match="No space"):
        run(quick, tmp_path / "two")
    assert not (tmp_path / "two" / "metrics.json").exists()


def test_a_scan_that_finds_nothing_says_so(quick, tmp_path, monkeypatch):
    """No contacts: an empty table with its header, and figures without values; no key is missing."""
    trace = Trace(
        status=np.full(1, np.int8(Status.LOST)),
        contacts=np.zeros(1, dtype=np.int64),
        approaches=np.zeros(1, dtype=np.int64),
        reason=("nothing found",),
    )
    monkeypatch.setattr(scan, "follow", lambda *_, **__: (None, trace))
    metrics = run(quick, tmp_path / "none")
    assert {path.name for path in (tmp_path / "none").iterdir()} == FILES
    assert set(metrics) >= METRICS
    assert metrics["contacts"] == 0
    assert all(metrics[name] is None for name in ERROR_FIGURES)
    columns = cloud.read_csv(tmp_path / "none" / "contacts.csv")
    assert list(columns)[: len(COLUMNS)] == COLUMNS
    assert columns["id"].size == 0
    assert _events(tmp_path / "none")[-1]["ended"] == "nothing found"


def test_progress_grows_to_the_end(quick, tmp_path):
    """Contacts and the share of the work rise, to all of it; the contour counts as it is followed."""
    told = []
    run(quick, tmp_path / "told", progress=lambda contacts, share: told.append((contacts, share)))
    contacts, share = np.array(told).T
    assert np.all(np.diff(contacts) > 0)
    assert np.all(np.diff(share) >= 0.0)
    assert 0.0 < share[0] < 0.5
    assert share[-1] == 1.0


def test_bodies_stand_where_the_scene_puts_them(scene_file):
    """Two copies of one mesh: each in its place, turned, with its own friction."""
    path = scene_file.with_name("two.toml")
    path.write_text(
        '[[object]]\nmesh = "ball.ply"\nfriction_angle_deg = 5\n'
        '[[object]]\nmesh = "ball.ply"\nposition_mm = [300, 0, 10]\nrotation_deg = [0, 0, 45]\n',
        encoding="utf-8",
    )
    environment = prepare(load_scene(path)).environment
    path.unlink()
    np.testing.assert_allclose(environment.friction, np.tan(np.deg2rad([5.0, 10.0])))
    # The geodesic ball is not quite symmetric: its bounds lie up to 0.1 mm inside those of the sphere.
    np.testing.assert_allclose(environment.bounds, [[-0.06, -0.06, -0.06], [0.36, 0.06, 0.07]], atol=1e-4)
    assert np.count_nonzero(environment.body == 0) == np.count_nonzero(environment.body == 1)


def test_preparing_writes_nothing(scene_file):
    """The outlook of a dry run: contours, step, size of the object, strategy."""
    before = sorted(scene_file.parent.iterdir())
    outlook = prepare(load_scene(scene_file)).outlook()
    assert outlook["contours"] == 1
    assert outlook["step_m"] == pytest.approx(0.04)
    np.testing.assert_allclose(outlook["extent_m"], 0.12, atol=1e-3)
    assert sorted(scene_file.parent.iterdir()) == before


@pytest.mark.parametrize("name", STRATEGIES)
def test_every_strategy_has_the_name_it_is_asked_by(name, quick):
    """Made by name, for any number of contours; scene files know the same names."""
    made = make_strategy(name, 7, quick.scene.antenna, quick.scene.mount)
    assert made.name == name
    assert set(STRATEGIES) == set(SCENE_STRATEGIES)


def test_unknown_strategies_are_refused_by_name(quick):
    """The message lists those there are."""
    with pytest.raises(UsageError, match="strategy 'modle' is not known: use one of model, "):
        make_strategy("modle", 1, quick.scene.antenna, quick.scene.mount)


def test_the_commit_is_found_without_git(tmp_path):
    """A branch's own file, packed refs, a detached head, and no repository at all."""
    assert scan._commit(tmp_path) is None
    git = tmp_path / ".git"
    (git / "refs" / "heads").mkdir(parents=True)
    (git / "HEAD").write_text("ref: refs/heads/main\n")
    assert scan._commit(tmp_path) is None
    (git / "packed-refs").write_text("# pack-refs\naaaa refs/heads/other\nbbbb refs/heads/main\n")
    assert scan._commit(tmp_path) == "bbbb"
    (git / "refs" / "heads" / "main").write_text("cccc\n")
    assert scan._commit(tmp_path) == "cccc"
    (git / "HEAD").write_text("dddd\n")
    assert scan._commit(tmp_path) == "dddd"


def test_no_contacts_make_no_truth(quick):
    """Nothing observed is an empty truth, not a failure."""
    instrument = scan.MeshInstrument(
        quick.environment,
        antennas=1,
        antenna=quick.scene.antenna,
        machine=quick.scene.machine,
        mount=quick.scene.mount,
    )
    truth, rungs = scan.Observed(instrument).truth()
    assert truth.point.shape == (0, 3)
    assert rungs.size == len(Contacts.none()) == 0
