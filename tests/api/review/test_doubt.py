"""Boxes to review are the same wherever they are counted, and others are in bins."""

import pytest

from tests.support import frames as scene
from tests.support.api import BY_TAGS

CAR = scene.ON_THE_CAR
BOXES = [
    {"id": "in front", "class": "car", "xyxy": CAR, "distance": 10},
    {"id": "behind", "class": "car", "xyxy": CAR, "distance": 20},
    {"id": "wall", "class": "car", "xyxy": scene.IN_THE_SKY, "distance": 30},
    {"id": "small", "class": "walker", "xyxy": [40, 10, 43, 13], "distance": 90},
    {"id": "outside", "class": "car", "xyxy": [90, 0, 99, 9], "distance": 5},
]
BINS = {"in front": "ask", "behind": "ask", "wall": "wall", "small": "small",
        "outside": "sure"}  # fmt: skip


@pytest.fixture
def dataset(api):
    """Three frames with a box of each bin, decided by tags, in a new dataset."""
    name = api.dataset(config=BY_TAGS)
    for number in range(3):
        annotation = {**scene.annotation(), "boxes": BOXES, "number": number}
        api.upload_frame(name, str(number), annotation)
    return name


def numbers_to_review(api, dataset):
    """Every number that says how many boxes are to be reviewed."""
    queue = api.post(f"/datasets/{dataset}/queue", {}).json()
    listed = {"dataset": dataset, "bin": "ask", "review": "undecided"}
    frames = api.json(f"/datasets/{dataset}/frames")["items"]
    stats = api.json(f"/datasets/{dataset}/stats")
    return {
        api.json(f"/datasets/{dataset}")["counts"]["to_review"],
        stats["to_review"],
        stats["bins"]["ask"],
        queue["remaining"] + queue["unsure"],
        sum(frame["counts"]["to_review"] for frame in frames),
        api.json("/boxes", count="true", **listed)["total"],
    }


def test_to_review_is_one_number_everywhere(api, dataset):
    counted = [numbers_to_review(api, dataset)]
    to_ask = api.boxes(dataset, sort="doubt", bin="ask")

    for box, verdict in zip(to_ask, ("keep", "unsure", "reject"), strict=False):
        api.review(box["box_id"], verdict)
        counted.append(numbers_to_review(api, dataset))

    assert counted == [{6}, {5}, {5}, {4}]


def test_box_says_its_bin_and_why_it_is_asked_about(api, dataset):
    boxes = {box["id"]: box for box in api.boxes(dataset)}

    assert {name: box["bin"] for name, box in boxes.items()} == BINS
    assert boxes["behind"]["question"] == (
        "kept by its tags, but the nearer car in front covers 100 % of it"
    )
    assert boxes["in front"]["question"] == (
        "kept by its tags, but the farther car behind covers 100 % of it"
    )
    assert [boxes[name]["question"] for name in ("wall", "small", "outside")] == [
        None
    ] * 3


def test_upload_says_the_same_of_its_boxes_as_a_list(api, dataset):
    annotation = {**scene.annotation(), "boxes": BOXES, "number": 9}
    stored = api.upload_frame(dataset, "9", annotation)

    listed = api.boxes(dataset)[-len(BOXES) :]

    assert [(box["bin"], box["question"]) for box in stored["decisions"]] == [
        (box["bin"], box["question"]) for box in listed
    ]


@pytest.mark.parametrize("name", ["wall", "small", "sure"])
def test_bin_is_answered_in_bulk_and_undone(api, dataset, name):
    filters = {"bin": name, "review": "undecided"}
    seen = api.json("/boxes", dataset=dataset, limit=1, count="true", **filters)
    body = {"dataset": dataset, "verdict": "reject", "filter": filters}

    batch = api.post("/reviews/bulk", body | {"snapshot": seen["snapshot"]}).json()
    left = api.json(f"/datasets/{dataset}/stats")["bins"]
    api.post(f"/review-batches/{batch['id']}/undo")

    every = {"ask": 6, "wall": 3, "small": 3, "sure": 3}
    assert batch["count"] == seen["total"] == 3
    assert left == every | {name: 0}
    assert api.json(f"/datasets/{dataset}/stats")["bins"] == every


def test_queue_of_another_bin_and_samples_have_boxes_that_are_not_in_doubt(
    api, dataset
):
    def remaining(**body):
        return api.post(f"/datasets/{dataset}/queue", body).json()["remaining"]

    assert remaining() == remaining(order="class") == 6
    assert remaining(filters={"bin": "wall"}) == 3
    assert remaining(order="random") == 15
    assert remaining(filters={"class": "walker"}) == 3


def test_bins_follow_the_configuration(api, dataset):
    no_tag = {"car": {"accept": ["Truck"]}}

    api.run(dataset, {**BY_TAGS, "review_min_side": 1, "classes": no_tag})

    assert {box["id"]: box["bin"] for box in api.boxes(dataset)} == {
        **dict.fromkeys(BINS, "wall"),
        "outside": "sure",
    }
    assert numbers_to_review(api, dataset) == {0}
