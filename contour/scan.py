"""The pipeline: from a scene to a folder of contacts.

A result folder has ``contacts.csv`` (SI units), ``points.ply`` and ``points.vtp`` (in the unit of the mesh),
``readings.npz`` (all samples, for :func:`replay`), ``log.jsonl`` (events, one JSON object a line),
``run.json`` (resolved scene, versions, seed), what ``finish`` adds (:mod:`contour.finish`: ``surface.ply``) and
``metrics.json``, which is written last: its presence says done.
"""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import contour
from contour import cloud
from contour.bodies import build_environment
from contour.contacts import Contacts, flag_names
from contour.evaluate import errors_of, figures, true_columns
from contour.frames import wrap_angle
from contour.instrument import (
    ApproachReading,
    Instrument,
    Outcome,
    PushReading,
    RecordingInstrument,
    ReplayInstrument,
    Stop,
)
from contour.ladder import Rung
from contour.localise import localise
from contour.mesh_env import MeshEnvironment
from contour.mesh_instrument import MeshInstrument
from contour.mesh_io import unit_of
from contour.plan import Plan
from contour.scene import Scene
from contour.sensing import Strategy
from contour.smoothing import SmoothedNormals, smooth_normals
from contour.strategy import make_strategy
from contour.trace import Status, Trace
from contour.tracing import Tracer
from contour.truth import truth_of
from contour.virtual import TrueContact

__all__ = ["Finish", "Job", "Observed", "Progress", "events", "follow", "prepare", "replay", "run"]

TOUCH_SIGMA = 8e-6
"""Standard deviation of a touch's place by the machine's last step back [m]."""

FloatArray = NDArray[np.float64]
Progress = Callable[[int, float], None]
"""``progress(contacts, share)``: contacts made so far and the share of the work that is done."""
Finish = Callable[[Path, cloud.Table], dict[str, Any]]
"""``finish(folder, columns)``: what follows a scan; metrics to add."""
Observer = Callable[[Contacts], None]
LIBRARIES = ("numpy", "scipy", "trimesh", "embreex")
"""What the numbers of a run depend on, besides contour itself."""
NEARLY = 0.95
"""Largest share that a contour counts for before it has ended."""


@dataclass(slots=True)
class Observed:
    """What a simulation knows of the contacts, taken through the side door as they are made."""

    instrument: MeshInstrument
    parts: list[TrueContact] = field(default_factory=list)
    rungs: list[NDArray[np.int8]] = field(default_factory=list)

    def __call__(self, contacts: Contacts) -> None:
        """Note what the antennas of ``contacts`` touch."""
        truth, rung = truth_of(self.instrument, contacts.which)
        self.parts.append(truth)
        self.rungs.append(rung)

    def truth(self) -> tuple[TrueContact, NDArray[np.int8]]:
        """All of it, in the order of the contacts."""
        nothing = truth_of(self.instrument, np.zeros(0, dtype=np.int64))
        parts, rungs = [nothing[0], *self.parts], [nothing[1], *self.rungs]
        merged = {f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(TrueContact)}
        return TrueContact(**merged), np.concatenate(rungs)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Job:
    """A scene ready to be scanned."""

    scene: Scene
    environment: MeshEnvironment
    plan: Plan

    @property
    def unit(self) -> str:
        """Unit of the point files: that of the first mesh, so that they lie over it in a viewer."""
        body = self.scene.bodies[0]
        return unit_of(body.mesh, body.unit)

    def outlook(self) -> dict[str, Any]:
        """What a dry run shows."""
        extent = self.environment.bounds[1] - self.environment.bounds[0]
        return {
            "contours": self.plan.contours,
            "step_m": self.plan.step,
            "extent_m": extent.tolist(),
            "strategy": self.scene.scan.strategy,
        }


def prepare(scene: Scene) -> Job:
    """Load the meshes of ``scene`` and plan its contours; every fault of the input shows here."""
    environment = build_environment(scene.bodies)
    return Job(scene=scene, environment=environment, plan=scene.build_plan(environment.bounds))


