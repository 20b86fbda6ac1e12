"""Boxes over HTTP: how many a list has in total, and which boxes one overlaps."""

from tests.support import frames as scene


def test_list_of_boxes_returns_the_total_count_on_request(api, dataset):
    real, ghost = api.box_ids(dataset)[:2]
    api.review(real, "keep")
    api.review(ghost, "keep")

    for filters, total in (({}, 6), ({"conflict": "true"}, 1), ({"class": "van"}, 0)):
        page = api.json("/boxes", dataset=dataset, count="true", limit=1, **filters)
        assert page["total"] == total, filters
    assert "total" not in api.json("/boxes", dataset=dataset, limit=1)


def test_box_outside_the_image_is_in_no_range_of_matches(api):
    outside = {"id": "outside", "class": "car", "xyxy": [900, 900, 950, 950]}
    ghost = {"id": "ghost", "class": "car", "xyxy": scene.IN_THE_SKY}
    name = api.dataset()
    api.upload_frame(name, "a", {**scene.annotation(), "boxes": [outside, ghost]})

    for range_of_matches in ({"match_max": 10}, {"match_min": 0}):
        page = api.json("/boxes", dataset=name, count="true", **range_of_matches)
        assert [box["id"] for box in page["items"]] == ["ghost"]
        assert page["total"] == 1


def test_class_whose_name_has_a_comma_can_be_selected(api):
    box = {"id": "1", "class": "car,bus", "xyxy": scene.ON_THE_CAR}
    name = api.dataset()
    api.upload_frame(name, "a", {**scene.annotation(), "boxes": [box]})

    page = api.json("/boxes", dataset=name, **{"class": "car,bus"})

    assert [box["id"] for box in page["items"]] == ["1"]


def test_box_lists_the_boxes_that_it_overlaps_as_neighbours(api):
    rectangles = {
        "near": [8, 20, 24, 30],
        "part": [20, 22, 33, 32],
        "inside": [9, 21, 23, 29],
        "far": [42, 3, 52, 11],
    }
    boxes = [
        {"id": name, "class": "car", "xyxy": xyxy} for name, xyxy in rectangles.items()
    ]
    stored = api.upload_frame(
        api.dataset(), "a", {**scene.annotation(), "boxes": boxes}
    )
    ids = {box["id"]: box["box_id"] for box in stored["decisions"]}

    near = api.json(f"/boxes/{ids['near']}")

    assert near["neighbours"] == [ids["part"], ids["inside"]]
