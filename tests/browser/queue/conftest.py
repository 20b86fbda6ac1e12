"""A queue that takes several answers."""

import pytest

from tests.support.page import many_boxes
from tests.support.page.scenes import MakeScene, Scene


@pytest.fixture
def twenty_boxes(make_scene: MakeScene) -> Scene:
    """Twenty boxes on one frame: b0, b2, ... are kept, b1, b3, ... are rejected."""
    return make_scene(boxes=many_boxes.alternating_boxes(20))
