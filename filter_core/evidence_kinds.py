"""The kinds of evidence: what a box can be judged by.

They are the segmentation (``semantic``) and the channels, which are all others.
`EVIDENCE` describes each in one row. How channels are measured is in
`filter_core.evidence`, how they decide in `filter_core.decisions.channel_rules`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final, Literal, NamedTuple, TypeAlias, get_args

ChannelName: TypeAlias = Literal[
    "ordered", "depth", "depth_center", "instance", "lidar"
]
"""The channels: the kinds of evidence besides the segmentation."""

EvidenceName: TypeAlias = Literal["semantic", ChannelName]
"""All kinds of evidence."""

EvidenceChoice: TypeAlias = Literal[EvidenceName, "auto"]
"""The values of the key ``evidence``: one kind, or ``auto``, which tries several."""

SEMANTIC: Final = "semantic"

AUTO: Final = "auto"

CHANNELS: Final[tuple[ChannelName, ...]] = get_args(ChannelName)
"""The names of the channels, in the order of listings."""

STRONGEST_FIRST: Final[tuple[ChannelName, ...]] = ("instance", "depth", "ordered")
"""The channels that ``auto`` tries, in this order."""


class EvidenceKind(NamedTuple):
    """The description of one value of the key ``evidence``.

    Attributes
    ----------
    needs : str
        What a frame must have, as text for people.
    keeps : str
        When a box is kept, as text for people.
    file : str or None
        The kind of file that is read for it besides the segmentation.
    """

    needs: str
    keeps: str
    file: str | None = None


EVIDENCE: Final[Mapping[EvidenceChoice, EvidenceKind]] = {
    SEMANTIC: EvidenceKind(
        "segmentation",
        "enough of its pixels carry an accepted tag (the thresholds above)",
    ),
    "ordered": EvidenceKind(
        "segmentation, distances or 3D boxes",
        "`min_visible_pixels` and `min_visible_percent` of them belong to no nearer "
        "box, and `ordered_min_pixels` where nearer boxes have others",
    ),
    "depth": EvidenceKind(
        "segmentation, raw depth, camera, 3D boxes",
        "`min_visible_pixels` and `min_visible_percent` of them lie within the box's "
        "own depth, give or take `depth_tolerance`",
        file="depth",
    ),
    "depth_center": EvidenceKind(
        "raw depth, camera, 3D boxes",
        "nothing nearer is seen at its centre: another method, for comparison",
        file="depth",
    ),
    "instance": EvidenceKind(
        "instance image",
        "`min_visible_pixels` and `min_visible_percent` of its own instance are seen",
        file="instances",
    ),
    "lidar": EvidenceKind(
        "semantic LiDAR with its transform, 3D boxes",
        "`lidar_min_points` of an accepted tag lie inside it",
        file="lidar",
    ),
    AUTO: EvidenceKind(
        "the data of instance, depth or ordered",
        "the strongest of instance, depth and ordered that has a number",
    ),
}


def files_for(kinds: Iterable[str]) -> tuple[str, ...]:
    """The kinds of files that kinds of evidence read besides the segmentation."""
    kind_names = set(kinds)
    files = {
        kind.file for name, kind in EVIDENCE.items() if name in kind_names and kind.file
    }
    return tuple(sorted(files))
