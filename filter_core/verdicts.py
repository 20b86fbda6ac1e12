"""Verdicts, their reasons, and boxes that were decided, as columns.

- `Decisions`: what `decide` makes of the evidence. A `Reason` is the rule that decided;
  each belongs to one `Verdict`.
- `DecidedBoxes`: boxes, reasons and people's answers, from which labels are written.
- `DecisionColumns`: the columns that tables of decisions have besides these.

One box as a dictionary with the keys of the API is a `Decision`, see
`decisions/record.py`. There are no rules here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Final, Literal, NamedTuple, TypeAlias, TypedDict, get_args

import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import BoolArray, BoxesXYXY, FloatArray, IntArray, rows_of

Profile: TypeAlias = Literal["paper", "carlasimu"]
"""How boxes are counted and compared: as the paper is written, or as its authors'
published code behaves."""


VerdictName: TypeAlias = Literal["kept", "rejected", "unmeasured"]
"""The values of `Verdict`."""


class Verdict(str, Enum):
    """The filter's decision on a box."""

    KEPT = "kept"
    REJECTED = "rejected"
    UNMEASURED = "unmeasured"


ReasonLabel: TypeAlias = Literal[
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
"""The names of reasons on the wire."""


class _ReasonRow(NamedTuple):
    """The declaration of a reason; the attributes are those of `Reason`."""

    number: int
    label: ReasonLabel
    verdict: Verdict = Verdict.REJECTED
    is_final: bool = False
    in_image: bool = True


class Reason(IntEnum):
    """The rule that decided a box: one row per reason, without gaps in the numbers.

    Reasons 10 to 13, from EXPLAINED_BY_NEARER to TOO_FEW_LIDAR_POINTS, come from
    channels only. The channel
    ``ordered`` may also give NO_VISIBLE_PIXELS, as the rules do. A box that a channel
    keeps is VISIBLE, like one that reaches its threshold; `Decisions.channel` says
    which it was. DROPPED_CLASS and UNMAPPED_CLASS have the same name: that nothing is
    known of a box's class, which profile ``carlasimu`` rejects, as the published code
    drops such boxes. A new reason comes last; "Add a rule or a reason" in
    ARCHITECTURE.md has the other places.

    Attributes
    ----------
    label : ReasonLabel
        Its name on the wire, such as ``below_threshold``; two reasons can share one.
    is_final : bool
        No channel overwrites it: it follows from the box and the configuration, and
        needs no pixels. (For NO_SEGMENTATION it is False: a channel, such as ``lidar``,
        may still decide.)
    in_image : bool
        Whether some of the box is in the image; if not, no person can judge it. The
        page's queue repeats the names of the reasons for which it is False
        (`static/js/queue/session.js`).
    """

    OUTSIDE_IMAGE = _ReasonRow(1, "outside_image", is_final=True, in_image=False)
    COVERS_IMAGE = _ReasonRow(2, "covers_image", is_final=True)
    DEGENERATE = _ReasonRow(3, "degenerate", is_final=True, in_image=False)
    OUT_OF_RANGE = _ReasonRow(4, "out_of_range", is_final=True)
    DROPPED_CLASS = _ReasonRow(5, "unmapped_class", is_final=True)
    NO_SEGMENTATION = _ReasonRow(6, "no_segmentation", Verdict.UNMEASURED)
    NO_VISIBLE_PIXELS = _ReasonRow(7, "no_visible_pixels")
    LARGE_BELOW_THRESHOLD = _ReasonRow(8, "large_below_threshold")
    BELOW_THRESHOLD = _ReasonRow(9, "below_threshold")
    EXPLAINED_BY_NEARER = _ReasonRow(10, "explained_by_nearer")
    HIDDEN_BY_DEPTH = _ReasonRow(11, "hidden_by_depth")
    HIDDEN_BY_INSTANCE = _ReasonRow(12, "hidden_by_instance")
    TOO_FEW_LIDAR_POINTS = _ReasonRow(13, "too_few_lidar_points")
    VISIBLE = _ReasonRow(14, "visible", Verdict.KEPT)
    UNMAPPED_CLASS = _ReasonRow(15, "unmapped_class", Verdict.UNMEASURED, is_final=True)
    PASSED = _ReasonRow(16, "passed", Verdict.UNMEASURED, is_final=True)
    UNKNOWN_PIXELS = _ReasonRow(17, "unknown_pixels", Verdict.UNMEASURED)

    label: ReasonLabel
    verdict: Verdict
    is_final: bool
    in_image: bool

    def __new__(
        cls,
        number: int,
        label: ReasonLabel = "visible",
        verdict: Verdict = Verdict.REJECTED,
        is_final: bool = False,
        in_image: bool = True,
    ) -> Reason:
        """The value is the number, which is stored and never changes its meaning."""
        # Enum passes all fields of the member's `_ReasonRow`. The defaults are only for
        # type checkers, which would refuse `Reason(5)` without them.
        reason = int.__new__(cls, number)
        reason._value_ = number
        reason.label = label
        reason.verdict = verdict
        reason.is_final = is_final
        reason.in_image = in_image
        return reason

    @classmethod
    def with_label(cls, label: str) -> tuple[Reason, ...]:
        """The reasons of this name, mostly one.

        Raises `ValueError`: there is no reason of this name.
        """
        reasons = tuple(reason for reason in cls if reason.label == label)
        if not reasons:
            labels = ", ".join(get_args(ReasonLabel))
            raise ValueError(f"unknown reason {label!r}; known: {labels}")
        return reasons


_REASONS: Final = tuple(Reason)
"""By number less 1: for single boxes, because `Reason(number)` takes longer."""


@dataclass(frozen=True)
class Decisions:
    """What `decide` gives for N boxes: reasons, and the numbers that led to them.

    Attributes
    ----------
    reason : (N,) uint8, `Reason`
        The verdict follows from it.
    threshold : (N,) float64, percent; NaN where no threshold applied
    margin : (N,) float64, percent; NaN where no threshold applied
        ``match_percent - threshold``, with a match of at most 100.
    toss_up : (N,) bool
        The 95 % Wilson interval of the match contains the threshold.
    large : (N,) bool
        The box is large, and a threshold applied. Under profile ``carlasimu`` that can
        be the threshold for small boxes, which large boxes must pass as well.
    channel : (N,) uint8
        The channel that decided, as 1 + its position in `CHANNELS`
        (`evidence_kinds.py`). 0: the rules of the segmentation decided.
    """

    reason: NDArray[np.uint8]
    threshold: FloatArray
    margin: FloatArray
    toss_up: BoolArray
    large: BoolArray
    channel: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.reason)

    def __getitem__(self, rows: IntArray | BoolArray) -> Decisions:
        """Some of the boxes."""
        return rows_of(self, rows)

    def overwrite(
        self,
        rows: IntArray,
        reason: NDArray[np.uint8] | IntArray | Reason,
        channel: int = 0,
    ) -> None:
        """Give some boxes another reason, without a threshold; changed in place."""
        self.reason[rows] = reason
        self.threshold[rows] = np.nan
        self.margin[rows] = np.nan
        self.toss_up[rows] = False
        self.large[rows] = False
        self.channel[rows] = channel

    def count(self, verdict: Verdict) -> int:
        """How many boxes have this verdict."""
        codes = [reason for reason in Reason if reason.verdict is verdict]
        return int(np.isin(self.reason, codes).sum())


