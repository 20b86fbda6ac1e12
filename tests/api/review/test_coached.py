"""The boxes by which somebody who is new learns to answer."""

import json

from tests.support.sensors import lesson

LESSON = ["full", "walled", "partly", "gone", "behind"]


def test_boxes_of_known_truth_are_for_people_who_have_answered_no_others(api):
    """Datasets that do not say so coach nobody."""
    dataset, plain = api.dataset(coached=True), api.dataset()
    frame = lesson()
    annotation = json.loads(frame.pop("annotation"))
    annotation["boxes"].append({"id": "far", "class": "car", "xyxy": [0, 0, 9, 9]})
    for name in (dataset, plain):
        api.upload_frame(name, "a", annotation=annotation, **frame)
    boxes = {box["id"]: box for box in api.json("/boxes", dataset=dataset)["items"]}

    taught = api.json(f"/datasets/{dataset}/coached")["items"]
    assert [box["id"] for box in taught] == LESSON
    assert [bool(box["visible_pixels"]) for box in taught] == [
        *(True, False, True, False, False)
    ]
    assert api.json(f"/datasets/{plain}/coached")["items"] == []

    api.review(boxes["full"]["box_id"], "reject", 0)
    assert api.json(f"/datasets/{dataset}/coached")["items"] != []
    api.review(boxes["far"]["box_id"], "reject", 0)
    assert api.json(f"/datasets/{dataset}/coached")["items"] == []
