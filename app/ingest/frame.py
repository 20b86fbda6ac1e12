"""A frame on its way in, stage by stage: as it came, checked, measured, stored.

Each stage is one object, which the next step takes; `app.ingest.service` has the steps.
A frame may also end early, as a `RefusedFrame`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TypeAlias

from app.boxes.queries import FileRow
from app.errors import AppError, forget_frames
from app.measuring.active import ActiveDataset
from app.measuring.frame_files import MEASURED, SENSORS, FrameFiles
from app.security import Principal
from app.storage import Drafts
from filter_core.annotation.frame import FrameAnnotation
from filter_core.pipeline import MeasuredFrame
from unghost.wire.datasets import VerdictCounts


@dataclass(frozen=True)
class UploadRequest:
    """What all frames of one request have in common.

    With `replace`, a frame with other content becomes the next revision of its key.
    """

    dataset: str
    sender: Principal
    replace: bool = False


@dataclass
class UploadedFrame:
    """A frame as it came, alone or in an archive.

    Attributes
    ----------
    key : str
        The frame's name in its dataset.
    annotation : bytes
        JSON.
    files : dict
        The bytes of each file by its kind.
    may_rename : bool
        The annotation may name another key, as in an archive.
    fault : AppError or None
        What was found wrong with it already.
    """

    key: str
    annotation: bytes = b""
    files: dict[str, bytes] = field(default_factory=dict)
    may_rename: bool = False
    fault: AppError | None = None

    @property
    def size_bytes(self) -> int:
        """What it holds in memory."""
        return len(self.annotation) + sum(map(len, self.files.values()))


@dataclass(frozen=True)
class CheckedFrame:
    """A frame whose annotation and headers are in order; no pixel was read yet.

    `digest` names what was sent: the same content has the same digest. `contents` are
    the bytes of the files, `files` what is stored about them.
    """

    key: str
    annotation: FrameAnnotation
    image_wh: tuple[int, int]
    files: tuple[FileRow, ...]
    contents: Mapping[str, bytes]
    digest: str

    def blobs(self) -> dict[str, bytes]:
        """The files by their digests."""
        return {row.sha256: self.contents[row.kind] for row in self.files}

    def to_measure(self, sensors: tuple[str, ...]) -> FrameFiles:
        """The files that a measurement reads, with those of these sensors."""
        return FrameFiles.of(self.contents, self.image_wh, sensors)

    def without_other_files(self) -> CheckedFrame:
        """Itself, holding only the bytes that some measurement reads."""
        kinds = (*MEASURED, *SENSORS)
        needed = {kind: self.contents[kind] for kind in kinds if kind in self.contents}
        return replace(self, contents=needed)


@dataclass(frozen=True)
class ReadyFrame:
    """A measured frame whose files are written; only its rows are missing.

    `active` is its dataset, with the measurement that the numbers belong to. `drafts`
    are its files, which `storage.settle` makes durable.
    """

    checked: CheckedFrame
    measured: MeasuredFrame
    active: ActiveDataset
    drafts: Drafts

    @property
    def key(self) -> str:
        """The frame's key."""
        return self.checked.key

    @property
    def size_bytes(self) -> int:
        """Bytes of files that it holds in memory."""
        return sum(map(len, self.checked.contents.values()))

    def is_measured_for(self, active: ActiveDataset) -> bool:
        """Whether its numbers are those that the dataset asks for by now."""
        return active.row.measurement_digest == self.active.row.measurement_digest


@dataclass(frozen=True)
class StoredFrame:
    """A frame that is in the database.

    If this upload has stored it, it is a `NewFrame` (`app.ingest.rows`). `verdicts` are
    the numbers of its boxes by verdict; None if nobody has counted them.
    """

    key: str
    frame_id: int
    verdicts: VerdictCounts | None = None


@dataclass(frozen=True)
class RefusedFrame:
    """A frame that is not stored, and why."""

    key: str
    error: Exception

    def __post_init__(self) -> None:
        """Nothing of the frame is kept."""
        forget_frames(self.error)


EndedFrame: TypeAlias = StoredFrame | RefusedFrame
"""A frame that has come to its end."""
PreparedFrame: TypeAlias = ReadyFrame | EndedFrame
"""A frame after `prepare_frame`: ready for the transaction, or at its end."""
