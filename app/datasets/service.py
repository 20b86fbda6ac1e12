"""Creates, changes, deletes and describes datasets."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from sqlalchemy.orm import Session

from app.boxes.counts import count, summary
from app.boxes.current import TallyRepository, replace_tallies
from app.boxes.queries import FrameRepository
from app.catalog.datasets import DatasetRepository
from app.catalog.frames import ProblemRepository
from app.context import ServiceContext
from app.db.base import filled, response_of, utc_now
from app.db.engine import once_committed
from app.db.tables import Dataset, Run
from app.errors import BadRequest
from app.jobs.kind import all_open_jobs
from app.jobs.service import end_all, interrupt
from app.measuring.active import active_config, active_digest, add_version
from app.measuring.plan import DatasetReading, measurement_of, plan_for
from app.measuring.queries import EvidenceRepository
from app.runs.queries import RunRepository
from app.runs.service import RunRequest, coming_settings, request_run
from app.storage.room import DeletionSignal
from filter_core.config.filter import FilterConfig
from filter_core.errors import ConfigError
from filter_core.formats.recording import RecordingDescription, values_of
from unghost.wire import datasets as wire

CARLA_CLASSES: Final = (
    "car",
    "truck",
    "van",
    "bus",
    "motorcycle",
    "bicycle",
    "walker",
    "traffic_light",
)
"""The classes of a dataset that is created without any, in the order of its exports."""


@dataclass(frozen=True)
class NewDataset:
    """A dataset to be created."""

    reading: DatasetReading
    description: str
    classes: Sequence[str] | None
    config: FilterConfig
    author: str
    recording: Mapping[str, object] | None = None
    rule: str = ""
    coached: bool = False


def create_dataset(session: Session, new_dataset: NewDataset) -> Dataset:
    """Create an empty dataset with its first configuration active."""
    reading, config = new_dataset.reading, new_dataset.config
    author = new_dataset.author
    plan, classes = plan_for(reading, config), new_dataset.classes
    dataset = DatasetRepository(session).add(
        Dataset(
            name=reading.name,
            description=new_dataset.description,
            rule=new_dataset.rule,
            coached=new_dataset.coached,
            recording=checked_recording(new_dataset.recording),
            created_by=author,
            **reading.as_columns(),
        ),
        list(dict.fromkeys(CARLA_CLASSES if classes is None else classes)),
    )
    version, _ = add_version(session, dataset, config, author=author)
    measurement = measurement_of(session, dataset.id, reading, plan)
    now = utc_now()
    run = RunRepository(session).add(
        Run(
            dataset_id=dataset.id,
            config_id=version.id,
            measurement_id=measurement.id,
            kind="decide",
            state="done",
            activate=True,
            counts={},
            created_by=author,
            started_at=now,
            finished_at=now,
        )
    )
    DatasetRepository(session).activate(dataset, run)
    return dataset


def change_dataset(
    context: ServiceContext,
    session: Session,
    dataset: Dataset,
    changes: Mapping[str, Any],
    author: str,
) -> Run | None:
    """Change what only describes it at once; settings of reading, by the returned run.

    The run measures all frames again. The dataset's settings change when it is done, so
    that they always describe how the current numbers were read.
    """
    about = {key: changes[key] for key in _DESCRIBING if key in changes}
    if about.get("recording") is not None:
        about["recording"] = checked_recording(about["recording"])
    if about:
        DatasetRepository(session).change(dataset, about)
    current, config = coming_settings(session, dataset)
    others = {key: changes[key] for key in changes if key not in _DESCRIBING}
    reading = replace(current, **others)
    if reading == current:
        return None
    request = RunRequest(config, author, True, reading)
    return request_run(context, session, dataset, request)


_DESCRIBING: Final = ("description", "rule", "coached", "recording")
"""Changes of a dataset after which nothing is measured again."""


def checked_recording(
    document: Mapping[str, object] | None,
) -> Mapping[str, object] | None:
    """A description of a recording, as it is.

    Raises ConfigError if it has an unknown key or a wrong value.
    """
    make: Callable[..., RecordingDescription] = RecordingDescription
    try:
        make(**values_of(document))
    except ConfigError as exc:
        raise ConfigError(
            f"recording: {exc.detail}", pointer=f"/recording{exc.pointer}"
        ) from exc
    return document


def remove_dataset(
    context: ServiceContext, session: Session, name: str, confirmed: str | None
) -> Dataset:
    """Delete a dataset with everything in it; its blobs stay until garbage collection.

    The dataset is hidden from the commit on, and its rows are deleted in small steps
    after that. Its jobs are interrupted first, and read by a session of their own:
    `session` must be unused, since its first statement waits for the turn to write,
    which a run of this dataset may hold during its last step. Raises NotFound if there
    is no such dataset, and BadRequest if `confirmed` is not its name.
    """
    with context.database.read() as before:
        dataset = DatasetRepository(before).named(name)
        if confirmed != name:
            shown = "nothing" if confirmed is None else repr(confirmed)
            raise BadRequest(
                f"deleting dataset {name!r} deletes all its frames and answers and "
                f"cannot be undone; expected ?confirm={name}, found {shown}",
                code="not_confirmed",
            )
        jobs = all_open_jobs(before, dataset.id)
    for job in jobs:
        interrupt(context, session, job)
    dataset = DatasetRepository(session).named(name)
    end_all(session, dataset.id)
    DatasetRepository(session).hide(dataset)
    replace_tallies(session, dataset.id, {})
    once_committed(session, context.one(DeletionSignal).set)
    return dataset


def describe_dataset(session: Session, dataset: Dataset) -> wire.Dataset:
    """A dataset as responses show it."""
    counts = count(TallyRepository(session).of_dataset(dataset.id))
    frames = FrameRepository(session)
    active = active_config(session, dataset)
    return response_of(
        wire.Dataset,
        dataset,
        classes=tuple(DatasetRepository(session).listed_classes(dataset.id)),
        classes_frozen=dataset.classes_frozen_at is not None,
        config=active.digest,
        evidence=active.evidence,
        active_run=dataset.active_run_id,
        thumbnail_frame_id=frames.first_with_image(dataset.id),
        counts=wire.DatasetCounts(
            frames=frames.count(dataset.id),
            **summary(counts),
            problems=ProblemRepository(session).count(dataset.id),
        ),
    )


def statistics(session: Session, dataset: Dataset) -> wire.Stats:
    """The counts of a dataset, from its tallies."""
    counts = count(TallyRepository(session).of_dataset(dataset.id))
    classes = DatasetRepository(session).classes(dataset.id)
    names = {class_id: name for name, class_id in classes.items()}
    measurement = filled(dataset.active_measurement_id)
    frames = FrameRepository(session)
    places = {
        f"by_{what}": {
            name: wire.MapCounts(frames=number, boxes=boxes)
            for name, (number, boxes) in of.items()
        }
        for what, of in frames.counts_by_place(dataset.id).items()
    }
    reasons = counts.reasons_by_class
    return wire.Stats(
        frames=frames.count(dataset.id),
        **summary(counts),
        unsure=counts.unsure,
        conflicts=counts.conflicts,
        toss_ups=counts.toss_ups,
        bins=counts.bins,
        lossy=EvidenceRepository(session).lossy_boxes(measurement),
        effective=counts.effective,
        by_reason=counts.by_reason,
        by_class={names[key]: of for key, of in counts.by_class.items()},
        reasons_by_class={names[key]: of for key, of in reasons.items()},
        **places,
        config=active_digest(session, dataset),
        run=dataset.active_run_id,
    )
