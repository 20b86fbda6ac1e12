"""Bulk answers and other writers: bulk answers read before they block others."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from functools import partial

import pytest

from app.access.audit import AuditTrail
from app.db.engine import Database
from app.review.service import review_box
from app.security import Principal
from tests.support.database_access import record_access
from tests.support.databases import url_of
from tests.support.statements import statements_of
from tests.support.waiting import until
from unghost.wire.boxes import ReviewIn

PATIENCE_S = 20
BOXES = 60


@pytest.fixture
def street(own_api):
    """A frame with many boxes, and their ids."""
    return own_api.dataset_of_cars(BOXES)


@contextmanager
def blocked_writers(service) -> Iterator[None]:
    """Makes all writers wait until the block ends."""
    turns = service.app.state.database.turns
    turns.take(person=True, wait_s=PATIENCE_S)
    try:
        yield
    finally:
        turns.give_back()


def wait_for_writers(service, number: int) -> None:
    turns = service.app.state.database.turns
    until(lambda: turns.waiting >= number)


def answer_as_another_server(service, box_id: int, seen: int = 0) -> None:
    """Answer a box as another server on the same database would."""
    with (
        closing(Database(url_of(service.settings.data))) as other,
        other.write(person=True) as session,
    ):
        answer = ReviewIn(verdict="unsure", seen_revision=seen)
        ada = Principal(1, "ada", "reviewer")
        review_box(AuditTrail(session, ada), box_id, answer, ada, most=9)


def filter_with_snapshot(api, name):
    return {"filter": {}, **snapshot_of(api, name)}


def snapshot_of(api, name):
    return {"snapshot": api.json("/boxes", dataset=name, count="true")["snapshot"]}


def bulk(api, name, **which):
    body = {"dataset": name, "verdict": "reject", **which}
    return api.post("/reviews/bulk", body)


@pytest.mark.parametrize(
    ("act", "writes"),
    [
        ("listed", "INSERT INTO review_batches"),
        ("filter", "INSERT INTO review_batches"),
        ("undo", "INSERT INTO review_batches"),
        ("delete", "DELETE FROM frames"),
    ],
)
def test_single_answers_are_written_before_operations_on_many_boxes(
    service, own_api, street, act, writes
):
    name, ids = street
    other = own_api.upload_frame(own_api.dataset(), "b")["decisions"][0]["box_id"]
    acts = {
        "listed": partial(bulk, own_api, name, box_ids=ids),
        "filter": partial(bulk, own_api, name, **filter_with_snapshot(own_api, name)),
        "delete": partial(own_api.delete, f"/datasets/{name}/frames/a"),
    }
    if act == "undo":
        batch = bulk(own_api, name, box_ids=ids).json()["id"]
        acts["undo"] = partial(own_api.post, f"/review-batches/{batch}/undo")

    with (
        ThreadPoolExecutor(2) as pool,
        statements_of(service.app.state.database.engine) as statements,
    ):
        with blocked_writers(service):
            many = pool.submit(acts[act])
            wait_for_writers(service, 1)
            answer = pool.submit(own_api.review, other, "keep")
            wait_for_writers(service, 2)
        assert answer.result().status_code == 201
        assert many.result().is_success

    order = [statement for statement, _ in statements]
    single, long = (
        next(n for n, text in enumerate(order) if text.startswith(start))
        for start in ("INSERT INTO reviews ", writes)
    )
    assert single < long


def test_bulk_answer_inserts_its_reviews_with_one_statement(service, own_api, street):
    """One statement for each revision, while writing, would hold up other writers."""
    name, ids = street
    claimed = list(range(len(ids)))

    with statements_of(service.app.state.database.engine) as statements:
        response = bulk(own_api, name, box_ids=ids, seen_revisions=claimed)

    assert (response.json()["count"], len(response.json()["stale"])) == (1, BOXES - 1)
    wrote = [text for text, _ in statements if text.startswith("INSERT INTO reviews")]
    assert len(wrote) == 1


def run_while_waiting(service, act, between):
    """The answer to `act`; `between` runs after `act` has read and before it writes."""
    with ThreadPoolExecutor(1) as pool:
        with blocked_writers(service):
            request = pool.submit(act)
            wait_for_writers(service, 1)
            between()
        return request.result()


def test_bulk_answer_on_a_filter_changed_while_waiting_returns_412(
    service, own_api, street
):
    name, ids = street
    which = filter_with_snapshot(own_api, name)

    with record_access(service.app.state.database) as acts:
        response = run_while_waiting(
            service,
            partial(bulk, own_api, name, **which),
            partial(answer_as_another_server, service, ids[7]),
        )

    assert (response.status_code, response.json()["code"]) == (412, "stale_snapshot")
    assert response.json()["current"] == {"total": BOXES, **snapshot_of(own_api, name)}
    assert acts.nested_transactions == set()
    reviewed = own_api.json(f"/datasets/{name}/stats")
    assert (reviewed["unsure"], reviewed["reviewed"]) == (1, 0)


def test_bulk_answer_skips_a_listed_box_answered_while_waiting(
    service, own_api, street
):
    name, ids = street

    response = run_while_waiting(
        service,
        partial(bulk, own_api, name, box_ids=ids),
        partial(answer_as_another_server, service, ids[7]),
    ).json()

    assert (response["count"], response["stale"]) == (BOXES - 1, [ids[7]])
    assert own_api.json(f"/boxes/{ids[7]}")["review"]["reviewer"] == "ada"


def test_undo_skips_a_box_answered_while_waiting(service, own_api, street):
    name, ids = street
    batch = bulk(own_api, name, box_ids=ids).json()["id"]

    response = run_while_waiting(
        service,
        partial(own_api.post, f"/review-batches/{batch}/undo"),
        partial(answer_as_another_server, service, ids[7], 1),
    ).json()

    assert (response["undone"], response["skipped"]) == (BOXES - 1, [ids[7]])
    assert own_api.json(f"/boxes/{ids[7]}")["review"]["reviewer"] == "ada"


def test_bulk_answer_on_a_filter_is_replayed_by_idempotency_key(own_api, street):
    name, _ = street
    body = {"dataset": name, "verdict": "keep", **filter_with_snapshot(own_api, name)}
    key = {"Idempotency-Key": f"bulk {name}".replace(" ", "-")}

    first, again = (
        own_api.http.post("/api/v1/reviews/bulk", json=body, headers=key) for _ in "ab"
    )

    assert (first.status_code, again.status_code) == (201, 201)
    assert first.json() == again.json()
    assert again.headers["idempotent-replayed"] == "true"
