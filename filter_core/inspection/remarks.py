"""What is to be said about a recording, in sentences for people.

Remedies are named as keys of ``recording.yaml``; the command line adds its options.
"""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple, Protocol

from filter_core.class_names import class_meant_by, misspelt_class
from filter_core.classes import PASS
from filter_core.formats.reading import RECORDING_NAME, StreamFacts
from filter_core.formats.recording import description_text
from filter_core.formats.registry import layout_format
from filter_core.inspection.listing import Listed
from filter_core.inspection.recording import Inspection
from filter_core.local import ClassCount

_ENOUGH_BOXES: Final = 20
"""From so many boxes on, it is no chance if all of them are rejected."""

_MOST_UNKNOWN_PERCENT: Final = 1.0
"""Of the pixels in the boxes of a class."""

_LISTED: Final = 20
"""Classes that are named."""

ROLES: Final = {
    "image": "picture",
    "segmentation": "segmentation",
    "depth": "depth",
    "instances": "instances",
    "ignore_mask": "ignored regions",
    "mask": "mask, not used",
    "other": "other sensor, not used",
    "unclear": "unclear, not used",
    "lidar": "LiDAR",
    "radar": "radar",
}
"""What files of a role are, for people."""

MOST_IN_A_LINE: Final = 6
"""Names that are listed in a line."""

FAULTS: Final = {
    "outside": "outside of the image",
    "beyond": "reaching beyond the image",
    "inverted": "inverted, or with a negative size",
    "empty": "without extent",
}
"""What boxes of a kind of fault are, for people."""


_REMEDY: Final = re.compile(r"`(\w+): (?:\{([\w.-]+): ([\w.-]+)\}|([\w.-]+))`")
"""A key with a word as its value: `boxes: {unit: shares}`, `layout: yolo`."""

_BLANKS: Final = frozenset({"NAME", "CLASS", "DIR"})
"""In place of a word that a person has to say."""

_OF_ONE_CLASS: Final = re.compile(r"(\(\d+); [^()]*\)")
"""What helps for a class, behind its number of boxes."""


class Remark(NamedTuple):
    """A sentence, and whether it must be looked at before the recording is used.

    `unknown_classes` are those that it is about.
    """

    text: str
    is_serious: bool
    unknown_classes: tuple[str, ...] = ()

    @property
    def remedies(self) -> list[tuple[tuple[str, ...], str]]:
        """The keys of ``recording.yaml`` that the sentence recommends, with values.

        A key is such as ``("boxes", "unit")``.
        """
        remedies: list[tuple[tuple[str, ...], str]] = []
        for section, key, inner, plain in _REMEDY.findall(self.text):
            if _BLANKS.isdisjoint((key, inner)):
                place = (section, key) if key else (section,)
                remedies.append((place, inner or plain))
        return remedies

    @property
    def finding(self) -> str:
        """The sentence without what helps, for where that is offered as buttons."""
        bare = _OF_ONE_CLASS.sub(r"\1)", self.text)
        end = bare.rfind(";", 0, max(0, bare.find("`")))
        return bare[:end] if end > 0 else bare


class Advice(Protocol):
    """What can be done about classes, where boxes have been read from labels."""

    @property
    def written(self) -> str:
        """What happens to boxes that are unmeasured, as an addition to this word."""

    @property
    def general(self) -> str:
        """What helps for every class."""

    def for_class(self, name: str, meant: str | None) -> str:
        """What helps for this class, whose name perhaps means `meant`; may be empty."""

    def for_known(self, names: list[str]) -> str:
        """Why these classes have no tags although their names are understood."""

    def for_names(self, names: list[str]) -> str:
        """What makes one class of several that are measured alike; empty if nothing."""


@dataclass(frozen=True)
class RecordingAdvice:
    """`Advice` by keys of ``recording.yaml``.

    `default_class` is the class of labels that carry none, if there may be such labels.
    """

    default_class: str | None = None
    written: str = ""

    @property
    def general(self) -> str:
        return (
            "`classes: {NAME: CLASS}` says as what a class is measured, and "
            "`classes: {NAME: pass}` that it need not be"
        )

    def for_class(self, name: str, meant: str | None) -> str:
        if name == self.default_class:
            return "labels without a class; `boxes.default_class` names theirs"
        return f"`classes: {{{name}: {meant}}}`" if meant else ""

    def for_known(self, names: list[str]) -> str:
        return (
            f"; the tags of this version of CARLA have none for {listed_names(names)}"
        )

    def for_names(self, names: list[str]) -> str:
        other, name = names[:2]
        return f"; `classes: {{{other}: {{name: {name}}}}}` in recording.yaml joins two"


