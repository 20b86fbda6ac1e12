"""Between which distances a box is, and how far ahead, over HTTP and in stored rows."""

from tests.support import frames as scene

CAR = {"class": "car", "xyxy": scene.ON_THE_CAR}
RANGED = {
    "carla_version": "0.9.15",
    "boxes": [
        {"id": "far", **CAR, "distance_range": [100, 150]},
        {"id": "known", **CAR, "distance": 20},
    ],
}
SIZE = {"width": scene.WIDTH, "height": scene.HEIGHT, "fov": 90}
SOLID = {
    "carla_version": "0.9.15",
    "camera": {**SIZE, "transform": {"x": 0, "y": 0, "z": 0}},
    "boxes": [
        {
            "id": name,
            "class": "car",
            "box3d": {"transform": {"x": x, "y": 0, "z": 0}, "extent": [2, 1, 1]},
        }
        for name, x in (("beside", 0.5), ("ahead", 9))
    ],
}


def reasons(api, dataset):
    return {box["id"]: box["reason"] for box in api.boxes(dataset)}


def test_distance_range_is_stored_returned_and_compared_with_limits(api):
    dataset = api.dataset_of_one_frame(RANGED)

    run = api.run(dataset, {"max_distance": 100})

    assert run["state"] == "done"
    boxes = {box["id"]: box for box in api.boxes(dataset)}
    assert boxes["far"]["distance_range"] == [100, 150]
    assert (boxes["far"]["distance"], boxes["known"]["distance"]) == (None, 20)
    assert boxes["known"]["distance_range"] is None
    assert (boxes["far"]["reason"], boxes["known"]["reason"]) == (
        "out_of_range",
        "visible",
    )
    assert boxes["far"]["explanation"] == (
        "rejected: it is 100 to 150 m away, at most 100 m are allowed"
    )
    for filters, expected in (
        ({"distance_min": 100}, {"far"}),
        ({"distance_max": 150}, {"far", "known"}),
        ({"distance_min": 101}, set()),
        ({"distance_max": 149}, {"known"}),
        # Counted in the columns in memory, not by the database.
        ({"distance_min": 100, "count": True}, {"far"}),
    ):
        page = api.json("/boxes", dataset=dataset, **filters)
        assert {box["id"] for box in page["items"]} == expected
        assert page.get("total", len(expected)) == len(expected)


def test_min_forward_measures_again_and_puts_near_centres_out_of_range(api):
    dataset = api.dataset_of_one_frame(SOLID)
    before = reasons(api, dataset)

    run = api.run(dataset, {"min_forward": 1})

    assert run["state"] == "done"
    assert before["beside"] != "out_of_range"
    assert reasons(api, dataset) == {**before, "beside": "out_of_range"}