VERDICTS: Final = tuple(Verdict)
"""`DecidedBoxes.verdict` and `DecidedBoxes.effective` are indexes into this."""


KEPT, REJECTED, UNMEASURED = (np.uint8(code) for code in range(len(VERDICTS)))


VERDICT_OF_REASON: Final = np.array(
    [0, *(VERDICTS.index(reason.verdict) for reason in Reason)], np.uint8
)
"""The filter's verdict of each reason, as an index into `VERDICTS`; row 0 is unused."""


class Answer(IntEnum):
    """A person's answer on a box."""

    NONE = 0
    KEEP = 1
    REJECT = 2
    UNSURE = 3


_VERDICT_OF_ANSWER: Final = (None, Verdict.KEPT, Verdict.REJECTED, None)


@dataclass(frozen=True, eq=False)
class DecidedBoxes:
    """The N boxes of one or several frames, with all columns that labels need.

    Attributes
    ----------
    ids : sequence of N str
        Unique in their frame.
    class_names : tuple of str
        What `class_index` points into.
    class_index : (N,) int32
    reason : (N,) uint8, `Reason`
    answer : (N,) uint8, `Answer`
    lossy : (N,) bool
        Whether its segmentation was a lossy image, such as a JPEG.
    xyxy : (N, 4) float64, px
        Corrected; NaN rows for boxes without a rectangle in the image.
    amodal_xyxy, visible_xyxy : (N, 4) float64, px
        Of 3D boxes, before and after clipping to the image; else NaN rows.
    tight_xyxy : (N, 4) float64, px
        Around the visible pixels; NaN rows where they are not known.
    distance : (N,) float64, metres, NaN where unknown
    distance_range : (N, 2) float64, metres
        See `Evidence`; NaN rows where unknown.
    match_percent : (N,) float64, 0..100, NaN where not measured
    occlusion : (N,) int64
        KITTI's level: 0 fully visible, 1 partly, 2 largely occluded, 3 unknown.
    """

    ids: Sequence[str]
    class_names: tuple[str, ...]
    class_index: NDArray[np.int32]
    reason: NDArray[np.uint8]
    answer: NDArray[np.uint8]
    lossy: BoolArray
    xyxy: BoxesXYXY
    amodal_xyxy: BoxesXYXY
    visible_xyxy: BoxesXYXY
    tight_xyxy: BoxesXYXY
    distance: FloatArray
    distance_range: FloatArray
    match_percent: FloatArray
    occlusion: IntArray

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, rows: slice) -> DecidedBoxes:
        """A range of the boxes, as views of the same arrays."""
        return rows_of(self, rows, shared=("class_names",))

    @property
    def verdict(self) -> NDArray[np.uint8]:
        """(N,) uint8: the filter's verdict, an index into `VERDICTS`."""
        verdict: NDArray[np.uint8] = VERDICT_OF_REASON[self.reason]
        return verdict

    @property
    def effective(self) -> NDArray[np.uint8]:
        """(N,) uint8: a person's keep or reject, else the filter's verdict."""
        verdict = self.verdict
        verdict[self.answer == Answer.KEEP] = KEPT
        verdict[self.answer == Answer.REJECT] = REJECTED
        return verdict

    def class_name(self, row: int) -> str:
        """The class of one box."""
        return self.class_names[int(self.class_index[row])]

    def is_reviewed(self, row: int) -> bool:
        """Whether a person said keep or reject of one box; unsure does not count."""
        return _VERDICT_OF_ANSWER[int(self.answer[row])] is not None

    def effective_verdict(self, row: int) -> VerdictName:
        """The effective verdict of one box, by its name on the wire."""
        answered = _VERDICT_OF_ANSWER[int(self.answer[row])]
        return (answered or _REASONS[int(self.reason[row]) - 1].verdict).value

    def reason_label(self, row: int) -> ReasonLabel:
        """The reason of one box by its name on the wire."""
        return _REASONS[int(self.reason[row]) - 1].label


