"""What follows a scan: surface and comparison in the folder and its metrics, and scans that lose nothing."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
import trimesh
from made_runs import PLACE, write_ball_run

from contour import cloud, finish, shapes
from contour.cli import OK, WRONG_USAGE, main
from contour.contacts import Flag
from contour.finish import COMPARISON_FILE, compare_to, finishing
from contour.results import load_run, load_surface
from contour.scan import prepare, run
from contour.scene import SURFACES, load_scene
from contour.surface import METHODS

SCENE = """
[[object]]
mesh = "ball.ply"
position_mm = [50, 20, 10]
[scan]
strategy = "one-push"
[plan]
contours = 6
step_mm = 25
"""
SURFACE_KEYS = {"method", "vertices", "faces", "watertight", "touched", "seconds", "notes"}


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    """A few contours round a ball, with the quickest strategy."""
    folder = tmp_path_factory.mktemp("scene")
    shapes.write_mesh(folder / "ball.ply", shapes.load("sphere").mesh(), "ball")
    (folder / "ball.toml").write_text(SCENE, encoding="utf-8")
    return prepare(load_scene(folder / "ball.toml"))


@pytest.fixture(scope="module")
def small(job):
    """The same with a single contour, too little for a surface."""
    path = job.scene.bodies[0].mesh.with_name("small.toml")
    plan = '[plan]\nfamily = "silhouettes"\ndirections = [[0, 1, 0]]\nstep_mm = 40\n'
    path.write_text(SCENE.partition("[plan]")[0] + plan, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def scanned(job, tmp_path_factory):
    """Its result folder and metrics."""
    folder = tmp_path_factory.mktemp("results") / "ball"
    return folder, run(job, folder, finish=finishing(job))


@pytest.fixture
def ball_run(tmp_path):
    """A finished scan without a surface, of many exact contacts."""
    return write_ball_run(tmp_path)


def test_a_scan_ends_with_surface_and_comparison(job, scanned):
    """Both in metrics.json; the surface lies on the ball where the ball is."""
    folder, metrics = scanned
    written = cloud.read_json(folder / "metrics.json")
    assert written == json.loads(json.dumps(metrics))
    assert set(written["surface"]) == SURFACE_KEYS
    surface = load_surface(load_run(folder))
    assert (len(surface.vertices), len(surface.faces)) == (
        written["surface"]["vertices"],
        written["surface"]["faces"],
    )
    assert written["surface"]["watertight"] is surface.watertight is True
    radius = np.linalg.norm(surface.vertices - PLACE, axis=1)
    off = np.abs(radius - 0.06)
    comparison = written["comparison"]
    assert comparison["accuracy_mean_m"] == pytest.approx(off.mean(), rel=0.15)
    assert comparison["accuracy_mean_m"] < 5e-3  # one push a contact is rough
    outward = trimesh.creation.icosphere(subdivisions=5).vertices
    lean = np.rad2deg(np.arcsin(-outward @ job.plan.direction.T))  # all of a ball is in sight at some lean
    share = ((lean > -5.0) & (lean < 48.0)).any(axis=1).mean()
    assert 0.5 < share < 0.9
    assert comparison["reachable_share"] == pytest.approx(share, abs=0.01)
    assert 0.0 < comparison["within_5mm_share"] < 1.0


def test_metrics_are_written_last(small, tmp_path):
    """When what follows a scan begins, all other files are there and metrics.json is not."""
    seen = {}

    def look(folder, columns):
        seen.update({"files": {path.name for path in folder.iterdir()}, "contacts": columns["id"].size})
        return {"looked": 1}

    metrics = run(prepare(load_scene(small)), tmp_path / "out", finish=look)
    assert "metrics.json" not in seen["files"]
    assert seen["files"] >= {
        "contacts.csv",
        "points.ply",
        "points.vtp",
        "readings.npz",
        "run.json",
        "log.jsonl",
    }
    assert seen["contacts"] == metrics["contacts"]
    assert cloud.read_json(tmp_path / "out" / "metrics.json")["looked"] == 1


def test_whatever_goes_wrong_then_the_scan_is_whole(small, tmp_path):
    """An error nobody foresaw is raised, and the folder is a finished scan all the same."""

    def fail(folder, columns):
        raise ZeroDivisionError(folder, columns["id"].size)

    with pytest.raises(ZeroDivisionError):
        run(prepare(load_scene(small)), tmp_path / "out", finish=fail)
    assert load_run(tmp_path / "out").metrics["contacts"] > 0


def _spoilt(columns, how):
    columns = {name: column.copy() for name, column in columns.items()}
    if how == "plane":
        columns["z_m"][:] = 0.01
    elif how == "few":
        columns = {name: column[:7] for name, column in columns.items()}
    elif how == "flagged":
        columns["flags"][:] = int(next(flag for flag in Flag if flag))
    elif how == "none":
        columns = {name: column[:0] for name, column in columns.items()}
    return columns


@pytest.mark.parametrize(
    "how,reason", [("plane", "plane"), ("few", "6 points"), ("flagged", "0 points"), ("none", "0 points")]
)
def test_without_a_surface_the_reason_is_a_note(job, ball_run, tmp_path, how, reason):
    """Contacts on a plane, too few, all flagged, none: no file, no error, one line."""
    out = tmp_path / "out"
    out.mkdir()
    metrics = finishing(job)(out, _spoilt(cloud.read_csv(ball_run / "contacts.csv"), how))
    assert set(metrics) == {"surface"}
    assert set(metrics["surface"]) == {"notes"}
    (note,) = metrics["surface"]["notes"]
    assert note.startswith("no surface: ")
    assert reason in note
    assert "\n" not in note
    assert not list(out.iterdir())


def test_what_cannot_be_compared_is_a_note(job, ball_run, tmp_path):
    """The surface stays where only the comparison fails; here contacts that are 1,000 times too far apart."""
    columns = cloud.read_csv(ball_run / "contacts.csv")
    for axis, middle in zip("xyz", PLACE, strict=True):
        columns[f"{axis}_m"] = 1e3 * (columns[f"{axis}_m"] - middle)
    metrics = finishing(job)(tmp_path, columns)
    assert set(metrics["surface"]) == SURFACE_KEYS
    (note,) = metrics["comparison"]["notes"]
    assert note.startswith("not compared: ")
    assert "not of one object" in note
    assert (tmp_path / finish.SURFACE_FILE).exists()


def test_surface_methods_have_their_names(job, ball_run, tmp_path):
    """Scenes know all methods; none makes none; another is refused by name."""
    assert {*METHODS, "none"} == set(SURFACES)
    scene = job.scene.bodies[0].mesh.with_name("ball.toml")
    columns = cloud.read_csv(ball_run / "contacts.csv")
    for name, made in (("none", None), ("layers", "layers"), ("auto", "hermite")):
        asked = prepare(load_scene(scene, surface=name))
        assert finishing(asked)(tmp_path, columns).get("surface", {}).get("method") == made
    assert main(["scan", str(scene), "--surface", "poison", "--dry-run"]) == WRONG_USAGE


def test_the_command_shows_surface_and_comparison(job, small, tmp_path, capsys, monkeypatch):
    """``contour scan --surface``: tables with units, or the reason; with none there is neither file nor row."""
    monkeypatch.chdir(tmp_path)
    scene = str(job.scene.bodies[0].mesh.with_name("ball.toml"))
    assert main(["scan", scene, "--out", "with"]) == OK
    told = capsys.readouterr().out
    assert "surface: watertight" in told
    assert "comparison: accuracy mean" in told
    assert (tmp_path / "with" / "surface.ply").exists()
    assert main(["scan", str(small), "--out", "few"]) == OK
    assert "surface: note" in capsys.readouterr().out
    assert load_surface(load_run(tmp_path / "few")) is None
    assert main(["scan", str(small), "--out", "without", "--surface", "none"]) == OK
    told = capsys.readouterr().out
    assert "surface: " not in told
    assert "comparison: " not in told
    assert not (tmp_path / "without" / "surface.ply").exists()
    assert "surface" not in cloud.read_json(tmp_path / "without" / "metrics.json")


def test_compare_writes_its_file_and_the_surface(ball_run, capsys):
    """``contour compare MESH RUN``: a table with units, comparison.json, and surface.ply where there was none."""
    mesh = ball_run.parent / "ball.ply"
    before = {path.name: path.read_bytes() for path in ball_run.iterdir()}
    assert main(["compare", str(mesh), str(ball_run)]) == OK
    told = capsys.readouterr().out
    rows = [
        [cell.strip() for cell in line.split("\N{BOX DRAWINGS LIGHT VERTICAL}")] for line in told.splitlines()
    ]
    assert any(row[1:2] == ["accuracy mean"] and row[3] == "mm" for row in rows)
    assert any(row[1:2] == ["within 5mm"] and row[3] == "%" for row in rows)
    written = cloud.read_json(ball_run / COMPARISON_FILE)
    assert written["accuracy_mean_m"] < 0.1e-3
    assert written["mesh"] == str(mesh)
    assert set(written["surface"]) == SURFACE_KEYS
    assert {path.name for path in ball_run.iterdir()} == {*before, COMPARISON_FILE, "surface.ply"}
    assert {name: (ball_run / name).read_bytes() for name in before} == before
    again = compare_to(mesh, ball_run)
    assert again["surface"] == written["surface"]
    assert again["accuracy_mean_m"] == pytest.approx(written["accuracy_mean_m"], rel=1e-3)


def test_any_mesh_may_be_the_nominal_one(ball_run):
    """A ball 2 mm larger in radius, in metres, as OBJ: the scan lies 2 mm inside."""
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.062)
    ball.export(ball_run.parent / "larger.obj")
    found = compare_to(ball_run.parent / "larger.obj", ball_run, unit="m")
    assert found["accuracy_mean_m"] == pytest.approx(2e-3, abs=0.05e-3)
    assert found["completeness_mean_m"] == pytest.approx(2e-3, abs=0.05e-3)
    assert found["f_score_1mm"] == 0.0


@pytest.mark.parametrize(
    "case,message",
    [
        ("unit", "looks like it is in mm, not in m; give --unit mm"),
        ("no mesh", "does not exist"),
        ("not meshed", "mesh"),
        ("no unit", "give --unit"),
        ("half", "was not finished"),
        ("no contacts", "without contacts"),
        ("plane", "plane"),
        ("swapped", "is no folder"),
    ],
)
def test_bad_input_is_one_line_and_loses_nothing(case, message, ball_run, capsys):
    """Exit code 2, what it is and what to do, and the run's folder as it was."""
    mesh = ball_run.parent / "ball.ply"
    columns = cloud.read_csv(ball_run / "contacts.csv")
    arguments = [str(mesh), str(ball_run)]
    if case == "unit":
        arguments += ["--unit", "m"]
    elif case == "no mesh":
        arguments[0] = str(mesh.with_name("nothing.ply"))
    elif case == "not meshed":
        mesh.write_bytes(b"solid nonsense")
        arguments += ["--unit", "mm"]
    elif case == "no unit":
        shutil.copy(mesh, mesh.with_suffix(".stl"))
        arguments[0] = str(mesh.with_suffix(".stl"))
    elif case == "half":
        (ball_run / "metrics.json").unlink()
    elif case == "no contacts":
        cloud.write_csv(ball_run / "contacts.csv", _spoilt(columns, "none"))
    elif case == "plane":
        cloud.write_csv(ball_run / "contacts.csv", _spoilt(columns, "plane"))
    else:
        arguments.reverse()
    before = {path.name: path.read_bytes() for path in ball_run.iterdir()}
    assert main(["compare", *arguments]) == WRONG_USAGE
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.count("\n") == 1
    assert message in told.err
    assert {path.name: path.read_bytes() for path in ball_run.iterdir()} == before
