"""No request makes the database read a big table from end to end.

Each request is sent to a real server. SQLite then explains how it ran each statement of
the request, and of the job that the request started. A big table is one that grows with
the data.
"""

import itertools
import re
from typing import Any

import pytest
from sqlalchemy import inspect

from app.db.base import Base
from tests.support import frames as scene
from tests.support.api import BASE
from tests.support.live import live
from tests.support.statements import Statement, statements_of

pytestmark = pytest.mark.sqlite_files("plans as SQLite reports them")

LARGE_TABLES = {
    "frames",
    "frame_files",
    "boxes",
    "decisions",
    "evidence",
    "reviews",
    "flips",
}
LARGE_TABLES |= {"blobs", "claims"}
ALLOWED_SCANS = {
    "INSERT INTO dataset_classes": "SQLite plans to look for boxes that wait for their "
    "class; it does so only within a transaction in which one does",
    "DELETE FROM dataset_classes": "SQLite looks for boxes of the class: 6 ms for each "
    "100,000 boxes that there are. A class of a deleted dataset goes in a transaction "
    "of its own, in the background, and others have their turns after each; an index "
    "would cost every upload for that",
}
"""A part of a statement that may read all of a large table -> the reason."""
NOT_INDEXED = {
    ("boxes", "class_id"): "classes are only deleted with their dataset, and an index "
    "would cost every upload for that"
}
SCANNED_TABLE = re.compile(r"^SCAN (\w+)")
EXPLAINED = ("SELECT", "UPDATE", "DELETE", "INSERT", "WITH")
CARS_ARE_SKY = {"classes": {"car": {"accept": ["Sky"]}}}
NOTHING_VISIBLE = {"min_visible_pixels": 10**6}
BOXES = [
    {"class": name, "xyxy": xyxy}
    for name in ("car", "truck", "walker")
    for xyxy in (scene.ON_THE_CAR, scene.IN_THE_SKY, [0, 0, 64, 48], [90, 0, 99, 9])
]


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    with live(tmp_path_factory.mktemp("plans") / "data", workers=2) as running:
        yield running


@pytest.fixture(scope="module")
def street(own_api):
    """A dataset with frames, answers, runs and a refused frame."""
    name = own_api.dataset()
    for number in range(6):
        annotation = {**scene.annotation(), "boxes": BOXES, "number": number}
        own_api.upload_frame(name, f"a/{number}", annotation)
    boxes = own_api.box_ids(name)
    for box_id, verdict in zip(boxes, ("keep", "reject", "unsure"), strict=False):
        assert own_api.review(box_id, verdict).status_code == 201
    own_api.post(
        "/reviews/bulk", {"dataset": name, "box_ids": boxes[5:8], "verdict": "keep"}
    )
    own_api.run(name, NOTHING_VISIBLE)
    own_api.run(name, {})
    own_api.put(name, "bad", b"{")
    return name


def full_scans(service, statements: list[Statement]) -> set[str]:
    """Statements that read a big table from end to end, with their plan."""
    bad = set()
    engine = service.app.state.database.engine
    with engine.connect() as connection:
        for statement, parameters in dict.fromkeys(
            (sql, parameters)
            for sql, parameters in statements
            if sql.lstrip().upper().startswith(EXPLAINED)
        ):
            plan = connection.exec_driver_sql(
                f"EXPLAIN QUERY PLAN {statement}", parameters
            )
            steps = [row[3] for row in plan]
            if any(is_full_scan_of_big_table(step, statement) for step in steps):
                bad.add(f"{statement}\n  {steps}")
    return {each for each in bad if not any(part in each for part in ALLOWED_SCANS)}


def is_full_scan_of_big_table(step: str, statement: str) -> bool:
    match = SCANNED_TABLE.match(step)
    if match is None:
        return False
    name = match[1]
    alias = re.search(rf"(\w+) AS {name}\b", statement)
    return (alias[1] if alias else name) in LARGE_TABLES


def get(path: str, **parameters: Any):
    def ask(api, street):
        response = api.get(path.format(d=street), **parameters)
        assert response.status_code == 200, response.text

    return ask


def boxes(**parameters: Any):
    return lambda api, street: get("/boxes", dataset=street, **parameters)(api, street)


def post(path: str, body: Any, *, expected: int):
    def ask(api, street):
        response = api.post(path.format(d=street), body)
        assert response.status_code == expected, response.text
        if expected == 202:
            assert api.wait_for_job(response)["state"] == "done"

    return ask


def run(config: Any, *, activate: bool):
    body = {"config": config, "activate": activate}
    return post("/datasets/{d}/runs", body, expected=202)


def queue(order: str, **filters: Any):
    body = {"order": order, "filters": filters}
    return post("/datasets/{d}/queue", body, expected=200)


def box_pages(api, street):
    box_id = api.boxes(street)[0]["box_id"]
    for path in (
        f"/boxes/{box_id}",
        f"/boxes/{box_id}/history",
        f"/boxes/{box_id}/crop",
    ):
        get(path)(api, street)


def frame_pages(api, street):
    frame = api.json(f"/datasets/{street}/frames/a/1")
    for part in ("", "/image", "/thumbnail", "/overlay"):
        get(f"/frames/{frame['id']}{part}")(api, street)


