"""Writes an export: one consistent snapshot of the database, streamed into a zip file.

The file is named by its hash, and the same state gives the same bytes. An interrupted
export starts again, since its snapshot is gone. Two processes may write the same
export: the first to finish ends it.
"""

from __future__ import annotations

import hashlib
import json
import secrets
import shutil
import zipfile
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

from sqlalchemy.orm import Session

from app.boxes.current import TallyRepository
from app.boxes.queries import FileRow, FrameRepository, LatestAnswers
from app.boxes.reader import DecisionReader
from app.catalog.datasets import DatasetRepository
from app.db.engine import once_committed
from app.db.tables import Dataset, Export, Frame
from app.engine.children import PixelPool
from app.exports.queries import VersionRepository
from app.jobs.kind import Task
from app.measuring.active import active_digest
from app.storage.base import BlobsUncertain
from app.storage.room import DeletionSignal
from filter_core.formats import export as formats
from filter_core.formats.format import Need
from filter_core.formats.recording import COMPANIONS
from filter_core.formats.registry import FORMATS, format_of, write_export
from filter_core.formats.same import SOURCE_LABELS
from filter_core.formats.tally import Counts
from filter_core.images.drawing import DrawnBox, png_with_boxes
from filter_core.pipeline import class_name_of
from filter_core.segmentation.reading import SegmentationOptions, in_colors
from filter_core.values import JsonObject, as_text
from filter_core.verdicts import DecidedBoxes

_FRAMES_AT_A_TIME: Final = 200
"""Frames whose rows are read together."""

_NO_ROWS: Final = slice(0, 0)

_CROWD: Final = '"iscrowd"'
"""The JSON key that marks a crowd in an annotation."""
_PARTS: Final = ('"split"', '"sequence"')
"""The JSON keys that say of which part or sequence a frame is."""
_EPOCH: Final = (1980, 1, 1, 0, 0, 0)
"""The earliest time in a zip file, for all entries: exports contain no clock time."""
_PACKED: Final = (".png", ".jpg")
"""Compressed already: compressing them again takes time and saves nothing."""
_READABLE: Final = 0o644 << 16


def write_archive(task: Task[Export]) -> None:
    """Write the zip file of an export, store it, and end the export's job."""
    context = task.context
    task.check()
    temporary, name = context.storage.temporary_folder(), f"export-{task.job.id}"
    # A folder for this attempt alone: earlier ones may still run.
    folder = temporary / f"{name}-{secrets.token_hex(4)}"
    folder.mkdir()
    try:
        file = folder / "export.zip"
        with context.database.read() as session:
            counts, frames = _stream(task, session, file)
            version = frames.version()
        size_bytes = file.stat().st_size
        digest = task.retry_unavailable(lambda: context.storage.adopt(file))
    finally:
        shutil.rmtree(folder, ignore_errors=True)

    def end() -> None:
        with context.database.write() as session:
            export = task.row(session)
            context.storage.require([digest])
            export.sha256, export.size_bytes = digest, size_bytes
            export.counts, export.done = counts, export.total
            export.version = version
            if export.name is not None:
                export.frames_state = pack_state(frames.digests)
            task.end_job(session)
            # Older files may have to make place for this one.
            once_committed(session, context.one(DeletionSignal).set)

    try:
        end()
    except BlobsUncertain as uncertain:
        task.retry_unavailable(partial(context.storage.make_sure, uncertain.digests))
        end()
    # Another process that still writes this export stops at its next `check`, because
    # the job has ended: its folder can be removed, as those of interrupted attempts.
    for left in (name, f"{name}-*"):
        for abandoned in temporary.glob(left):
            shutil.rmtree(abandoned, ignore_errors=True)


