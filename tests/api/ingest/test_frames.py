"""Frames: stored once, replaced on request, listed, deleted."""

import json
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from tests.support import frames as scene
from tests.support.api import BASE

CAR = {"id": "real", "class": "car", "xyxy": scene.ON_THE_CAR}
GHOST = {"id": "ghost", "class": "car", "xyxy": scene.IN_THE_SKY}


def test_same_frame_again_is_200_in_any_order_of_its_json_keys(api):
    dataset = api.dataset()
    first = api.put(dataset, "a")
    turned: dict[str, Any] = dict(reversed(list(scene.annotation().items())))
    turned["boxes"] = [dict(reversed(list(box.items()))) for box in turned["boxes"]]
    spaced = json.dumps(turned, indent=4).encode()

    again = [api.put(dataset, "a"), api.put(dataset, "a", spaced)]
    replaced = api.put(dataset, "a", spaced, replace=True)

    assert [response.status_code for response in (*again, replaced)] == [200, 200, 200]
    assert [response.json() for response in (*again, replaced)] == [first.json()] * 3
    assert again[0].headers["location"] == first.headers["location"]


def test_other_content_of_the_same_frame_key_is_409(api):
    dataset = api.dataset()
    first = api.upload_frame(dataset, "a")
    image, segmentation = scene.image(), scene.segmentation()

    for other in (
        {"annotation": scene.annotation_of(CAR)},
        {"image": scene.image(1), "segmentation": segmentation},
        {"image": image},
    ):
        response = api.put(dataset, "a", **other)
        problem = response.json()
        assert (response.status_code, problem["code"]) == (409, "frame_conflict"), other
        assert "?replace=true" in problem["detail"]
    assert api.json(f"/frames/{first['frame']['id']}")["revision"] == 1
    assert api.json(f"/datasets/{dataset}")["counts"]["problems"] == 0


def test_concurrent_uploads_of_one_frame_key_store_one_frame(api):
    dataset = api.dataset()

    with ThreadPoolExecutor(4) as pool:
        same = list(pool.map(lambda _: api.put(dataset, "same").status_code, range(4)))
        other = list(
            pool.map(
                lambda n: api.put(dataset, "b", image=scene.image(n)).status_code,
                range(4),
            )
        )

    assert sorted(same) == [200, 200, 200, 201]
    assert sorted(other) == [201, 409, 409, 409]
    assert api.json(f"/datasets/{dataset}/stats")["boxes"] == 4


def test_replaced_frame_keeps_the_answers_of_unchanged_boxes(api):
    dataset = api.dataset()
    moved = {**CAR, "id": "moved"}
    renamed = {**CAR, "id": "renamed"}
    cleared = {**CAR, "id": "cleared"}
    old = api.upload_frame(
        dataset, "a", scene.annotation_of(CAR, moved, renamed, cleared)
    )
    for box in old["decisions"]:
        assert api.review(box["box_id"], "reject", comment="no").status_code == 201
    api.review(old["decisions"][3]["box_id"], "clear", 1)

    new = api.upload_frame(
        dataset,
        "a",
        scene.annotation_of(
            GHOST,
            {**cleared, "instance_id": 7},
            {**CAR, "note": "the same box"},
            {**moved, "xyxy": [20, 24, 40, 41]},
            {**renamed, "class": "truck"},
        ),
        replace=True,
    )

    boxes = {box["id"]: box for box in new["decisions"]}
    assert (new["frame"]["revision"], len(boxes)) == (2, 5)
    assert {key for key, box in boxes.items() if box["review"]} == {"real"}
    assert boxes["real"]["review"] == {
        "verdict": "reject",
        "reviewer": "admin",
        "revision": 1,
        "comment": "no",
        "created_at": boxes["real"]["review"]["created_at"],
    }
    assert boxes["real"]["effective_verdict"] == "rejected"
    history = api.json(f"/boxes/{boxes['real']['box_id']}/history")["items"]
    assert [entry["kind"] for entry in history] == ["review", "decision"]
    assert history[0]["carried_from"] == old["decisions"][0]["box_id"]
    assert api.json(f"/datasets/{dataset}/stats")["reviewed"] == 1
    assert old["answers_set_aside"] == 0
    assert (new["answers_set_aside"], new["boxes_set_aside"]) == (
        2,
        ["moved", "renamed"],
    )


