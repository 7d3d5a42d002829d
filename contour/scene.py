"""Scenes: what is mapped, with which antenna on which machine, and how; from TOML or made for a bare mesh.

Sections of a scene file; every key but ``mesh`` is optional; lengths, angles and so on carry a unit in the
key or in the value (contour.quantities)::

    [[object]]                      # one or more bodies
    mesh = "mug.ply"                # relative to the scene file
    unit = "mm"                     # of the mesh's numbers
    position_mm = [0, 0, 0]         # of the mesh's origin in the world
    rotation_deg = [0, 0, 90]       # about the world's x, then y, then z axis
    friction_angle_deg = 10         # for the simulator alone

    [antenna]                       # length_mm, diameter_mm, youngs_modulus_GPa, adaptor_mm, ...
    [gantry]                        # speeds, axis limits, floor, mount
    [scan]                          # strategy, rung, tolerance, seed, surface
    [plan]                          # family, step_mm, contours, ...

A misspelled key is refused by name. Everything is checked before anything is made.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from contour.antenna import Antenna, Beam, Sensor
from contour.errors import UsageError
from contour.frames import Mount
from contour.ladder import RUNGS
from contour.machine import MachineModel
from contour.plan import Plan, Reach, default_plan, levels_plan, orientation_plan
from contour.quantities import ANY_LENGTH, METRES_PER, Key, closest, read_section
from contour.strategy import STRATEGIES

__all__ = ["SURFACES", "Body", "PlanSettings", "ScanSettings", "Scene", "load_scene", "scene_of_record"]

FloatArray = NDArray[np.float64]

FAMILIES = ("default", "levels", "silhouettes")
"""Kinds of plan."""
SURFACES = ("auto", "hermite", "layers", "none")
"""Ways to the surface after a scan: contour.surface.METHODS, or none."""
STEEPEST_FRICTION = float(np.deg2rad(80.0))
"""Friction angles from here on are no friction angles any more [rad]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Body:
    """One object of a scene."""

    mesh: Path
    """File of the mesh."""
    unit: str | None
    """Unit of the mesh's numbers; None where the file itself must say."""
    placement: FloatArray
    """(4, 4) T_world_object, translation in m."""
    friction_angle: float
    """rad; the simulator's alone, no estimator sees it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanSettings:
    """How to sense."""

    strategy: str = "model"
    """One of contour.strategy.STRATEGIES."""
    rung: str = "auto"
    """One of contour.ladder.RUNGS, for the simulator."""
    tolerance: float = 1e-3
    """Error of the simulator's forward model that ``auto`` allows, as a share of the moment."""
    seed: int = 0
    """Of everything random."""
    surface: str = "auto"
    """One of :data:`SURFACES`."""

    def __post_init__(self) -> None:
        for word, known, what in (
            (self.strategy, STRATEGIES, "strategy"),
            (self.rung, RUNGS, "rung"),
            (self.surface, SURFACES, "surface method"),
        ):
            if word not in known:
                raise UsageError(f"no {what} is called {word!r}: {closest(word, known)}")
        if not 0.0 < self.tolerance < 1.0:
            raise UsageError(f"scan tolerance is {self.tolerance!r}: it must be a share between 0 and 1")
        if self.seed < 0:
            raise UsageError(f"seed is {self.seed}: it must be zero or more")


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanSettings:
    """Which contours to follow."""

    family: str = "default"
    """One of ``default``, ``levels`` (needs axis and heights) and ``silhouettes`` (needs directions)."""
    step: float | None = None
    """Distance between contacts [m]; a twentieth of the object's longest edge if None."""
    contours: int = 60
    """How many at most, in the default plan."""
    starts: int = 1
    """Lines of first contact for each outline."""
    axis: tuple[float, ...] = ()
    """Beam direction of ``levels``, world."""
    heights: tuple[float, ...] = ()
    """Coordinates of the tip along it [m]."""
    directions: tuple[tuple[float, ...], ...] = ()
    """Beam directions of ``silhouettes``, world."""

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise UsageError(f"no plan family is called {self.family!r}: {closest(self.family, FAMILIES)}")
        if self.step is not None and not self.step > 0.0:
            raise UsageError(f"plan step is {self.step * 1e3:g} mm: it must be above zero")
        if self.contours < 1 or self.starts < 1:
            raise UsageError(f"plan has {self.contours} contours and {self.starts} starts: give at least one")
        needs = {"default": (), "levels": ("axis", "heights"), "silhouettes": ("directions",)}[self.family]
        for name in ("axis", "heights", "directions"):
            if bool(getattr(self, name)) != (name in needs):
                verb = "needs" if name in needs else "has no use for"
                raise UsageError(
                    f"plan family {self.family!r} {verb} {name}: give it to the family it belongs to"
                )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """Everything that a scan is made from."""

    name: str
    """Of the result folder."""
    bodies: tuple[Body, ...]
    """What is mapped."""
    antenna: Antenna
    """The instrument."""
    machine: MachineModel
    """What carries it."""
    mount: Mount
    """How the gantry's base stands in the world."""
    reach: Reach
    """Where the base may go."""
    scan: ScanSettings
    """How to sense."""
    plan: PlanSettings
    """Which contours to follow."""

    def build_plan(self, bounds: FloatArray) -> Plan:
        """The contours to follow round an object with ``bounds`` (2, 3) m in the world."""
        settings = self.plan
        step, starts = settings.step, settings.starts
        where = (bounds, self.antenna, self.mount, self.reach)
        if settings.family == "levels":
            return levels_plan(settings.axis, settings.heights, *where, step=step, starts=starts)
        if settings.family == "silhouettes":
            return orientation_plan(settings.directions, *where, step=step, starts=starts)
        return default_plan(*where, contours=settings.contours, step=step, starts=starts)

    def resolved(self) -> dict[str, Any]:
        """Every number of the scene in SI, for ``run.json``."""
        return {
            "name": self.name,
            "objects": [asdict(body) for body in self.bodies],
            "antenna": asdict(self.antenna),
            "machine": asdict(self.machine),
            "mount": asdict(self.mount),
            "reach": asdict(self.reach),
            "scan": asdict(self.scan),
            "plan": asdict(self.plan),
        }


