"""The data types of the library: arrays, boxes, evidence, decisions.

All of these store columns: row i is box i.

- `FrameBoxes`: the boxes of a frame, before any pixel is read.
- `Evidence`: the numbers measured for them. `ChannelNumbers` is the part of it that is
  measured besides the segmentation.
- `Decisions`: what `decide` makes of the evidence. A `Reason` is the rule that decided;
  each belongs to one `Verdict`.
- `DecidedBoxes`: boxes, reasons and people's answers, from which labels are written.
- `DecisionColumns`: the columns that tables of decisions have besides these.

One box as a dictionary with the keys of the API is a `Decision`, see
`decisions/record.py`. There are no rules here.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import Field, dataclass, field, fields, replace
from enum import Enum, IntEnum
from typing import (
    ClassVar,
    Final,
    Literal,
    NamedTuple,
    Protocol,
    TypeAlias,
    TypedDict,
    TypeVar,
    get_args,
)

import numpy as np
from numpy.typing import NDArray

TagImage: TypeAlias = NDArray[np.uint8]
"""(H, W): CARLA's semantic tag of each pixel; 255 is Unknown."""

Mask: TypeAlias = NDArray[np.bool_]
"""(H, W): always boolean, never a tag image."""

BoxesXYXY: TypeAlias = NDArray[np.float64]
"""(N, 4) px, ``x_min y_min x_max y_max``, half-open: ``[0, 0, 1, 1]`` is one pixel."""

FloatArray: TypeAlias = NDArray[np.float64]

IntArray: TypeAlias = NDArray[np.int64]

BoolArray: TypeAlias = NDArray[np.bool_]

Profile: TypeAlias = Literal["paper", "carlasimu"]
"""How boxes are counted and compared: as the paper is written, or as its authors'
published code behaves."""

ProjectionMode: TypeAlias = Literal["clipped", "naive"]
"""How 3D boxes become rectangles: cut exactly at the image, or as in the paper."""

DepthEncoding: TypeAlias = Literal[
    "auto",
    "carla",
    "carla-bgr",
    "millimetres16",
    "metres16",
    "log8",
    "linear8",
]
"""How a depth image holds metres; ``auto`` leaves it to recognition."""

VerdictName: TypeAlias = Literal["kept", "rejected", "unmeasured"]
"""The values of `Verdict`."""

UNKNOWN_TAG: Final = 255
"""The tag of a pixel whose colour or number is no tag of its family."""

N_TAGS: Final = 31
"""Columns of a tag histogram: tags 0..29, then Unknown."""

UNKNOWN_COLUMN: Final = N_TAGS - 1

NOT_MEASURED: Final = -1
"""Stands for a missing value in columns of counts, rows and ids."""