def _stream(
    task: Task[Export], session: Session, file: Path
) -> tuple[Counts, ExportFrames]:
    """Write the file; the counts of its content, and the frames that it was made of."""
    export = task.row(session)
    dataset = DatasetRepository(session).with_id(export.dataset_id)
    # The stored request, which an earlier version may have checked, has a value for
    # every option, also for those that its format does not have.
    names = FORMATS[export.format].options
    stored = {name: v for name, v in export.options.items() if name in names}
    options = formats.ExportOptions.from_mapping(stored)
    needs, storage = format_of(export.format, options).needs, task.context.storage

    def read(digest: str) -> bytes:
        return task.retry_unavailable(partial(storage.read, digest))

    frames = ExportFrames(read, session, dataset, needs, task.context.drawers)
    expected = sum(TallyRepository(session).of_dataset(dataset.id).values())
    absent = (dataset.recording or {}).get(COMPANIONS)
    head = formats.ExportHead(
        classes=tuple(DatasetRepository(session).listed_classes(dataset.id)),
        facts={
            "dataset": dataset.name,
            "run": dataset.active_run_id,
            "config": active_digest(session, dataset),
            "last_review": LatestAnswers(session).last_id(dataset.id),
            "frames": FrameRepository(session).count(dataset.id),
            **({"companions_absent": absent} if absent else {}),
        },
        expected_boxes=expected,
        temporary=file.parent,
    )
    if export.since is not None:
        since = VersionRepository(session, dataset).named(export.since)
        frames.known = unpack_state(since)
        gone = sorted(frames.known.keys() - FrameRepository(session).keys(dataset.id))
        facts = {**head.facts, "since": export.since, "removed": gone}
        head = replace(head, facts=facts, expected_boxes=None)

    def reporting() -> Iterator[formats.ExportFrame]:
        for done, frame in enumerate(frames):
            task.check()
            task.report(min(done, export.total))
            yield frame

    with closing(ReproducibleZip(file)) as archive:
        counts = write_export(export.format, reporting(), archive.add, head, options)
    if frames.boxes != expected:
        raise formats.ExportError(
            f"expected {expected} boxes, found {frames.boxes}", code="count_mismatch"
        )
    return counts, frames


def pack_state(digests: Mapping[str, str]) -> bytes:
    """The digests of frames by their keys, compressed."""
    return zlib.compress(json.dumps(digests).encode())


def unpack_state(version: Export) -> dict[str, str]:
    """The digests of a version's frames by their keys."""
    state: dict[str, str] = json.loads(zlib.decompress(version.frames_state or b""))
    return state