def _keys(**kinds: tuple[str, str]) -> dict[str, Key]:
    return {name: Key(kind=kind, usual=usual) for name, (kind, usual) in kinds.items()}


_BEAM_KEYS = _keys(
    length=("length", "mm"),
    diameter=("length", "mm"),
    youngs_modulus=("stress", "GPa"),
    density=("density", "kg_m3"),
    adaptor=("length", "mm"),
    yield_stress=("stress", "MPa"),
)
_SENSOR_KEYS = _keys(
    moment_noise=("moment", "uNm"),
    moment_drift=("moment rate", "uNm_s"),
    encoder_step=("angle", "deg"),
    sample_rate=("frequency", "Hz"),
    touch_sigmas=("number", ""),
)
_MACHINE_KEYS = _keys(
    travel_speed=("speed", "mm_s"),
    approach_speed=("speed", "mm_s"),
    retreat_speed=("speed", "mm_s"),
    acceleration=("acceleration", "m_s2"),
    push_speed=("turn speed", "deg_s"),
    return_speed=("turn speed", "deg_s"),
    turn_speed=("turn speed", "deg_s"),
    turn_acceleration=("turn acceleration", "rad_s2"),
    initial_offset=("moment", "uNm"),
)
_AXES = {
    **{axis: Key(kind="length", usual="mm", length=2) for axis in "xyz"},
    **{axis: Key(kind="angle", usual="deg", length=2) for axis in ("phi1", "phi2")},
}
_POSE_KEYS = {
    "position": Key(kind="length", usual="mm", length=3),
    "rotation": Key(kind="angle", usual="deg", length=3),
}
_SECTIONS: dict[str, dict[str, Key]] = {
    "object": {
        "mesh": Key(kind="text"),
        "unit": Key(kind="text", choices=tuple(METRES_PER)),
        "friction_angle": Key(kind="angle", usual="deg"),
        **_POSE_KEYS,
    },
    "antenna": {**_BEAM_KEYS, **_SENSOR_KEYS, "moment_limit": Key(kind="moment", usual="mNm")},
    "gantry": {**_MACHINE_KEYS, **_AXES, **_POSE_KEYS, "floor": Key(kind="length", usual="mm")},
    "scan": {
        "strategy": Key(kind="text", choices=STRATEGIES),
        "rung": Key(kind="text", choices=RUNGS),
        "tolerance": Key(kind="number"),
        "seed": Key(kind="whole"),
        "surface": Key(kind="text", choices=SURFACES),
    },
    "plan": {
        "family": Key(kind="text", choices=FAMILIES),
        "step": Key(kind="length", usual="mm"),
        "contours": Key(kind="whole"),
        "starts": Key(kind="whole"),
        "axis": Key(kind="number", length=3),
        "heights": Key(kind="length", usual="mm", length=ANY_LENGTH),
        "directions": Key(kind="vectors"),
    },
}
DEFAULT_FRICTION = float(np.deg2rad(10.0))
"""Friction angle of a body that names none [rad]."""