class HiddenBy(TypedDict):
    """A tag that a box's class does not accept.

    `rgb` is its colour in the palette of the frame, and `percent` the share of the
    box's counted pixels that have it, 0..100.
    """

    tag: int
    name: str
    rgb: list[int]
    percent: float


@dataclass(frozen=True, eq=False)
class DecisionColumns:
    """The columns of N boxes that tables of decisions have besides `DecidedBoxes`.

    Attributes
    ----------
    threshold, margin : (N,) float64, percent; NaN where no threshold applied
    toss_up, large : (N,) bool
        See `Decisions`, like `threshold` and `margin`.
    matched_pixels, unknown_pixels, box_pixels : (N,) int64, px
        See `Evidence`; `NOT_MEASURED` for the first two where nothing was measured.
    area_percent, crowding : (N,) float64, percent; NaN where unknown
    explained_by : sequence of N str or None
        The id of the nearer box that takes most of the box's pixels.
    hidden_by : sequence of N sequences of HiddenBy
        The commonest tags that the box's class does not accept.
    reviewer, comment : sequence of N str or None
        Of the current answer.
    config : str
        The digest of the configuration that decided.
    """

    threshold: FloatArray
    margin: FloatArray
    toss_up: BoolArray
    large: BoolArray
    matched_pixels: IntArray
    box_pixels: IntArray
    unknown_pixels: IntArray
    area_percent: FloatArray
    crowding: FloatArray
    explained_by: Sequence[str | None]
    hidden_by: Sequence[Sequence[HiddenBy]]
    reviewer: Sequence[str | None]
    comment: Sequence[str | None]
    config: str

    def __len__(self) -> int:
        return len(self.threshold)

    def __getitem__(self, rows: slice) -> DecisionColumns:
        """A range of the boxes."""
        return rows_of(self, rows, shared=("config",))
