"""Client of Unghost, which finds the boxes that CARLA's camera cannot see.

Each name is imported on first use: importing this package loads nothing, creating a
`Client` loads httpx, and reading a response pydantic. The server, numpy and OpenCV are
not loaded.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from unghost.client.client import (
        Client as Client,
    )
    from unghost.client.discovery import (
        Server as Server,
        find_server as find_server,
    )
    from unghost.client.errors import (
        ApiError as ApiError,
        BadRequest as BadRequest,
        Conflict as Conflict,
        DamagedDownload as DamagedDownload,
        Forbidden as Forbidden,
        Invalid as Invalid,
        InvalidName as InvalidName,
        NotFound as NotFound,
        RunFailed as RunFailed,
        ServerFault as ServerFault,
        StaleReview as StaleReview,
        TooLarge as TooLarge,
        Unauthorized as Unauthorized,
        Unavailable as Unavailable,
        UnexpectedAnswer as UnexpectedAnswer,
    )
    from unghost.client.outgoing import (
        AlreadyThere as AlreadyThere,
        NotSent as NotSent,
        Outcome as Outcome,
        OutgoingFrame as OutgoingFrame,
        Sent as Sent,
    )
    from unghost.client.transport import (
        RetryPolicy as RetryPolicy,
    )
    from unghost.wire.access import (
        AuditEntry as AuditEntry,
        NewToken as NewToken,
        Session as Session,
        Token as Token,
        Version as Version,
    )
    from unghost.wire.quality import (
        Agreement as Agreement,
        Band as Band,
        BandScore as BandScore,
        ChannelScore as ChannelScore,
        Confusion as Confusion,
        Evaluation as Evaluation,
        Measure as Measure,
        Pair as Pair,
        Quality as Quality,
        Reviewer as Reviewer,
        Score as Score,
        Suggestion as Suggestion,
        ThresholdPoint as ThresholdPoint,
        WrongBox as WrongBox,
    )
    from unghost.wire.boxes import (
        Claim as Claim,
        Decision as Decision,
        HiddenBy as HiddenBy,
        HistoryEntry as HistoryEntry,
        Queue as Queue,
        Review as Review,
        ReviewBatch as ReviewBatch,
        ReviewMark as ReviewMark,
        Selection as Selection,
        UndoneBatch as UndoneBatch,
    )
    from unghost.wire.datasets import (
        Counts as Counts,
        Dataset as Dataset,
        FrameProblem as FrameProblem,
        Histogram as Histogram,
        RefusedFrame as RefusedFrame,
        Stats as Stats,
    )
    from unghost.wire.frames import (
        Frame as Frame,
        SegmentationReport as SegmentationReport,
        StoredFile as StoredFile,
        StoredFrame as StoredFrame,
    )
    from unghost.wire.model import (
        Fault as Fault,
    )
    from unghost.wire.runs import (
        ConfigVersion as ConfigVersion,
        Diff as Diff,
        Export as Export,
        ExportOptions as ExportOptions,
        Failure as Failure,
        Flip as Flip,
        FlipCounts as FlipCounts,
        Preview as Preview,
        Run as Run,
    )

_NAMES: Final = {
    "unghost.client.client": ("Client",),
    "unghost.client.discovery": (
        "Server",
        "find_server",
    ),
    "unghost.client.errors": (
        "ApiError",
        "BadRequest",
        "Conflict",
        "DamagedDownload",
        "Forbidden",
        "Invalid",
        "InvalidName",
        "NotFound",
        "RunFailed",
        "ServerFault",
        "StaleReview",
        "TooLarge",
        "Unauthorized",
        "Unavailable",
        "UnexpectedAnswer",
    ),
    "unghost.client.outgoing": (
        "AlreadyThere",
        "NotSent",
        "Outcome",
        "OutgoingFrame",
        "Sent",
    ),
    "unghost.client.transport": ("RetryPolicy",),
    "unghost.wire.access": (
        "AuditEntry",
        "NewToken",
        "Session",
        "Token",
        "Version",
    ),
    "unghost.wire.quality": (
        "Agreement",
        "Band",
        "BandScore",
        "ChannelScore",
        "Confusion",
        "Evaluation",
        "Measure",
        "Pair",
        "Quality",
        "Reviewer",
        "Score",
        "Suggestion",
        "ThresholdPoint",
        "WrongBox",
    ),
    "unghost.wire.boxes": (
        "Claim",
        "Decision",
        "HiddenBy",
        "HistoryEntry",
        "Queue",
        "Review",
        "ReviewBatch",
        "ReviewMark",
        "Selection",
        "UndoneBatch",
    ),
    "unghost.wire.datasets": (
        "Counts",
        "Dataset",
        "FrameProblem",
        "Histogram",
        "RefusedFrame",
        "Stats",
    ),
    "unghost.wire.frames": (
        "Frame",
        "SegmentationReport",
        "StoredFile",
        "StoredFrame",
    ),
    "unghost.wire.model": ("Fault",),
    "unghost.wire.runs": (
        "ConfigVersion",
        "Diff",
        "Export",
        "ExportOptions",
        "Failure",
        "Flip",
        "FlipCounts",
        "Preview",
        "Run",
    ),
}
_MODULE_OF: Final = {name: module for module in _NAMES for name in _NAMES[module]}

__all__ = sorted(_MODULE_OF)


def __getattr__(name: str) -> object:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value: object = getattr(import_module(_MODULE_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULE_OF})
