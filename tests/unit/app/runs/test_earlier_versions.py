"""Numbers that an earlier version has measured stay until a run measures again."""

from dataclasses import replace

from app.context import ServiceContext
from app.db.tables import Measurement, Run
from app.jobs.queries import job_with_id
from app.measuring.plan import active_measurement, plan_of
from app.runs.flips import run_diff
from filter_core.config.filter import FilterConfig
from filter_core.verdicts import Reason
from tests.support import frames as scene

BOXES = [
    # A pixel of the car; with the edge as given a pixel of the road below it, too.
    {"id": "rounded", "class": "car", "xyxy": [20, 39, 21, 40.0003]},
    {"id": "named", "class": "Car", "xyxy": scene.ON_THE_CAR},
    {"id": "plain", "class": "car", "xyxy": scene.ON_THE_CAR},
]
STRICT = {"threshold_small_box": 60}
FORMER = [Reason.BELOW_THRESHOLD, Reason.UNMAPPED_CLASS, Reason.VISIBLE]
NEW = [Reason.VISIBLE, Reason.VISIBLE, Reason.VISIBLE]


def measured_by_version_1(street):
    """Make the measurement of an empty dataset one of the first version."""
    with street.context.database.write() as session:
        row = active_measurement(session, street.row(session))
        plan = replace(plan_of(row, FilterConfig()), version=1)
        row.options = {
            key: value for key, value in row.options.items() if key != "version"
        }
        row.digest, row.pixel_digest = plan.digest, plan.pixel_digest


def reasons(street):
    return [reason for _, reason in sorted(street.reasons().items())]


def put(street, key):
    frame = {"carla_version": "0.9.15", "boxes": BOXES}
    street.put(key, frame, image=scene.image(), segmentation=scene.segmentation())


def diff(context: ServiceContext, run: Run, against: int):
    with context.database.read() as session:
        runs = job_with_id(session, Run, against), job_with_id(session, Run, run.id)
        return run_diff(context, session, runs, 10)


def test_numbers_of_version_1_stay_until_a_run_measures_again(services):
    street = services.dataset()
    measured_by_version_1(street)
    put(street, "a")
    before = street.run(STRICT)
    put(street, "b")  # as the other frames of the dataset are measured
    former = reasons(street)
    preview = street.preview(STRICT)

    measured = street.run(STRICT, measure_again=True)
    put(street, "c")
    after = street.run({**STRICT, "threshold_big_box": 40})

    assert (before.kind, former, preview["needs_pixels"]) == (
        "decide",
        FORMER * 2,
        False,
    )
    assert (measured.kind, after.kind) == ("measure", "decide")
    assert reasons(street) == NEW * 3
    changes = diff(services.context, measured, before.id)
    causes = {flip.class_name: flip.cause for flip in changes.items}
    assert causes == {"car": "edge_rounded", "Car": "class_known"}
    assert changes.by_cause == {"class_known": 2, "edge_rounded": 2}
    assert diff(services.context, after, measured.id).by_cause == {}


def test_class_map_of_a_configuration_is_no_other_cause(services):
    street = services.dataset()
    frame = {"boxes": [{"id": "a", "class": "caar", "xyxy": scene.ON_THE_CAR}]}
    street.put("a", frame, image=scene.image(), segmentation=scene.segmentation())
    before = street.run({})

    after = street.run({"classes": {"caar": "car"}})

    changes = diff(services.context, after, before.id)
    assert (changes.total, changes.by_cause) == (1, {})
    assert [flip.cause for flip in changes.items] == [None]


def test_run_that_needs_pixels_measures_in_the_newest_version(services):
    street = services.dataset()
    measured_by_version_1(street)
    put(street, "a")

    run = street.run({**STRICT, "projection": "naive"})

    assert (run.kind, reasons(street)) == ("measure", NEW)


def test_run_that_is_requested_while_another_measures_again_keeps_its_version(services):
    street = services.dataset()
    measured_by_version_1(street)
    put(street, "a")

    measuring = street.request(STRICT, measure_again=True)
    deciding = street.request({**STRICT, "threshold_big_box": 40})

    with services.context.database.read() as session:
        rows = [
            session.get_one(
                Measurement, job_with_id(session, Run, run_id).measurement_id
            )
            for run_id in (measuring, deciding)
        ]
        assert [row.options.get("version") for row in rows] == [2, 2]
