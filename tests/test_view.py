"""Pictures of a run: by VTK where it can, by matplotlib where it cannot, and never at the cost of anything."""

from __future__ import annotations

import hashlib
import time
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread
from picture_runs import CRASH, copied_run, drawable

from contour import view
from contour.cli import OK, WRONG_USAGE, main
from contour.contacts import Flag
from contour.errors import UsageError
from contour.results import SURFACE_FILE, load_run
from contour.view import picture, window_possible


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A small finished scan, on a machine without a display."""
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    return copied_run(tmp_path)


@pytest.fixture
def crashing(monkeypatch):
    """VTK kills its process."""
    monkeypatch.setattr(view, "_CHILD", CRASH)


def _inked(path, rows=slice(110, 480), columns=slice(20, 780)):
    """Which pixels of the upper left view are not white."""
    image = imread(path)[:, :, :3]
    assert image.shape == (1200, 1600, 3)
    return np.any(image[rows, columns] < 0.97, axis=2)


def _digests(folder):
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}


def _painted(path):
    """Each of the four views is drawn in, and in several colours."""
    image = imread(path)[:, :, :3]
    for top in (110, 680):
        for left in (20, 820):
            part = image[top : top + 350, left : left + 740].reshape(-1, 3)
            inked = part[np.any(part < 0.97, axis=1)]
            assert len(inked) > 0.03 * len(part)
            assert len(np.unique((16 * inked).astype(int), axis=0)) > 10


@pytest.mark.usefixtures("crashing")
def test_a_crash_leaves_a_picture_by_matplotlib_and_exit_code_zero(folder, capsys):
    """SIGSEGV in the child: the picture is there, it is said who drew it and why; no other file is touched."""
    before = _digests(folder)
    assert main(["view", str(folder)]) == OK
    told = capsys.readouterr().out
    assert "drawn by matplotlib" in told
    assert "SIGSEGV" in told
    assert "there is no display" in told
    _painted(folder / "view.png")
    after = _digests(folder)
    del after["view.png"]
    assert after == before


def test_vtk_draws_where_it_can(folder, capsys):
    """The command says that VTK drew it."""
    if drawable():
        pytest.skip(drawable())
    assert main(["view", str(folder), "--out", str(folder / "other.png")]) == OK
    assert "drawn by VTK" in capsys.readouterr().out
    assert not (folder / "view.png").exists()
    _painted(folder / "other.png")


def test_both_ways_show_the_same(folder, monkeypatch):
    """The outlines of the surface agree but for a few pixels, so cameras and scales are the same."""
    if drawable():
        pytest.skip(drawable())
    run = load_run(folder)
    rows, columns = slice(110, 1000), slice(60, 1540)
    first = picture(run, what="surface")
    vtk = _inked(first.path, rows, columns)
    shaded = imread(first.path)
    monkeypatch.setattr(view, "_CHILD", CRASH)
    second = picture(run, what="surface")
    assert (first.drawn_by, second.drawn_by) == ("VTK", "matplotlib")
    painted = _inked(second.path, rows, columns)
    # The one has light on smooth ground, the other flat triangles: nearly no pixel is the same.
    same = np.all(shaded[rows, columns] == imread(second.path)[rows, columns], axis=2)
    assert np.mean(same[vtk & painted]) < 0.5
    assert np.count_nonzero(vtk ^ painted) < 0.01 * np.count_nonzero(vtk)
    assert 0.2 < vtk.mean() < 0.8


@pytest.mark.parametrize(
    "child,reason",
    [
        (("-c", "pass"), "without a picture"),
        (("-c", "raise SystemExit('no such library')"), "no such library"),
        (("-c", "import time; time.sleep(60)"), "within 1 s"),
    ],
)
def test_any_failure_of_the_child_is_told(child, reason, folder, monkeypatch):
    """It ends without a picture, with an error, or never: matplotlib steps in within the time limit."""
    monkeypatch.setattr(view, "_CHILD", child)
    begun = time.monotonic()
    made = picture(load_run(folder), what="points", patience=1.0)
    assert made.drawn_by == "matplotlib"
    assert reason in made.notes[-1]
    assert made.path.stat().st_size > 10_000
    assert time.monotonic() - begun < 50.0


@pytest.mark.usefixtures("crashing")
def test_what_to_install_is_said(folder, monkeypatch):
    """The doctor's remedy, where libraries are absent."""
    view._remedy.cache_clear()
    monkeypatch.setattr("contour.doctor._DRAW", CRASH[1])
    monkeypatch.setattr("contour.doctor._loads", lambda library: library != "libGL.so.1")
    made = picture(load_run(folder), what="points")
    view._remedy.cache_clear()
    assert "apt install libgl1;" in made.notes[-1]