def test_replacing_names_the_first_of_many_boxes_whose_answers_are_set_aside(api):
    dataset = api.dataset()
    boxes = [{**CAR, "id": f"box-{number}"} for number in range(12)]
    old = api.upload_frame(dataset, "a", scene.annotation_of(*boxes))
    ids = [box["box_id"] for box in old["decisions"]]
    body = {"dataset": dataset, "box_ids": ids, "verdict": "reject"}
    assert api.post("/reviews/bulk", body).status_code == 201

    new = api.upload_frame(dataset, "a", scene.annotation_of(GHOST), replace=True)
    again = api.put(dataset, "a", scene.annotation_of(GHOST), replace=True).json()

    assert new["answers_set_aside"] == 12
    assert new["boxes_set_aside"] == [f"box-{number}" for number in range(10)]
    assert (again["answers_set_aside"], again["boxes_set_aside"]) == (0, [])


@pytest.mark.parametrize(("yaw", "keeps"), [(0, True), (30, False)])
def test_answer_on_a_3d_box_is_carried_over_only_with_the_same_camera(api, yaw, keeps):
    corners = [[x, y, z] for x in (9, 11) for y in (-1, 1) for z in (0, 2)]
    box = {"id": "1", "class": "car", "vertices": corners}

    def seen_from(yaw):
        place = {"x": 0, "y": 0, "z": 1, "pitch": 0, "yaw": yaw, "roll": 0}
        size = {"width": scene.WIDTH, "height": scene.HEIGHT, "fov": 90}
        return {**scene.annotation_of(box), "camera": {**size, "transform": place}}

    dataset = api.dataset()
    old = api.upload_frame(dataset, "a", seen_from(0))
    api.review(old["decisions"][0]["box_id"], "keep")

    new = api.upload_frame(
        dataset, "a", {**seen_from(yaw), "note": "again"}, replace=True
    )

    assert (new["decisions"][0]["review"] is not None) is keeps


def test_superseded_revision_of_a_frame_stays_readable(api):
    dataset = api.dataset()
    old = api.upload_frame(dataset, "a")
    box = old["decisions"][0]["box_id"]
    api.review(box, "keep")
    new = api.upload_frame(dataset, "a", scene.annotation_of(CAR), replace=True)
    back = api.upload_frame(dataset, "a", replace=True)

    shown = api.json(f"/frames/{old['frame']['id']}")
    assert (shown["superseded"], shown["boxes"]) == (True, [])
    assert api.get(f"/boxes/{box}").status_code == 404
    assert api.review(box, "reject", 1).status_code == 404
    assert len(api.json(f"/boxes/{box}/history")["items"]) == 2
    assert api.get(f"/frames/{old['frame']['id']}/image").content == scene.image()
    assert [each["frame"]["revision"] for each in (new, back)] == [2, 3]
    assert api.json(f"/datasets/{dataset}/frames/a")["id"] == back["frame"]["id"]
    (listed,) = api.json(f"/datasets/{dataset}/frames")["items"]
    assert listed["id"] == back["frame"]["id"]
    assert api.json(f"/datasets/{dataset}/stats")["boxes"] == 2


def test_deleting_a_frame_deletes_its_boxes_and_answers(api):
    dataset = api.dataset()
    gone = api.upload_frame(dataset, "a/1")
    api.upload_frame(dataset, "a/2")
    api.review(gone["decisions"][0]["box_id"], "reject")
    path = f"{BASE}/datasets/{dataset}/frames/a/1"

    responses = [api.http.delete(path), api.http.delete(path)]

    assert [response.status_code for response in responses] == [204, 404]
    box = gone["decisions"][0]["box_id"]
    for url in (f"/frames/{gone['frame']['id']}", f"/boxes/{box}"):
        assert api.get(url).status_code == 404
    assert api.get(f"/boxes/{box}/history").status_code == 404
    assert keys(api.json(f"/datasets/{dataset}/frames")) == ["a/2"]
    stats = api.json(f"/datasets/{dataset}/stats")
    assert (stats["frames"], stats["boxes"], stats["reviewed"]) == (1, 2, 0)
    assert api.put(dataset, "a/1").status_code == 201


