"""An inspection in words, for people: what a recording is, and what is to be said."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Final

from unghost.cli.sources import naming_reading
from unghost.cli.summary import Advice, BoxSummary, Remark

if TYPE_CHECKING:
    from filter_core.formats.reading import StreamFacts
    from filter_core.inspection.listing import Listed
    from filter_core.inspection.recording import Inspection

ROLES: Final = {
    "image": "picture",
    "segmentation": "segmentation",
    "depth": "depth",
    "instances": "instances",
    "ignore_mask": "ignored regions",
    "mask": "mask, not used",
    "other": "other sensor, not used",
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


def remarks_on(inspection: Inspection) -> Iterator[Remark]:
    """What is to be said about a recording, and what makes the exit code 3."""
    for problem in inspection.problems:
        yield Remark(naming_reading(problem.detail), is_serious=True)
    yield from _refused(inspection.refused, f"of {counted(inspection.frames, 'frame')}")
    looked_at = f"of {counted(inspection.pictures, 'frame')} that were looked at"
    yield from _refused(inspection.refused_pictures, looked_at)
    for listed in inspection.left_over:
        first = listed.examples[0]
        yield Remark(
            f"{counted(listed.count, 'file')} not matched, such as {first.name}: "
            f"{first.why}",
            is_serious=True,
        )
    yield from _about_classes(inspection)
    if inspection.frames and not inspection.boxes.count:
        yield Remark(
            "no frame has a box: `layout` in recording.yaml names another layout "
            "(--layout), `boxes: {labels: DIR}` the folder of the labels (--labels)",
            is_serious=False,
        )
    if inspection.frames and not inspection.with_role.get("segmentation"):
        yield Remark(
            "no frame has a segmentation, so no box can be measured; `segmentation: "
            "{folder: DIR}` in recording.yaml names their folder (--segmentation)",
            is_serious=False,
        )
    for note in inspection.notes:
        yield Remark(f"{inspection.layout}: {note}", is_serious=False)
    for note, count in inspection.image_notes:
        yield Remark(f"{counted(count, 'frame')}: {note}", is_serious=False)


def _refused(refused: Iterable[Listed], of: str) -> Iterator[Remark]:
    for listed in refused:
        first = listed.examples[0]
        yield Remark(
            f"{listed.count} {of} cannot be used ({listed.kind}), such as "
            f"{first.name}: {naming_reading(first.why)}",
            is_serious=True,
        )


def _about_classes(inspection: Inspection) -> Iterator[Remark]:
    """Of names by all labels, of pixels by those that were looked at."""
    from filter_core.formats.registry import layout_format
    from filter_core.local import ClassCount

    described, layout = inspection.described, inspection.layout
    has_some = layout and "default_class" in layout_format(layout).read_options
    advice = Advice(described.default_class if has_some else None)
    names, pixels = BoxSummary(advice), BoxSummary(advice)
    for one in inspection.classes:
        unmapped = 0 if one.measured_as else one.boxes
        if one.boxes:
            names.add({one.name: ClassCount(one.boxes, unmapped=unmapped)})
        if one.measured_as and one.looked_at.boxes:
            pixels.add({one.name: one.looked_at})
    yield from names.about_names()
    sample = inspection.pictures < inspection.frames
    which = f"in {inspection.pictures} frames that were looked at: " if sample else ""
    for remark in pixels.about_pixels():
        yield Remark(f"{which}{remark.text}", remark.is_serious)


def counted(count: int, noun: str) -> str:
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
        key=lambda one: (order.get(one.role, len(order)), -one.images),
    )


def told_by(stream: StreamFacts) -> str:
    """What told the role of a stream."""
    return " and ".join(stream.told_by) or "nothing: taken for pictures"


def facts(inspection: Inspection) -> Iterator[tuple[str, str]]:
    """A recording in a few lines: what, and what it is."""
    from filter_core.formats.registry import layout_format

    if inspection.layout is None:
        yield "layout", "cannot be read"
    else:
        title = layout_format(inspection.layout).title
        yield "layout", f"{title}, {inspection.why}"
        counts = [counted(inspection.frames, "frame")]
        boxes = inspection.boxes
        counts.append(counted(boxes.count, "box"))
        if boxes.in_3d:
            counts.append(f"{boxes.in_3d:,} of them in 3D")
        yield "holds", ", ".join(counts)
    if inspection.sizes:
        sizes = [
            f"{one.width} x {one.height} px ({one.images})" for one in inspection.sizes
        ]
        yield "sizes of images", _first(sizes)
    if inspection.segmentation is not None:
        yield "segmentation", segmentation_text(inspection)
    if inspection.depth is not None:
        yield "depth", depth_text(inspection)
    for split in inspection.splits:
        noun = "line" if split.told_by == "list" else "frame"
        yield (
            f"split ({split.told_by})",
            f"{split.name}: {counted(split.frames, noun)}",
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
    return (
        f"{len(folders)} folders with pictures of the same names ({frames} in the "
        f"first), of cameras or of runs that count alike: {_first(folders)}"
    )


def _first(words: Sequence[str]) -> str:
    more = len(words) - MOST_IN_A_LINE
    return ", ".join([*words[:MOST_IN_A_LINE], *([f"and {more} more"] * (more > 0))])
