"""Some frames of a recording, looked at: their pictures, tags, depth, and verdicts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import UNKNOWN_TAG
from filter_core.config.filter import FilterConfig
from filter_core.decisions.rules import decide
from filter_core.errors import FilterError, LayoutError
from filter_core.formats.reading import FrameSource, frame_size, read_file
from filter_core.geometry.boxes import pixel_bounds
from filter_core.images.decoding import decode_as_seen
from filter_core.images.header import read_image_header
from filter_core.inspection.listing import Counted, Listed, Listing, counted
from filter_core.local import (
    ClassCount,
    count_by_class,
    in_order,
    measure_source,
    measuring_of,
)
from filter_core.pipeline import FrameResult, MeasuredFrame
from filter_core.recognition import Shown, depth_images, recognise_recording
from filter_core.segmentation.codes import Segmentation
from filter_core.segmentation.palettes import FAMILIES, PAPER_TABLE, known_family
from filter_core.segmentation.reading import SegmentationOptions, read_segmentation
from filter_core.segmentation.recognition import Reading as Candidate
from filter_core.verdicts import VerdictName

_WIDEST: Final = 960
"""px; of a painted frame."""

_QUALITY: Final = 82

_PAINTED: Final = 3


class Reading(NamedTuple):
    """How segmentations are read, and how many of those that were looked at."""

    family: str
    encoding: str
    channel_order: str
    lossy: bool
    images: int = 1


class Size(NamedTuple):
    """A size of images in px, and how many of those that were looked at have it."""

    width: int
    height: int
    images: int


class DrawnBox(NamedTuple):
    """A box of a painted frame: its rectangle in px, and its verdict."""

    xyxy: tuple[float, ...]
    class_name: str
    verdict: VerdictName
    explanation: str


@dataclass(frozen=True)
class DrawnFrame:
    """A frame with the verdicts of its boxes.

    `wh` is its size in px. `jpeg` is the picture, smaller, or without one the
    segmentation in its colours; None: there is neither.
    Boxes that cannot be drawn, because no part of them is in the image, are `outside`.
    """

    key: str
    wh: tuple[int, int]
    jpeg: bytes | None
    boxes: tuple[DrawnBox, ...]
    outside: int = 0


@dataclass(frozen=True)
class SegmentationFacts:
    """What the segmentations that were looked at say about those of the recording.

    Attributes
    ----------
    readings : tuple of Reading
        The most frequent first.
    family : str or None
        The family of tags that most of them may have: a recording has one.
    is_named : bool
        Whether the configuration names the family.
    agreeing, told : int
        How many may have it, and how many of these can have no other.
    unknown_percent : float
        Of all their pixels.
    """

    looked_at: int
    readings: tuple[Reading, ...]
    family: str | None
    is_named: bool
    agreeing: int
    told: int
    unknown_percent: float
    refused: tuple[Listed, ...]
    notes: tuple[Counted, ...]

    @property
    def is_certain(self) -> bool:
        """Whether all may have this family, and some can have no other."""
        return self.told > 0 and self.agreeing == self.looked_at

    def common(self, key: str) -> str | None:
        """What all say of one field of `Reading`; None if they differ."""
        values = {getattr(reading, key) for reading in self.readings}
        return values.pop() if len(values) == 1 else None


@dataclass(frozen=True)
class DepthFacts:
    """What some depth images say about those of the recording.

    `encoding` is that of all; None if they show none, or different ones. Some encodings
    are `shown` for certain; images that are `unclear` are read, but do not show theirs.
    """

    looked_at: int
    encoding: str | None
    shown: tuple[Counted, ...]
    unclear: int
    refused: tuple[Listed, ...]


@dataclass
class PictureSurvey:
    """What the frames that were looked at show.

    Attributes
    ----------
    frames : int
        How many were looked at.
    sizes : Counter of (width, height)
    verdicts : Counter of (class, verdict)
    unknown : Counter of (class, tag or colour)
        Pixels in boxes whose tag is unknown.
    refused : Listing
        Frames that cannot be measured, by the code of the first fault.
    notes : Counter of str
        How depth and instance images were read.
    problem : LayoutError or None
        Their segmentations are of several families.
    """

    frames: int = 0
    problem: LayoutError | None = None
    sizes: Counter[tuple[int, int]] = field(default_factory=Counter)
    classes: dict[str, ClassCount] = field(default_factory=dict)
    verdicts: Counter[tuple[str, VerdictName]] = field(default_factory=Counter)
    unknown: Counter[tuple[str, str]] = field(default_factory=Counter)
    refused: Listing = field(default_factory=Listing)
    notes: Counter[str] = field(default_factory=Counter)
    drawn: tuple[DrawnFrame, ...] = ()
    segmentation: SegmentationFacts | None = None
    depth: DepthFacts | None = None


@dataclass(frozen=True, eq=False)
class _Look:
    """One frame, measured and decided; or why it cannot be.

    `placed` has the boxes of a frame whose segmentation cannot be read: they can be
    drawn all the same.
    """

    source: FrameSource
    problem: FilterError | None = None
    result: FrameResult | None = None
    placed: FrameResult | None = None
    reading: Reading | None = None
    families: tuple[str, ...] = ()
    unknown_percent: float = 0.0
    notes: tuple[str, ...] = ()
    unknown: Mapping[tuple[str, str], int] = field(default_factory=dict)


def look_at(
    frames: Sequence[FrameSource], config: FilterConfig, workers: int | None = None
) -> PictureSurvey:
    """Measure and decide some frames, as the filter does.

    `workers` are threads; by default one more than there are cores.
    """
    survey = PictureSurvey(frames=len(frames))
    shown = Shown()
    try:
        shown = recognise_recording(frames, config, ("depth", *config.channels))
    except LayoutError as several_families:
        survey.problem = several_families
    read = [shown.of_frame(frame) for frame in frames]
    looks = list(in_order(partial(_look, config), read, workers))
    for look in looks:
        size = frame_size(look.source)
        if size is not None:
            survey.sizes[size] += 1
        if look.problem is not None:
            survey.refused.refuse(look.source.key, look.problem)
        if look.result is None:
            continue
        measured, verdicts = look.result.measured, look.result.verdicts
        for name, count in count_by_class(measured.evidence, verdicts).items():
            survey.classes[name] = survey.classes.get(name, ClassCount()).plus(count)
        names = ((each["class"], each["verdict"]) for each in look.result.decisions)
        survey.verdicts.update(names)
        survey.unknown.update(look.unknown)
        survey.notes.update(measured.notes)
    survey.segmentation = _segmentations(looks, config, shown)
    survey.depth = _depth(frames, config, shown)
    survey.drawn = tuple(map(_drawn, _chosen(looks)))
    return survey


def _look(config: FilterConfig, source: FrameSource) -> _Look:
    try:
        result = _decided(source, config)
        look = _Look(source, result=result)
        if source.segmentation is None:
            return look
        segmentation = _read_again(source, source.segmentation, result.measured, config)
    except FilterError as problem:
        with suppress(FilterError):
            placed = _decided(replace(source, segmentation=None, others={}), config)
            return _Look(source, problem, placed=placed)
        return _Look(source, problem)
    return replace(
        look,
        reading=Reading(
            segmentation.family,
            segmentation.encoding,
            segmentation.channel_order,
            segmentation.lossy,
        ),
        families=_families(
            # What it tells itself, whatever others of the recording do.
            segmentation,
            _options(result.measured, config.measuring().reading),
        ),
        unknown_percent=segmentation.unknown_percent,
        notes=segmentation.notes,
        unknown=_unknown_values(segmentation, result.measured),
    )


def _decided(source: FrameSource, config: FilterConfig) -> FrameResult:
    measured = measure_source(source, config, config.channels)
    return FrameResult(measured, decide(measured.evidence, config), config)


def _options(
    measured: MeasuredFrame, reading: SegmentationOptions
) -> SegmentationOptions:
    """How the segmentation of a frame is read when it is measured."""
    version = reading.carla_version or measured.annotation.carla_version
    return replace(reading, carla_version=version)


def _read_again(
    source: FrameSource, path: Path, measured: MeasuredFrame, config: FilterConfig
) -> Segmentation:
    """The segmentation of a frame that was measured, whose tags are looked at, too."""
    reading = measuring_of(source, config).reading
    content = read_file(path, "segmentation")
    return read_segmentation(content, _options(measured, reading))


def _families(
    segmentation: Segmentation, options: SegmentationOptions
) -> tuple[str, ...]:
    """The families that an image may have: the one that is named, or by its colours."""
    own, order = segmentation.family, segmentation.channel_order
    is_named = options.palette != "auto" or own == known_family(options.carla_version)
    if is_named or segmentation.encoding == "raw":  # raw tags prove theirs
        return (own,)
    codes = frozenset(segmentation.codes.occurring)
    fewest = len(Candidate(own, order).missing(codes))
    others = (name for name in FAMILIES if name not in (own, PAPER_TABLE))
    return own, *(
        name for name in others if len(Candidate(name, order).missing(codes)) == fewest
    )


def _unknown_values(
    segmentation: Segmentation, measured: MeasuredFrame
) -> dict[tuple[str, str], int]:
    """Pixels in boxes whose tag is unknown, by class and by tag or colour."""
    evidence = measured.evidence
    rows = np.flatnonzero(evidence.measured & (evidence.unknown_pixels > 0))
    if not len(rows) or evidence.xyxy is None:
        return {}
    counts: Counter[tuple[str, str]] = Counter()
    bounds = pixel_bounds(evidence.xyxy[rows], measured.wh).tolist()
    for row, (x0, y0, x1, y1) in zip(rows.tolist(), bounds, strict=True):
        region = slice(y0, y1), slice(x0, x1)
        pixels = segmentation.pixels[region][segmentation.tags[region] == UNKNOWN_TAG]
        name = evidence.class_names[evidence.class_index[row]]
        values, numbers = np.unique(pixels, axis=0, return_counts=True)
        for value, number in zip(values.tolist(), numbers.tolist(), strict=True):
            is_tag = isinstance(value, int)
            words = f"tag {value}" if is_tag else f"#{bytes(value).hex()}"
            counts[name, words] += number
    return dict(counts)


def _segmentations(
    looks: Sequence[_Look], config: FilterConfig, shown: Shown
) -> SegmentationFacts | None:
    with_one = [look for look in looks if look.source.segmentation is not None]
    if not with_one:
        return None
    read = [look for look in with_one if look.reading is not None]
    refused = Listing()
    notes: Counter[str] = Counter()
    for look in with_one:
        notes.update(look.notes)
        if look.problem is not None:
            refused.refuse(look.source.key, look.problem)
    votes = Counter(family for look in read for family in look.families)
    most = max(votes, key=lambda name: votes[name], default=None)
    family = shown.keys.get("palette", most)
    shares = [look.unknown_percent for look in read]
    return SegmentationFacts(
        looked_at=len(with_one),
        readings=tuple(
            reading._replace(images=count)
            for reading, count in Counter(look.reading for look in read).most_common()
            if reading is not None
        ),
        family=family,
        is_named=config.palette != "auto",
        agreeing=votes[family] if family else 0,
        told=sum(look.families == (family,) for look in read),
        unknown_percent=sum(shares) / len(shares) if shares else 0.0,
        refused=refused.listed(),
        notes=counted(notes),
    )


def _depth(
    frames: Sequence[FrameSource], config: FilterConfig, shown: Shown
) -> DepthFacts | None:
    encodings: Counter[str] = Counter()
    refused = Listing()
    unclear = looked_at = 0
    for key, depth in depth_images(frames):
        looked_at += 1
        if isinstance(depth, FilterError):
            refused.add(depth.kind, key, depth.detail)
        elif depth.is_certain:
            encodings[depth.encoding] += 1
        else:
            unclear += 1
    if not looked_at:
        return None
    named = shown.keys.get("depth_encoding", config.depth_encoding)
    return DepthFacts(
        looked_at=looked_at,
        encoding=None if named == "auto" else named,
        shown=counted(encodings),
        unclear=unclear,
        refused=refused.listed(),
    )


def _chosen(looks: Sequence[_Look]) -> list[_Look]:
    """Frames that are drawn: those with most boxes of each verdict."""
    left = [look for look in looks if look.result or look.placed]
    chosen: list[_Look] = []
    folders: set[str] = set()
    for verdict in (*("rejected", "kept", "unmeasured") * _PAINTED, *("",) * _PAINTED):

        def rank(look: _Look, verdict: str = verdict) -> tuple[int, bool]:
            result = look.result or look.placed
            decisions = result.decisions if result else []
            boxes = sum(box["verdict"] == verdict for box in decisions)
            return boxes, _folder(look) not in folders  # of equals, of another folder

        best = max(left, key=rank, default=None)
        if best is None or len(chosen) == _PAINTED:
            break
        if rank(best)[0] or not verdict:
            chosen.append(best)
            left.remove(best)
            folders.add(_folder(best))
    return chosen


def _folder(look: _Look) -> str:
    return look.source.key.rpartition("/")[0]


def _drawn(look: _Look) -> DrawnFrame:
    result = look.result or look.placed
    assert result is not None, "a frame that was not placed is not drawn"
    why = f"unmeasured: {look.problem.detail}" if look.problem else None
    boxes = tuple(
        DrawnBox(
            xyxy=tuple(each["xyxy"]),
            class_name=each["class"],
            verdict=each["verdict"],
            explanation=why or each["explanation"],
        )
        for each in result.decisions
        if each["xyxy"] is not None
    )
    try:
        jpeg = _jpeg(look.source, result.measured, result.config)
    except FilterError:  # a damaged picture; its frame is shown without it
        jpeg = None
    outside = len(result.decisions) - len(boxes)
    return DrawnFrame(look.source.key, result.measured.wh, jpeg, boxes, outside)


def _jpeg(
    source: FrameSource, measured: MeasuredFrame, config: FilterConfig
) -> bytes | None:
    """The picture of a frame, or else its segmentation in colours; None: neither."""
    picture: NDArray[np.uint8] | None = None
    if source.image is not None:
        content = read_file(source.image, "image")
        header = read_image_header(content)
        picture = decode_as_seen(content, header, cv2.IMREAD_COLOR)
    elif source.segmentation is not None:
        read = _read_again(source, source.segmentation, measured, config)
        painted = FAMILIES[read.family].paint(read.tags)
        picture = np.ascontiguousarray(painted[:, :, ::-1])
    if picture is None:
        return None
    height, width = picture.shape[:2]
    scale = min(1.0, _WIDEST / width)
    size = max(1, round(width * scale)), max(1, round(height * scale))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    _, jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return jpeg.tobytes()
