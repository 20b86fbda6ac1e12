"""Runs, configurations and previews over HTTP; a server that dies in the middle."""

from __future__ import annotations

import json
import shutil
import sqlite3

import pytest

from tests.api import frames as scene
from tests.api.resources import BASE
from tests.servers import STOP_WAIT_S

NOTHING_VISIBLE = {"min_visible_pixels": 10**6}
CARS_ARE_SKY = {"classes": {"car": {"accept": ["Sky"]}}}
YAML = {"Content-Type": "application/yaml"}


@pytest.fixture
def dataset(api):
    name = api.dataset()
    api.stored(name, "a")
    return name


def ids(api, dataset):
    """The server's ids of the car and of the ghost."""
    return [box["box_id"] for box in api.boxes(dataset)]


def add_config(api, dataset, content, headers=YAML):
    path = f"{BASE}/datasets/{dataset}/configs"
    return api.http.post(path, content=content, headers=headers)


def test_a_run_is_described_whole(api, dataset):
    accepted = api.post(f"/datasets/{dataset}/runs", {"config": NOTHING_VISIBLE})
    run = api.finished(accepted)

    times = ("created_at", "started_at", "finished_at")
    assert {key: run[key] for key in run if key not in (*times, "id", "config")} == {
        "dataset": dataset,
        "kind": "decide",
        "state": "done",
        "activate": False,
        "total": 1,
        "done": 1,
        "changed": 1,
        "counts": {"kept": 0, "rejected": 2, "unmeasured": 0},
        "error": None,
        "created_by": "admin",
    }
    assert run["created_at"] <= run["started_at"] <= run["finished_at"]
    assert api.json(f"/runs/{run['id']}") == run
    listed = api.json(f"/datasets/{dataset}/runs", limit=1)
    assert [item["id"] for item in listed["items"]] == [run["id"]]
    older = api.json(f"/datasets/{dataset}/runs", cursor=listed["next_cursor"])
    assert [item["state"] for item in older["items"]] == ["done"]


def test_a_run_that_is_not_activated_changes_nothing(api, dataset):
    before = (api.json(f"/datasets/{dataset}"), api.boxes(dataset))

    run = api.run(dataset, NOTHING_VISIBLE, activate=False)

    assert run["changed"] == 1
    assert (api.json(f"/datasets/{dataset}"), api.boxes(dataset)) == before
    entries = api.json(f"/boxes/{ids(api, dataset)[0]}/history")["items"]
    assert [(e["verdict"], e.get("activated")) for e in entries] == [
        ("rejected", False),
        ("kept", None),
    ]


def test_a_run_never_touches_an_answer_and_contradictions_are_counted(api, dataset):
    car, _ = ids(api, dataset)
    api.review(car, "keep", comment="I see it")

    api.run(dataset, NOTHING_VISIBLE)

    box, stats = api.json(f"/boxes/{car}"), api.json(f"/datasets/{dataset}/stats")
    assert (box["verdict"], box["effective_verdict"]) == ("rejected", "kept")
    assert (box["review"]["comment"], box["revision"]) == ("I see it", 1)
    assert (stats["conflicts"], stats["effective"]["kept"]) == (1, 1)


def test_history_reproduces_every_earlier_verdict(api, dataset):
    car, ghost = ids(api, dataset)
    first = api.json(f"/datasets/{dataset}")["config"]
    runs = [
        api.run(dataset, config)
        for config in (NOTHING_VISIBLE, CARS_ARE_SKY, {"profile": "carlasimu"})
    ]

    found = {
        box: [
            (entry["config"], entry["verdict"], entry["reason"], entry["match_percent"])
            for entry in api.json(f"/boxes/{box}/history")["items"]
        ]
        for box in (car, ghost)
    }

    invisible, sky, published = (run["config"] for run in runs)
    assert [run["kind"] for run in runs] == ["decide", "decide", "measure"]
    assert found == {
        car: [
            (published, "kept", "visible", 100.0),
            (invisible, "rejected", "no_visible_pixels", 100.0),
            (first, "kept", "visible", 100.0),
        ],
        ghost: [
            (published, "rejected", "no_visible_pixels", 0.0),
            (sky, "kept", "visible", 100.0),
            (first, "rejected", "no_visible_pixels", 0.0),
        ],
    }


def test_numbers_are_enough_when_the_files_are_gone(start_api):
    server, api = start_api()
    name = api.dataset()
    api.stored(name, "a")
    shutil.rmtree(server.data / "blobs")

    decided = api.run(name, NOTHING_VISIBLE)
    recounted = api.run(name, CARS_ARE_SKY)
    preview = api.post(f"/datasets/{name}/preview", {"config": {}}).json()
    measured = api.run(name, {"profile": "carlasimu"})

    assert (decided["state"], recounted["state"]) == ("done", "done")
    assert preview["flips"]["total"] == 2
    assert (measured["kind"], measured["state"]) == ("measure", "failed")
    assert api.json(f"/datasets/{name}")["config"] == recounted["config"]


