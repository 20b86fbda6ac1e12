"""Every annotation that docs/*.md shows as an example can be parsed as one."""

import json
import re

import pytest

from filter_core import parse_annotation
from tests.support.sources import CHECKOUT

DOCS = CHECKOUT / "docs"
BLOCK = re.compile(r"```json\n(.*?)```", re.DOTALL)
EXAMPLES = [
    pytest.param(block, id=f"{path.name} {number}")
    for path in sorted(DOCS.glob("*.md"))
    for number, block in enumerate(BLOCK.findall(path.read_text("utf-8")))
    if '"boxes"' in block
]


@pytest.mark.parametrize("block", EXAMPLES)
def test_every_example_annotation_can_be_parsed(block):
    shown = json.loads(block)

    parsed = [box.id for box in parse_annotation(shown).boxes]

    assert len(parsed) == len(shown["boxes"])
    named = {box["id"] for box in shown["boxes"] if "id" in box}
    assert named <= set(parsed)
