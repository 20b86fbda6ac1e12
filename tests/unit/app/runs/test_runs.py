"""Runs while frames are stored, settings change, or files are missing."""

import shutil
from typing import Any

import pytest

from app.db.tables import Run
from app.jobs.driver import drive_job
from app.jobs.queries import job_with_id
from app.jobs.service import cancel, start
from app.runs.service import RUNS, described_run
from filter_core.verdicts import Reason
from tests.support import frames as scene
from tests.support.services import FLIPS, run_job, running_services
from tests.support.statements import interrupted_at
from tests.support.waiting import until

KEPT, UNSEEN = int(Reason.VISIBLE), int(Reason.NO_VISIBLE_PIXELS)
NUMBERS = "evidence.numbers"
"""Part of the statement that loads the numbers on which a run decides."""
CARS_ARE_SKY = {"classes": {"car": {"accept": ["Sky"]}}}


def put(street, key, shift=0):
    files = {"image": scene.image(), "segmentation": scene.segmentation(shift)}
    return street.put(key, scene.annotation(), **files)


@pytest.mark.parametrize("after", [False, True])
@pytest.mark.parametrize(
    "config",
    [
        pytest.param({"profile": "carlasimu"}, id="measured from pixels"),
        pytest.param(CARS_ARE_SKY, id="recounted from histograms"),
        pytest.param({"threshold_small_box": 99}, id="decided again"),
    ],
)
def test_frame_uploaded_during_a_run_is_part_of_the_run(services, config, after):
    """The run used to wait forever for numbers that were not going to be measured."""
    street = services.dataset()
    put(street, "first")
    run_id = street.request(config)
    database = services.context.database

    with interrupted_at(
        database.engine, NUMBERS, lambda: put(street, "second"), after=after
    ):
        drive_job(services.context, run_job(run_id))

    assert len(street.reasons()) == 4
    assert street.tallies() == street.recounted()
    assert street.preview(config)["flips"]["total"] == 0


def test_run_that_decides_by_stored_numbers_reads_no_file(tmp_path):
    blobs = tmp_path / "blobs"
    with running_services(tmp_path) as services:
        street = services.dataset()
        put(street, "a")
        shutil.move(blobs, tmp_path / "elsewhere")

        decided = street.run({"min_visible_pixels": 10**6})
        recounted = street.run(CARS_ARE_SKY)
        flips = street.preview({})["flips"]["total"]
        run_id = street.request({"profile": "carlasimu"})
        drive_job(services.context, run_job(run_id))
        measured = street.wait(run_id)
        shutil.move(tmp_path / "elsewhere", blobs)
        again = street.run({"profile": "carlasimu"})
        reasons = list(street.reasons().values())

    assert [(run.kind, run.state) for run in (decided, recounted)] == [
        ("decide", "done"),
        ("decide", "done"),
    ]
    assert (decided.changed, recounted.changed, flips) == (1, 1, 2)
    assert (measured.kind, measured.state) == ("measure", "failed")
    assert measured.error is not None
    assert measured.error["code"] == "damaged_file"
    assert (again.state, reasons) == ("done", [KEPT, UNSEEN])


def test_recounting_equals_measuring(services):
    recounted, measured = services.dataset(), services.dataset()
    put(recounted, "a")
    recounted.run(CARS_ARE_SKY)
    measured.run(CARS_ARE_SKY)
    put(measured, "a")

    for street in (recounted, measured):
        assert list(street.reasons().values()) == [UNSEEN, KEPT]


def test_newly_mapped_class_without_segmentation_is_unmeasured(services):
    """The old box used to keep unmapped_class, while a new one got no_segmentation."""
    dragon = {"classes": {"dragon": {"accept": ["Car"]}}}
    annotation = {"boxes": [{"class": "dragon", "xyxy": scene.ON_THE_CAR}]}
    street = services.dataset()
    street.put("before", annotation, image=scene.image())

    street.run(dragon)
    street.put("after", annotation, image=scene.image())

    assert list(street.reasons().values()) == [int(Reason.NO_SEGMENTATION)] * 2


def test_settings_of_queued_runs_do_not_overwrite_each_other(services):
    """The second run used to restore the settings that the first had replaced."""
    street = services.dataset()
    put(street, "a")
    first = street.change(palette="carla-0.9.14")
    second = street.change(lossy_segmentation="nearest")
    third = street.request({"threshold_small_box": 99})
    fourth = street.change(encoding="palette")

    for run_id in (first, second, third, fourth):
        drive_job(services.context, run_job(run_id))

    with services.context.database.read() as session:
        row = street.row(session)
        now = (row.palette, row.lossy_segmentation, row.encoding)
    assert now == ("carla-0.9.14", "nearest", "palette")
    assert street.active_config()["threshold_small_box"] == 99


