"""The one place that imports CARLA's client library, and names for its objects."""

from __future__ import annotations

from typing import Any, TypeAlias

from unghost.capture.errors import CaptureError, SimulatorAway

# The library is an extra and its types differ between versions: these are words.
Carla: TypeAlias = Any
Client: TypeAlias = Any
World: TypeAlias = Any
Actor: TypeAlias = Any
Blueprint: TypeAlias = Any
Snapshot: TypeAlias = Any
Measurement: TypeAlias = Any
Box: TypeAlias = Any
Pose: TypeAlias = Any
Vector: TypeAlias = Any


def load_carla() -> Carla:
    """The module `carla`, of whatever version is installed.

    Raises
    ------
    CaptureError
        It is not installed; the text says how to install it.
    """
    try:
        import carla
    except ImportError as error:
        raise CaptureError(
            "capture needs CARLA's client library: pip install 'unghost[carla]', or "
            f"carla in the version of your simulator ({error})"
        ) from error
    return carla


def connect(carla: Carla, host: str, port: int, timeout_s: float) -> Client:
    """A client of the simulator, which has answered once.

    Raises
    ------
    SimulatorAway
        Nothing answers within the time-out.
    """
    try:
        # A name that stands for no address is refused here already.
        client = carla.Client(host, port)
        client.set_timeout(timeout_s)
        client.get_server_version()
    except RuntimeError as error:
        raise SimulatorAway(f"no simulator at {host}:{port}: {error}") from error
    return client


def answers(client: Client, timeout_s: float) -> bool:
    """Whether the simulator is there; the client waits no longer from here on."""
    client.set_timeout(timeout_s)
    try:
        client.get_server_version()
    except RuntimeError:
        return False
    return True
