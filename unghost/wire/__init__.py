"""The models of request and response bodies, for the service and the client.

A model is imported when it is first used, because pydantic takes a tenth of a second to
import. Nothing else of Unghost is imported here.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from unghost.wire.access import (
        Alive as Alive,
        AuditEntry as AuditEntry,
        LogIn as LogIn,
        LoginCode as LoginCode,
        NewLoginCode as NewLoginCode,
        NewSession as NewSession,
        NewToken as NewToken,
        Ready as Ready,
        Session as Session,
        Token as Token,
        TokenIn as TokenIn,
        Version as Version,
    )
    from unghost.wire.boxes import (
        AcceptedTag as AcceptedTag,
        Box as Box,
        BoxListQuery as BoxListQuery,
        BoxPage as BoxPage,
        BoxSelection as BoxSelection,
        BulkIn as BulkIn,
        Claim as Claim,
        Decision as Decision,
        FrameListQuery as FrameListQuery,
        HiddenBy as HiddenBy,
        History as History,
        HistoryEntry as HistoryEntry,
        Queue as Queue,
        QueueIn as QueueIn,
        QueuedBox as QueuedBox,
        Review as Review,
        ReviewBatch as ReviewBatch,
        ReviewIn as ReviewIn,
        ReviewMark as ReviewMark,
        Selection as Selection,
        UndoneBatch as UndoneBatch,
    )
    from unghost.wire.datasets import (
        Dataset as Dataset,
        DatasetCounts as DatasetCounts,
        DatasetIn as DatasetIn,
        DatasetPatch as DatasetPatch,
        FrameCounts as FrameCounts,
        FrameProblem as FrameProblem,
        Histogram as Histogram,
        IgnoreMask as IgnoreMask,
        RefusedFrame as RefusedFrame,
        Stats as Stats,
        VerdictCounts as VerdictCounts,
    )
    from unghost.wire.folders import (
        FolderEnd as FolderEnd,
        FolderFrame as FolderFrame,
        FolderHead as FolderHead,
        UnmatchedFile as UnmatchedFile,
    )
    from unghost.wire.frames import (
        BatchEnd as BatchEnd,
        BatchLine as BatchLine,
        CropQuery as CropQuery,
        Frame as Frame,
        FrameDetails as FrameDetails,
        FrameSummary as FrameSummary,
        KnownFrame as KnownFrame,
        KnownFrames as KnownFrames,
        KnownFramesIn as KnownFramesIn,
        OverlayQuery as OverlayQuery,
        SegmentationReport as SegmentationReport,
        StoredFile as StoredFile,
        StoredFrame as StoredFrame,
    )
    from unghost.wire.model import (
        Fault as Fault,
        MissingKey as MissingKey,
        Page as Page,
        Problem as Problem,
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
    from unghost.wire.runs import (
        ConfigVersion as ConfigVersion,
        Diff as Diff,
        DownloadLink as DownloadLink,
        Export as Export,
        ExportOptions as ExportOptions,
        Failure as Failure,
        Flip as Flip,
        FlipCounts as FlipCounts,
        FlipSide as FlipSide,
        Flips as Flips,
        Preview as Preview,
        Run as Run,
        RunCounts as RunCounts,
    )

_NAMES: Final = {
    "access": (
        "Alive",
        "AuditEntry",
        "LogIn",
        "LoginCode",
        "NewLoginCode",
        "NewSession",
        "NewToken",
        "Ready",
        "Session",
        "Token",
        "TokenIn",
        "Version",
    ),
    "boxes": (
        "AcceptedTag",
        "Box",
        "BoxListQuery",
        "BoxPage",
        "BoxSelection",
        "BulkIn",
        "Claim",
        "Decision",
        "FrameListQuery",
        "HiddenBy",
        "History",
        "HistoryEntry",
        "Queue",
        "QueueIn",
        "QueuedBox",
        "Review",
        "ReviewBatch",
        "ReviewIn",
        "ReviewMark",
        "Selection",
        "UndoneBatch",
    ),
    "datasets": (
        "Dataset",
        "DatasetCounts",
        "DatasetIn",
        "DatasetPatch",
        "FrameCounts",
        "FrameProblem",
        "Histogram",
        "IgnoreMask",
        "RefusedFrame",
        "Stats",
        "VerdictCounts",
    ),
    "folders": (
        "FolderEnd",
        "FolderFrame",
        "FolderHead",
        "UnmatchedFile",
    ),
    "frames": (
        "BatchEnd",
        "BatchLine",
        "CropQuery",
        "Frame",
        "FrameDetails",
        "FrameSummary",
        "KnownFrame",
        "KnownFrames",
        "KnownFramesIn",
        "OverlayQuery",
        "SegmentationReport",
        "StoredFile",
        "StoredFrame",
    ),
    "model": (
        "Fault",
        "MissingKey",
        "Page",
        "Problem",
    ),
    "quality": (
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
    "runs": (
        "ConfigVersion",
        "Diff",
        "DownloadLink",
        "Export",
        "ExportOptions",
        "Failure",
        "Flip",
        "FlipCounts",
        "FlipSide",
        "Flips",
        "Preview",
        "Run",
        "RunCounts",
    ),
}
_MODULE_OF: Final = {name: module for module in _NAMES for name in _NAMES[module]}


def __getattr__(name: str) -> object:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value: object = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULE_OF})