def replace_and_delete_frame(api, street):
    api.upload_frame(street, "later")
    api.upload_frame(
        street, "later", {**scene.annotation(), "map": "Town01"}, replace=True
    )
    api.post(f"/datasets/{street}/known-frames", {"keys": ["later", "a/1"]})
    assert api.http.delete(f"{BASE}/datasets/{street}/frames/later").status_code == 204


def answers(api, street):
    box = api.boxes(street, review="undecided")[0]
    response = api.review(box["box_id"], "keep", seen=box["revision"])
    assert response.status_code == 201, response.text
    filters = {"verdict": "rejected", "review": "undecided"}
    seen = api.json("/boxes", dataset=street, count="true", **filters)["snapshot"]
    body = {"dataset": street, "filter": filters, "snapshot": seen}
    batch = api.post("/reviews/bulk", {**body, "verdict": "reject"})
    assert batch.status_code == 201, batch.text
    undone = api.post(f"/review-batches/{batch.json()['id']}/undo")
    assert undone.status_code == 200, undone.text


def diffs(api, street):
    runs = api.json(f"/datasets/{street}/runs")["items"]
    runs = [run["id"] for run in runs if run["state"] == "done"]
    for run, other in itertools.permutations(runs[:3], 2):
        get(f"/runs/{run}/diff", against=other)(api, street)


def watch_and_cancel_run(api, street):
    accepted = api.post(f"/datasets/{street}/runs", {"config": {"encoding": "palette"}})
    run_id = accepted.json()["id"]
    assert api.post(f"/runs/{run_id}/cancel").status_code in (202, 409)
    get(f"/runs/{run_id}/events")(api, street)


def deleted(api, street):
    other = api.dataset()
    api.upload_frame(other, "a")
    gone = api.http.delete(f"{BASE}/datasets/{other}", params={"confirm": other})
    assert gone.status_code == 204


SORTS = ("doubt", "match_percent")
FILTERS: tuple[dict[str, Any], ...] = (
    {},
    {"verdict": "kept"},
    {"effective": "rejected"},
    {"reason": "visible"},
    {"class": "car"},
    {"review": "undecided"},
    {"review": "keep"},
    {"conflict": "true"},
    {"toss_up": "true"},
    {"match_min": 1, "match_max": 90},
    {"margin_max": 5},
)
REQUESTS = {
    **{
        f"boxes by {sort} {filters}": boxes(sort=sort, **filters)
        for sort in SORTS
        for filters in FILTERS
    },
    **{f"count of boxes {each}": boxes(count="true", **each) for each in FILTERS},
    **{f"frames {each}": get("/datasets/{d}/frames", **each) for each in FILTERS},
    "frames by arrival": get("/datasets/{d}/frames", sort="-id"),
    "frames by key": get("/datasets/{d}/frames", key="a/", limit=2),
    **{f"queue by {order}": queue(order) for order in ("doubt", "random", "class")},
    "queue for an audit": queue("audit"),
    "queue of kept cars": queue("doubt", verdict="kept", **{"class": "car"}),
    "queue of conflicts": queue("doubt", conflict=True),
    "datasets": get("/datasets"),
    "a dataset": get("/datasets/{d}"),
    **{
        name: get(f"/datasets/{{d}}/{name}")
        for name in (
            *("stats", "histogram", "quality", "problems"),
            *("runs", "configs", "config", "exports"),
        )
    },
    "preview": post("/datasets/{d}/preview", {"config": CARS_ARE_SKY}, expected=200),
    "run from numbers": run(NOTHING_VISIBLE, activate=True),
    "run from histograms": run(CARS_ARE_SKY, activate=False),
    "run from pixels": run({"palette": scene.FAMILY}, activate=True),
    "diffs": diffs,
    "a run that is watched and cancelled": watch_and_cancel_run,
    "export as YOLO": post("/datasets/{d}/exports", {"format": "yolo"}, expected=202),
    "export of decisions": post(
        "/datasets/{d}/exports", {"format": "decisions-jsonl"}, expected=202
    ),
    "a box": box_pages,
    "a frame": frame_pages,
    "frames come and go": replace_and_delete_frame,
    "answers": answers,
    "a dataset is deleted": deleted,
}


@pytest.mark.parametrize("name", REQUESTS)
def test_request_makes_no_full_scan_of_a_big_table(service, own_api, street, name):
    with statements_of(service.app.state.database.engine) as statements:
        REQUESTS[name](own_api, street)

    assert len(statements) > 1
    assert full_scans(service, statements) == set()


def test_full_scan_of_a_big_table_is_detected(service, own_api, street):
    whole = "SELECT count(*) FROM decisions AS d WHERE d.reason = 3"

    assert full_scans(service, [(whole, ())]) != set()
    assert full_scans(service, [("SELECT * FROM runs", ())]) == set()


def test_foreign_keys_of_big_tables_have_an_index(service):
    """SQLite looks for the rows that refer to a deleted one: that needs an index."""
    inspector = inspect(service.app.state.database.engine)
    missing = {
        (table, *key["constrained_columns"])
        for table in LARGE_TABLES & set(Base.metadata.tables)
        for key in inspector.get_foreign_keys(table)
        if not has_index_on(inspector, table, key["constrained_columns"])
    }

    assert missing == set(NOT_INDEXED)


def has_index_on(inspector, table, columns):
    keys = [inspector.get_pk_constraint(table)["constrained_columns"]]
    keys += [each["column_names"] for each in inspector.get_unique_constraints(table)]
    keys += [each["column_names"] for each in inspector.get_indexes(table)]
    return any(key[: len(columns)] == columns for key in keys)
