"""The response about a stored frame takes few queries."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest

from tests.support import frames as scene
from tests.support.api import Api
from tests.support.statements import statements_of

BOXES = 60


@pytest.fixture
def api(service) -> Iterator[Api]:
    with service.admin() as client:
        yield Api(client)


def test_replaced_frame_is_returned_without_querying_evidence(service, api):
    """Every other writer waits for queries within the transaction."""
    name, ids = api.dataset_of_cars(BOXES)
    assert api.review(ids[3], "keep", comment="seen").status_code == 201
    boxes = [{"class": "car", "xyxy": scene.ON_THE_CAR} for _ in range(BOXES)]
    boxes[4] = {"class": "car", "xyxy": scene.IN_THE_SKY}
    annotation = {**scene.annotation(), "boxes": boxes}

    with statements_of(service.app.state.database.engine) as found:
        answer = api.upload_frame(name, "a", annotation, replace=True)

    assert [text for text, _ in found if "FROM evidence" in text] == []
    frame = api.json(f"/frames/{answer['frame']['id']}")
    assert answer["decisions"] == frame["boxes"]
    assert answer["decisions"][3]["review"]["comment"] == "seen"
    assert answer["frame"]["counts"] == frame["counts"]
    assert frame["counts"]["reviewed"] == 1


def test_frame_is_read_with_one_query_per_table(service, api):
    name, _ = api.dataset_of_cars(BOXES)
    frame = api.json(f"/datasets/{name}/frames")["items"][0]["id"]

    with statements_of(service.app.state.database.engine) as found:
        api.json(f"/frames/{frame}")

    asked = [
        text for text, _ in found if re.search("FROM (evidence|frame_files)", text)
    ]
    assert len(asked) == len(set(asked)) == 2