def load_scene(
    path: Path,
    *,
    unit: str | None = None,
    strategy: str | None = None,
    seed: int | None = None,
    surface: str | None = None,
) -> Scene:
    """The scene of a TOML file, or the default scene around a mesh file.

    Args:
        path: ``.toml`` or a mesh.
        unit: unit of meshes for which the scene names none.
        strategy: instead of the scene's.
        seed: instead of the scene's.
        surface: instead of the scene's.

    Raises:
        UsageError: whatever is wrong with it, in one line.
    """
    if unit is not None and unit not in METRES_PER:
        raise UsageError(f"--unit {unit!r} is unknown: {closest(unit, METRES_PER)}")
    if not path.is_file():
        raise UsageError(f"{path} does not exist or is no file: check the path")
    if path.stat().st_size == 0:
        raise UsageError(f"{path} is empty: write it again")
    toml = path.suffix.lower() == ".toml"
    sections = _parse(path) if toml else {"object": [{"mesh": path.name}]}
    scene = _build(path, sections)
    bodies = tuple(replace(body, unit=body.unit or unit) for body in scene.bodies)
    asked = {"strategy": strategy, "seed": seed, "surface": surface}
    chosen = {k: v for k, v in asked.items() if v is not None}
    scan = replace(scene.scan, **chosen)  # type: ignore[arg-type]
    return replace(scene, bodies=bodies, scan=scan, machine=replace(scene.machine, seed=scan.seed))


def scene_of_record(record: Mapping[str, Any], folder: Path | None = None) -> Scene:
    """The scene that :meth:`Scene.resolved` wrote down, as ``run.json`` has it.

    Meshes that are not where the record says are looked for in ``folder``, by their names.
    """
    antenna, machine, plan = record["antenna"], record["machine"], record["plan"]
    limits = {
        name: np.array([least if number is None else number for number in record["reach"][name]])
        for name, least in (("lower", -np.inf), ("upper", np.inf))  # JSON has no infinity
    }
    floor = record["reach"]["floor"]
    sensor = Sensor(**antenna["sensor"])
    bodies = [
        {**body, "mesh": _found(Path(body["mesh"]), folder), "placement": np.array(body["placement"])}
        for body in record["objects"]
    ]
    return Scene(
        name=record["name"],
        bodies=tuple(Body(**body) for body in bodies),
        antenna=Antenna(beam=Beam(**antenna["beam"]), sensor=sensor, moment_limit=antenna["moment_limit"]),
        machine=MachineModel(**{**machine, "sensor": Sensor(**machine["sensor"])}),
        mount=Mount(np.array(record["mount"]["rotation"]), np.array(record["mount"]["origin"])),
        reach=Reach(**limits, floor=-np.inf if floor is None else floor),
        scan=ScanSettings(**record["scan"]),
        plan=PlanSettings(
            **{
                **plan,
                "axis": tuple(plan["axis"]),
                "heights": tuple(plan["heights"]),
                "directions": tuple(tuple(direction) for direction in plan["directions"]),
            }
        ),
    )