class ExportFrames:
    """Iterates over all current frames in order of key, and reads only what is needed.

    `needs` are the parts of a frame that the format uses; child processes draw. A frame
    that still has its digest in `known`, by its key, is left out. `digests` are those
    of all frames so far: of their files, boxes, decisions and answers; `boxes` counts
    the boxes of these, also of frames that were left out.
    """

    def __init__(
        self,
        read: Callable[[str], bytes],
        session: Session,
        dataset: Dataset,
        needs: Collection[Need],
        drawers: PixelPool,
    ) -> None:
        self._read, self._drawers, self._session = read, drawers, session
        self._dataset, self._needs = dataset, needs
        self._reader = DecisionReader(session, dataset)
        self.known: Mapping[str, str] = {}
        self.digests: dict[str, str] = {}
        self.boxes = 0

    def version(self) -> str:
        """Digest of the configuration and of all frames, after they were read."""
        version = active_digest(self._session, self._dataset)
        lines = [f"version 1 {version}"]
        lines += [f"{digest} {key}" for key, digest in self.digests.items()]
        return hashlib.sha256("\n".join(lines).encode()).hexdigest()

    def __iter__(self) -> Iterator[formats.ExportFrame]:
        repository, after = FrameRepository(self._session), ""
        while frames := repository.next_frames(
            self._dataset.id, after=after, limit=_FRAMES_AT_A_TIME
        ):
            yield from self._read_together(frames)
            after = frames[-1].key

    def _read_together(self, frames: Sequence[Frame]) -> Iterator[formats.ExportFrame]:
        """Several frames, whose data is read at once."""
        repository, needs = FrameRepository(self._session), self._needs
        ids = [frame.id for frame in frames]
        boxes = self._reader.read_frames(ids)
        rows_by_frame = boxes.rows_by_frame()
        texts = repository.annotation_texts(ids) if "annotation" in needs else {}
        files = repository.files(ids) if "image" in needs else {}
        decisions = self._reader.records(boxes) if "decisions" in needs else ()
        columns = self._reader.columns(boxes) if "decision_columns" in needs else None
        for frame in frames:
            rows = rows_by_frame.get(frame.id, _NO_ROWS)
            labels, evidence = boxes.labels[rows], boxes.frames.get(frame.id)
            digest = _digest_of(frame, labels)
            self.digests[frame.key] = digest
            self.boxes += len(labels)
            if self.known.get(frame.key) == digest:
                continue
            yield replace(
                self._frame(
                    frame,
                    labels,
                    text=texts.get(frame.id, "{}"),
                    files=files.get(frame.id, {}),
                    palette=None if evidence is None else evidence.palette,
                ),
                decisions=decisions[rows],
                columns=None if columns is None else columns[rows],
            )

    def _draw(self, digest: str, boxes: Sequence[DrawnBox]) -> bytes:
        return self._drawers.run(png_with_boxes, self._read(digest), boxes)

    def _colored(self, digest: str, palette: str | None) -> bytes:
        content = self._read(digest)
        if palette is None:
            return content
        options = SegmentationOptions(palette=palette)
        return self._drawers.run(in_colors, content, options)

    def _frame(
        self,
        frame: Frame,
        boxes: DecidedBoxes,
        *,
        text: str,
        files: Mapping[str, FileRow],
        palette: str | None,
    ) -> formats.ExportFrame:
        """A frame without its decisions; `text` is its annotation, as stored."""
        wh, image = (frame.width, frame.height), files.get("image")
        # Whether an annotation may have the labels of a format of this name.
        has_labels = f'"{SOURCE_LABELS}"' in text
        annotation = formats.GivenAnnotation(
            partial(_annotation, text, self._dataset.renamed_classes),
            wh,
            crowds=_CROWD in text,
            may_be_of=lambda name: has_labels and f'"{name}"' in text,
        )
        said = annotation.frame if any(key in text for key in _PARTS) else {}
        return formats.ExportFrame(
            key=frame.key,
            wh=wh,
            boxes=boxes,
            given=annotation,
            map=frame.map,
            sequence=as_text(said.get("sequence")),
            split=as_text(said.get("split")),
            media_type=image.media_type if image else "image/png",
            read_image=partial(self._read, image.sha256) if image else None,
            read_files={
                kind: (
                    partial(self._colored, file.sha256, palette)
                    if kind == "segmentation"
                    else partial(self._read, file.sha256)
                )
                for kind, file in files.items()
            },
            draw=partial(self._draw, image.sha256) if image else None,
            palette=palette,
        )


def _digest_of(frame: Frame, boxes: DecidedBoxes) -> str:
    """Digest of a frame's files and annotation, of its decisions, and of answers."""
    names = [boxes.class_names[index] for index in boxes.class_index.tolist()]
    digest = hashlib.sha256(frame.content_digest.encode())
    digest.update(json.dumps([*boxes.ids, *names]).encode())
    digest.update(boxes.reason.tobytes() + boxes.answer.tobytes())
    return digest.hexdigest()


def _annotation(text: str, renamed: Mapping[str, str]) -> JsonObject:
    """An annotation as it was sent, but with the present names of classes."""
    annotation: JsonObject = json.loads(text)
    if renamed:
        for box in annotation.get("boxes", ()):
            sent = class_name_of(*map(box.get, ("class", "type_id", "base_type")))
            if sent in renamed:
                box["class"] = renamed[sent]
    return annotation


class ReproducibleZip:
    """A zip file that depends on its files alone: no times, owners or system names."""

    def __init__(self, path: Path) -> None:
        self._zip = zipfile.ZipFile(path, "w", allowZip64=True)

    def close(self) -> None:
        """Write the list of files, with which the zip file ends."""
        self._zip.close()

    def add(self, name: str, pieces: Iterable[bytes]) -> None:
        """Add a file, piece by piece."""
        entry = zipfile.ZipInfo(name, _EPOCH)
        entry.create_system = 3  # Unix, on every system
        entry.external_attr = _READABLE
        packed = name.endswith(_PACKED)
        entry.compress_type = zipfile.ZIP_STORED if packed else zipfile.ZIP_DEFLATED
        with self._zip.open(entry, "w", force_zip64=True) as file:
            for piece in pieces:
                file.write(piece)
