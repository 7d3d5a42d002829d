"""How right contacts are, by shape, strategy and region, on shapes known in closed form.

Every shape stands four times in one scene, with friction angles of 3, 10, 17 and 25 deg; the default plan
follows each, all contours in lockstep, with the default antenna and noise. The truth is that of
contour.shapes.

    python benchmarks/accuracy.py --shapes sphere box --strategies model bisection --out results
"""

from __future__ import annotations

import argparse
import csv
import json
import platform
import subprocess
import sys
import time
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

import contour
from contour import shapes
from contour.antenna import Antenna
from contour.contacts import Contacts, Kind
from contour.evaluate import Errors, errors_of, figures
from contour.frames import Mount, wrap_angle
from contour.instrument import PushReading, Watch
from contour.ladder import Rung
from contour.machine import MachineModel
from contour.mesh_env import MeshEnvironment
from contour.mesh_instrument import MeshInstrument
from contour.plan import Plan, default_plan
from contour.regions import REGIONS, analytic_truth
from contour.scan import Observed, follow
from contour.smoothing import smooth_normals
from contour.strategy import STRATEGIES, make_strategy
from contour.tracing import Tracer
from contour.virtual import TrueContact

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

FRICTION_ANGLES = np.deg2rad([3.0, 10.0, 17.0, 25.0])
"""Of the four copies of a shape."""
APART = 1.0
"""Distance between the copies [m]; no beam reaches from one to the next."""
SMOOTH = ("sphere", "cylinder", "torus", "vase", "blob")
CORNERED = ("box", "gear", "rod12", "rod2")
OTHERS = ("shaft", "bracket", "fin", "mug")

