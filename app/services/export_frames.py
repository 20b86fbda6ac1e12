"""Frames of a dataset as the writers of formats take them, one after the other."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Final

from sqlalchemy.orm import Session

from app.boxes.queries import FileRow, FrameRepository
from app.boxes.reader import DecisionReader, StoredDecision
from app.db.tables import Dataset, Frame
from filter_core.formats.export import ExportFrame, GivenAnnotation
from filter_core.formats.format import Need
from filter_core.types import DecidedBoxes

_CHUNK: Final = 200

_CROWD: Final = '"iscrowd"'
"""What stands in the text of an annotation that has the key."""


class ExportFrames:
    """Iterates over all current frames in the order of their keys.

    What the format does not need is not read.
    """

    def __init__(
        self,
        read: Callable[[str], bytes],
        session: Session,
        dataset: Dataset,
        needs: Collection[Need],
    ) -> None:
        self._read = read
        self._session = session
        self._dataset = dataset
        self._needs = needs
        self._reader = DecisionReader(session, dataset)

    def __iter__(self) -> Iterator[ExportFrame]:
        frames = FrameRepository(self._session)
        after = ""
        while chunk := frames.chunk(self._dataset.id, after=after, limit=_CHUNK):
            content = self._content(chunk)
            for frame in chunk:
                yield self._frame(frame, content)
            after = chunk[-1].key
            # Otherwise the session would keep every frame it has ever seen.
            for frame in chunk:
                self._session.expunge(frame)

    def _content(self, chunk: list[Frame]) -> _Content:
        frames = FrameRepository(self._session)
        content = _Content(self._reader.columns_of_frames(chunk))
        ids = [frame.id for frame in chunk]
        if "annotation" in self._needs:
            content.annotations = frames.annotation_texts(ids)
        if "image" in self._needs:
            content.files = frames.files(ids)
        if "decisions" in self._needs:
            content.decisions = self._reader.of_frames(
                chunk, explained="explanations" in self._needs
            )
            content.palettes = self._reader.palettes(ids)
        return content

    def _frame(self, frame: Frame, content: _Content) -> ExportFrame:
        wh = (frame.width or 0, frame.height or 0)
        text = content.annotations.get(frame.id, "{}")
        image = content.files.get(frame.id, {}).get("image")
        return ExportFrame(
            key=frame.key,
            wh=wh,
            boxes=content.boxes.get(frame.id) or DecidedBoxes.empty(),
            given=GivenAnnotation(partial(json.loads, text), wh, crowds=_CROWD in text),
            map=frame.map,
            media_type=image.media_type if image else "image/png",
            read_image=partial(self._read, image.sha256) if image else None,
            palette=content.palettes.get(frame.id),
            decisions=content.decisions.get(frame.id, ()),
        )


@dataclass
class _Content:
    """What is read of some frames at once, each by the ids of the frames."""

    boxes: Mapping[int, DecidedBoxes]
    annotations: Mapping[int, str] = field(default_factory=dict)
    files: Mapping[int, Mapping[str, FileRow]] = field(default_factory=dict)
    decisions: Mapping[int, list[StoredDecision]] = field(default_factory=dict)
    palettes: Mapping[int, str] = field(default_factory=dict)
