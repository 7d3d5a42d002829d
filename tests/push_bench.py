"""Pushes against contacts that stay where they are: for strategies alone, without scene and tracing."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from contour import contact as reduced
from contour import elastica
from contour.antenna import Antenna, Sensor
from contour.contacts import Contacts, Kind
from contour.frames import Mount
from contour.machine import MachineModel, NoiseKey
from contour.sensing import Action, Bins, Strategy, Touch, binned
from contour.virtual import TrueContact, VirtualAntenna

QUIET = Sensor(moment_noise=1e-9, moment_drift=0.0, encoder_step=1e-9)
"""A sensor without noise to speak of: what is left is the mechanics."""


def true_contacts(n: int, **values) -> TrueContact:
    """n contacts: flat edges at 100 mm whose outer normal is +x_s, but for ``values``."""
    defaults = {
        "distance": 0.1,
        "outward": 0.0,
        "tilt": 0.0,
        "kind": Kind.SIDE,
        "radius_along": 0.0,
        "radius_across": np.inf,
        "friction": np.tan(np.deg2rad(10.0)),
        "body": 0,
        "region": -1,
        "extent": np.inf,
        "depth": 0.0,
    }
    shapes = {"point": (n, 3), "normal": (n, 3)}
    kinds = {"kind": np.int8, "region": np.int8, "body": np.int64}
    columns = {}
    for f in fields(TrueContact):
        value = values.get(f.name, defaults.get(f.name, 0.0))
        columns[f.name] = np.array(
            np.broadcast_to(value, shapes.get(f.name, (n,))), kinds.get(f.name, np.float64)
        )
    return TrueContact(**columns)


@dataclass
class Bench:
    """n antennas, each against one contact of ``truth``, touched along its normal."""

    truth: TrueContact
    sensor: Sensor = QUIET
    expected_off: float = 0.0
    """How far off the true normal the contour leads to expect it [rad]."""
    elevation: float = 0.0
    """phi2, by which the beam points upwards [rad]."""
    exact: bool = False
    """Whether the exact rod answers the pushes, and not the reduced one."""

    def __post_init__(self) -> None:
        self.antenna = Antenna(sensor=self.sensor)
        self.mount = Mount.identity()
        self.machine = MachineModel(sensor=self.sensor, initial_offset=0.0)
        self._virtual = VirtualAntenna(self.antenna, self.machine, self.mount, self._answer)
        self.pushes: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def _answer(self, contact, eps, path, rows):
        model = elastica if self.exact else reduced
        cycle = model.push_cycle(
            eps,
            path,
            distance=contact.distance,
            friction=contact.friction,
            radius_along=contact.radius_along,
            radius_across=contact.radius_across,
        )
        return np.where(cycle.slipped_off, 0.0, cycle.moment_angle), cycle.delta

    def touch(self) -> Touch:
        """The touches, as an approach along the inner normals would leave them."""
        n = self.truth.distance.size
        self._joints = np.tile([0.0, self.elevation], (n, 1))
        up = np.array([0.0, np.sin(self.elevation), np.cos(self.elevation)])  # in the sensor frame
        weight = self.antenna.gravity_force(up)
        return Touch(
            which=np.arange(n),
            joints=self._joints,
            base_in_plane=np.zeros((n, 2)),
            base_along=np.zeros(n),
            approach=self.truth.outward + np.pi,
            approach_share=np.ones(n),
            tare=np.tile([weight[1], -weight[0]], (n, 1)),
            tare_time=np.zeros(n),
            tare_samples=np.full(n, 20),
            preload=np.zeros((n, 2)),
            preload_samples=np.full(n, 10),
            rise=self.antenna.stiffness3 / self.truth.distance**2,
            expected=self.truth.outward + self.expected_off,
            expected_sigma=np.full(n, np.deg2rad(20.0)),
            fresh=np.ones(n, dtype=bool),
        )

    def first_push(self, eps: np.ndarray, angle: float) -> tuple[Bins, Touch]:
        """Bins of one push of every contact, ``eps`` (n,) rad off the inner normal, and the touches they began at."""
        touch = self.touch()
        n = len(touch)
        reading, _ = self._virtual.push(
            self.truth,
            which=np.arange(n),
            key=NoiseKey(antenna=np.arange(n), approach=np.ones(n, dtype=int), push=np.ones(n, dtype=int)),
            clock=np.zeros(n),
            joints=touch.joints,
            phi=self.truth.outward + np.pi + eps,
            angle=np.full(n, angle),
            moment_limit=np.full(n, 0.015),
        )
        return binned(reading, touch, self.antenna, self.mount), touch

    def localise(self, strategy: Strategy, *, fresh=True, drop_after: int = 20, **changes) -> Contacts:
        """Contacts from ``strategy``; ``changes`` replace fields of the touch.

        After ``drop_after`` pushes the bodies are gone when the beam comes back.
        """
        touch = replace(self.touch(), **changes)
        touch = replace(touch, fresh=np.full(len(touch), fresh))
        strategy.start(touch)
        for turn in range(20):
            ask = strategy.ask()
            rows = np.flatnonzero(ask.action != Action.DONE)
            if rows.size == 0:
                return strategy.contacts()
            if turn >= drop_after:
                strategy.drop(rows)
                continue
            self.pushes.append((rows, ask.phi[rows], ask.action[rows].copy()))
            reading, _ = self._virtual.push(
                self.truth.take(rows),
                which=rows,
                key=NoiseKey(antenna=rows, approach=np.ones_like(rows), push=np.full_like(rows, turn + 1)),
                clock=np.zeros(rows.size),
                joints=self._joints[rows],
                phi=ask.phi[rows],
                angle=ask.angle[rows],
                moment_limit=ask.moment_limit[rows],
                watch=strategy.watch(rows),
            )
            strategy.tell(rows, touch.take(rows), reading)
        raise AssertionError("a contact asked for more than 20 pushes")