WITHIN = 1.959963984540054
"""Half width of the 95 % interval in sigmas."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    """One scan and its truth, row by row."""

    contacts: Contacts
    truth: TrueContact
    facets: FloatArray
    """(n,) rad, normal of the mesh off that of the shape: an error of the simulation."""
    errors: Errors
    smoothed: FloatArray
    """(n,) rad, error of the normal after smoothing along the contour."""
    smoothed_sigma: FloatArray
    """(n,) rad, its standard deviation as claimed."""
    first: NDArray[np.bool_]
    """(n,) the first contact of its contour."""
    phi: FloatArray
    """(n,) rad, direction of the last push."""
    angle: FloatArray
    """(n,) rad, how far it went."""
    rung: NDArray[np.int8]
    reasons: tuple[str, ...]
    """Why each contour ended."""
    seconds: float
    rays: int

    @property
    def region(self) -> NDArray[np.int8]:
        """(n,) codes of contour.regions.REGIONS."""
        return self.truth.region

    def take(self, rows: NDArray[np.bool_]) -> Outcome:
        """The contacts ``rows``."""
        errors = Errors(**{f.name: getattr(self.errors, f.name)[rows] for f in fields(Errors)})
        return Outcome(
            contacts=self.contacts.take(rows),
            truth=self.truth.take(np.flatnonzero(rows)),
            facets=self.facets[rows],
            errors=errors,
            smoothed=self.smoothed[rows],
            smoothed_sigma=self.smoothed_sigma[rows],
            first=self.first[rows],
            phi=self.phi[rows],
            angle=self.angle[rows],
            rung=self.rung[rows],
            reasons=self.reasons,
            seconds=self.seconds,
            rays=self.rays,
        )


class LoggingInstrument(MeshInstrument):
    """Remembers the last push of every antenna, which tells eps and q of contacts that went wrong."""

    last: FloatArray
    """(antennas, 2) rad, direction and angle."""

    def push(
        self,
        which: IntArray,
        phi: FloatArray,
        angle: FloatArray,
        *,
        moment_limit: FloatArray,
        watch: Watch | None = None,
    ) -> PushReading:
        """As the simulated instrument does."""
        reading = super().push(which, phi, angle, moment_limit=moment_limit, watch=watch)
        self.last[which] = np.column_stack((reading.phi, reading.angle))
        return reading


def joined(plans: list[Plan]) -> Plan:
    """All contours of ``plans``, which keep their planes apart."""
    columns = {}
    for f in fields(Plan):
        if f.name not in {"label", "step", "reach", "plane"}:
            columns[f.name] = np.concatenate([getattr(plan, f.name) for plan in plans])
    gap = 1 + max(int(plan.plane.max()) for plan in plans)
    plane = np.concatenate([plan.plane + i * gap for i, plan in enumerate(plans)])
    label = tuple(f"body {i}: {label}" for i, plan in enumerate(plans) for label in plan.label)
    return Plan(**columns, plane=plane, label=label, step=plans[0].step, reach=plans[0].reach)


def scene_of(name: str) -> tuple[MeshEnvironment, FloatArray]:
    """Four copies of a shape with their frictions, and where their origins lie (4, 3) m."""
    mesh = shapes.load(name).mesh()
    places = np.zeros((FRICTION_ANGLES.size, 3))
    places[:, 0] = APART * np.arange(FRICTION_ANGLES.size)
    scene = trimesh.Scene()
    for i, place in enumerate(places):
        body = trimesh.Trimesh(mesh.vertices + place, mesh.faces, process=False)
        scene.add_geometry(body, node_name=str(i), geom_name=str(i))
    return MeshEnvironment(scene, friction=np.tan(FRICTION_ANGLES).tolist()), places


def measure(
    name: str,
    strategy: str,
    *,
    contours: int = 48,
    rung: str = "auto",
    seed: int = 0,
    step: float | None = None,
) -> Outcome:
    """Scan the shape ``name`` along ``contours`` contours, a quarter of them on each copy."""
    environment, places = scene_of(name)
    antenna, mount = Antenna(), Mount.identity()
    own = shapes.load(name).mesh().vertices
    box = np.stack((own.min(axis=0), own.max(axis=0)))
    each = max(contours // len(places), 1)
    plan = joined([default_plan(box + place, antenna, mount, contours=each, step=step) for place in places])
    machine = MachineModel(sensor=antenna.sensor, seed=seed)
    instrument = LoggingInstrument(
        environment, antennas=plan.contours, antenna=antenna, machine=machine, mount=mount, rung=rung
    )
    instrument.last = np.zeros((plan.contours, 2))
    observed = Observed(instrument)
    first: list[NDArray[np.bool_]] = []
    last: list[FloatArray] = []

    def observe(contacts: Contacts) -> None:
        observed(contacts)
        first.append(contacts.sequence == 0)  # so far the order of localising
        last.append(instrument.last[contacts.which])

    rays, begun = environment.rays_cast, time.perf_counter()
    contacts, trace = follow(
        instrument,
        make_strategy(strategy, plan.contours, antenna, mount),
        Tracer(plan, mount, antenna),
        observe=observe,
    )
    seconds = time.perf_counter() - begun
    if contacts is None:
        raise SystemExit(f"{name}: no contour found the shape; its plan has {plan.contours} contours")
    mesh_truth, rungs = observed.truth()
    rotation = mount.rotation_world_sensor(mount.poses(np.zeros((plan.contours, 3)), plan.direction))
    # Bodies of the scene are numbered in the order in which they were added.
    frames = rotation[contacts.which]
    truth = analytic_truth(mesh_truth, frames, shapes.load(name), places[mesh_truth.body])
    smoothed = smooth_normals(contacts, closed=trace.closed)
    return Outcome(
        contacts=contacts,
        truth=truth,
        facets=wrap_angle(mesh_truth.outward - truth.outward),
        errors=errors_of(contacts, truth, antenna.beam.length),
        smoothed=wrap_angle(smoothed.outward - truth.outward),
        smoothed_sigma=smoothed.sigma,
        first=np.concatenate(first),
        phi=np.concatenate(last)[:, 0],
        angle=np.concatenate(last)[:, 1],
        rung=rungs,
        reasons=trace.reason,
        seconds=seconds,
        rays=environment.rays_cast - rays,
    )


# ------------------------------------------------------------------------------------------------- tables

COLUMNS = {
    "contacts": "d",
    "flagged %": ".1f",
    "pushes": ".2f",
    "first": ".2f",
    "s rms %": ".3f",
    "s p99 %": ".2f",
    "s cover": ".3f",
    "n med deg": ".2f",
    "n p95 deg": ".2f",
    "n cover": ".3f",
    "smooth med": ".2f",
    "smooth p95": ".2f",
    "smooth cover": ".3f",
    "wrong": "d",
}
"""Columns of the table and their formats."""


def row_of(outcome: Outcome) -> dict[str, float | int | None]:
    """The figures of some contacts, in the units of the table."""
    values = figures(outcome.contacts, outcome.errors)
    known = values["s_error_rms_rel"] is not None
    first = outcome.contacts.pushes[outcome.first]
    good = outcome.contacts.good
    smoothed = np.rad2deg(np.abs(outcome.smoothed[good]))
    within = np.abs(outcome.smoothed[good]) <= WITHIN * outcome.smoothed_sigma[good]

    def scaled(key: str, factor: float = 1.0) -> float | None:
        return factor * float(values[key]) if known else None

    return {
        "contacts": values["contacts"],
        "flagged %": 100.0 * values["flagged"] / max(values["contacts"], 1),
        "pushes": values["pushes_per_contact"],
        "first": float(first.mean()) if first.size else None,
        "s rms %": scaled("s_error_rms_rel", 100.0),
        "s p99 %": scaled("s_error_p99_rel", 100.0),
        "s cover": scaled("coverage_95"),
        "n med deg": scaled("normal_error_median_rad", 180.0 / np.pi),
        "n p95 deg": scaled("normal_error_p95_rad", 180.0 / np.pi),
        "n cover": scaled("coverage_95_normal"),
        "smooth med": float(np.median(smoothed)) if known else None,
        "smooth p95": float(np.quantile(smoothed, 0.95)) if known else None,
        "smooth cover": float(within.mean()) if known else None,
        "wrong": values["silently_wrong"] if known else None,
    }


def rows_of(shape: str, strategy: str, outcome: Outcome) -> list[dict[str, object]]:
    """The row of all contacts and one for each region that there is."""
    rows: list[dict[str, object]] = [
        {"shape": shape, "strategy": strategy, "region": "all", **row_of(outcome)}
    ]
    for code, region in enumerate(REGIONS):
        here = outcome.region == code
        if here.any():
            rows.append(
                {"shape": shape, "strategy": strategy, "region": region, **row_of(outcome.take(here))}
            )
    return rows


def markdown(rows: list[dict[str, object]]) -> str:
    """Rows as a table."""
    names = ["shape", "strategy", "region", *COLUMNS]
    lines = ["| " + " | ".join(names) + " |", "|" + "---|" * 3 + "---:|" * len(COLUMNS)]
    for row in rows:
        cells = [str(row[name]) for name in names[:3]]
        cells += ["" if row[name] is None else format(row[name], code) for name, code in COLUMNS.items()]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def details(outcome: Outcome) -> dict[str, FloatArray]:
    """What is needed to find out why a contact is wrong, a column each."""
    contacts, truth, errors = outcome.contacts, outcome.truth, outcome.errors
    degrees = 180.0 / np.pi
    with np.errstate(divide="ignore"):
        bend = np.where(truth.radius_across == 0.0, np.inf, 1.0 / truth.radius_across)
    return {
        "contour": contacts.which,
        "sequence": contacts.sequence,
        "first": outcome.first,
        "region": outcome.region,
        "kind": truth.kind,
        "kind_found": contacts.kind,
        "rung": outcome.rung,
        "flags": contacts.flags,
        "pushes": contacts.pushes,
        "s_mm": 1e3 * truth.distance,
        "alpha_deg": degrees * np.arctan(truth.friction),
        "alpha_found_deg": degrees * contacts.friction_angle,
        "R_mm": 1e3 * truth.radius_along,
        "R_found_mm": 1e3 * contacts.radius_along,
        "bend_1_m": bend,
        "bend_found_1_m": contacts.curvature_across,
        "tilt_deg": degrees * truth.tilt,
        "eps_deg": degrees * wrap_angle(outcome.phi - truth.outward - np.pi),
        "theta_deg": degrees * outcome.angle,
        "q": 1.0 / np.maximum(np.abs(bend) * truth.distance * outcome.angle, 1e-9),
        "s_error_%": 100.0 * errors.distance_relative,
        "s_sigmas": errors.distance / np.maximum(contacts.sigma_distance, 1e-12),
        "n_error_deg": degrees * errors.normal,
        "n_sigmas": errors.normal / np.maximum(contacts.sigma_normal, 1e-12),
        "n_facets_deg": degrees * outcome.facets,
        "n_sigma_deg": degrees * contacts.sigma_normal,
        "wrong": errors.wrong,
    }


def worst(outcome: Outcome, most: int = 12) -> str:
    """The unflagged contacts farthest out in sigmas, with what they lie on."""
    columns = details(outcome)
    size = np.maximum(np.abs(columns["s_sigmas"]), np.abs(columns["n_sigmas"])) * outcome.contacts.good
    order = np.argsort(size)[::-1][:most]
    lines = []
    for i in order[size[order] > 3.0]:
        kind = Kind(int(outcome.truth.kind[i])).name.lower()
        rung = Rung(int(outcome.rung[i])).name.lower() if outcome.rung[i] >= 0 else "-"
        lines.append(
            f"  {REGIONS[int(outcome.region[i])]:6s} {kind:4s} {rung:8s} s {columns['s_mm'][i]:5.1f} mm  "
            f"alpha {columns['alpha_deg'][i]:4.1f} ({columns['alpha_found_deg'][i]:4.1f})  "
            f"R {columns['R_mm'][i]:6.1f} ({columns['R_found_mm'][i]:6.1f})  "
            f"1/R_l {columns['bend_1_m'][i]:7.1f} ({columns['bend_found_1_m'][i]:7.1f})  "
            f"eps {columns['eps_deg'][i]:+5.1f}  q {min(columns['q'][i], 999.0):5.1f}  "
            f"ds {columns['s_error_%'][i]:+6.2f} % = {columns['s_sigmas'][i]:+5.1f} sigma  "
            f"dn {columns['n_error_deg'][i]:+6.2f} deg = {columns['n_sigmas'][i]:+5.1f} sigma  "
            f"mesh {columns['n_facets_deg'][i]:+5.2f}  pushes {outcome.contacts.pushes[i]}"
        )
    return "\n".join(lines)


def _commit() -> str:
    answer = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False
    )
    return answer.stdout.strip() or "unknown"


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--shapes", nargs="+", choices=shapes.NAMES, default=[*SMOOTH, *CORNERED])
    parser.add_argument("--strategies", nargs="+", choices=STRATEGIES, default=["model"])
    parser.add_argument("--rung", default="auto", help="forward model of the simulator")
    parser.add_argument("--contours", type=int, default=48, help="of each shape, a quarter for each friction")
    parser.add_argument("--step", type=float, help="distance between contacts [mm]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="folder for accuracy.md, accuracy.csv and the details")
    return parser.parse_args()


def main() -> None:
    """Measure, print as it goes, and write the tables."""
    args = _arguments()
    rows: list[dict[str, object]] = []
    step = None if args.step is None else args.step * 1e-3
    for name in args.shapes:
        for strategy in args.strategies:
            outcome = measure(
                name, strategy, contours=args.contours, rung=args.rung, seed=args.seed, step=step
            )
            new = rows_of(name, strategy, outcome)
            rows += new
            ends = {reason: outcome.reasons.count(reason) for reason in sorted(set(outcome.reasons))}
            used = {r.name.lower(): int(np.count_nonzero(outcome.rung == r)) for r in Rung}
            print(markdown(new), worst(outcome), sep="")
            print(f"{len(outcome.contacts)} contacts in {outcome.seconds:.1f} s; rungs {used}; ends {ends}\n")
            sys.stdout.flush()
            if args.out is not None:
                args.out.mkdir(parents=True, exist_ok=True)
                np.savez_compressed(args.out / f"{name}-{strategy}-{args.rung}.npz", **details(outcome))
    if args.out is not None:
        (args.out / "accuracy.md").write_text(markdown(rows), encoding="utf-8")
        with (args.out / "accuracy.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, fieldnames=list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)
        about = {
            "contour": contour.__version__,
            "commit": _commit(),
            "python": platform.python_version(),
            "numpy": np.__version__,
            "machine": platform.machine(),
            "rung": args.rung,
            "contours": args.contours,
            "seed": args.seed,
        }
        (args.out / "about.json").write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
