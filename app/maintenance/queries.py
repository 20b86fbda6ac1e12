"""SQL for finding used and unused files, and for deleting the rows of unused ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from sqlalchemy import delete, exists, select
from sqlalchemy.orm import Session

from app.db.tables import Blob, Export, FrameFile


class WantedFile(NamedTuple):
    """A blob to which rows refer, and its stored size."""

    sha256: str
    size_bytes: int | None


class StoredFileRepository:
    """Rows about blobs."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def of_frames(self) -> Iterator[WantedFile]:
        """Files of frames, of every revision."""
        rows = select(Blob.sha256, Blob.size_bytes).where(
            exists().where(FrameFile.sha256 == Blob.sha256)
        )
        for row in self._session.execute(rows):
            yield WantedFile(row[0], row[1])

    def any_of_frames(self) -> bool:
        """Whether any frame has a file."""
        return self._session.scalar(select(FrameFile.sha256).limit(1)) is not None

    def of_exports(self) -> Iterator[WantedFile]:
        """Files of exports that are done."""
        rows = select(Export.sha256, Export.size_bytes).where(
            Export.state == "done", Export.sha256.is_not(None)
        )
        for row in self._session.execute(rows):
            yield WantedFile(str(row[0]), row[1])

    def referred_to(self, digests: Sequence[str]) -> set[str]:
        """Which of the given blobs a frame or an export refers to."""
        frames = select(FrameFile.sha256).where(FrameFile.sha256.in_(digests))
        exports = select(Export.sha256).where(
            Export.sha256.in_(digests), Export.state == "done"
        )
        found = {*self._session.scalars(frames), *self._session.scalars(exports)}
        return {digest for digest in found if digest is not None}

    def unused_rows(self) -> list[str]:
        """Blobs that have a row, but no frame."""
        rows = select(Blob.sha256).where(
            ~exists().where(FrameFile.sha256 == Blob.sha256)
        )
        return list(self._session.scalars(rows))

    def forget(self, digests: Sequence[str]) -> None:
        """Delete the rows of blobs that no frame has."""
        self._session.execute(
            delete(Blob).where(
                Blob.sha256.in_(digests),
                ~exists().where(FrameFile.sha256 == Blob.sha256),
            )
        )

    def open_exports(self) -> set[int]:
        """Exports that are being written, or will be."""
        rows = select(Export.id).where(Export.state.in_(("queued", "running")))
        return set(self._session.scalars(rows))