def follow(
    instrument: Instrument,
    strategy: Strategy,
    tracer: Tracer,
    *,
    observe: Observer | None = None,
) -> tuple[Contacts | None, Trace]:
    """Trace every contour of ``tracer``, all in lockstep.

    Returns:
        The contacts in the order they were made, None if there are none, and how the contours went.
        ``observe`` sees the contacts of each round as they are made.
    """
    parts: list[Contacts] = []
    begun = instrument.machine_time
    while tracer.active.size:
        reading = instrument.approach(*tracer.ask())
        rows = tracer.touched(reading)
        if rows.size:
            expected = tracer.expected(reading.which[rows])
            contacts = localise(
                instrument,
                strategy,
                reading.take(rows),
                expected=expected.outward,
                expected_sigma=expected.sigma,
                fresh=expected.fresh,
            )
            now = instrument.machine_time
            contacts = replace(contacts, machine_time=now[contacts.which] - begun[contacts.which])
            begun[contacts.which] = now[contacts.which]
            tracer.tell(contacts)
            if observe is not None:
                observe(contacts)
            instrument.release(contacts.which, tracer.clearance(contacts.which))
            parts.append(contacts)
    return (tracer.place(Contacts.concatenate(parts)) if parts else None), tracer.summary()


def run(
    job: Job, folder: Path, *, progress: Progress | None = None, finish: Finish | None = None
) -> dict[str, Any]:
    """Scan ``job`` and write its result folder; the metrics, which are written last.

    ``finish`` comes before them, when all else is in the folder. What it returns is added to them; if it
    raises, they are written without, and the scan is whole.
    """
    scene = job.scene
    simulated = MeshInstrument(
        job.environment,
        antennas=job.plan.contours,
        antenna=scene.antenna,
        machine=scene.machine,
        mount=scene.mount,
        rung=scene.scan.rung,
        tolerance=scene.scan.tolerance,
    )
    recorder = RecordingInstrument(simulated)
    tracer = Tracer(job.plan, scene.mount, scene.antenna)
    observed = Observed(simulated)

    def observe(contacts: Contacts) -> None:
        observed(contacts)
        if progress is not None:
            progress(sum(rung.size for rung in observed.rungs), _share(tracer.summary(), job.plan))

    begun, rays = time.perf_counter(), job.environment.rays_cast
    found, trace = follow(recorder, _strategy(job), tracer, observe=observe)
    spent = time.perf_counter() - begun
    contacts = Contacts.none() if found is None else found
    truth, rungs = observed.truth()
    metrics = {
        **figures(contacts, errors_of(contacts, truth, scene.antenna.beam.length)),
        "rays_cast": job.environment.rays_cast - rays,
        "scan_s": spent,
        "contacts_per_s": len(contacts) / spent,
        "machine_time_s": float(recorder.machine_time.sum()),
        "rungs": {rung.name.lower(): int(np.count_nonzero(rungs == rung)) for rung in Rung},
        "unconverged": simulated.unconverged,
    }
    smooth = _smoothed(contacts, trace, job)
    turn = np.abs(wrap_angle(smooth.outward - truth.outward)[contacts.good])
    metrics["smooth_normal_error_median_rad"] = float(np.median(turn)) if turn.size else None
    metrics["smooth_normal_error_p95_rad"] = float(np.quantile(turn, 0.95)) if turn.size else None
    columns = cloud.table(contacts, true_columns(truth, rungs)) | _smooth_columns(contacts, smooth, job)
    folder.mkdir(parents=True, exist_ok=True)
    cloud.write_json(folder / "run.json", _run_record(scene))
    lines = [json.dumps(event) + "\n" for event in events(recorder, contacts, trace)]
    (folder / "log.jsonl").write_text("".join(lines), encoding="utf-8")
    np.savez_compressed(folder / "readings.npz", allow_pickle=False, **recorder.log())
    cloud.write_csv(folder / "contacts.csv", columns)
    cloud.write_ply(folder / "points.ply", columns, unit=job.unit)
    cloud.write_vtp(folder / "points.vtp", columns, unit=job.unit)
    try:
        metrics |= {} if finish is None else finish(folder, columns)
    finally:
        cloud.write_json(folder / "metrics.json", metrics)
    return metrics


