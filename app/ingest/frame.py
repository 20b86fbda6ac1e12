"""The stages of a frame's ingestion: uploaded, ready (measured), accepted.

Each stage is a type, the input of the next step; `app.ingest.service` has the steps. A
frame may also be refused, as a `RefusedFrame`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from app.boxes.queries import FileRow
from app.errors import AppError
from app.measuring.active import ActiveDataset
from app.memory import forget_tracebacks
from app.security import Principal
from app.storage.base import Drafts
from filter_core.pipeline import MeasuredFrame
from unghost.wire.datasets import VerdictCounts


@dataclass(frozen=True)
class UploadRequest:
    """The parameters that all frames of one request share.

    With `replace`, a frame with other content becomes the next revision of its key.
    """

    dataset: str
    sender: Principal
    replace: bool = False


@dataclass
class UploadedFrame:
    """A frame as it was received, alone or in an archive.

    `key` is its name in its dataset; with `may_rename`, as in an archive, the
    annotation, which is JSON, may have another one. `files` has the bytes of each file
    by its kind. `fault` was found while it was received.
    """

    key: str
    annotation: bytes = b""
    files: dict[str, bytes] = field(default_factory=dict)
    may_rename: bool = False
    fault: AppError | None = None

    @property
    def size_bytes(self) -> int:
        """Bytes of its annotation and files in memory."""
        return len(self.annotation) + sum(map(len, self.files.values()))


@dataclass(frozen=True)
class ReadyFrame:
    """A measured frame whose files are written, and whose rows are not.

    `contents` has the bytes by kind of those `files` that some measurement reads. Equal
    content has an equal `digest`. `active` is its dataset, with the measurement to
    which the numbers belong; `drafts` are its files, which `storage.settle` makes
    durable.
    """

    key: str
    files: tuple[FileRow, ...]
    contents: Mapping[str, bytes]
    digest: str
    measured: MeasuredFrame
    active: ActiveDataset
    drafts: Drafts

    @property
    def size_bytes(self) -> int:
        """Bytes of its files in memory."""
        return sum(map(len, self.contents.values()))

    def is_measured_for(self, active: ActiveDataset) -> bool:
        """Whether its numbers belong to the current measurement of the dataset."""
        return active.row.measurement_digest == self.active.row.measurement_digest


@dataclass(frozen=True)
class AcceptedFrame:
    """An uploaded frame that is in the database, by this upload or an earlier one.

    If this upload has stored it, it is a `NewFrame` (`app.ingest.rows`). `verdicts` are
    the numbers of its boxes by verdict; None if they have not been counted. Of answers
    on the revision that this upload has replaced, whose boxes have changed or are gone,
    `answers_set_aside` is the number, and `boxes_set_aside` has the ids of the first of
    these boxes.
    """

    key: str
    frame_id: int
    verdicts: VerdictCounts | None = None
    answers_set_aside: int = 0
    boxes_set_aside: tuple[str, ...] = ()


@dataclass(frozen=True)
class RefusedFrame:
    """A frame that is refused, and the reason."""

    key: str
    error: Exception

    def __post_init__(self) -> None:
        """Drop the error's tracebacks, which refer to the frame's data."""
        forget_tracebacks(self.error)


EndedFrame: TypeAlias = AcceptedFrame | RefusedFrame
"""The final result for a frame."""
PreparedFrame: TypeAlias = ReadyFrame | EndedFrame
"""A frame after `prepare_frame`: ready for the transaction, or a final result."""
