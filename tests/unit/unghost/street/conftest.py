"""A short drive through every town, rendered once."""

from __future__ import annotations

import pytest

from tests.support.decoded_frame import DecodedFrame
from unghost.street.street import StreetScene

FRAMES = 12


@pytest.fixture(scope="session")
def drive():
    """The first frames of the demo, towns by turns."""
    return [DecodedFrame(frame) for frame in StreetScene(0).frames(FRAMES)]
