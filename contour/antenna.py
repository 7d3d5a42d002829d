"""The antenna's own numbers: beam, moment sensor, encoders, and what follows from them.

The beam is straight, round and uniform, clamped to a rigid adaptor of length a at the centre of rotation. Its
stiffness EI = E pi d^4 / 64 sets the scale of everything: at small angles an edge at distance s answers a
turn theta with the moment 3 EI theta / s (Kaneko1998, (4)-(7) and (12)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contour.errors import UsageError

__all__ = ["GRAVITY", "Antenna", "Beam", "Sensor"]

FloatArray = NDArray[np.float64]

GRAVITY = 9.80665
"""Standard acceleration of free fall [m/s^2]."""


def _positive(**values: float) -> None:
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0.0):
            raise UsageError(f"antenna {name} is {value!r}: it must be a finite number above zero")


@dataclass(frozen=True, slots=True, kw_only=True)
class Beam:
    """A straight round elastic wire.

    >>> round(Beam().stiffness, 6)
    0.004142
    """

    length: float = 0.210
    """L [m], from the centre of rotation to the tip, the adaptor included."""
    diameter: float = 0.8e-3
    """d [m]."""
    youngs_modulus: float = 206e9
    """E [Pa]."""
    density: float = 7850.0
    """rho_v [kg/m^3]."""
    adaptor: float = 0.0
    """a [m], rigid stub between centre of rotation and beam."""
    yield_stress: float = 600e6
    """Stress that bends the wire for good [Pa]."""

    def __post_init__(self) -> None:
        _positive(
            length=self.length,
            diameter=self.diameter,
            youngs_modulus=self.youngs_modulus,
            density=self.density,
            yield_stress=self.yield_stress,
        )
        if not 0.0 <= self.adaptor < self.length:
            raise UsageError(
                f"antenna adaptor is {self.adaptor * 1e3:g} mm: it must be at least 0 and shorter than the "
                f"beam ({self.length * 1e3:g} mm)"
            )

    @property
    def radius(self) -> float:
        """Half the diameter [m]."""
        return 0.5 * self.diameter

    @property
    def second_moment(self) -> float:
        """I = pi d^4 / 64 [m^4]."""
        return float(np.pi * self.diameter**4 / 64.0)

    @property
    def stiffness(self) -> float:
        """EI [N m^2]."""
        return self.youngs_modulus * self.second_moment

    @property
    def yield_moment(self) -> float:
        """sigma I / (d/2) [N m]: 30 mN m for 0.8 mm at 600 MPa."""
        return self.yield_stress * self.second_moment / self.radius

    @property
    def line_weight(self) -> float:
        """w, weight per length [N/m]."""
        return float(self.density * np.pi * self.radius**2 * GRAVITY)

    @property
    def sag(self) -> float:
        """Tip deflection of the horizontal beam [m], (43) of Kaneko1998 with its slip mended.

        Printed: 8 rho g L^4 / (E d^4); a uniformly loaded cantilever gives
        w l^4 / (8 EI) = 8 rho_l g l^4 / (pi E d^4).

        >>> round(Beam().sag / Beam().length, 4)
        0.0108
        """
        return self.line_weight * (self.length - self.adaptor) ** 4 / (8.0 * self.stiffness)

    def sag_at(self, distance: ArrayLike) -> FloatArray:
        """Deflection [m] of the horizontal free beam at ``distance`` [m] from the centre of rotation.

        w x^2 (6 l^2 - 4 l x + x^2) / (24 EI), x and l from the adaptor's end.
        """
        x = np.maximum(np.asarray(distance, dtype=np.float64) - self.adaptor, 0.0)
        free = self.length - self.adaptor
        shape = x**2 * (6.0 * free**2 - 4.0 * free * x + x**2)
        return np.asarray(self.line_weight * shape / (24.0 * self.stiffness))

    @property
    def gravity_moment(self) -> float:
        """Moment of the horizontal beam's own weight about the centre of rotation [N m]."""
        return 0.5 * self.line_weight * (self.length**2 - self.adaptor**2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """The two-axis moment sensor and the two encoders at the base."""

    moment_noise: float = 10e-6
    """Standard deviation of a sample, each axis [N m]."""
    moment_drift: float = 1e-6
    """Rate of the offset's ramp, each axis [N m/s]."""
    encoder_step: float = float(np.deg2rad(0.001))
    """Step of the angle encoders [rad]."""
    sample_rate: float = 100.0
    """Samples a second [Hz]."""
    touch_sigmas: float = 5.0
    """Touch is declared when the moment exceeds this many standard deviations of a sample."""

    def __post_init__(self) -> None:
        _positive(
            moment_noise=self.moment_noise,
            encoder_step=self.encoder_step,
            sample_rate=self.sample_rate,
            touch_sigmas=self.touch_sigmas,
        )
        if not (np.isfinite(self.moment_drift) and self.moment_drift >= 0.0):
            raise UsageError(
                f"antenna moment_drift is {self.moment_drift!r}: it must be zero or more, in N m/s"
            )

    @property
    def touch_moment(self) -> float:
        """Moment at which touch is declared [N m]."""
        return self.touch_sigmas * self.moment_noise


@dataclass(frozen=True, slots=True, kw_only=True)
class Antenna:
    """One antenna: its beam, its sensor and the moment at which a push must stop."""

    beam: Beam = Beam()
    """The wire."""
    sensor: Sensor = Sensor()
    """Moment sensor and encoders."""
    moment_limit: float = 15e-3
    """Largest moment of a push [N m]; half of the yield moment for the default wire."""

    def __post_init__(self) -> None:
        _positive(moment_limit=self.moment_limit)
        if self.moment_limit > self.beam.yield_moment:
            raise UsageError(
                f"antenna moment limit {self.moment_limit * 1e3:.3g} mN m is above the yield moment "
                f"{self.beam.yield_moment * 1e3:.3g} mN m: lower it to about half, "
                f"{self.beam.yield_moment * 500:.3g} mN m"
            )
        if self.sensor.touch_moment >= 0.5 * self.moment_limit:
            raise UsageError(
                f"antenna feels touch at {self.sensor.touch_moment * 1e3:.3g} mN m but must stop at "
                f"{self.moment_limit * 1e3:.3g} mN m: it would yield before contact is felt; "
                "use a thicker beam or a quieter sensor"
            )

    @property
    def stiffness3(self) -> float:
        """3 EI [N m^2], the constant of (7) and (12): s = 3 EI C."""
        return 3.0 * self.beam.stiffness

    def compliance(self, distance: ArrayLike) -> FloatArray:
        """c0 [rad/(N m)] of an edge at ``distance`` [m]: (s - a)^3 / (3 EI s^2), or s / (3 EI) if a = 0."""
        s = np.asarray(distance, dtype=np.float64)
        return (s - self.beam.adaptor) ** 3 / (self.stiffness3 * s**2)

    def distance(self, compliance: ArrayLike) -> FloatArray:
        """Distance [m] of an edge from its compliance [rad/(N m)]; inverse of :meth:`compliance`.

        >>> round(float(Antenna().distance(Antenna().compliance(0.1))), 12)
        0.1
        """
        c = np.asarray(compliance, dtype=np.float64) * self.stiffness3
        s = c + 3.0 * self.beam.adaptor
        # Newton on (s - a)^3 = c s^2; from above its root the iteration falls monotonically.
        for _ in range(40 if self.beam.adaptor > 0.0 else 0):
            x = s - self.beam.adaptor
            s = s - (x**3 - c * s**2) / (3.0 * x**2 - 2.0 * c * s)
        return np.asarray(s)

    def gravity_force(self, up_sensor: FloatArray) -> FloatArray:
        """(-m_z, m_x) of the beam's weight [N m], (..., 2), for the world's up in sensor coordinates.

        The weight -w up per length at y gives m = y x f, so (-m_z, m_x) = integral of y (f_x, f_z).
        """
        return -self.beam.gravity_moment * np.stack((up_sensor[..., 0], up_sensor[..., 2]), axis=-1)
