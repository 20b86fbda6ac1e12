"""Frames of a dataset as the writers of formats take them, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final

from sqlalchemy.orm import Session

from app.db.tables import Dataset, Frame
from app.repositories.frames import FileRow, FrameRepository
from app.services.decisions import DecisionReader
from filter_core.annotation.frame import frame_boxes_2d
from filter_core.annotation.parsing import parse_annotation
from filter_core.formats.export import ExportFrame, export_boxes

_CHUNK: Final = 200


class ExportFrames:
    """Iterates over all current frames in the order of their keys.

    Without `whole_decisions` a decision has only what formats of labels write.
    """

    def __init__(
        self,
        read: Callable[[str], bytes],
        session: Session,
        dataset: Dataset,
        *,
        whole_decisions: bool,
    ) -> None:
        self._read = read
        self._session = session
        self._dataset = dataset
        self._whole = whole_decisions
        self._reader = DecisionReader(session, dataset)

    def __iter__(self) -> Iterator[ExportFrame]:
        frames = FrameRepository(self._session)
        after = ""
        while chunk := frames.chunk(self._dataset.id, after=after, limit=_CHUNK):
            files = frames.files(frame.id for frame in chunk)
            decisions = self._reader.of_frames(chunk, whole=self._whole)
            palettes = self._palettes(chunk)
            for frame in chunk:
                content = self._frame(frame, files[frame.id], decisions[frame.id])
                yield replace(content, palette=palettes.get(frame.id))
            after = chunk[-1].key
            # Otherwise the session would keep every frame it has ever seen.
            for frame in chunk:
                self._session.expunge(frame)

    def _palettes(self, chunk: Sequence[Frame]) -> Mapping[int, str]:
        if not self._whole:
            return {}
        return self._reader.palettes(frame.id for frame in chunk)

    def _frame(
        self,
        frame: Frame,
        files: Mapping[str, FileRow],
        decisions: list[dict[str, Any]],
    ) -> ExportFrame:
        annotation = parse_annotation(frame.annotation, frame=frame.key)
        wh = (frame.width or 0, frame.height or 0)
        geometry = frame_boxes_2d(annotation, wh, self._reader.config.projection)
        image = files.get("image")
        return ExportFrame(
            key=frame.key,
            wh=wh,
            boxes=export_boxes(annotation, decisions, geometry),
            map=frame.map,
            annotation=annotation.raw,
            camera=annotation.camera,
            media_type=image.media_type if image else "image/png",
            read_image=self._reader_of(image),
        )

    def _reader_of(self, image: FileRow | None) -> Callable[[], bytes] | None:
        if image is None:
            return None
        return partial(self._read, image.sha256)