@dataclass
class BoxSummary:
    """Counts boxes by class, and says at the end what should be looked at.

    `unknown_percent` is the share of unknown pixels by class, where it is not counted.
    """

    advice: Advice
    unknown_percent: Mapping[str, float] = field(default_factory=dict)
    _classes: dict[str, ClassCount] = field(default_factory=dict)

    def add(self, classes: Mapping[str, ClassCount]) -> None:
        """Count boxes, such as those of a frame."""
        for name, count in classes.items():
            total = self._classes.get(name)
            self._classes[name] = count if total is None else total.plus(count)

    @property
    def boxes(self) -> dict[str, int]:
        """How many boxes each class has."""
        return {name: count.boxes for name, count in self._classes.items()}

    def about_names(self) -> list[Remark]:
        """What is to be said about the names of classes."""
        return [*self._unmapped(), *self._names_of_one_class()]

    def about_pixels(self) -> list[Remark]:
        """What is to be said about what was measured."""
        return [*self._rejected(), *self._unknown_pixels()]

    def _count(self, of: Callable[[ClassCount], int]) -> dict[str, int]:
        """The classes for which a count is not 0, by name."""
        counts = {name: of(self._classes[name]) for name in sorted(self._classes)}
        return {name: count for name, count in counts.items() if count}

    def _unmapped(self) -> list[Remark]:
        unmapped = self._count(lambda count: count.unmapped)
        if not unmapped:
            return []
        of_unmapped = [self._classes[name] for name in unmapped]
        is_dropped = all(count.rejected == count.boxes for count in of_unmapped)
        count = sum(unmapped.values())
        whose = "its" if count == 1 else "their"
        why = f"since the filter does not know {whose} class"
        what = f"unmeasured{self.advice.written}, {why}"
        if is_dropped:
            what = "rejected, since profile carlasimu drops classes without a colour"
        boxes = f"{count} boxes are"
        if count == 1:
            boxes, what = "1 box is", what.replace("they came", "it came")
        named = named_classes(unmapped, self.advice)
        # Profile carlasimu knows its own classes only, and measuring changes nothing.
        understood = [] if is_dropped else list(filter(class_meant_by, unmapped))
        why_none = self.advice.for_known(understood) if understood else ""
        text = f"{boxes} {what}: {named}; {self.advice.general}{why_none}"
        return [Remark(text, is_serious=True, unknown_classes=(*unmapped,))]

    def _rejected(self) -> list[Remark]:
        boxes_by_name = {
            name: count.boxes
            for name, count in sorted(self._classes.items())
            if count.rejected == count.boxes and not count.unmapped
        }
        measured = [count for count in self._classes.values() if not count.unmapped]
        total = sum(count.boxes for count in measured)
        rejected = sum(count.rejected for count in measured)
        if total and rejected == total:
            which = "" if len(measured) == len(self._classes) else " of a known class"
            text = f"every box{which} is rejected ({total})"
            return [Remark(f"{text}; {_LOOK}", is_serious=total >= _ENOUGH_BOXES)]
        if not boxes_by_name:
            return []
        is_serious = max(boxes_by_name.values()) >= _ENOUGH_BOXES
        hint = f"; {_LOOK}" if is_serious else ""
        named = listed_names(
            f"{name} ({count})" for name, count in boxes_by_name.items()
        )
        return [Remark(f"every box is rejected of: {named}{hint}", is_serious)]

    def _unknown_pixels(self) -> list[Remark]:
        counted = {
            name: 100 * count.unknown_pixels / count.pixels
            for name, count in self._classes.items()
            if count.pixels
        }
        shares = {**counted, **self.unknown_percent}
        many = {
            name: share
            for name, share in sorted(shares.items())
            if share > _MOST_UNKNOWN_PERCENT
        }
        if not many:
            return []
        named = listed_names(f"{name} ({share:.1f} %)" for name, share in many.items())
        return [
            Remark(
                "tags or colours of the segmentation that are unknown inside boxes of: "
                f"{named}; boxes that these pixels could keep are unmeasured; if "
                "another version of CARLA made the images, their palette or "
                "carla_version is wrong",
                is_serious=True,
            )
        ]

    def _names_of_one_class(self) -> list[Remark]:
        names: dict[str, list[str]] = defaultdict(list)
        for name in sorted(self._classes):
            if meaning := class_meant_by(name):
                names[meaning].append(name)
        alike = {name: same for name, same in names.items() if len(same) > 1}
        if not alike:
            return []
        groups = [
            f"{counts} ({meaning}{self.advice.for_names(same)})"
            for meaning, same in alike.items()
            for counts in [
                listed_names(f"{name} ({self.boxes[name]})" for name in same)
            ]
        ]
        return [
            Remark(
                "names of one class, which are measured alike and kept apart: "
                f"{'; '.join(groups)}",
                is_serious=False,
            )
        ]


