"""The command line: it parses, calls, and turns errors into exit codes.

0 done; 1 a known error; 2 wrong usage or bad input; 3 trouble with a device: each told in one line. Errors
that nobody foresaw keep their traceback.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import cyclopts
from rich.console import Console

from contour import __version__
from contour.errors import ContourError, LinkError, UsageError

if TYPE_CHECKING:
    from contour.scene import Scene

__all__ = ["app", "compare", "demo", "doctor", "main", "report", "scan", "view"]

DEMO = "mug"
"""Shape that the demo maps."""
DEMO_STEP = 0.014
"""Step along its contours [m], coarser than a scan's by itself: a demo takes a minute."""
DEMO_CONTOURS = 24
RESULTS = Path("results")
"""Folder of result folders, where none is asked for."""
OK, KNOWN_ERROR, WRONG_USAGE, DEVICE_FAULT = 0, 1, 2, 3

app = cyclopts.App(
    name="contour",
    help="Maps the shape of objects by touch with a flexible beam.",
    version=f"contour {__version__}",
    result_action="return_value",
)


@app.command
def scan(
    source: Path,
    *,
    unit: str | None = None,
    out: Path | None = None,
    strategy: str | None = None,
    seed: int | None = None,
    surface: str | None = None,
    report: bool = True,
    dry_run: Annotated[bool, cyclopts.Parameter(negative=())] = False,
) -> int:
    """Map an object: contacts along contours round it, with their uncertainty.

    Args:
        source: a mesh, or a scene file (.toml).
        unit: unit of the mesh's numbers, where file and scene do not say (mm, m, ...).
        out: folder for the results; results/NAME if not given.
        strategy: model, bisection, bisection-limited or one-push.
        seed: of everything random.
        surface: auto, hermite, layers or none: how the surface is made from the contacts.
        report: end with view.png and report.html too.
        dry_run: check everything and say what would be done, but do not scan.
    """
    from contour.scene import load_scene

    scene = load_scene(source, unit=unit, strategy=strategy, seed=seed, surface=surface)
    folder = _free_folder(out, scene.name)
    code = _scan(scene, folder, dry_run=dry_run)
    if report and not dry_run:
        _show(folder)
    return code


@app.command
def demo(*, out: Path | None = None) -> int:
    """Map the mug with a handle, in simulation.

    Args:
        out: folder for the results; results/mug if not given.
    """
    from contour import shapes
    from contour.scene import load_scene

    folder = _free_folder(out, DEMO)
    folder.mkdir(parents=True, exist_ok=True)
    mesh = folder / f"{DEMO}.ply"
    shapes.write_mesh(mesh, shapes.load(DEMO).mesh(), DEMO)
    scene = load_scene(mesh, unit="mm")
    coarse = replace(scene, plan=replace(scene.plan, step=DEMO_STEP, contours=DEMO_CONTOURS))
    code = _scan(coarse, folder, dry_run=False)
    _show(folder)
    return code


@app.command
def compare(mesh: Path, run: Path, *, unit: str | None = None) -> int:
    """Hold the surface of a finished scan against a nominal mesh; writes comparison.json into its folder.

    Args:
        mesh: the nominal mesh, placed as the scan's only object was; or a scene file (.toml).
        run: folder of the scan.
        unit: unit of the mesh's numbers, where the file does not say (mm, m, ...).
    """
    from contour.console import metrics_table
    from contour.finish import compare_to

    console = Console(soft_wrap=True, highlight=False)
    console.print(metrics_table(f"{run} against {mesh}", compare_to(mesh, run, unit=unit)))
    return OK


