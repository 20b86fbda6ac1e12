"""What can go wrong with a capture, in words for people."""

from __future__ import annotations


class CaptureError(Exception):
    """A capture cannot begin or go on; the text says why."""


class ScenarioError(CaptureError):
    """A scenario is wrong, or does not fit the simulator; nothing was spawned."""


class SimulatorAway(CaptureError):
    """No simulator answers at the address."""
