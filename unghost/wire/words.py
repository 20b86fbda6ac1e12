"""Every fixed set of values of the API and of command-line options, as a `Literal`.

Nothing heavy is imported here, so that the command line can check options and list
their values without loading the library. Where the library or the service has a table
of the same values, a test compares them.
"""

from __future__ import annotations

from typing import Final, Literal, TypeAlias, get_args

TAR: Final = "application/x-tar"
"""The media type of archives: of batches, of folders, and of crops."""

# Boxes
Verdict: TypeAlias = Literal["kept", "rejected", "unmeasured"]
"""The verdict of the filter on a box."""
Answer: TypeAlias = Literal["keep", "reject", "unsure", "clear"]
"""A person's answer on a box; `clear` removes an earlier answer."""
ReviewState: TypeAlias = Literal[
    "undecided", "decided", "keep", "reject", "unsure", "none", "any"
]
"""Filters of a list of boxes by the answers on them."""
EvidenceName: TypeAlias = Literal[
    "semantic", "ordered", "depth", "depth_center", "instance", "lidar"
]
"""The kinds of evidence on which a verdict can be based."""
EvidenceChoice: TypeAlias = Literal[EvidenceName, "auto"]
"""By what boxes are decided: one kind, or the strongest that a frame allows."""
Reason: TypeAlias = Literal[
    "outside_image",
    "covers_image",
    "degenerate",
    "out_of_range",
    "unmapped_class",
    "no_segmentation",
    "no_visible_pixels",
    "large_below_threshold",
    "below_threshold",
    "explained_by_nearer",
    "hidden_by_depth",
    "hidden_by_instance",
    "too_few_lidar_points",
    "visible",
    "passed",
    "unknown_pixels",
]
"""The rule that gave a box its verdict."""
FlipCause: TypeAlias = Literal["class_known", "edge_rounded"]
"""What has changed a verdict besides the configuration: a class has tags now, or an
edge that was rounded is a whole number again."""
OcclusionLevel: TypeAlias = Literal[0, 1, 2, 3]
"""How much of an object is hidden, as in KITTI; 3: unknown."""
BoxSort: TypeAlias = Literal[
    "id", "doubt", "match_percent", "-match_percent", "crowding"
]
"""Orders of a list of boxes."""
Bin: TypeAlias = Literal["ask", "sure", "small", "wall"]
"""What is to be done about a box: a person is asked about it; or the filter is sure, it
is too small to see, or nothing of it is seen."""
QueueOrder: TypeAlias = Literal["doubt", "random", "class", "audit"]
"""Orders of the review queue."""
HistoryKind: TypeAlias = Literal["decision", "review"]
"""The kinds of entries in a box's history."""

# Frames
FrameSort: TypeAlias = Literal["key", "-key", "id", "-id"]
"""Orders of a list of frames."""
FileKind: TypeAlias = Literal[
    "image", "segmentation", "depth", "instances", "lidar", "radar", "ignore_mask"
]
"""The files of a frame."""
UploadWord: TypeAlias = Literal["stored", "already_there", "refused"]
"""The outcome of a frame that was sent."""
LayerName: TypeAlias = Literal["image", "segmentation", "blend", "depth", "instances"]
"""What a picture of a frame or of a box shows."""
EdgeKind: TypeAlias = Literal["2d", "3d"]
"""How a picture outlines boxes."""

# Folders
_LabelFormat: TypeAlias = Literal[
    "yolo",
    "coco",
    "kitti",
    "voc",
    "cvat",
    "label-studio",
    "manifest",
    "decisions-jsonl",
]
"""The formats of labels that are both read and written."""
FolderLayout: TypeAlias = Literal[
    _LabelFormat, "carlasimu", "nuscenes", "table", "pairs"
]
"""The formats that a folder of frames can be read in."""
Layout: TypeAlias = Literal["auto", FolderLayout]
"""The format to read a folder in; `auto`: the one that its files show."""

# Segmentations
Palette: TypeAlias = Literal[
    "auto", "carla-0.9.0", "carla-0.9.10", "carla-0.9.14", "paper-table1"
]
"""The tables of tags, by the versions of CARLA that share one."""
Encoding: TypeAlias = Literal["auto", "palette", "raw"]
"""How tags are written in a segmentation."""
ChannelOrder: TypeAlias = Literal["auto", "rgb", "bgr"]
"""The order of a segmentation's colour channels."""
LossyPolicy: TypeAlias = Literal["refuse", "nearest"]
"""What happens to a segmentation whose colours are not exact."""

# Runs and exports
FinishedState: TypeAlias = Literal["done", "failed", "cancelled"]
"""How a run or an export ended."""
JobState: TypeAlias = Literal["queued", "running", FinishedState]
"""The states of a run or an export."""
FINISHED: Final[frozenset[JobState]] = frozenset(get_args(FinishedState))
"""The final states."""
RunKind: TypeAlias = Literal["decide", "measure"]
"""Whether a run decides by stored numbers, or measures pixels first."""
ExportFormat: TypeAlias = Literal[
    _LabelFormat, "decisions-csv", "decisions-parquet", "carlasimu"
]
"""What an export can be written as."""
ConvertFormat: TypeAlias = Literal[ExportFormat, "same"]
"""What a folder can be converted to; `same`: its own format and layout."""
Include: TypeAlias = Literal["effective", "kept", "all"]
"""Which boxes an export has: by the effective verdict, by the filter's, or all."""
RejectedBoxes: TypeAlias = Literal["drop", "dontcare"]
"""What an export does with rejected boxes."""
Rectangle: TypeAlias = Literal["visible", "amodal", "tight"]
"""Which rectangle of a box an export writes."""
SplitBy: TypeAlias = Literal["sequence", "map"]
"""Whether the shares of parts are of whole sequences, or of the frames of each map."""
Images: TypeAlias = Literal["copy", "none"]
"""Whether an export has the images as well."""

# Quality
Truth: TypeAlias = Literal["people", "instances"]
"""The ground truth with which verdicts are compared."""
ThresholdTarget: TypeAlias = Literal["f1", "recall"]
"""The goal of a suggested threshold."""
Refusal: TypeAlias = Literal["no_random_answers", "too_few_random_answers"]
"""Why the answers of people cannot say how good the filter is."""
WrongVerdict: TypeAlias = Literal["kept_hidden", "rejected_visible"]
"""The two ways in which a channel can be wrong about a box."""

# People
Role: TypeAlias = Literal["viewer", "reviewer", "admin"]
"""What a token may do; each role may do what the one before may."""

# Hooks
HookEvent: TypeAlias = Literal["run.ended", "export.ended", "dataset.reviewed"]
"""What a hook is told of."""
DeliveredEvent: TypeAlias = Literal[HookEvent, "ping"]
"""What is delivered: an event, or a trial."""
DeliveryState: TypeAlias = Literal["waiting", "delivered", "failed"]
"""Whether a delivery will be tried (again), has arrived, or was given up."""