class Dataclass(Protocol):
    """Any dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Field[object]]]


_Table = TypeVar("_Table", bound=Dataclass)


def rows_of(
    table: _Table, rows: slice | IntArray | BoolArray, *, shared: Collection[str] = ()
) -> _Table:
    """Some rows of a table, that is, of a dataclass whose fields are columns.

    Parameters
    ----------
    table : dataclass
        Columns that are None stay None.
    rows : slice, (M,) int64 or bool
        A slice gives views of the same arrays.
    shared : names of fields
        Those that are no columns, and stay as they are.
    """
    columns = {
        spec.name: getattr(table, spec.name)
        for spec in fields(table)
        if spec.name not in shared
    }
    return replace(
        table,
        **{name: one[rows] for name, one in columns.items() if one is not None},
    )


def floats_or_none(column: FloatArray) -> list[float | None]:
    """The numbers of a column, None where it has NaN."""
    # NaN alone differs from itself.
    return [None if value != value else value for value in column.tolist()]


def counts_or_none(column: IntArray) -> list[int | None]:
    """The numbers of a column, None where it has `NOT_MEASURED`."""
    return [None if value == NOT_MEASURED else value for value in column.tolist()]


@dataclass(frozen=True)
class FrameBoxes:
    """The N boxes of one frame, as given.

    Attributes
    ----------
    xyxy : (N, 4) float64, px
        Not yet corrected; may lie outside the image.
    class_names : tuple of str
        The classes that `class_index` refers to.
    class_index : (N,) int32
    accept_mask : (N,) int64
        Bit t is set if the box's class accepts tag t; 0: the class is not mapped.
    distance : (N,) float64, metres, NaN where unknown
    distance_range : (N, 2) float64, metres
        Between which distances a box is, the lower one excluded (except 0); NaN rows
        where unknown. Default: all NaN.
    image_wh : (width, height) of the image, px
    ids : tuple of N str
        Unique in the frame. Default: the boxes' positions.
    vertices : (N, 8, 3) float64, metres
        World corners of 3D boxes; NaN for boxes that are not 3D. Default: all NaN.
    instance_id : (N,) int64
        The object's id in an instance image, as given by the annotation;
        `NOT_MEASURED` where it is not given. Default: none given.
    not_ahead : (N,) bool
        The centre of the 3D box is nearer than the configuration's `min_forward`.
        Default: none is.
    measured_as : tuple of str
        The filter's class as which each of `class_names` is measured; a name that
        means no class stands for itself. Default: `class_names`.
    """

    xyxy: BoxesXYXY
    class_names: tuple[str, ...]
    class_index: NDArray[np.int32]
    accept_mask: IntArray
    distance: FloatArray
    image_wh: tuple[int, int]
    ids: tuple[str, ...] = ()
    vertices: FloatArray = field(default_factory=lambda: np.empty((0, 8, 3)))
    instance_id: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    not_ahead: BoolArray = field(default_factory=lambda: np.empty(0, np.bool_))
    distance_range: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    measured_as: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Fill in the defaults; the broadcast arrays take no memory."""
        count = len(self)
        if not self.measured_as:
            object.__setattr__(self, "measured_as", self.class_names)
        if not self.ids:
            object.__setattr__(self, "ids", tuple(map(str, range(count))))
        if not len(self.vertices):
            no_corners = np.broadcast_to(np.nan, (count, 8, 3))
            object.__setattr__(self, "vertices", no_corners)
        if not len(self.instance_id):
            none_given = np.broadcast_to(np.int64(NOT_MEASURED), count)
            object.__setattr__(self, "instance_id", none_given)
        if not len(self.not_ahead):
            object.__setattr__(self, "not_ahead", np.broadcast_to(False, count))
        if not len(self.distance_range):
            unknown = np.broadcast_to(np.nan, (count, 2))
            object.__setattr__(self, "distance_range", unknown)

    def __len__(self) -> int:
        return len(self.class_index)

    @classmethod
    def of(
        cls,
        xyxy: BoxesXYXY | Sequence[Sequence[float]],
        classes: Sequence[str],
        accept_masks: Mapping[str, int],
        image_wh: tuple[int, int],
        distance: Sequence[float] | FloatArray | None = None,
    ) -> FrameBoxes:
        """Boxes from rectangles and class names.

        Parameters
        ----------
        xyxy : (N, 4), px
        classes : sequence of N str
        accept_masks : mapping of str to int
            By class; a class that it does not have is not mapped.
        image_wh : (width, height) of the image, px
        distance : (N,), metres, optional
            Default: unknown.
        """
        names = tuple(dict.fromkeys(classes))
        index = {name: number for number, name in enumerate(names)}
        class_index = np.array([index[name] for name in classes], dtype=np.int32)
        masks = np.array([accept_masks.get(name, 0) for name in names], dtype=np.int64)
        unknown = np.full(len(classes), np.nan)
        return cls(
            xyxy=np.asarray(xyxy, dtype=np.float64).reshape(-1, 4),
            class_names=names,
            class_index=class_index,
            accept_mask=masks[class_index],
            distance=unknown if distance is None else np.asarray(distance, np.float64),
            image_wh=image_wh,
        )


class BoxState(IntEnum):
    """The result of correcting a box's coordinates (Algorithm 1 of the paper)."""

    MEASURABLE = 0
    OUTSIDE_IMAGE = 1
    COVERS_IMAGE = 2
    DEGENERATE = 3
    NOT_AHEAD = 4
    """Its rectangle was not looked at: its centre is nearer than `min_forward`."""