_LOOK: Final = (
    "look at some of them: labels in other units or of other images, or a wrong "
    "palette reject every box (`boxes.unit`, `boxes.corners`, "
    "`segmentation.palette`)"
)


def named_classes(boxes: Mapping[str, int], advice: Advice) -> str:
    """Unmapped classes with their numbers of boxes, and what helps for each."""
    named = []
    for name, count in boxes.items():
        meant = None if class_meant_by(name) else misspelt_class(name)
        hint = advice.for_class(name, meant)
        named.append(f"{name} ({count}; {hint})" if hint else f"{name} ({count})")
    return listed_names(named)


def listed_names(parts: Iterable[str], most: int = _LISTED) -> str:
    listed = list(parts)
    more = len(listed) - most
    return ", ".join(listed[:most] + ([f"and {more} more"] if more > 0 else []))


def remarks_on(inspection: Inspection) -> Iterator[Remark]:
    """What is to be said about a recording, and what makes the exit code 3."""
    for problem in inspection.problems:
        yield Remark(_by_keys(problem.detail), is_serious=True)
    yield from _refused(
        inspection.refused, f"of {count_of(inspection.frames, 'frame')}"
    )
    looked_at = f"of {count_of(inspection.pictures, 'frame')} that were looked at"
    yield from _refused(inspection.refused_pictures, looked_at)
    for listed in inspection.left_over:
        first = listed.examples[0]
        yield Remark(
            f"{count_of(listed.count, 'file')} not matched, such as {first.name}: "
            f"{first.why}",
            is_serious=True,
        )
    yield from _about_classes(inspection)
    if inspection.frames and not inspection.boxes.count:
        yield Remark(
            "no frame has a box: `layout` in recording.yaml names another layout, "
            "`boxes: {labels: DIR}` in recording.yaml the folder of the labels",
            is_serious=False,
        )
    if inspection.frames and not inspection.with_role.get("segmentation"):
        yield Remark(
            "no frame has a segmentation, so no box can be measured; `segmentation: "
            "{folder: DIR}` in recording.yaml names their folder",
            is_serious=False,
        )
    if inspection.layout and not layout_format(inspection.layout).box_spans:
        yield Remark(
            f"boxes can be taken out of layout {inspection.layout} only by writing "
            "another one: `convert --to same` is refused",
            is_serious=False,
        )
    for note in inspection.notes:
        yield Remark(f"{inspection.layout}: {note}", is_serious=False)
    for note, count in inspection.image_notes:
        yield Remark(f"{count_of(count, 'frame')}: {note}", is_serious=False)


_PALETTE: Final = re.compile("(?<=ame the palette )in the dataset or the config")

_READING: Final = re.compile(r"\b(?:lossy_segmentation|(encoding)): (nearest|raw)")
"""Settings of a dataset that errors about images recommend."""


def _by_keys(detail: str) -> str:
    """An error of a frame with the keys of the settings that it recommends."""
    palette = f"by `segmentation: {{palette: NAME}}` in {RECORDING_NAME}"
    return _READING.sub(
        lambda match: (
            f"`segmentation: {{{match[1] or 'lossy'}: {match[2]}}}` in {RECORDING_NAME}"
        ),
        _PALETTE.sub(palette, detail),
    )


def _refused(refused: Iterable[Listed], of: str) -> Iterator[Remark]:
    for listed in refused:
        first = listed.examples[0]
        yield Remark(
            f"{listed.count} {of} cannot be used ({listed.kind}), such as "
            f"{first.name}: {_by_keys(first.why)}",
            is_serious=True,
        )


def _about_classes(inspection: Inspection) -> Iterator[Remark]:
    """Of names by all labels, of pixels by those that were looked at."""
    described, layout = inspection.described, inspection.layout
    has_some = layout and "default_class" in layout_format(layout).read_options
    advice = RecordingAdvice(described.default_class if has_some else None)
    names, pixels = BoxSummary(advice), BoxSummary(advice)
    for class_facts in inspection.classes:
        unmapped = 0 if class_facts.measured_as else class_facts.boxes
        if class_facts.boxes:
            names.add(
                {class_facts.name: ClassCount(class_facts.boxes, unmapped=unmapped)}
            )
        if class_facts.measured_as and class_facts.looked_at.boxes:
            pixels.add({class_facts.name: class_facts.looked_at})
    yield from names.about_names()
    sample = inspection.pictures < inspection.frames
    which = f"in {inspection.pictures} frames that were looked at: " if sample else ""
    for remark in pixels.about_pixels():
        yield remark._replace(text=f"{which}{remark.text}")


def count_of(count: int, noun: str) -> str:
    """A number of things."""
    plural = f"{noun}es" if noun.endswith("x") else f"{noun}s"
    return f"{count:,} {noun if count == 1 else plural}"