@pytest.mark.parametrize("state", ["queued", "running"])
def test_a_run_that_a_crash_cut_off_ends_once(start_api, state):
    first, api = start_api()
    name = api.dataset()
    for number in range(3):
        api.stored(name, str(number), {**scene.annotation(), "number": number})
    run = api.run(name, {"profile": "carlasimu"})
    first.process.kill()
    first.process.wait(STOP_WAIT_S)
    with sqlite3.connect(first.data / "unghost.db") as database:
        database.execute(f"UPDATE runs SET state = '{state}' WHERE id = {run['id']}")
        database.execute(
            "DELETE FROM evidence WHERE frame_id = 2 AND measurement_id = 2"
        )
        database.execute("DELETE FROM flips")
        database.execute("UPDATE datasets SET active_run_id = 1, active_config_id = 1")
        database.execute("UPDATE datasets SET active_measurement_id = 1")
    database.close()

    _, api = start_api()
    for _ in range(2000):
        again = api.json(f"/runs/{run['id']}")
        if again["state"] == "done":
            break

    counted = ("state", "total", "done", "changed", "counts")
    assert [again[key] for key in counted] == [run[key] for key in counted]
    assert api.json(f"/datasets/{name}")["active_run"] == run["id"]
    assert api.json(f"/datasets/{name}/stats")["kept"] == 3
    assert len(api.json(f"/datasets/{name}/runs")["items"]) == 2


def test_a_killed_server_keeps_what_it_answered(start_api):
    first, api = start_api()
    name = api.dataset()
    stored = api.stored(name, "a")
    car = stored["decisions"][0]["box_id"]
    accepted = api.post(f"/datasets/{name}/runs", {"config": {}, "activate": True})
    review = api.review(car, "reject")
    first.process.kill()
    first.process.wait(STOP_WAIT_S)

    _, api = start_api()

    assert review.status_code == 201
    assert api.finished(accepted)["state"] == "done"
    assert api.json(f"/boxes/{car}")["effective_verdict"] == "rejected"
    frame = api.json(f"/datasets/{name}/frames/a")
    for file in frame["files"].values():
        assert api.http.get(file["url"]).status_code == 200


def test_a_dataset_can_be_deleted_while_a_run_waits(api, dataset):
    accepted = api.post(f"/datasets/{dataset}/runs", {"config": NOTHING_VISIBLE})
    gone = api.http.delete(f"{BASE}/datasets/{dataset}", params={"confirm": dataset})

    other = api.dataset()
    api.stored(other, "a")
    assert gone.status_code == 204
    assert api.http.get(accepted.headers["location"]).status_code == 404
    assert api.run(other, NOTHING_VISIBLE)["state"] == "done"


def test_configs_are_versions_by_content(api, dataset):
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


def test_activating_a_config_is_a_run(api, dataset):
    digest = add_config(api, dataset, b"min_visible_pixels: 1000000").json()["digest"]
    path = f"{BASE}/datasets/{dataset}/config"

    run = api.finished(api.http.put(path, json={"digest": digest}))
    unknown = api.http.put(path, json={"digest": "0" * 64})

    active = api.json(f"/datasets/{dataset}/config")
    assert (run["activate"], run["config"]) == (True, digest)
    assert (active["digest"], active["active"]) == (digest, True)
    assert unknown.status_code == 404
    assert api.verdicts(dataset) == {"real": "rejected", "ghost": "rejected"}


@pytest.mark.parametrize(
    ("content", "code", "words"),
    [
        (b"treshold_small_box: 1", "unknown_key", "threshold_small_box"),
        (b"threshold_small_box: 101", "bad_config", "101"),
        (b"threshold_small_box: .nan", "bad_config", "threshold_small_box"),
        (b"threshold_small_box: '10'", "bad_config", "10"),
        (b"evidence: depth", "not_available", "depth"),
        (b"a: [", "bad_yaml", ""),
        (b"\xff\xfe\xfa", "bad_yaml", ""),
        (b"[" * 20_000, "bad_yaml", ""),
        (b"{" * 20_000, "bad_yaml", ""),
        (b"!!python/object/apply:os.system ['true']", "bad_yaml", ""),
        (b"a: &a [1]\nb: [*a, *a]", "bad_yaml", ""),
        (b'{"classes": {"\\ud800": {"threshold_small_box": 1}}}', "bad_config", ""),
        (b"classes: {1: {threshold_small_box: 1}}", "bad_config", "class"),
        (b"- 1", "bad_config", "mapping"),
    ],
)
def test_a_bad_config_is_refused(api, dataset, content, code, words):
    answer = add_config(api, dataset, content)

    assert (answer.status_code, answer.json()["code"]) == (422, code), answer.text
    assert words in answer.json()["detail"]
    assert len(api.json(f"/datasets/{dataset}/configs")["items"]) == 1


@pytest.mark.parametrize(
    ("headers", "content", "status"),
    [
        ({"Content-Type": "text/plain"}, b"{}", 415),
        ({}, b"{}", 415),
        (YAML, b"a" * (1024**2 + 1), 413),
    ],
)
def test_another_body_is_no_config(api, dataset, headers, content, status):
    assert add_config(api, dataset, content, headers).status_code == status