@dataclass(frozen=True)
class NumberColumn:
    """Describes one stored column, a field of `Evidence` or `ChannelNumbers`.

    Attributes
    ----------
    meaning : str
        What was measured, in one line.
    unit : str
        Empty for numbers that have none.
    dtype : str
        numpy's name of the type in memory.
    missing : float
        The number that stands for "nothing measured".
    width : int
        Numbers per box: 1 for a column (N,), 4 for rectangles (N, 4).
    stored : str
        numpy's name of the type in stored records, if it is another than in memory.
    since : int
        The first layout of stored records that has the column. A column that is added
        gets the next number, so that older records can still be read.
    """

    meaning: str
    unit: str
    dtype: str
    missing: float
    width: int = 1
    stored: str = ""
    since: int = 1

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of one box's entry: () for a number, (4,) for a rectangle."""
        return () if self.width == 1 else (self.width,)


def number_columns(table: type[Evidence | ChannelNumbers]) -> dict[str, NumberColumn]:
    """The columns of numbers that are measured and stored, by their fields' names."""
    declared = {spec.name: spec.metadata.get("column") for spec in fields(table)}
    return {name: column for name, column in declared.items() if column is not None}


def _count_column(meaning: str, *, unit: str = "px") -> dict[str, NumberColumn]:
    return {"column": NumberColumn(meaning, unit, "i8", 0)}


def _channel_count_column(
    meaning: str, *, unit: str = "px", stored: str = "", since: int = 1
) -> dict[str, NumberColumn]:
    """A column of counts that has `NOT_MEASURED` where its channel has none."""
    column = NumberColumn(meaning, unit, "i8", NOT_MEASURED, stored=stored, since=since)
    return {"column": column}


def _float_column(
    meaning: str, *, unit: str, width: int = 1, since: int = 1
) -> dict[str, NumberColumn]:
    return {"column": NumberColumn(meaning, unit, "f8", np.nan, width, since=since)}


_ALL: Final = slice(None)


@dataclass(frozen=True)
class Evidence:
    """Numbers measured for N boxes: no threshold, no verdict.

    Attributes
    ----------
    class_names : tuple of str
        What `class_index` points into.
    class_index : (N,) int32
    xyxy : (N, 4) float64, px, or None
        None where only the numbers that a decision needs were loaded.
    tag_counts : (N, N_TAGS) int32, px, or None
        Pixels of each tag in the box; the last column is Unknown.
    channels : ChannelNumbers of N boxes, or None
        What was measured besides the segmentation.

    Notes
    -----
    The other columns are described where they are declared below: a `_count_column` is
    (N,) int64, a `_float_column` (N,) float64.
    """

    class_names: tuple[str, ...]
    class_index: NDArray[np.int32]
    state: NDArray[np.uint8] = field(
        metadata={
            "column": NumberColumn(
                "what correcting the box found", "`BoxState`", "u1", 0
            )
        }
    )
    measured: BoolArray = field(
        metadata={
            "column": NumberColumn("whether there was a segmentation", "", "?", False)
        }
    )
    accept_mask: IntArray = field(
        metadata=_count_column(
            "bit t is set if the box's class accepts tag t; 0: its class is not mapped",
            unit="tags",
        )
    )
    box_pixels: IntArray = field(
        metadata=_count_column("pixels of the box, without ignored ones")
    )
    matched_pixels: IntArray = field(
        metadata=_count_column("those of box_pixels that have an accepted tag")
    )
    image_pixels: IntArray = field(metadata=_count_column("pixels of the image"))
    match_percent: FloatArray = field(
        metadata=_float_column(
            "matched_pixels as percent of box_pixels; under profile `carlasimu` "
            "of the box's area, and can exceed 100",
            unit="percent",
        )
    )
    area_percent: FloatArray = field(
        metadata=_float_column("area of the box", unit="percent of the image")
    )
    crowding: FloatArray = field(
        metadata=_float_column(
            "largest share of it that one other box covers, of those whose "
            "accepted tags include one of its own",
            unit="percent of the box",
        )
    )
    distance: FloatArray = field(
        metadata=_float_column(
            "distance from the camera; NaN if unknown", unit="metres"
        )
    )
    unknown_pixels: IntArray = field(
        metadata={
            "column": NumberColumn(
                "those of box_pixels whose tag or colour the family does not have",
                "px",
                "i8",
                0,
                since=2,
            )
        }
    )
    xyxy: BoxesXYXY | None = field(
        default=None,
        metadata=_float_column(
            "corrected rectangle; NaN if outside the image or without area",
            unit="px",
            width=4,
        ),
    )
    distance_range: FloatArray | None = field(
        default=None,
        metadata=_float_column(
            "between which distances it is, where its distance is not known; NaN if "
            "this is not known either",
            unit="metres",
            width=2,
            since=3,
        ),
    )
    tag_counts: NDArray[np.int32] | None = None
    channels: ChannelNumbers | None = None

    def __len__(self) -> int:
        return len(self.class_index)

    def distance_bounds(self, rows: slice = _ALL) -> tuple[FloatArray, FloatArray]:
        """(M,), (M,) metres: between which distances some of the boxes are.

        Twice the distance where it is known, and NaN where nothing is.
        """
        distance = self.distance[rows]
        if self.distance_range is None:
            return distance, distance
        low, high = self.distance_range[rows].T
        unknown = np.isnan(distance)
        return np.where(unknown, low, distance), np.where(unknown, high, distance)

    def shown_match(self, rows: slice | IntArray = _ALL) -> FloatArray:
        """(M,) percent: the match of some of the boxes (default: all) as it is output.

        It is at most 100, which `match_percent` can exceed under profile ``carlasimu``,
        and NaN for a box without counted pixels, where `match_percent` is 0.
        """
        match = np.minimum(self.match_percent[rows], 100.0)
        match[self.box_pixels[rows] == 0] = np.nan
        return match

    def take(self, rows: IntArray) -> Evidence:
        """Some of the boxes, by their `rows` (M,), in the order asked for."""
        return rows_of(self, rows, shared=("class_names",))


