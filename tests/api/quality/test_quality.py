"""The filter's verdicts compared with people's answers, over HTTP."""

import pytest

from tests.support import frames as scene
from tests.support.api import BY_TAGS, Api

FRAMES = 4


@pytest.fixture(scope="module")
def people(api, server):
    """Clients of two reviewers besides the admin."""
    opened = []
    for name in ("ada", "eve"):
        body = {"name": f"{name}-{api.dataset()}", "role": "reviewer"}
        token = api.post("/tokens", body).json()["token"]
        opened.append(Api.at(server.url, {"Authorization": f"Bearer {token}"}))
    yield opened
    for client in opened:
        client.http.close()


@pytest.fixture
def dataset(api):
    """Frames of a car, a quarter of a car and a ghost, at several distances."""
    name = api.dataset(config=BY_TAGS)
    for number in range(FRAMES):
        boxes: list[dict[str, object]] = [
            {"id": "real", "xyxy": scene.ON_THE_CAR, "distance": 50.0 * number},
            {"id": "partly", "xyxy": [20, 24, 60, 46], "distance": 10},
            {"id": "ghost", "xyxy": scene.IN_THE_SKY},
        ]
        boxes = [{**box, "class": "car"} for box in boxes]
        api.upload_frame(name, str(number), {**scene.annotation(), "boxes": boxes})
    return name


def box_ids_of(api, dataset, source):
    return [box["box_id"] for box in api.boxes(dataset) if box["id"] == source]


def quality(api, dataset, **query):
    return api.json(f"/datasets/{dataset}/quality", **query)


def confusion_counts(confusion):
    names = ("kept_keep", "kept_reject", "rejected_keep", "rejected_reject")
    return [confusion[name] for name in names]


def test_quality_without_answers_is_empty(api, dataset):
    report = quality(api, dataset)

    assert (report["reviewed"], report["unsure"], report["unmeasured"]) == (0, 0, 0)
    assert confusion_counts(report["confusion"]) == [0, 0, 0, 0]
    assert report["confusion"]["f1"] is None
    assert [report[name] for name in ("by_class", "reviewers", "suggested")] == [
        *({}, [], [])
    ]
    assert report["agreement"] == {
        **dict.fromkeys(("boxes", "agreed"), 0),
        **dict.fromkeys(("percent", "kappa", "interval")),
        "pairs": [],
    }


def test_confusion_counts_verdicts_against_answers(api, dataset):
    real, ghost = box_ids_of(api, dataset, "real"), box_ids_of(api, dataset, "ghost")
    for box_id in real[:3]:
        api.review(box_id, "keep")
    api.review(real[3], "reject")
    api.review(ghost[0], "keep")
    api.review(ghost[1], "reject")
    api.review(ghost[2], "unsure")

    response = quality(api, dataset)

    assert (response["reviewed"], response["unsure"]) == (6, 1)
    assert confusion_counts(response["confusion"]) == [3, 1, 1, 1]
    assert response["by_class"] == {"car": response["confusion"]}
    bands = {band["band"]: confusion_counts(band) for band in response["by_distance"]}
    assert bands == {
        "0-50": [1, 0, 0, 0],
        "50-100": [1, 0, 0, 0],
        "100-150": [1, 0, 0, 0],
        "150-200": [0, 1, 0, 0],
        ">200": [0, 0, 0, 0],
        "unknown": [0, 0, 1, 1],
    }


@pytest.fixture
def street(api):
    """Forty cars and forty ghosts; the filter keeps the cars, and people half of each.

    People keep those with an even number.
    """
    name = api.dataset(config=BY_TAGS)
    boxes = [
        {"id": f"{number}{more}", "class": of, "xyxy": xyxy}
        for number in range(40)
        for more, of, xyxy in (
            ("", "car", scene.ON_THE_CAR),
            ("-ghost", "truck", scene.IN_THE_SKY),
        )
    ]
    api.upload_frame(name, "a", {**scene.annotation(), "boxes": boxes})
    return name


def answer_truly(api, box):
    number = int(box["id"].removesuffix("-ghost"))
    api.review(box["box_id"], "reject" if number % 2 else "keep", box["revision"])


