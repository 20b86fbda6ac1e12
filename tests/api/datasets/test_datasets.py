"""Datasets: created, listed page by page, changed, deleted."""

import pytest

from tests.support import frames as scene
from tests.support.api import BASE
from unghost.wire.datasets import MAX_CLASSES

MASK = {"polygons": [[[0, 0], [64, 0], [64, 48], [0, 48]]]}


def test_names_may_have_upper_case_and_signs_and_are_unique_regardless_of_case(api):
    first = api.post("/datasets", {"name": "Town.10-H_D"})
    second = api.post("/datasets", {"name": "town.10-h_d"})
    http = api.http
    http.delete(f"{BASE}/datasets/Town.10-H_D", params={"confirm": "Town.10-H_D"})
    third = api.post("/datasets", {"name": "town.10-H_D"})

    assert (first.status_code, first.json()["name"]) == (201, "Town.10-H_D")
    assert (second.status_code, second.json()["code"]) == (409, "dataset_exists")
    assert second.json()["detail"] == "a dataset 'Town.10-H_D' exists already"
    assert third.status_code == 201


@pytest.mark.parametrize(
    ("body", "pointer"),
    [
        ({}, "/name"),
        ({"name": "a/b"}, "/name"),
        ({"name": ".."}, "/name"),
        ({"name": "a", "palette": "cityscapes"}, "/palette"),
        ({"name": "a", "colour": "blue"}, "/colour"),
        ({"name": "a", "classes": ["a\nb"]}, "/classes/0"),
        ({"name": "a", "description": "\0"}, "/description"),
        ({"name": "a", "recording": []}, "/recording"),
        (
            {"name": "a", "ignore_mask": {"polygons": [[[0, 0], [1, 1]]]}},
            "/ignore_mask/polygons/0",
        ),
    ],
)
def test_invalid_dataset_is_refused_with_a_pointer_to_its_field(api, body, pointer):
    problem = api.post("/datasets", body).json()

    assert (problem["status"], problem["code"]) == (422, "invalid_request")
    assert [fault["pointer"] for fault in problem["errors"]] == [pointer]


def test_dataset_pagination_by_name_follows_next_links(api):
    names = sorted(api.dataset() for _ in range(5))

    seen, path = [], f"{BASE}/datasets?limit=2"
    while path:
        response = api.http.get(path)
        assert len(response.json()["items"]) <= 2
        seen += [item["name"] for item in response.json()["items"]]
        path = response.links.get("next", {}).get("url")

    assert [name for name in seen if name in names] == names
    assert seen == sorted(set(seen))


@pytest.mark.parametrize(
    ("path", "status", "code"),
    [
        ("/datasets/nowhere", 404, "not_found"),
        ("/datasets/nowhere/stats", 404, "not_found"),
        ("/datasets/nowhere/frames", 404, "not_found"),
        ("/datasets/nowhere/runs", 404, "not_found"),
        ("/datasets/%00", 404, "not_found"),
        ("/datasets?limit=0", 422, "invalid_request"),
        ("/datasets?limit=1001", 422, "invalid_request"),
        ("/datasets?colour=blue", 400, "unknown_parameter"),
        ("/boxes", 422, "invalid_request"),
        ("/boxes?dataset=nowhere", 404, "not_found"),
        ("/boxes/0", 422, "invalid_request"),
        ("/boxes/9223372036854775808", 422, "invalid_request"),
        ("/boxes/9223372036854775807", 404, "not_found"),
        ("/frames/9223372036854775807", 404, "not_found"),
        ("/frames/1/radio", 422, "invalid_request"),
        ("/runs/9223372036854775807", 404, "not_found"),
        ("/configs/" + "0" * 64, 404, "not_found"),
        ("/configs/xyz", 422, "invalid_request"),
    ],
)
def test_invalid_path_or_parameter_has_its_status_and_code(api, path, status, code):
    response = api.get(path) if "?" not in path else api.http.get(BASE + path)

    assert (response.status_code, response.json()["code"]) == (status, code)


def test_dataset_description_is_changed_without_a_run(api):
    changes = {"description": "new", "rule": "new", "coached": False}
    name = api.dataset(description="old", rule="old", coached=True)
    before = api.json(f"/datasets/{name}")
    assert [before[key] for key in changes] == ["old", "old", True]

    for key, new in changes.items():
        response = api.http.patch(f"{BASE}/datasets/{name}", json={key: new})
        assert (response.status_code, response.json()[key]) == (200, new)
    after = api.json(f"/datasets/{name}")
    assert {key: after[key] for key in changes} == changes