@dataclass(frozen=True, eq=False)
class ChannelNumbers:
    """The numbers that channels measured for N boxes.

    Columns are (N,) int64 with `NOT_MEASURED` where a channel has no number for a box,
    or (N,) and (N, 4) float64 with NaN there. Every column that is declared here is
    stored; the module of its channel fills it.
    """

    owned_pixels: IntArray = field(
        metadata=_channel_count_column(
            "accepted pixels in the box's silhouette that no nearer box takes"
        )
    )
    explained_by: IntArray = field(
        metadata=_channel_count_column(
            "of the nearer boxes, the one that takes most of the accepted pixels in "
            "the box's silhouette",
            unit="position in the frame",
            stored="i4",
        )
    )
    depth_pixels: IntArray = field(
        metadata=_channel_count_column(
            "accepted pixels in the silhouette at the depth of the box itself"
        )
    )
    nearer_percent: FloatArray = field(
        metadata=_float_column(
            "share of the silhouette hidden by something nearer",
            unit="percent of the silhouette",
        )
    )
    depth_gap: FloatArray = field(
        metadata=_float_column(
            "how far the median of the accepted pixels is in front of the box "
            "(negative: behind it); NaN if some are at its own depth",
            unit="metres",
        )
    )
    center_gap: FloatArray = field(
        metadata=_float_column(
            "how far the surface seen at the box's centre is in front of the box",
            unit="metres",
        )
    )
    instance_pixels: IntArray = field(
        metadata=_channel_count_column(
            "accepted pixels of the instance that was assigned to it"
        )
    )
    lidar_points: IntArray = field(
        metadata=_channel_count_column(
            "points of an accepted tag inside the 3D box", unit="points"
        )
    )
    tight_xyxy: BoxesXYXY = field(
        metadata=_float_column(
            "rectangle around the visible pixels, by instance or else by depth",
            unit="px",
            width=4,
        )
    )

    @classmethod
    def absent(cls, count: int) -> ChannelNumbers:
        """New columns for `count` boxes, filled with "not measured"."""
        columns = {
            name: np.full((count, *column.shape), column.missing, column.dtype)
            for name, column in number_columns(cls).items()
        }
        return cls(**columns)

    def __len__(self) -> int:
        return len(self.owned_pixels)

    def __getitem__(self, rows: slice | IntArray | BoolArray) -> ChannelNumbers:
        """Some of the boxes."""
        return rows_of(self, rows)


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
    verdict : Verdict
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

        Raises
        ------
        ValueError
            There is no reason of this name.
        """
        reasons = tuple(reason for reason in cls if reason.label == label)
        if not reasons:
            known = ", ".join(get_args(ReasonLabel))
            raise ValueError(f"unknown reason {label!r}; known: {known}")
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
