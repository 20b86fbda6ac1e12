"""Configurations, identified by their content, and previews of their verdicts."""

import pytest

from tests.support import frames as scene
from tests.support.api import BASE, Api
from tests.support.live import block_jobs

CARS_ARE_SKY = {"classes": {"car": {"accept": ["Sky"]}}}
YAML = {"Content-Type": "application/yaml"}


def add_config(api, dataset, content, headers=YAML):
    path = f"{BASE}/datasets/{dataset}/configs"
    return api.http.post(path, content=content, headers=headers)


def test_config_versions_are_identified_by_content(api, dataset):
    yaml = b"# a comment\nthreshold_small_box: 12.0\n"
    first = add_config(api, dataset, yaml)
    same = add_config(api, dataset, b'{"threshold_small_box": 12}')
    simulator = add_config(
        api, dataset, b"sitting:\n  threshold_small_box: 4\n  cam_rgb: {width: 9}\n"
    )

    digest = first.json()["digest"]
    assert (first.status_code, same.status_code) == (201, 200)
    assert first.headers["location"] == f"{BASE}/configs/{digest}"
    assert same.json()["created_at"] == first.json()["created_at"]
    assert api.json(f"/configs/{digest}")["config"] == first.json()["config"]
    assert first.json()["config"]["threshold_small_box"] == 12
    assert first.json()["active"] is False
    assert simulator.json()["config"]["profile"] == "carlasimu"
    assert simulator.json()["unused_keys"]
    page = api.json(f"/datasets/{dataset}/configs", limit=2)
    assert [item["digest"] for item in page["items"]] == [
        simulator.json()["digest"],
        digest,
    ]
    (oldest,) = api.json(f"/datasets/{dataset}/configs", cursor=page["next_cursor"])[
        "items"
    ]
    assert oldest["digest"] == api.json(f"/datasets/{dataset}")["config"]
    assert oldest["active"] is True


def test_of_two_people_who_activate_at_once_the_second_is_refused(serve):
    """Activating a configuration again returns the open run."""
    service = serve()
    with service.admin() as http, block_jobs(service.app.state.services.engine):
        api = Api(http)
        dataset = api.dataset()
        path = f"{BASE}/datasets/{dataset}/config"
        seen = http.get(path)
        mine, yours = (
            add_config(api, dataset, b"min_visible_pixels: %d" % pixels).json()[
                "digest"
            ]
            for pixels in (8, 9)
        )
        match = {"If-Match": seen.headers["etag"]}

        first, again, unmatched = (
            http.put(path, json={"digest": mine}, headers=headers)
            for headers in (match, match, {})
        )
        second = http.put(path, json={"digest": yours}, headers=match)
        after = {"If-Match": f'"{mine}"'}
        knowing = http.put(path, json={"digest": yours}, headers=after)

    assert seen.headers["etag"] == f'"{seen.json()["digest"]}"'
    for response in (first, again, unmatched):
        assert (response.status_code, response.json()["id"]) == (
            202,
            first.json()["id"],
        )
        assert response.headers["location"] == first.headers["location"]
    problem = second.json()
    assert (second.status_code, problem["code"]) == (412, "stale_config")
    assert problem["current"]["digest"] == mine
    assert knowing.status_code == 202


NOT_ACCEPTED = (
    (b"treshold_small_box: 1", "unknown_key", "threshold_small_box"),
    (b"threshold_small_box: 101", "bad_config", "101"),
    (b"[" * 20_000, "bad_yaml", ""),
    (b"!!python/object/apply:os.system ['true']", "bad_yaml", ""),
    (b"a: &a [1]\nb: [*a, *a]", "bad_yaml", ""),
)


def test_invalid_config_is_refused(api, dataset):
    for content, code, words in NOT_ACCEPTED:
        response = add_config(api, dataset, content)
        refusal = (response.status_code, response.json()["code"])
        assert refusal == (422, code), response.text
        assert words in response.json()["detail"]
    for headers in ({"Content-Type": "text/plain"}, {}):
        assert add_config(api, dataset, b"{}", headers).status_code == 415
    assert add_config(api, dataset, b"a" * (1024**2 + 1)).status_code == 413
    assert len(api.json(f"/datasets/{dataset}/configs")["items"]) == 1