def test_description_of_a_recording_is_kept_and_replaced_without_a_run(api):
    first = {"files": {"image": "cam/{frame}.png"}, "boxes": {"classes": ["car"]}}
    place = f"{BASE}/datasets/described"
    wrong = {"recording": {"boxes": {"unit": "feet"}}}

    response = api.post("/datasets", {"name": "described", "recording": first})
    refused = [
        api.post("/datasets", {"name": "wrong", **wrong}),
        api.http.patch(place, json=wrong),
    ]

    assert response.json()["recording"] == first
    assert api.json("/datasets/described")["recording"] == first
    for recording in ({"layout": "yolo"}, None):
        response = api.http.patch(place, json={"recording": recording})
        assert (response.status_code, response.json()["recording"]) == (200, recording)
    for response in refused:
        (error,) = response.json()["errors"]
        pointed = response.status_code, error["pointer"]
        assert pointed == (422, "/recording/boxes/unit")
        assert error["detail"].startswith("recording: boxes: unit: expected one of")


def test_null_as_a_dataset_setting_is_refused(api):
    """Null used to give a 409 or a run that failed."""
    place = f"{BASE}/datasets/{api.dataset()}"
    keys = ("description", "palette", "encoding", "channel_order", "lossy_segmentation")
    for key in keys:
        response = api.http.patch(place, json={key: None})
        refusal = (response.status_code, response.json()["code"])
        assert refusal == (422, "invalid_request"), key
        assert response.json()["errors"][0]["pointer"] == f"/{key}"


def test_ignore_mask_is_applied_by_a_run_and_can_be_removed(api):
    name = api.dataset_of_one_frame()
    path = f"{BASE}/datasets/{name}"

    accepted = api.http.patch(path, json={"ignore_mask": MASK, "description": "masked"})
    assert accepted.json()["kind"] == "measure"
    counts = {"kept": 0, "rejected": 2, "unmeasured": 0}
    assert api.wait_for_job(accepted)["counts"] == counts
    assert api.json(f"/datasets/{name}")["has_ignore_mask"] is True
    run = api.wait_for_job(api.http.patch(path, json={"ignore_mask": None}))
    assert run["changed"] == 1
    assert api.json(f"/datasets/{name}")["has_ignore_mask"] is False
    assert api.verdicts(name) == {"real": "kept", "ghost": "rejected"}


def test_dataset_setting_takes_effect_only_when_its_run_succeeds(api):
    name = api.dataset()
    api.upload_frame(name, "town/7")
    path = f"{BASE}/datasets/{name}"

    failed = api.wait_for_job(api.http.patch(path, json={"palette": "carla-0.9.10"}))
    unchanged = api.json(f"/datasets/{name}")["palette"]
    done = api.wait_for_job(api.http.patch(path, json={"palette": "carla-0.9.14"}))

    assert (failed["state"], unchanged) == ("failed", "auto")
    assert failed["error"]["code"] == "segmentation_contradiction"
    assert failed["error"]["detail"].startswith("frame town/7: ")
    assert (done["state"], done["kind"], done["changed"]) == ("done", "measure", 0)
    assert api.json(f"/datasets/{name}")["palette"] == "carla-0.9.14"


def test_a_setting_that_contradicts_the_config_is_refused(api):
    name = api.dataset()
    assert api.run(name, {"palette": "carla-0.9.14"})["state"] == "done"

    response = api.http.patch(
        f"{BASE}/datasets/{name}", json={"palette": "carla-0.9.10"}
    )

    assert response.json()["code"] == "segmentation_contradiction"
    assert name in response.json()["detail"]
    assert "the configuration" in response.json()["detail"]


def test_deleting_a_dataset_needs_its_name_as_confirmation(api):
    name = api.dataset()
    frame = api.upload_frame(name, "a")["frame"]["id"]
    path = f"{BASE}/datasets/{name}"

    forgotten = api.http.delete(path)
    wrong = api.http.delete(path, params={"confirm": "other"})
    right = api.http.delete(path, params={"confirm": name})

    assert (forgotten.status_code, wrong.status_code) == (400, 400)
    assert {each.json()["code"] for each in (forgotten, wrong)} == {"not_confirmed"}
    assert f"expected ?confirm={name}, found nothing" in forgotten.json()["detail"]
    assert wrong.json()["detail"].endswith("found 'other'")
    assert (right.status_code, right.content) == (204, b"")
    assert api.get(f"/datasets/{name}").status_code == 404
    assert api.get(f"/frames/{frame}").status_code == 404
    assert api.post("/datasets", {"name": name}).status_code == 201
    assert api.boxes(name) == []