@pytest.mark.usefixtures("crashing")
def test_without_surface_points_stand_in(folder):
    """It is said, and asking for the surface alone is refused."""
    (folder / SURFACE_FILE).unlink()
    made = picture(load_run(folder))
    assert made.views == ("contours", "points", "uncertainty", "antenna")
    assert "no surface.ply" in made.notes[0]
    with pytest.raises(UsageError, match=r"no surface\.ply"):
        picture(load_run(folder), what="surface")


@pytest.mark.usefixtures("crashing")
def test_without_the_nominal_mesh_there_is_still_a_picture(folder):
    """The mesh was moved since: it is said that there is no deviation."""
    record = folder / "run.json"
    record.write_text(record.read_text(encoding="utf-8").replace("ball.ply", "gone.ply"), encoding="utf-8")
    made = picture(load_run(folder), what="surface")
    assert "no deviation shown: mesh" in made.notes[0]
    assert "gone.ply" in made.notes[0]


def test_deviations_are_those_of_the_comparison(folder):
    """Signed, from the mesh that the run names: the surface's worst is in metrics.json."""
    run = load_run(folder)
    surface = view.load_surface(run)
    deviation, reason = view._deviation(run, surface)
    assert not reason
    assert np.abs(deviation).max() == pytest.approx(run.metrics["comparison"]["accuracy_max_m"], rel=0.05)


@pytest.mark.parametrize(
    "options,message",
    [
        (["--what", "contour"], "did you mean 'contours'?"),
        (["--contact", "87"], "contacts 0 to 86"),
        (["--contact", "-1"], "contacts 0 to 86"),
        (["--out", "picture.jpg"], ".png"),
        (["--out", "nowhere/picture.png"], "does not exist"),
    ],
)
def test_wrong_wishes_are_one_line(options, message, folder, capsys):
    """Exit code 2, what is wrong and what would be right, and no picture."""
    assert main(["view", str(folder), *options]) == WRONG_USAGE
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert message in told
    assert not list(folder.glob("*.png"))


def _changed(run, **columns):
    return replace(run, contacts={**run.contacts, **columns})


@pytest.mark.usefixtures("crashing")
@pytest.mark.parametrize("surface", [True, False])
def test_runs_with_nothing_good_still_have_a_picture(surface, folder):
    """Every contact flagged, or one contact only: all four views, and no deviation from what was not felt."""
    if not surface:
        (folder / SURFACE_FILE).unlink()
    run = load_run(folder)
    made = picture(_changed(run, flags=np.full(run.contour.size, int(Flag.LOST))))
    assert len(made.views) == 4
    assert not surface or "fewer than two contacts" in made.notes[0]
    single = replace(run, contacts={name: column[:1] for name, column in run.contacts.items()})
    assert len(picture(single).views) == 4


@pytest.mark.usefixtures("crashing")
def test_contacts_without_a_place_are_left_out(folder):
    """A contact that was lost has no numbers: the others are shown, and asking for it is refused."""
    run = load_run(folder)
    lost = {name: run.contacts[name].copy() for name in ("x_m", "y_m", "z_m", "flags")}
    for column in lost.values():
        column[5] = Flag.LOST if column is lost["flags"] else np.nan
    assert len(picture(_changed(run, **lost)).views) == 4
    with pytest.raises(UsageError, match="--contact 5 has no place"):
        picture(_changed(run, **lost), contact=5)


def test_half_written_runs_are_refused(folder, capsys):
    """No metrics.json: one line."""
    (folder / "metrics.json").unlink()
    assert main(["view", str(folder)]) == WRONG_USAGE
    assert "was not finished" in capsys.readouterr().err


@pytest.mark.usefixtures("crashing")
def test_a_window_that_cannot_open_becomes_a_picture(folder, monkeypatch, capsys):
    """A display is named but VTK crashes on it: exit code 0, a PNG and the reason."""
    monkeypatch.setenv("DISPLAY", ":99")
    assert window_possible()
    assert main(["view", str(folder), "--what", "contours"]) == OK
    told = capsys.readouterr().out
    assert "no window could be opened (its process crashed (SIGSEGV))" in told
    assert (folder / "view.png").exists()