@pytest.mark.parametrize(
    ("path", "body", "status"),
    [
        (
            "preview",
            {"config": {"classes": {"\ud800": {"min_visible_pixels": 2}}}},
            422,
        ),
        ("preview", {"config": {"treshold_small_box": 1}}, 422),
        ("preview", {"config": [], "limit": 5}, 422),
        ("preview", {"config": {}, "bins": 1}, 422),
        ("runs", {"config": "0" * 64}, 404),
        ("runs", {"config": "xyz"}, 422),
        ("runs", {"config": {"palette": "cityscapes"}}, 422),
        ("runs", {"config": {}, "scope": "frame"}, 422),
        ("runs", {"config": {"classes": {"car": {"accept": ["Unicorn"]}}}}, 422),
    ],
)
def test_a_bad_request_for_a_decision_is_refused(api, dataset, path, body, status):
    answer = api.http.post(
        f"{BASE}/datasets/{dataset}/{path}",
        content=json.dumps(body).encode(),
        headers={"Content-Type": "application/json"},
    )

    assert answer.status_code == status, answer.text
    assert api.verdicts(dataset) == {"real": "kept", "ghost": "rejected"}


def test_a_preview_says_what_would_flip_and_writes_nothing(api, dataset):
    before = api.json(f"/datasets/{dataset}/runs"), api.json(f"/datasets/{dataset}")
    body = {"config": CARS_ARE_SKY, "bins": 2}

    preview = api.post(f"/datasets/{dataset}/preview", body).json()

    car, ghost = ids(api, dataset)
    kept = {"verdict": "kept", "reason": "visible"}
    unseen = {"verdict": "rejected", "reason": "no_visible_pixels"}
    frame = api.json(f"/boxes/{car}")["frame_id"]
    items = {item["box_id"]: item for item in preview["flips"].pop("items")}
    assert {key: preview[key] for key in preview if key != "config"} == {
        "needs_pixels": False,
        "counts": {"kept": 1, "rejected": 1, "unmeasured": 0},
        "by_reason": {"no_visible_pixels": 1, "visible": 1},
        "by_class": {"car": {"kept": 1, "rejected": 1, "unmeasured": 0}},
        "histograms": {
            "edges": [0.0, 50.0, 100.0],
            "classes": {"car": [1, 1]},
            "thresholds": {"car": 10.0},
        },
        "flips": {"total": 2, "kept_to_rejected": 1, "rejected_to_kept": 1},
    }
    assert items[ghost] == {
        "box_id": ghost,
        "frame_id": frame,
        "class": "car",
        "match_percent": 100.0,
        "before": unseen,
        "after": kept,
    }
    assert items[car]["after"] == unseen
    after = api.json(f"/datasets/{dataset}/runs"), api.json(f"/datasets/{dataset}")
    assert after == before


def test_a_preview_that_needs_pixels_says_so(api, dataset):
    body = {"config": {"profile": "carlasimu"}}

    preview = api.post(f"/datasets/{dataset}/preview", body).json()

    assert preview["needs_pixels"] is True
    assert preview["counts"] is None


def test_stats_and_histogram_are_those_of_the_boxes(api, dataset):
    described = api.json(f"/datasets/{dataset}")

    assert api.json(f"/datasets/{dataset}/stats") == {
        "frames": 1,
        "boxes": 2,
        "kept": 1,
        "rejected": 1,
        "unmeasured": 0,
        "reviewed": 0,
        "to_review": 1,
        "unsure": 0,
        "conflicts": 0,
        "toss_ups": 0,
        "lossy": 0,
        "effective": {"kept": 1, "rejected": 1, "unmeasured": 0},
        "by_reason": {"visible": 1, "no_visible_pixels": 1},
        "by_class": {"car": {"kept": 1, "rejected": 1, "unmeasured": 0}},
        "config": described["config"],
        "run": described["active_run"],
    }
    assert api.json(f"/datasets/{dataset}/histogram", bins=4) == {
        "edges": [0.0, 25.0, 50.0, 75.0, 100.0],
        "classes": {"car": [1, 0, 0, 1]},
        "thresholds": {"car": 10.0},
    }
    assert api.json(f"/datasets/{api.dataset(classes=[])}/histogram", bins=2) == {
        "edges": [0.0, 50.0, 100.0],
        "classes": {},
        "thresholds": {},
    }


def test_too_many_runs_are_asked_to_come_later(start_api):
    _, api = start_api(UNGHOST_MAX_OPEN_RUNS="1", UNGHOST_WORKERS="1")
    name = api.dataset()
    for number in range(10):
        api.stored(name, str(number), {**scene.annotation(), "number": number})
    body = {"config": {"profile": "carlasimu"}}

    answers = [api.post(f"/datasets/{name}/runs", body) for _ in range(20)]

    late = [answer for answer in answers if answer.status_code == 429]
    assert {answer.status_code for answer in answers} == {202, 429}
    assert int(late[0].headers["retry-after"]) >= 1