def test_classes_keep_their_order_and_unknown_ones_are_appended(api):
    name = api.dataset(classes=["walker", "car", "walker"])
    boxes = [{"class": "dragon", "xyxy": [0, 0, 9, 9]}]

    stored = api.upload_frame(name, "a", {**scene.annotation(), "boxes": boxes})

    assert api.json(f"/datasets/{name}")["classes"] == ["walker", "car", "dragon"]
    assert stored["decisions"][0]["reason"] == "unmapped_class"


def boxes_of(*classes):
    box = {"xyxy": [0, 0, 9, 9]}
    return {**scene.annotation(), "boxes": [{**box, "class": name} for name in classes]}


def test_frame_with_more_classes_than_a_dataset_may_have_is_its_problem(api):
    name = api.dataset(classes=[f"class {number}" for number in range(MAX_CLASSES - 1)])
    api.upload_frame(name, "before", boxes_of("class 7"))

    refused = api.put(name, "a", boxes_of("class 7", "dragon", "griffin"))
    (problem,) = api.json(f"/datasets/{name}/problems")["items"]
    last = api.put(name, "b", boxes_of("dragon", "class 7"))
    full = api.put(name, "b", boxes_of("griffin"), replace=True)
    stored = api.put(name, "c", boxes_of("dragon", "class 998"))

    body = refused.json()
    assert (refused.status_code, body["code"]) == (422, "too_many_classes")
    assert body["detail"] == (
        f"frame a: expected at most 1000 classes in dataset '{name}', found 1001 with "
        "those of this frame, such as 'dragon'"
    )
    assert body["errors"][0]["pointer"] == "/boxes"
    assert (problem["key"], problem["error"]["code"]) == ("a", "too_many_classes")
    assert (last.status_code, full.status_code, stored.status_code) == (201, 422, 201)
    classes = api.json(f"/datasets/{name}")["classes"]
    assert (len(classes), classes[-1]) == (MAX_CLASSES, "dragon")


def test_dataset_is_not_created_with_more_classes_than_it_may_have(api):
    most = [f"class {number}" for number in range(MAX_CLASSES)]

    stored = api.post("/datasets", {"name": "most-classes", "classes": most})
    refused = api.post("/datasets", {"name": "too-many", "classes": [*most, "more"]})

    assert (stored.status_code, refused.status_code) == (201, 422)
    assert "1000" in refused.json()["errors"][0]["detail"]


def test_report_counts_effective_verdicts_by_distance_and_lists_worst_frames(api):
    dataset = api.dataset()
    box = {"class": "car", "xyxy": scene.IN_THE_SKY}
    near = {**box, "id": "near", "distance": 49.9}
    far = {**box, "id": "far", "distance": 200}
    bands = [
        {**box, "id": str(index), "distance_range": ends}
        for index, ends in enumerate(([0, 50], [50, 100], [30, 70]))
    ]
    rain = {"map": "Town01", "weather": {"preset": "WetNoon", "wetness": 50}}
    api.upload_frame(dataset, "a", {"boxes": [near, *bands], **rain})
    mist = {"map": "Town02", "weather": {"fog_density": 5}}
    boxes = {"boxes": [near, far, *[{**box, "id": f"{n}"} for n in range(3)]]}
    worst = api.upload_frame(dataset, "b", {**boxes, **mist})["frame"]["id"]
    (kept,) = (box for box in api.boxes(dataset) if box["id"] == "far")
    api.review(kept["box_id"], "keep")

    report = api.get(f"/datasets/{dataset}/report").json()

    none = {"kept": 0, "rejected": 0, "unmeasured": 0}
    assert report["by_distance"] == [
        {**none, "rejected": 3, "distance_from": 0, "distance_to": 50},
        {**none, "rejected": 1, "distance_from": 50, "distance_to": 100},
        {**none, "kept": 1, "distance_from": 200, "distance_to": None},
        {**none, "rejected": 4, "distance_from": None, "distance_to": None},
    ]
    first, second = {**none, "rejected": 4}, {**none, "kept": 1, "rejected": 4}
    assert report["by_map"] == [
        {"name": "Town01", **first},
        {"name": "Town02", **second},
    ]
    assert report["by_weather"] == [
        {"name": "WetNoon", **first},
        {"name": "other", **second},
    ]
    counts = api.get(f"/datasets/{dataset}/stats").json()["by_weather"]
    assert counts["other"] == {"frames": 1, "boxes": 5}
    filters = {"weather": "WetNoon", "distance_max": 50}
    listed = api.json(f"/datasets/{dataset}/frames", **filters)["items"]
    assert [frame["key"] for frame in listed] == ["a"]
    assert len(report["worst_frames"]) == 2
    assert worst in [frame["id"] for frame in report["worst_frames"]]
