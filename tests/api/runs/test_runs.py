"""Runs over HTTP, and a server that dies in the middle of one."""

import pytest

from app.db.engine import make_engine
from app.db.migrate import migrate
from app.package import migrations_dir
from tests.support import frames as scene
from tests.support import sensors
from tests.support.api import BASE, BY_TAGS, Api
from tests.support.databases import change, url_of
from tests.support.live import block_jobs
from tests.support.pictures import png
from tests.support.servers import STOP_WAIT_S
from tests.support.waiting import until

NOTHING_VISIBLE = {"min_visible_pixels": 10**6}
CARS_ARE_SKY = {"classes": {"car": {"accept": ["Sky"]}}}


def test_run_keeps_answers_and_counts_conflicts_if_it_is_activated(api, dataset):
    car, _ = api.box_ids(dataset)
    api.review(car, "keep", comment="I see it")
    before = (api.json(f"/datasets/{dataset}"), api.boxes(dataset))

    run = api.run(dataset, NOTHING_VISIBLE, activate=False)

    assert run["changed"] == 1
    assert (api.json(f"/datasets/{dataset}"), api.boxes(dataset)) == before
    entries = api.json(f"/boxes/{car}/history")["items"]
    decided = [entry for entry in entries if entry["kind"] == "decision"]
    assert [(entry["verdict"], entry.get("activated")) for entry in decided] == [
        *(("rejected", False), ("kept", None))
    ]

    api.run(dataset, NOTHING_VISIBLE)

    box, stats = api.json(f"/boxes/{car}"), api.json(f"/datasets/{dataset}/stats")
    assert (box["verdict"], box["effective_verdict"]) == ("rejected", "kept")
    assert (box["review"]["comment"], box["revision"]) == ("I see it", 1)
    assert (stats["conflicts"], stats["effective"]["kept"]) == (1, 1)


def test_history_reproduces_every_earlier_verdict(api, dataset):
    car, ghost = api.box_ids(dataset)
    first = api.json(f"/datasets/{dataset}")["config"]
    runs = [
        api.run(dataset, config)
        for config in (NOTHING_VISIBLE, CARS_ARE_SKY, {"profile": "carlasimu"})
    ]

    histories = {
        box: [
            (entry["config"], entry["verdict"], entry["reason"], entry["match_percent"])
            for entry in api.json(f"/boxes/{box}/history")["items"]
        ]
        for box in (car, ghost)
    }

    invisible, sky, published = (run["config"] for run in runs)
    assert [run["kind"] for run in runs] == ["decide", "decide", "measure"]
    assert histories == {
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


def migrate_back_to(data, revision):
    """Migrate the database of a stopped server back to an earlier schema."""
    engine = make_engine(url_of(data))
    try:
        migrate(engine, migrations_dir(), revision)
    finally:
        engine.dispose()


def test_run_interrupted_by_a_crash_resumes_after_an_upgrade(start_api):
    """The server is upgraded from schema 0005, which had no chunks and no leases."""
    first, api = start_api()
    name = api.dataset_of_frames(3)
    run = api.run(name, {"profile": "carlasimu"})
    first.process.kill()
    first.process.wait(STOP_WAIT_S)
    change(
        first.data,
        f"UPDATE runs SET state = 'running' WHERE id = {run['id']}",
        "DELETE FROM evidence WHERE frame_id = 2 AND measurement_id = 2",
        "DELETE FROM flips",
        "UPDATE datasets SET active_run_id = 1, active_config_id = 1",
        "UPDATE datasets SET active_measurement_id = 1",
    )
    migrate_back_to(first.data, "0005")

    _, api = start_api()
    until(lambda: api.json(f"/runs/{run['id']}")["state"] == "done")
    again = api.json(f"/runs/{run['id']}")

    counted = ("state", "total", "done", "changed", "counts")
    assert [again[key] for key in counted] == [run[key] for key in counted]
    assert api.json(f"/datasets/{name}")["active_run"] == run["id"]
    assert api.json(f"/datasets/{name}/stats")["kept"] == 3
    assert len(api.json(f"/datasets/{name}/runs")["items"]) == 2


def test_a_dataset_can_be_deleted_while_a_run_waits(api, dataset):
    accepted = api.post(f"/datasets/{dataset}/runs", {"config": NOTHING_VISIBLE})
    gone = api.http.delete(f"{BASE}/datasets/{dataset}", params={"confirm": dataset})

    other = api.dataset()
    api.upload_frame(other, "a")
    assert gone.status_code == 204
    assert api.http.get(accepted.headers["location"]).status_code == 404
    assert api.run(other, NOTHING_VISIBLE)["state"] == "done"


def test_too_many_open_runs_return_429_with_retry_after(serve):
    service = serve(max_open_runs=1)
    with service.admin() as http, block_jobs(service.app.state.services.engine):
        api = Api(http)
        name = api.dataset()
        taken, late = (
            api.post(f"/datasets/{name}/runs", {"config": {}}) for _ in range(2)
        )

    assert (taken.status_code, late.status_code) == (202, 429)
    assert int(late.headers["retry-after"]) >= 1


NEW_TAG = 100
"""A tag of a changed CARLA, which no family of tags has."""
NEW_THING = (30, 4, 35, 9)
"""Few enough pixels, in the sky, for the others to tell the family."""


def street(class_name):
    """A frame with a box of this class on its car."""
    box = {"class": class_name, "xyxy": scene.ON_THE_CAR}
    files = {"image": scene.image(), "segmentation": scene.segmentation()}
    return {**scene.annotation(), "boxes": [box]}, files


def changed_carla():
    """A frame with raw tags, and a car where they are new."""
    tags = scene.tags()
    x_min, y_min, x_max, y_max = NEW_THING
    tags[y_min:y_max, x_min:x_max] = NEW_TAG
    box = {"class": "car", "xyxy": NEW_THING}
    files = {"image": scene.image(), "segmentation": png(tags)}
    return {**scene.annotation(), "boxes": [box]}, files


def with_instances():
    """A frame with a car that is behind another."""
    (box,) = (box for box in sensors.ANNOTATION["boxes"] if box["id"] == "218")
    return {**sensors.ANNOTATION, "boxes": [box]}, sensors.sensors()


@pytest.mark.parametrize(
    ("frame", "config", "before", "after"),
    [
        (street("Auto"), {"classes": {"Auto": "car"}},
         "unmeasured: unmapped_class", "kept: visible"),
        (street("car"), {"classes": {"car": "pass"}},
         "kept: visible", "unmeasured: passed"),
        (street("car"), CARS_ARE_SKY, "kept: visible", "rejected: no_visible_pixels"),
        (street("Auto"), {"profile": "carlasimu"},
         "unmeasured: unmapped_class", "rejected: unmapped_class"),
        (changed_carla(), {"tags": {NEW_TAG: "Car"}},
         "unmeasured: unknown_pixels", "kept: visible"),
        (with_instances(), {"evidence": "instance"},
         "kept: visible", "rejected: hidden_by_instance"),
    ],
)  # fmt: skip
def test_stored_frames_are_decided_anew_for_a_changed_configuration(
    api, frame, config, before, after
):
    """Whatever it changes: where stored numbers do not do, files are read again."""
    annotation, files = frame
    dataset = api.dataset_of_one_frame(annotation, config=BY_TAGS, **files)

    first = api.boxes(dataset)
    run = api.run(dataset, config)
    then = api.boxes(dataset)

    assert run["state"] == "done", run
    assert [f"{box['verdict']}: {box['reason']}" for box in (*first, *then)] == [
        before,
        after,
    ]