@pytest.fixture(scope="module")
def town(api):
    """Five frames; only the third has a truck, only the fourth a far box."""
    dataset = api.dataset()
    more = {2: {**CAR, "class": "truck"}, 3: {**CAR, "distance": 80.0}}
    for number in range(5):
        boxes = [CAR] if number == 4 else [more.get(number, CAR), GHOST]
        api.upload_frame(
            dataset, f"town{number // 3}/{number}", scene.annotation_of(*boxes)
        )
    return dataset


def keys(response):
    return [item["key"] for item in response["items"]]


def test_listed_frame_has_its_counts_and_which_files_it_has(api):
    """Boxes without a segmentation count as unmeasured."""
    dataset, image = api.dataset(), scene.image()
    outside = {"id": "out", "class": "car", "xyxy": [70, 0, 80, 9]}
    empty = api.upload_frame(dataset, "0", {"boxes": []}, image=image)
    assert (empty["decisions"], empty["segmentation"]) == ([], None)
    described = api.json(f"/datasets/{dataset}")
    assert described["thumbnail_frame_id"] == empty["frame"]["id"]
    api.upload_frame(dataset, "b", scene.annotation_of(CAR, outside), image=image)
    stats = api.json(f"/datasets/{dataset}/stats")
    api.upload_frame(dataset, "a")

    listed = api.json(f"/datasets/{dataset}/frames")["items"]

    assert stats["effective"] == {"kept": 0, "rejected": 1, "unmeasured": 1}
    assert stats["by_reason"] == {"outside_image": 1, "no_segmentation": 1}
    assert stats["to_review"] == 1
    names = ("boxes", "kept", "rejected", "unmeasured", "to_review")
    counts = [[item["counts"][name] for name in names] for item in listed]
    assert counts == [[0, 0, 0, 0, 0], [2, 1, 1, 0, 0], [2, 0, 1, 1, 1]]
    files = [(item["has_image"], item["has_segmentation"]) for item in listed]
    assert files == [(True, False), (True, True), (True, False)]
    assert api.put("nowhere", "a").status_code == 404


@pytest.mark.parametrize("sort", ["key", "-key", "id", "-id"])
def test_frame_pagination_by_key_or_id_in_both_directions(api, town, sort):
    items = api.json(f"/datasets/{town}/frames")["items"]
    by = sort.removeprefix("-")
    expected = sorted((item[by] for item in items), reverse=sort.startswith("-"))

    seen, path = [], f"{BASE}/datasets/{town}/frames?limit=2&sort={sort}"
    while path:
        response = api.http.get(path)
        seen += [item[by] for item in response.json()["items"]]
        path = response.links.get("next", {}).get("url")

    assert seen == expected


@pytest.mark.parametrize(
    ("filters", "expected"),
    [
        ({"key": "town1/"}, ["town1/3", "town1/4"]),
        ({"class": "truck"}, ["town0/2"]),
        ({"class": "dragon"}, []),
        ({"verdict": "rejected", "key": "town1"}, ["town1/3"]),
        ({"reason": "visible", "distance_min": 50}, ["town1/3"]),
        ({"review": "any"}, []),
    ],
)
def test_frames_are_filtered_by_their_boxes(api, town, filters, expected):
    assert keys(api.json(f"/datasets/{town}/frames", **filters)) == expected


def test_frame_has_the_ids_of_the_previous_and_next_frame(api, town):
    ids = [item["id"] for item in api.json(f"/datasets/{town}/frames")["items"]]

    around = [api.json(f"/frames/{frame}") for frame in ids]

    assert [frame["previous_id"] for frame in around] == [None, *ids[:-1]]
    assert [frame["next_id"] for frame in around] == [*ids[1:], None]