def answer_queue(api, dataset, count, order, **filters):
    """Answer so many boxes of the queue truly, as the page does."""
    body = {"order": order, "limit": count, "filters": filters}
    for box in api.post(f"/datasets/{dataset}/queue", body).json()["items"]:
        answer_truly(api, box)


def test_answers_on_doubtful_boxes_cannot_say_how_good_the_filter_is(api, street):
    answer_queue(api, street, 30, "doubt", review="none")

    response = quality(api, street)
    confusion = response["confusion"]

    assert sum(confusion_counts(confusion)) == 30
    assert [confusion[name] for name in ("precision", "recall", "f1")] == [None] * 3
    assert confusion["refused"] == "no_random_answers"
    assert response["plan"]["boxes"] == 50  # all that are left
    assert response["sample"] == {
        "boxes": 80,
        "before": 30,
        "answered": 0,
        "unsure": 0,
        "unanswered": 0,
    }


def test_random_answers_and_those_before_them_estimate_all_boxes(api, street):
    answer_queue(api, street, 20, "doubt", review="none")
    answer_queue(api, street, 50, "random")

    response = quality(api, street)
    sample, confusion = response["sample"], response["confusion"]

    assert (sample["before"], sample["answered"], sample["unanswered"]) == (20, 50, 0)
    for name in ("precision", "recall"):
        low, high = confusion[name]["low"], confusion[name]["high"]
        assert low <= 0.5 <= high
        assert 0.02 < high - low < 0.2
    assert confusion["refused"] is None


def test_sample_of_a_class_represents_that_class_alone(api, street):
    answer_queue(api, street, 30, "random", **{"class": "car"})

    response = quality(api, street)

    assert response["by_class"]["car"]["precision"]["low"] > 0
    assert response["confusion"]["recall"] is None
    assert response["confusion"]["refused"] == "too_few_random_answers"


def test_answers_of_other_filters_are_in_no_sample(api, street):
    answer_queue(api, street, 30, "random", verdict="kept")

    response = quality(api, street)

    assert response["sample"]["answered"] == 0
    assert response["confusion"]["refused"] == "no_random_answers"


def test_boxes_that_were_skipped_are_unanswered_in_the_sample(api, street):
    body = {"order": "random", "limit": 50}
    boxes = api.post(f"/datasets/{street}/queue", body).json()["items"]
    for box in [*boxes[:10], *boxes[20:]]:
        answer_truly(api, box)
    skipped = quality(api, street)
    again = api.post(f"/datasets/{street}/queue", body | {"limit": 10}).json()["items"]
    for box in boxes[10:20]:
        answer_truly(api, box)
    answered = quality(api, street)

    assert (skipped["sample"]["answered"], skipped["sample"]["unanswered"]) == (40, 10)
    assert [box["box_id"] for box in again] == [box["box_id"] for box in boxes[10:20]]
    assert answered["sample"]["unanswered"] == 0


def test_answers_on_all_boxes_are_exact(api, street):
    for box in api.boxes(street, limit=100):
        answer_truly(api, box)

    confusion = quality(api, street)["confusion"]

    for name in ("precision", "recall", "f1"):
        assert confusion[name] == {"value": 0.5, "low": 0.5, "high": 0.5}


def test_reviewers_are_compared_by_their_latest_answers(api, dataset, people):
    ada, eve = people
    boxes = api.box_ids(dataset)
    for box_id in boxes[:4]:
        ada.review(box_id, "reject")
        ada.review(box_id, "keep", 1)
    for box_id, verdict in zip(
        boxes[:4], ["keep", "keep", "reject", "unsure"], strict=True
    ):
        eve.review(box_id, verdict, 2)
    eve.review(boxes[4], "reject")
    eve.review(boxes[4], "clear", 1)

    report = quality(api, dataset)

    assert [
        (person["answers"], person["keep"], person["reject"], person["unsure"])
        for person in report["reviewers"]
    ] == [(4, 4, 0, 0), (4, 2, 1, 1)]
    agreed = report["agreement"]
    assert (agreed["boxes"], agreed["agreed"]) == (3, 2)
    assert agreed["percent"] == pytest.approx(200 / 3)
    assert agreed["kappa"] == pytest.approx(0)
    assert [(pair["boxes"], pair["agreed"]) for pair in agreed["pairs"]] == [(3, 2)]
    assert agreed["pairs"][0]["a"].startswith("ada-")