def _smoothed(contacts: Contacts, trace: Trace, job: Job) -> SmoothedNormals:
    """Normals smoothed along the contours."""
    antenna = job.scene.antenna
    noise = 0.4 * antenna.sensor.moment_noise * contacts.distance**2 / antenna.stiffness3
    return smooth_normals(contacts, closed=trace.closed, touch_sigma=np.hypot(TOUCH_SIGMA, noise))


def _smooth_columns(contacts: Contacts, smooth: SmoothedNormals, job: Job) -> cloud.Table:
    """Columns of the smoothed normals: ``smooth_nx`` ... in the world, and their sigma."""
    turn = wrap_angle(smooth.outward - contacts.outward)[:, None]
    aside = np.cross(contacts.normal, job.plan.direction[contacts.which])  # a quarter turn on, in Pi
    normal = np.cos(turn) * contacts.normal + np.sin(turn) * aside
    columns = {f"smooth_n{axis}": normal[:, i] for i, axis in enumerate("xyz")}
    return {**columns, "sigma_smooth_normal_rad": smooth.sigma}


def replay(job: Job, readings: Path) -> tuple[Contacts | None, Trace]:
    """The contacts of a scan again, bit for bit, from its ``readings.npz`` and the job that it was."""
    with np.load(readings) as log:
        instrument = ReplayInstrument(dict(log), antenna=job.scene.antenna, mount=job.scene.mount)
    tracer = Tracer(job.plan, job.scene.mount, job.scene.antenna)
    return follow(instrument, _strategy(job), tracer)


def events(recorder: RecordingInstrument, contacts: Contacts, trace: Trace) -> Iterator[dict[str, Any]]:
    """What happened: every call of the instrument, every flagged contact, and how each contour ended."""
    for number, (kind, which, reading) in enumerate(recorder.calls):
        event = {"event": kind, "call": number, "contours": which.size}
        if isinstance(reading, ApproachReading):
            event |= {o.name.lower(): int(np.count_nonzero(reading.outcome == o)) for o in Outcome}
        elif isinstance(reading, PushReading):
            event |= {f"stop_{s.name.lower()}": int(np.count_nonzero(reading.stop == s)) for s in Stop}
        yield event
    for row in np.flatnonzero(~contacts.good).tolist():
        yield {
            "event": "flagged",
            "contact": row,
            "contour": int(contacts.which[row]),
            "flags": flag_names(int(contacts.flags[row])),
        }
    for contour_number, reason in enumerate(trace.reason):
        yield {
            "event": "contour",
            "contour": contour_number,
            "status": Status(trace.status[contour_number]).name.lower(),
            "contacts": int(trace.contacts[contour_number]),
            "approaches": int(trace.approaches[contour_number]),
            "ended": reason,
        }


def _strategy(job: Job) -> Strategy:
    scene = job.scene
    return make_strategy(scene.scan.strategy, job.plan.contours, scene.antenna, scene.mount)


def _share(trace: Trace, plan: Plan) -> float:
    """Share of the work done: a contour that is followed counts by the way made round the box's outline."""
    way = np.minimum(trace.contacts * plan.step / np.maximum(plan.perimeter, plan.step), NEARLY)
    return float(np.mean(np.where(trace.status >= Status.CLOSED, 1.0, way)))


def _run_record(scene: Scene) -> dict[str, Any]:
    return {
        "versions": {
            "contour": contour.__version__,
            "python": platform.python_version(),
            **{name: _version(name) for name in LIBRARIES},
        },
        "commit": _commit(Path(contour.__file__).resolve().parents[1]),
        "seed": scene.scan.seed,
        "scene": scene.resolved(),
    }


def _version(library: str) -> str | None:
    try:
        return version(library)
    except PackageNotFoundError:  # embree has no wheels for some machines
        return None


def _commit(root: Path) -> str | None:
    """The commit of the source tree at ``root``; None where it is no git repository."""
    git = root / ".git"
    if not (git / "HEAD").is_file():
        return None
    kind, _, name = (git / "HEAD").read_text(encoding="utf-8").strip().rpartition(" ")
    if not kind:
        return name
    if (git / name).is_file():
        return (git / name).read_text(encoding="utf-8").strip()
    packed = git / "packed-refs"
    lines = packed.read_text(encoding="utf-8").splitlines() if packed.is_file() else []
    return next((line.split()[0] for line in lines if line.endswith(f" {name}")), None)