INVALID_REQUESTS = (
    ("preview", {"config": {"treshold_small_box": 1}}, 422),
    ("preview", {"config": [], "limit": 5}, 422),
    ("preview", {"config": {}, "bins": 1}, 422),
    ("runs", {"config": "0" * 64}, 404),
    ("runs", {"config": "xyz"}, 422),
    ("runs", {"config": {"palette": "cityscapes"}}, 422),
    ("runs", {"config": {}, "scope": "frame"}, 422),
    ("runs", {"config": {"classes": {"car": {"accept": ["Unicorn"]}}}}, 422),
)


def test_invalid_preview_or_run_request_is_refused(api, dataset):
    for path, body, status in INVALID_REQUESTS:
        response = api.post(f"/datasets/{dataset}/{path}", body)
        assert response.status_code == status, body
    assert api.verdicts(dataset) == {"real": "kept", "ghost": "rejected"}


def test_preview_returns_the_flips_and_writes_nothing(api, dataset):
    before = api.json(f"/datasets/{dataset}/runs"), api.json(f"/datasets/{dataset}")
    body = {"config": CARS_ARE_SKY, "bins": 2}

    preview = api.post(f"/datasets/{dataset}/preview", body).json()

    car, ghost = api.box_ids(dataset)
    each_way = {"kept_to_rejected": 1, "rejected_to_kept": 1}
    items = {item["box_id"]: item for item in preview["flips"].pop("items")}
    assert preview["flips"] == {"total": 2, **each_way, "by_class": {"car": each_way}}
    assert preview["counts"] == {"kept": 1, "rejected": 1, "unmeasured": 0}
    assert preview["by_reason"] == {"no_visible_pixels": 1, "visible": 1}
    histograms = preview["histograms"]
    assert (histograms["edges"], histograms["classes"]) == (
        [0.0, 50.0, 100.0],
        {"car": [1, 1]},
    )
    sides = {
        box: [items[box][side]["reason"] for side in ("before", "after")]
        for box in (car, ghost)
    }
    assert sides == {
        car: ["visible", "no_visible_pixels"],
        ghost: ["no_visible_pixels", "visible"],
    }
    assert items[ghost]["xyxy"] == api.json(f"/boxes/{ghost}")["xyxy"]
    after = api.json(f"/datasets/{dataset}/runs"), api.json(f"/datasets/{dataset}")
    assert after == before


@pytest.mark.parametrize(
    ("mask", "active", "previewed", "match"),
    [
        pytest.param(None, {"profile": "carlasimu"},
         {"profile": "carlasimu", "min_visible_pixels": 10**6}, 100.0,
         id="more than all"),
        pytest.param({"polygons": [[[0, 0], [64, 0], [64, 48], [0, 48]]]}, {},
         {"min_visible_pixels": 0, "threshold_small_box": 0}, None, id="no pixel"),
    ],
)  # fmt: skip
def test_a_flip_shows_the_match_of_the_box(api, mask, active, previewed, match):
    name = api.dataset(ignore_mask=mask)
    box = {"id": "real", "class": "car", "xyxy": [20.9, 24.9, 39.1, 39.1]}
    api.upload_frame(name, "a", {**scene.annotation(), "boxes": [box]})
    api.run(name, active)

    preview = api.post(f"/datasets/{name}/preview", {"config": previewed}).json()

    assert [box["match_percent"] for box in api.boxes(name)] == [match]
    assert [flip["match_percent"] for flip in preview["flips"]["items"]] == [match]


def test_histogram_of_a_dataset_without_classes_has_its_edges(api):
    histogram = api.json(f"/datasets/{api.dataset(classes=[])}/histogram", bins=2)

    assert histogram.pop("edges") == [0.0, 50.0, 100.0]
    assert histogram == {"classes": {}, "thresholds": {}, "unknown_percent": {}}