def test_run_that_cannot_read_a_frame_fails_and_changes_nothing(services):
    street = services.dataset()
    put(street, "good/1")
    before = street.reasons()

    run = street.run({}, palette="carla-0.9.0")

    assert run.state == "failed"
    assert run.error is not None
    assert run.error["code"] == "segmentation_contradiction"
    assert run.error["detail"].startswith("frame good/1: ")
    assert "carla-0.9.0" in run.error["detail"]
    assert street.reasons() == before


def test_run_that_is_started_repeatedly_ends_once(services):
    street = services.dataset()
    put(street, "a")
    run_id = street.request({"threshold_small_box": 99, "min_visible_pixels": 10**6})
    for _ in range(3):
        start(services.context, [run_job(run_id)])
    drive_job(services.context, run_job(run_id))

    street.wait(run_id)

    kept = street.history(street.box_ids()[0])
    assert [entry["reason"] for entry in kept] == ["no_visible_pixels", "visible"]
    assert kept[0]["run"] == run_id


@pytest.mark.parametrize("frames", [0, 1])
def test_dataset_without_boxes_can_be_previewed_and_run(services, frames):
    street = services.dataset()
    for _ in range(frames):
        street.put("empty", {"boxes": []}, image=scene.image())

    configs: list[dict[str, Any]] = [{}, CARS_ARE_SKY, {"profile": "carlasimu"}]
    for config in configs[:2]:
        preview = street.preview(config)
        assert preview["counts"] == {"kept": 0, "rejected": 0, "unmeasured": 0}
        assert preview["flips"]["total"] == 0
    for config in configs:
        assert street.run(config).state == "done"
    assert street.tallies() == {}


@pytest.fixture(params=["services", "postgres_services"], ids=["", "on PostgreSQL"])
def services_on_either_database(request):
    return request.getfixturevalue(request.param)


@pytest.mark.parametrize("config", [{"min_visible_pixels": 10**6}, CARS_ARE_SKY])
def test_run_that_is_storing_its_results_can_be_cancelled(
    services_on_either_database, config
):
    """The request to cancel waits for the turn to write, which the run holds."""
    services = services_on_either_database
    street = services.dataset()
    put(street, "a")
    before = (street.reasons(), street.tallies(), street.active_config())
    run_id = street.request(config)

    assert street.cancelled_while_it_ends(run_id) == "cancelled"
    assert street.wait(run_id).state == "cancelled"
    assert (street.reasons(), street.tallies(), street.active_config()) == before
    assert len(street.history(street.box_ids()[0])) == 1
    assert services.context.engine.interrupted() == set()


def test_run_continues_if_its_cancellation_is_rolled_back(services):
    street = services.dataset()
    put(street, "a")
    run_id = street.request({"min_visible_pixels": 10**6})

    def cancel_and_fail():
        with services.context.database.write() as session:
            cancel(services.context, session, RUNS, run_id)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        cancel_and_fail()

    until(lambda: street.wait(run_id).state == "done")
    assert services.context.engine.interrupted() == set()


def test_run_starts_immediately_when_the_previous_run_is_cancelled(services):
    """`drive_job` has declined it already; the next check would be much later."""
    street = services.dataset()
    put(street, "a")
    before = street.request({"min_visible_pixels": 10**6})
    run_id = street.request({"min_visible_pixels": 10**5})
    assert not drive_job(services.context, run_job(run_id))

    with services.context.database.write() as session:
        cancel(services.context, session, RUNS, before)

    assert street.wait(run_id).state == "done"


def test_progress_is_visible_while_the_last_transaction_is_open(services):
    street = services.dataset()
    put(street, "a")
    run_id = street.request({"min_visible_pixels": 10**6})
    seen = []

    def report_and_read_progress() -> None:
        services.context.engine.report(run_job(run_id), 1)
        with services.context.database.read() as elsewhere:
            run = job_with_id(elsewhere, Run, run_id)
            seen.append(described_run(services.context, elsewhere, run))

    with interrupted_at(
        services.context.database.engine, FLIPS, report_and_read_progress
    ):
        drive_job(services.context, run_job(run_id))

    assert [(run.state, run.done) for run in seen] == [("running", 1)]
    assert services.context.engine.reported(run_job(run_id)) == 0
