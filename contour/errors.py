"""The exceptions that contour raises on purpose.

ContourError
|-- UsageError (also ValueError)     bad input: what it is, and the remedy
|-- LimitViolation                   a pose, angle or moment outside what the machine allows
|-- NotConverged                     an iteration that gave up, with its residual
|-- InstrumentError                  a request the instrument must refuse in its present state
`-- LinkError                        trouble between the host and a controller
    |-- LinkTimeout                  nothing came in time
    |-- DeviceFault                  the controller reports an alarm
    `-- ProtocolViolation            what came is not what the contract says
"""

__all__ = [
    "ContourError",
    "DeviceFault",
    "InstrumentError",
    "LimitViolation",
    "LinkError",
    "LinkTimeout",
    "NotConverged",
    "ProtocolViolation",
    "UsageError",
]


class ContourError(Exception):
    """Root of everything that contour raises on purpose."""


class UsageError(ContourError, ValueError):
    """Bad input. The message names the thing, what was found and the remedy, in one line."""


class LimitViolation(ContourError):
    """A request beyond a limit of the machine. The message gives value, range and remedy."""


class NotConverged(ContourError):
    """An iteration that stopped before its tolerance."""

    def __init__(self, what: str, *, residual: float, iterations: int) -> None:
        super().__init__(f"{what} did not converge: residual {residual:.3g} after {iterations} iterations")
        self.residual = residual
        """What was left of the equations, in their own relative unit."""
        self.iterations = iterations
        """Iterations made."""


class InstrumentError(ContourError):
    """The instrument cannot do this now (for instance, take a zero while it touches)."""


class LinkError(ContourError):
    """Trouble between the host and a controller."""


class LinkTimeout(LinkError):
    """Nothing came from the controller in time."""


class DeviceFault(LinkError):
    """The controller reports an alarm or refuses a command."""


class ProtocolViolation(LinkError):
    """A reply that the contract does not allow."""
