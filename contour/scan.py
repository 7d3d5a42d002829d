"""The pipeline: from a scene to a folder of contacts."""

from __future__ import annotations

import io
import logging
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import contour
from contour import cloud
from contour.bodies import build_environment
from contour.contacts import Contacts
from contour.evaluate import errors_of, figures, true_columns
from contour.instrument import Instrument, RecordingInstrument
from contour.ladder import Rung
from contour.localise import localise
from contour.mesh_env import MeshEnvironment
from contour.mesh_instrument import MeshInstrument
from contour.plan import Plan
from contour.scene import Scene
from contour.sensing import Strategy
from contour.strategy import make_strategy
from contour.tracing import Trace, Tracer
from contour.truth import truth_of
from contour.virtual import TrueContact

__all__ = ["Job", "Observed", "Progress", "follow", "prepare", "run"]

logger = logging.getLogger(__name__)

FloatArray = NDArray[np.float64]
Progress = Callable[[int, float], None]
"""``progress(contacts, share)``: contacts made so far and the share of contours that are done."""
Observer = Callable[[Contacts], None]


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
        merged = {
            f.name: np.concatenate([getattr(p, f.name) for p in self.parts]) for f in fields(TrueContact)
        }
        return TrueContact(**merged), np.concatenate(self.rungs)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Job:
    """A scene ready to be scanned."""

    scene: Scene
    environment: MeshEnvironment
    plan: Plan

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
    progress: Progress | None = None,
) -> tuple[Contacts | None, Trace]:
    """Trace every contour of ``tracer``, all in lockstep; the contacts in the order they were made."""
    parts: list[Contacts] = []
    made = 0
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
            if observe is not None:
                observe(contacts)
            tracer.tell(contacts)
            instrument.release(contacts.which, tracer.clearance(contacts.which))
            parts.append(contacts)
            made += len(contacts)
        if progress is not None:
            progress(made, 1.0 - tracer.active.size / instrument.antennas)
    return (tracer.place(Contacts.concatenate(parts)) if parts else None), tracer.summary()


def run(job: Job, folder: Path, *, progress: Progress | None = None) -> dict[str, Any]:
    """Scan ``job`` and write its result folder; the metrics, which are written last."""
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
    strategy = make_strategy(scene.scan.strategy, job.plan.contours, scene.antenna, scene.mount)
    tracer = Tracer(job.plan, scene.mount, scene.antenna)
    observed = Observed(simulated)
    begun, rays = time.perf_counter(), job.environment.rays_cast
    contacts, trace = follow(recorder, strategy, tracer, observe=observed, progress=progress)
    spent = time.perf_counter() - begun
    folder.mkdir(parents=True, exist_ok=True)
    cost = {
        "rays_cast": job.environment.rays_cast - rays,
        "scan_s": spent,
        "contacts_per_s": (len(contacts) if contacts is not None else 0) / spent,
        "machine_time_s": float(recorder.machine_time.sum()),
    }
    cloud.write_json(folder / "run.json", _run_record(scene, trace))
    _write_log(folder, trace)
    if contacts is None:
        metrics = {"contacts": 0, "flagged": 0, **cost}
        cloud.write_json(folder / "metrics.json", metrics)
        return metrics
    truth, rungs = observed.truth()
    errors = errors_of(contacts, truth, scene.antenna.beam.length)
    columns = cloud.table(contacts, true_columns(truth, rungs))
    cloud.write_csv(folder / "contacts.csv", columns)
    cloud.write_ply(folder / "points.ply", columns, unit="m")
    cloud.write_vtp(folder / "points.vtp", columns, unit="m")
    _write_readings(folder / "readings.npz", recorder)
    counts = {rung.name.lower(): int(np.count_nonzero(rungs == rung)) for rung in Rung}
    metrics = {**figures(contacts, errors), **cost, "rungs": counts}
    cloud.write_json(folder / "metrics.json", metrics)
    return metrics


def _run_record(scene: Scene, trace: Trace) -> dict[str, Any]:
    return {
        "contour": contour.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "seed": scene.scan.seed,
        "scene": scene.resolved(),
        "contours": {"reasons": list(trace.reason), "approaches": trace.approaches.tolist()},
    }


def _write_log(folder: Path, trace: Trace) -> None:
    lines = io.StringIO()
    for i, (reason, contacts, approaches) in enumerate(
        zip(trace.reason, trace.contacts.tolist(), trace.approaches.tolist(), strict=True)
    ):
        lines.write(
            f'{{"contour": {i}, "contacts": {contacts}, "approaches": {approaches}, "ended": "{reason}"}}\n'
        )
    (folder / "log.jsonl").write_text(lines.getvalue())


def _write_readings(path: Path, recorder: RecordingInstrument) -> None:
    np.savez_compressed(path, **recorder.log())  # type: ignore[arg-type]