def _found(mesh: Path, folder: Path | None) -> Path:
    """A mesh where it was, or else beside the results."""
    beside = None if folder is None else folder / mesh.name
    return beside if beside is not None and not mesh.is_file() and beside.is_file() else mesh


def _parse(path: Path) -> dict[str, Any]:
    try:
        sections = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} is not valid TOML: {error}") from error
    for name, section in sections.items():
        if name not in _SECTIONS:
            raise UsageError(f"{path}: section [{name}] is unknown: {closest(name, _SECTIONS)}")
        tables = section if name == "object" and isinstance(section, list) else [section]
        if not all(isinstance(table, dict) for table in tables):
            raise UsageError(f"{path}: {name} must be a section: write [{name}]")
    if "object" not in sections:
        raise UsageError(f'{path} has no object: add [[object]] with mesh = "file.ply"')
    return sections


def _build(path: Path, sections: Mapping[str, Any]) -> Scene:
    values = {
        name: read_section(f"{path} [{name}]", sections.get(name, {}), keys)
        for name, keys in _SECTIONS.items()
        if name != "object"
    }
    objects = sections["object"] if isinstance(sections["object"], list) else [sections["object"]]
    bodies = tuple(_body(path, f"{path} [[object]] {i + 1}", table) for i, table in enumerate(objects))
    antenna, gantry = values["antenna"], values["gantry"]
    try:
        sensor = Sensor(**_only(antenna, _SENSOR_KEYS))
        instrument = Antenna(
            beam=Beam(**_only(antenna, _BEAM_KEYS)), sensor=sensor, **_only(antenna, ("moment_limit",))
        )
        machine = MachineModel(sensor=sensor, **_only(gantry, _MACHINE_KEYS))
        reach = Reach(
            lower=np.array([gantry.get(axis, (-np.inf, np.inf))[0] for axis in _AXES]),
            upper=np.array([gantry.get(axis, (-np.inf, np.inf))[1] for axis in _AXES]),
            floor=gantry.get("floor", -np.inf),
        )
        scan, plan = ScanSettings(**values["scan"]), PlanSettings(**values["plan"])
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from error
    placement = _placement(gantry)
    return Scene(
        name=path.stem,
        bodies=bodies,
        antenna=instrument,
        machine=machine,
        mount=Mount(placement[:3, :3], placement[:3, 3]),
        reach=reach,
        scan=scan,
        plan=plan,
    )


def _body(path: Path, where: str, section: Mapping[str, Any]) -> Body:
    values = read_section(where, section, _SECTIONS["object"])
    if "mesh" not in values:
        raise UsageError(f'{where} has no mesh: add mesh = "file.ply"')
    mesh = path.parent / values["mesh"]
    if not mesh.is_file():
        raise UsageError(
            f"{where}: mesh {mesh} does not exist: check the path, which is relative to the scene"
        )
    friction_angle = values.get("friction_angle", DEFAULT_FRICTION)
    if not 0.0 <= friction_angle < STEEPEST_FRICTION:
        raise UsageError(
            f"{where}: friction angle is {np.rad2deg(friction_angle):g} deg: it must lie in 0 to "
            f"{np.rad2deg(STEEPEST_FRICTION):g} deg"
        )
    return Body(
        mesh=mesh, unit=values.get("unit"), placement=_placement(values), friction_angle=friction_angle
    )


def _placement(values: Mapping[str, Any]) -> FloatArray:
    """T (4, 4) of a position and of turns about the fixed axes x, y and z."""
    placement = np.eye(4)
    placement[:3, :3] = Rotation.from_euler("xyz", values.get("rotation", (0.0, 0.0, 0.0))).as_matrix()
    placement[:3, 3] = values.get("position", (0.0, 0.0, 0.0))
    return placement


def _only(values: Mapping[str, Any], names: Mapping[str, Key] | tuple[str, ...]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if name in names}