def test_answer_that_somebody_else_has_cleared_counts_for_its_reviewer(
    api, dataset, people
):
    ada, eve = people
    box_id = api.box_ids(dataset)[0]
    ada.review(box_id, "keep")
    eve.review(box_id, "reject", 1)
    api.review(box_id, "clear", 2)

    report = quality(api, dataset)

    agreed = report["agreement"]
    assert (agreed["boxes"], agreed["agreed"]) == (1, 0)
    names = [person["name"][:3] for person in report["reviewers"]]
    assert [person["answers"] for person in report["reviewers"]] == [1, 1]
    assert sorted(names) == ["ada", "eve"]


@pytest.mark.parametrize("in_bulk", [False, True])
def test_undone_answer_counts_for_no_reviewer(api, dataset, people, in_bulk):
    ada, eve = people
    box_id = api.boxes(dataset)[0]["box_id"]
    ada.review(box_id, "keep")
    if in_bulk:
        seen = {"box_ids": [box_id], "seen_revisions": [1]}
        body = {"dataset": dataset, "verdict": "reject", **seen}
        batch = eve.post("/reviews/bulk", body).json()
        eve.post(f"/review-batches/{batch['id']}/undo")
    else:
        eve.review(box_id, "reject", 1)
        eve.post(f"/boxes/{box_id}/reviews/2/undo")

    report = quality(api, dataset)

    assert confusion_counts(report["confusion"])[0::2] == [1, 0]
    assert report["agreement"]["boxes"] == 0
    (reviewer,) = report["reviewers"]
    assert (reviewer["name"][:3], reviewer["keep"]) == ("ada", 1)


def test_thresholds_are_suggested_from_the_answers(api, dataset):
    for source, verdict in [("real", "keep"), ("partly", "reject")]:
        for box_id in box_ids_of(api, dataset, source):
            api.review(box_id, verdict)

    (of_cars,) = quality(api, dataset)["suggested"]
    partly = api.boxes(dataset, sort="match_percent", match_min=1)[0]["match_percent"]

    assert (of_cars["class"], of_cars["current"], of_cars["answers"]) == ("car", 10, 8)
    assert partly < of_cars["suggested"] < 100
    assert of_cars["f1_current"] == pytest.approx(2 * 4 / (2 * 4 + 4))
    assert of_cars["f1_suggested"] == 1
    assert of_cars["interval"][0] <= of_cars["suggested"] <= of_cars["interval"][1]
    curve = {point["threshold"]: point for point in of_cars["curve"]}
    assert curve[10]["precision"] == 0.5
    assert curve[of_cars["suggested"]]["recall"] == 1


def test_thresholds_are_suggested_for_a_target_recall(api, dataset):
    real, partly = (box_ids_of(api, dataset, name) for name in ("real", "partly"))
    for box_id in (*real, *partly[1:]):
        api.review(box_id, "keep")
    api.review(partly[0], "reject")
    match = api.boxes(dataset, sort="match_percent", match_min=1)[0]["match_percent"]

    suggested = [
        quality(api, dataset, **query)["suggested"][0]["suggested"]
        for query in ({}, {"target": "recall", "recall": 0.5})
    ]
    invalid: tuple[dict[str, object], ...] = (
        {"recall": 0.5},
        {"recall": 0.5, "target": "f1"},
        {"recall": 0, "target": "recall"},
        {"recall": 2, "target": "recall"},
        {"target": "luck"},
    )
    refused = [api.get(f"/datasets/{dataset}/quality", **query) for query in invalid]

    # More than half of the boxes to keep match completely.
    assert suggested[0] <= match < suggested[1]
    assert [response.status_code for response in refused] == [422] * 5
    (fault,) = refused[0].json()["errors"]
    assert fault["pointer"] == "/query/recall"
    assert "target=recall" in fault["detail"]
