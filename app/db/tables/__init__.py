"""The tables. `decisions` and `tallies` are derived from the others."""

from app.db.tables.datasets import ConfigVersion, Dataset, DatasetClass, Measurement
from app.db.tables.decisions import Decision, Flips, Tally
from app.db.tables.frames import (
    Blob,
    Box,
    Frame,
    FrameEvidence,
    FrameFile,
    IdBlock,
    Problem,
)
from app.db.tables.hooks import Hook, HookDelivery, PendingReview
from app.db.tables.jobs import Chunk, Export, Installation, JobRow, Lease, Run
from app.db.tables.reviews import Claim, Review, ReviewBatch

__all__ = [
    "Blob",
    "Box",
    "Chunk",
    "Claim",
    "ConfigVersion",
    "Dataset",
    "DatasetClass",
    "Decision",
    "Export",
    "Flips",
    "Frame",
    "FrameEvidence",
    "FrameFile",
    "Hook",
    "HookDelivery",
    "IdBlock",
    "Installation",
    "JobRow",
    "Lease",
    "Measurement",
    "PendingReview",
    "Problem",
    "Review",
    "ReviewBatch",
    "Run",
    "Tally",
]