def measured_as(name: str | None, nearest: str | None) -> str:
    """As what a class is measured, for people."""
    if name is not None:
        return name
    return f"unknown; is it {nearest}?" if nearest else "unknown"


def by_role(inspection: Inspection) -> list[StreamFacts]:
    """The streams in the order of `ROLES`, the largest first."""
    order = {role: at for at, role in enumerate(ROLES)}
    return sorted(
        inspection.streams,
        key=lambda stream: (order.get(stream.role, len(order)), -stream.images),
    )


def told_by(stream: StreamFacts) -> str:
    """What told the role of a stream."""
    nothing = "nothing: taken for pictures"
    if stream.role == "unclear":
        nothing = "neither name nor pixels, or each something else"
    return " and ".join(stream.told_by) or nothing


def facts(inspection: Inspection) -> Iterator[tuple[str, str]]:
    """A recording in a few lines: what, and what it is."""
    if inspection.layout is None:
        yield "layout", "cannot be read"
    else:
        title = layout_format(inspection.layout).title
        yield "layout", f"{title}, {inspection.why}"
        counts = [count_of(inspection.frames, "frame")]
        boxes = inspection.boxes
        counts.append(count_of(boxes.count, "box"))
        if boxes.in_3d:
            counts.append(f"{boxes.in_3d:,} of them in 3D")
        yield "holds", ", ".join(counts)
    if inspection.sizes:
        sizes = [
            f"{size.width} x {size.height} px ({size.images})"
            for size in inspection.sizes
        ]
        yield "sizes of images", listed_names(sizes, MOST_IN_A_LINE)
    if inspection.segmentation is not None:
        yield "segmentation", segmentation_text(inspection)
    if inspection.depth is not None:
        yield "depth", depth_text(inspection)
    for split in inspection.splits:
        noun = "line" if split.told_by == "list" else "frame"
        yield (
            f"split ({split.told_by})",
            f"{split.name}: {count_of(split.frames, noun)}",
        )
    for cameras in inspection.cameras[:MOST_IN_A_LINE]:
        yield "cameras", camera_text(cameras.folders, cameras.frames)


def segmentation_text(inspection: Inspection) -> str:
    """The family of tags, how it is written, and how sure that is."""
    tags = inspection.segmentation
    assert tags is not None, "asked for without segmentations"
    if tags.family is None:
        return f"none of {tags.looked_at} that were looked at can be read"
    how = [tags.family, *filter(None, (tags.common("encoding"),))]
    if tags.common("encoding") == "palette":
        how += filter(None, (tags.common("channel_order"),))
    sure = f"may have this family of tags, {tags.told} of them no other"
    if tags.is_named:
        sure = "can be read in this family of tags, which the description names"
    return (
        f"{', '.join(how)}: {tags.agreeing} of {tags.looked_at} that were looked at "
        f"{sure}; {tags.unknown_percent:.1f} % of their pixels are unknown"
    )


def depth_text(inspection: Inspection) -> str:
    """How depth images hold metres, and how sure that is."""
    depth = inspection.depth
    assert depth is not None, "asked for without depth images"
    shown = ", ".join(f"{count} show {name}" for name, count in depth.shown)
    parts = [depth.encoding or "encoding not known", *filter(None, (shown,))]
    if depth.unclear:
        parts.append(f"{depth.unclear} do not show theirs")
    for listed in depth.refused:
        why = listed.examples[0].why
        parts.append(f"{listed.count} cannot be used: {why}")
    return f"{'; '.join(parts)} (of {depth.looked_at} that were looked at)"


def camera_text(folders: Sequence[str], frames: int) -> str:
    """Folders that may be those of cameras."""
    names = listed_names(folders, MOST_IN_A_LINE)
    return (
        f"{len(folders)} folders with pictures of the same names ({frames} in the "
        f"first), of cameras or of runs that count alike: {names}"
    )


def recording_text(inspection: Inspection, folder: Path) -> str:
    """The text of a ``recording.yaml`` with what was recognised.

    What a person has to say about classes is in comments. Paths in it are relative to
    the `folder` where it is to be.
    """
    name = inspection.name
    head = (
        f"# How {name if name.isprintable() else ascii(name)} is read, as Unghost "
        "recognised it.\n"
        "# Correct what is wrong; what is left out is recognised again.\n"
    )
    hints = [
        f"#   {json.dumps(class_facts.name)}: {class_facts.nearest or PASS}\n"
        for class_facts in inspection.classes
        if class_facts.boxes and not class_facts.measured_as
    ]
    unknown = (
        "\n# Classes that are not known: say as what each is measured, or `pass`.\n"
        f"# classes:\n{''.join(hints)}"
    )
    text = description_text(inspection.described, folder)
    return f"{head}{text}{unknown if hints else ''}"
