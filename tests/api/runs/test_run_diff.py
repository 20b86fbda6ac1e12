"""Comparing any two runs, also those that were never activated."""

import pytest

from tests.support import frames as scene

NOTHING_VISIBLE = {"min_visible_pixels": 10**6}
CARS_ARE_SKY = {"classes": {"car": {"accept": ["Sky"]}}}
FROM_PIXELS = {"profile": "carlasimu"}
BOXES = [
    {"id": f"{n}", "class": "car" if n % 2 else "truck", "xyxy": [10 + n, 20, 40, 40]}
    for n in range(11)
]


def first_run(api, dataset):
    return api.json(f"/datasets/{dataset}/runs")["items"][-1]["id"]


def flips(diff):
    return {
        item["box_id"]: (item["before"]["verdict"], item["after"]["verdict"])
        for item in diff["items"]
    }


def test_diff_is_against_the_previously_active_run_by_default(api, dataset):
    first = first_run(api, dataset)
    car, _ = api.box_ids(dataset)
    tried = api.run(dataset, CARS_ARE_SKY, activate=False)
    run = api.run(dataset, NOTHING_VISIBLE)

    diff = api.json(f"/runs/{run['id']}/diff")

    (item,) = diff.pop("items")
    assert (diff["run"], diff["against"]) == (run["id"], first)
    assert (diff["compared"], diff["total"], diff["by_class"]) == (2, 1, {"car": 1})
    assert (diff["kept_to_rejected"], diff["rejected_to_kept"]) == (1, 0)
    assert (item["box_id"], item["match_percent"]) == (car, 100.0)
    assert (item["before"]["reason"], item["after"]["reason"]) == (
        "visible",
        "no_visible_pixels",
    )
    assert api.json(f"/runs/{tried['id']}/diff")["against"] == first


@pytest.mark.parametrize(
    ("other", "activate"),
    [(NOTHING_VISIBLE, True), (CARS_ARE_SKY, False), (FROM_PIXELS, True)],
)
def test_diff_of_any_two_runs_equals_the_difference_of_verdicts(
    api, dataset, other, activate
):
    api.upload_frame(dataset, "many", {**scene.annotation(), "boxes": BOXES})
    first = api.run(dataset, {"threshold_small_box": 80})
    before = {box["box_id"]: box["verdict"] for box in api.boxes(dataset)}
    second = api.run(dataset, other, activate=activate)
    shown = second if activate else api.run(dataset, other)
    after = {box["box_id"]: box["verdict"] for box in api.boxes(dataset)}

    forth = api.json(f"/runs/{second['id']}/diff", against=first["id"])
    back = api.json(f"/runs/{first['id']}/diff", against=second["id"])

    changed = {box: (before[box], after[box]) for box in before}
    changed = {box: pair for box, pair in changed.items() if pair[0] != pair[1]}
    assert flips(forth) == changed
    assert flips(back) == {box: pair[::-1] for box, pair in changed.items()}
    assert (forth["total"], sum(forth["by_class"].values())) == (len(changed),) * 2
    same = api.json(f"/runs/{shown['id']}/diff", against=second["id"])
    assert (same["total"], same["items"], same["by_class"]) == (0, [], {})


def test_diff_pagination_returns_every_flip_once_by_match(api, dataset):
    api.upload_frame(dataset, "many", {**scene.annotation(), "boxes": BOXES})
    run = api.run(dataset, {"threshold_small_box": 99.5})
    whole = api.json(f"/runs/{run['id']}/diff")

    flips: list[dict] = []
    cursor = None
    while cursor or not flips:
        more: dict[str, str] = {"cursor": cursor} if cursor else {}
        response = api.get(f"/runs/{run['id']}/diff", limit=2, **more)
        page = response.json()
        assert ("link" in response.headers) == (page["next_cursor"] is not None)
        flips += page["items"]
        cursor = page["next_cursor"]

    matches = [item["match_percent"] for item in whole["items"]]
    assert len(flips) == whole["total"] > 4
    assert flips == whole["items"]
    assert matches == sorted(matches, reverse=True)


def test_diff_omits_frames_that_only_one_run_has_measured(api, dataset):
    first, empty = first_run(api, dataset), api.dataset()
    run, of_none = (api.run(name, FROM_PIXELS)["id"] for name in (dataset, empty))
    api.upload_frame(dataset, "later")

    assert api.json(f"/runs/{run}/diff", against=first)["compared"] == 2
    assert api.json(f"/runs/{run}/diff", against=run)["compared"] == 4
    diff = api.json(f"/runs/{of_none}/diff")
    assert (diff["total"], diff["compared"], diff["items"]) == (0, 0, [])


def test_runs_that_cannot_be_compared_are_refused(api, dataset):
    first = first_run(api, dataset)
    other = first_run(api, api.dataset())
    empty = api.post(
        f"/datasets/{dataset}/runs", {"config": {"palette": "carla-0.9.0"}}
    )
    failed = api.wait_for_job(empty)
    run = api.run(dataset, NOTHING_VISIBLE)

    def code(path, **more):
        response = api.get(path, **more)
        return response.status_code, response.json()["code"]

    assert failed["state"] == "failed"
    assert code(f"/runs/{first}/diff") == (400, "nothing_before")
    assert code(f"/runs/{run['id']}/diff", against=other) == (400, "other_dataset")
    assert code(f"/runs/{run['id']}/diff", against=failed["id"]) == (
        409,
        "run_not_done",
    )
    assert code(f"/runs/{failed['id']}/diff") == (409, "run_not_done")
    assert code(f"/runs/{run['id']}/diff", against=10**9) == (404, "not_found")
    assert code("/runs/1000000000/diff") == (404, "not_found")
    for cursor in ("x", "1~", "~1", "1~1.5", f"1~{2**63}", "nan~1", "-1~1", "1~-1"):
        problem = code(f"/runs/{run['id']}/diff", cursor=cursor)
        assert problem == (400, "bad_cursor"), cursor