@app.command
def view(run: Path, *, what: str = "all", contact: int | None = None, out: Path | None = None) -> int:
    """Show a finished scan in a window, or write a PNG where there is no display.

    Args:
        run: folder of the scan.
        what: points, contours, surface, uncertainty, antenna, or all.
        contact: id of the contact at which the antenna is shown.
        out: a PNG to write instead of opening a window.
    """
    from contour.results import load_run
    from contour.view import Picture, picture, window, window_possible

    console = Console(soft_wrap=True, highlight=False, markup=False)
    loaded = load_run(run)
    shown: Picture | str = ""
    if out is None:
        shown = window(loaded, what=what, contact=contact) if window_possible() else "there is no display"
    if isinstance(shown, str):
        made = picture(loaded, out, what=what, contact=contact)
        reason = f"no window could be opened ({shown}): " if shown else ""
        console.print(f"{reason}{', '.join(made.views)} in {made.path}, drawn by {made.drawn_by}")
    else:
        made = shown
    for note in made.notes:
        console.print(note)
    return OK


@app.command
def doctor() -> int:
    """Say what this machine can do, and what to install for the rest."""
    from contour.console import findings_table
    from contour.doctor import examine

    findings = examine()
    Console(soft_wrap=True).print(findings_table(findings))
    return OK if all(finding.good for finding in findings) else KNOWN_ERROR


@app.command
def report(run: Path) -> int:
    """Write report.html into the folder of a finished scan: figures, charts and a 3-D view in one page.

    Args:
        run: folder of the scan.
    """
    from contour.report import write_report
    from contour.results import load_run

    path = write_report(load_run(run))
    Console(soft_wrap=True, highlight=False, markup=False).print(f"report in {path}: open it in a browser")
    return OK


def _free_folder(out: Path | None, name: str) -> Path:
    """Where results go: what was asked for if it is empty or not there, else a new name in results/."""
    if out is not None:
        if out.exists() and not (out.is_dir() and not any(out.iterdir())):
            raise UsageError(f"{out} is not empty: choose another --out, or remove it")
        return out
    free = RESULTS / name
    count = 1
    while free.exists():
        count += 1
        free = RESULTS / f"{name}-{count}"
    return free


def _scan(scene: Scene, folder: Path, *, dry_run: bool) -> int:
    """Run the pipeline, with progress before and a table after."""
    from contour.console import Reporter, metrics_table
    from contour.finish import finishing
    from contour.scan import prepare, run

    console = Console(soft_wrap=True, highlight=False)
    job = prepare(scene)
    if dry_run:
        console.print(metrics_table(f"{scene.name}, not scanned", job.outlook()))
        return OK
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{folder} cannot be made ({error.strerror}): choose another --out") from error
    with Reporter(console) as report:
        metrics = run(job, folder, progress=report, finish=finishing(job))
    console.print(metrics_table(f"{scene.name}, results in {folder}", metrics))
    return OK


def _show(folder: Path) -> None:
    """End a scan with its picture and its report; what cannot be made is said, and the results stand."""
    from contour.report import write_report
    from contour.results import load_run
    from contour.view import picture

    console = Console(soft_wrap=True, highlight=False, markup=False)
    try:
        run = load_run(folder)
        made = picture(run)
        for note in made.notes:
            console.print(note)
        console.print(f"picture in {made.path}, report in {write_report(run)}")
    except ContourError as error:
        console.print(f"no picture and no report: {error}")


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; the exit code."""
    errors = Console(stderr=True, soft_wrap=True, highlight=False, markup=False)
    try:
        result = app(arguments, exit_on_error=False, print_error=False)
    except cyclopts.CycloptsError as error:
        errors.print(f"contour: {' '.join(str(error).split())} See contour --help.")
        return WRONG_USAGE
    except UsageError as error:
        errors.print(f"contour: {error}")
        return WRONG_USAGE
    except LinkError as error:
        errors.print(f"contour: device: {error}")
        return DEVICE_FAULT
    except ContourError as error:
        errors.print(f"contour: {error}")
        return KNOWN_ERROR
    return result if isinstance(result, int) else OK


if __name__ == "__main__":
    sys.exit(main())
