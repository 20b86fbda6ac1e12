"""The services on PostgreSQL do what they do on SQLite.

The tests of each package run on SQLite unless `UNGHOST_TEST_DATABASE` is set. These
here always run on PostgreSQL: they check what it may do differently, when it stores,
sorts or locks rows. That concerns several packages, so they are in no package's folder.
"""

from concurrent.futures import ThreadPoolExecutor

import pytest

from app.access.audit import AuditTrail
from app.boxes.current import TallyRepository
from app.boxes.filter import to_filter
from app.boxes.orders import ORDERS, BoxPages
from app.boxes.queries import FrameRepository, PageRequest
from app.db.tables import Export
from app.exports.service import request_export
from app.ingest.check import MAX_TEXT
from app.jobs.queries import job_with_id
from app.review.bulk import review_many
from app.runs.flips import compared_runs, run_diff
from filter_core.verdicts import Reason
from tests.support import frames as scene
from tests.support.databases import empty_postgres
from tests.support.services import ServiceDataset, Services, running_services
from unghost.wire.boxes import BoxSelection, BulkIn
from unghost.wire.runs import ExportIn

KEPT, UNSEEN = int(Reason.VISIBLE), int(Reason.NO_VISIBLE_PIXELS)


@pytest.fixture(scope="module")
def services(postgres_services: Services) -> Services:
    return postgres_services


def put(street: ServiceDataset, key: str, **more):
    files = {"image": scene.image(), "segmentation": scene.segmentation()}
    return street.put(key, {**scene.annotation(), **more}, **files)


def test_frames_reviews_bulk_answers_and_runs_on_postgres(services):
    street = services.dataset()
    put(street, "a")
    real, ghost = street.box_ids()
    street.review(ghost, "keep")
    batch = street.bulk([real, ghost], "reject")
    street.undo(batch)
    run = street.run({"threshold_small_box": 99, "min_visible_pixels": 10**6})
    put(street, "a", map="Town01")

    assert (run.state, run.changed) == ("done", 1)
    assert list(street.reasons().values()) == [UNSEEN, UNSEEN]
    assert street.tallies() == street.recounted()
    assert sum(key.review == "keep" for key in street.tallies()) == 1
    recounted = street.run({"classes": {"car": {"accept": ["Sky"]}}})
    measured = street.run({"profile": "carlasimu"})
    assert (recounted.kind, measured.kind) == ("decide", "measure")
    assert list(street.reasons().values()) == [KEPT, UNSEEN]
    assert [entry["kind"] for entry in street.history(ghost)] == ["review"] * 3 + [
        "decision"
    ]


def test_stale_boxes_of_a_bulk_answer_are_listed_in_order_of_id(services):
    """PostgreSQL moves changed rows, so they are not read in the order of their ids."""
    street = services.dataset()
    for number in range(3):
        put(street, str(number), number=number)
    ids = street.box_ids()
    for box_id in reversed(ids):
        street.review(box_id, "keep")

    request = BulkIn(
        dataset=street.name, verdict="keep", box_ids=ids, seen_revisions=[0] * len(ids)
    )
    with services.context.database.write() as session:
        audit = AuditTrail(session, street.by)
        stored = review_many(services.context, audit, request, street.by)

    assert list(stored.stale) == ids


def test_pages_list_all_boxes_in_every_order(services):
    street = services.dataset()
    for number in range(4):
        put(street, str(number), number=number)
    with services.context.database.read() as session:
        chosen = to_filter(session, street.row(session), BoxSelection())
        tallies = TallyRepository(session).of_dataset(street.id)
        pages = BoxPages(session, chosen, tallies)
        for order in ORDERS:
            first, cursor = pages.page(order, "", 5)
            rest, end = pages.page(order, cursor or "", 5)
            assert (sorted(first + rest), end) == (street.box_ids(), None), order


def test_texts_of_the_maximum_length_are_stored(services):
    """PostgreSQL enforces the length of a column, SQLite does not."""
    street = services.dataset()
    long = "x" * MAX_TEXT
    boxes = [{"id": long, "class": long, "xyxy": scene.ON_THE_CAR}]

    put(street, "k" * 512, boxes=boxes, map=long, carla_version=long)

    assert len(street.box_ids()) == 1


def test_concurrent_uploads_are_counted_once_each(services):
    street = services.dataset()
    put(street, "first")

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda n: put(street, f"{n % 6}", number=n // 6), range(24)))

    assert len(street.box_ids()) == 2 * 7
    assert street.tallies() == street.recounted()


def test_concurrent_runs_and_uploads_leave_no_box_undecided(services):
    street = services.dataset()
    put(street, "first")
    configs = [{"min_visible_pixels": 10**6}, {}] * 4

    with ThreadPoolExecutor(5) as pool:
        frames = [pool.submit(put, street, f"{n}") for n in range(24)]
        runs = [street.run(config) for config in configs]
        for frame in frames:
            frame.result()

    assert [run.state for run in runs] == ["done"] * 8
    assert street.tallies() == street.recounted()
    assert list(street.reasons().values()) == [KEPT, UNSEEN] * 25


def test_run_diff_and_export_on_postgres(services):
    street = services.dataset()
    put(street, "a")
    run = street.run({"min_visible_pixels": 10**6}, activate=False)
    with services.context.database.read() as session:
        runs = compared_runs(session, run.id, None)
        diff = run_diff(services.context, session, runs, 10)
    with services.context.database.write() as session:
        request = ExportIn(format="yolo")
        export = request_export(
            services.context, session, street.row(session), request, "ada"
        )
    street.wait(run.id)

    assert (diff.total, diff.kept_to_rejected) == (1, 1)
    with services.context.database.read() as session:
        job = job_with_id(session, Export, export.id)
        assert (job.state, job.done, job.total) == ("done", 1, 1)


def test_frame_keys_are_sorted_by_code_point_in_any_locale(tmp_path):
    """In English order, B comes after a, and underscores are ignored."""
    keys = ["B", "_c", "a", "a/B", "a/a", "a_", "b", "ä"]
    with (
        empty_postgres(language="en-US") as url,
        running_services(tmp_path, database_url=url) as services,
    ):
        street = services.dataset()
        for key in reversed(keys):
            put(street, key)
        with services.context.database.read() as session:
            frames = FrameRepository(session)
            by_key = PageRequest("key", "", 100)
            listed = frames.page(street.id, by_key)
            below = frames.page(street.id, by_key, "a/")

    assert [frame.key for frame in listed] == keys
    assert [frame.key for frame in below] == ["a/B", "a/a"]
