"""The boxes by which somebody who is new learns to answer."""

import json

from tests.support.sensors import lesson

LESSON = ["full", "walled", "partly", "gone", "behind"]


def test_boxes_of_known_truth_are_for_people_who_have_answered_no_others(api):
    dataset = api.dataset(coached=True)
    frame = lesson()
    annotation = json.loads(frame.pop("annotation"))
    annotation["boxes"].append({"id": "far", "class": "car", "xyxy": [0, 0, 9, 9]})
    api.upload_frame(dataset, "a", annotation=annotation, **frame)
    boxes = {box["id"]: box for box in api.json("/boxes", dataset=dataset)["items"]}

    taught = api.json(f"/datasets/{dataset}/coached")["items"]
    assert [box["id"] for box in taught] == LESSON
    assert [bool(box["visible_pixels"]) for box in taught] == [
        *(True, False, True, False, False)
    ]

    api.review(boxes["full"]["box_id"], "reject", 0)
    assert api.json(f"/datasets/{dataset}/coached")["items"] != []
    api.review(boxes["far"]["box_id"], "reject", 0)
    assert api.json(f"/datasets/{dataset}/coached")["items"] == []


def test_datasets_coach_nobody_unless_they_say_so(api):
    dataset = api.dataset()
    frame = lesson()
    annotation = json.loads(frame.pop("annotation"))
    api.upload_frame(dataset, "a", annotation=annotation, **frame)

    assert api.json(f"/datasets/{dataset}/coached")["items"] == []
