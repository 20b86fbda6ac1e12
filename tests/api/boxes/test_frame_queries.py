"""The response about a stored frame takes few queries."""

import re

from tests.support import frames as scene
from tests.support.statements import statements_of

BOXES = 60


def test_replaced_frame_is_returned_without_querying_evidence(service, own_api):
    """Every other writer waits for queries within the transaction."""
    name, ids = own_api.dataset_of_cars(BOXES)
    assert own_api.review(ids[3], "keep", comment="seen").status_code == 201
    boxes = [{"class": "car", "xyxy": scene.ON_THE_CAR} for _ in range(BOXES)]
    boxes[4] = {"class": "car", "xyxy": scene.IN_THE_SKY}
    annotation = {**scene.annotation(), "boxes": boxes}

    with statements_of(service.app.state.database.engine) as statements:
        response = own_api.upload_frame(name, "a", annotation, replace=True)

    assert [text for text, _ in statements if "FROM evidence" in text] == []
    frame = own_api.json(f"/frames/{response['frame']['id']}")
    assert response["decisions"] == frame["boxes"]
    assert response["decisions"][3]["review"]["comment"] == "seen"
    assert response["frame"]["counts"] == frame["counts"]
    assert frame["counts"]["reviewed"] == 1


def test_frame_is_read_with_one_query_per_table(service, own_api):
    name, _ = own_api.dataset_of_cars(BOXES)
    frame = own_api.json(f"/datasets/{name}/frames")["items"][0]["id"]

    with statements_of(service.app.state.database.engine) as statements:
        own_api.json(f"/frames/{frame}")

    queries = [
        text for text, _ in statements if re.search("FROM (evidence|frame_files)", text)
    ]
    assert len(queries) == len(set(queries)) == 2
