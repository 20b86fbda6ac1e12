"""The page that `unghost inspect --html` writes: one file, which opens from the disk.

It has no script and loads nothing. Its style is in `page.css`; its colours are those of
the review page (tokens.css).
"""

from __future__ import annotations

import html
import re
from base64 import b64encode
from collections.abc import Iterable, Iterator, Sequence
from importlib.resources import files
from typing import Final

from filter_core.inspection.listing import Listed
from filter_core.inspection.pictures import DrawnBox, DrawnFrame
from filter_core.inspection.recording import ClassFacts, Inspection
from filter_core.inspection.remarks import (
    FAULTS,
    MOST_IN_A_LINE,
    ROLES,
    Remark,
    by_role,
    camera_text,
    count_of,
    depth_text,
    facts,
    measured_as,
    segmentation_text,
    told_by,
)

_LIGHT: Final = """
  --bg: #f6f6f7; --surface: #ffffff; --sunken: #eeeff1; --line: #e3e5e8;
  --line-strong: #c9cdd3; --text: #16181d; --text-soft: #4d535d; --text-faint: #646b76;
  --accent: #3b5bdb; --kept: #00694d; --kept-strong: #007a5a; --kept-soft: #e2f3ee;
  --rejected: #a84300; --rejected-strong: #b84a00; --rejected-soft: #fdece2;
  --unmeasured-strong: #666d78; --unmeasured-soft: #eceef0;
"""

_DARK: Final = """
  --bg: #0c0d10; --surface: #131519; --sunken: #0c0d10; --line: #24272e;
  --line-strong: #3a3f49; --text: #eceef2; --text-soft: #b4bac5; --text-faint: #959ca9;
  --accent: #8ea6ff; --kept: #4fd6ae; --kept-strong: #2fbf95; --kept-soft: #10291f;
  --rejected: #ff9a61; --rejected-strong: #f0803c; --rejected-soft: #34190b;
  --unmeasured-strong: #8b93a1; --unmeasured-soft: #22252b;
"""

_INKS: Final = """
  --ink-kept: #14c795; --ink-rejected: #ff7a2f; --ink-unmeasured: #c3c8d0;
  --ink-casing: rgb(6 8 12 / 62%); --ink-text: #ffffff;
"""
"""Lines on a picture, in either theme."""

COLORS: Final = (_LIGHT, _DARK, _INKS)
"""Properties with the values of tokens.css: light, dark, and those of both."""

_THEMES: Final = (
    f":root {{ color-scheme: light dark; {_LIGHT} {_INKS} }}\n"
    f"@media (prefers-color-scheme: dark) {{ :root {{ {_DARK} }} }}"
)


def page(inspection: Inspection, remarks: Sequence[Remark], description: str) -> str:
    """The page as HTML; `description` is the text of its ``recording.yaml``."""
    name = html.escape(inspection.name)
    rows = []
    for kind in ("folder", "list", "labels"):
        splits = [split for split in inspection.splits if split.told_by == kind]
        if splits:
            drawn = "".join(
                f'<span style="flex-grow:{max(1, split.frames)}">'
                f"{html.escape(split.name)} {split.frames:,}</span>"
                for split in splits
            )
            text = ", ".join(f"{split.name}: {split.frames:,}" for split in splits)
            rows.append(
                (
                    f"split by {_SPLIT_BY[kind]}",
                    f'<span class="split" title="{html.escape(text)}">{drawn}</span>',
                )
            )
    for of_size in inspection.sizes[:MOST_IN_A_LINE]:
        size = f"{of_size.width} x {of_size.height} px"
        rows.append(("size of images", f"{size}, {count_of(of_size.images, 'frame')}"))
    for cameras in inspection.cameras[:MOST_IN_A_LINE]:
        text = camera_text(cameras.folders, cameras.frames)
        rows.append(("cameras", html.escape(text)))
    unused = "".join(
        _details(files.kind, files, with_why=False)
        for files in (*inspection.left_over, *inspection.not_read)
    )
    refused = "".join(
        _details(files.kind, files)
        for files in (*inspection.refused, *inspection.refused_pictures)
    )
    boxes = inspection.boxes
    faults = "".join(_details(FAULTS[fault.kind], fault) for fault in boxes.faults)
    faults = faults or '<p class="soft">None of the boxes in all labels.</p>'
    layout, *rest = facts(inspection)
    holds = next((value for name, value in rest if name == "holds"), "")
    lines = [holds, f"{layout[0].capitalize()}: {layout[1]}"]
    header = "".join(f"<p>{html.escape(line)}</p>" for line in lines if line)
    parts = (
        f"<header>\n<h1>{name}</h1>\n{header}</header>",
        section("What to look at", _remarks(inspection, remarks)),
        section("Three frames, as the filter decides them", _frames(inspection)),
        section("Classes", _classes(inspection)),
        '<div class="pair">',
        section("Tags and depth", _tags(inspection)),
        section("Splits, sizes and cameras", (_definitions(rows) if rows else "")),
        "</div>",
        section("Images by role", _streams(inspection)),
        '<div class="pair">',
        section("Boxes that can hardly be right", faults if boxes.count else ""),
        section(
            "Files that are not used",
            unused or '<p class="soft">Every file is used.</p>',
        ),
        "</div>",
        section("Frames that cannot be used", refused),
        section(
            "The description of this recording",
            '<p class="hint">Saved as recording.yaml in the folder, it says how the '
            "folder is read; --write FILE writes it. Change what is wrong.</p>"
            f"<pre>{html.escape(description)}</pre>",
        ),
        f"<footer>Written by unghost inspect. All labels were read, and the pictures "
        f"of {count_of(inspection.pictures, 'frame')}.</footer>",
    )
    return document(f"{name} - unghost inspect", parts)


def document(title: str, parts: Iterable[str]) -> str:
    """A page in the colours of the review page; `title` and `parts` are HTML."""
    body = "\n".join(part for part in parts if part)
    style = files(__package__).joinpath("page.css").read_bytes()
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{title}</title>\n"
        f"<style>{_THEMES}\n{style.decode()}</style>\n</head>\n<body>\n<main>\n{body}\n"
        "</main>\n</body>\n</html>\n"
    )


def section(title: str, content: str) -> str:
    """A section; nothing if it has no content."""
    return f"<section>\n<h2>{title}</h2>\n{content}\n</section>" if content else ""


_CODE: Final = re.compile("`([^`]+)`")


def _remarks(inspection: Inspection, remarks: Sequence[Remark]) -> str:
    ordered = sorted(remarks, key=lambda remark: not remark.is_serious)
    items = [
        _remark("serious" if remark.is_serious else "note", remark.text)
        for remark in ordered
    ]
    can_decide = inspection.boxes.count and inspection.with_role.get("segmentation")
    if can_decide and not any(remark.is_serious for remark in remarks):
        looked_at = count_of(inspection.pictures, "frame")
        fine = (
            f"all labels, and the pictures of {looked_at}, "
            "were understood: `unghost filter` can begin"
        )
        items.insert(0, _remark("fine", fine))
    return f'<ul class="remarks">{"".join(items)}</ul>' if items else ""


_SIGNS: Final = {"serious": "!", "note": "i", "fine": "&#10003;"}


def _remark(kind: str, text: str) -> str:
    words = _CODE.sub(r"<code>\1</code>", html.escape(text))
    return f'<li class="{kind}"><b>{_SIGNS[kind]}</b><span>{words}</span></li>'


def _frames(inspection: Inspection) -> str:
    if not inspection.drawn:
        return ""
    figures = "\n".join(map(_figure, inspection.drawn))
    legend = "".join(
        f'<span><svg viewBox="0 0 28 14" aria-hidden="true">'
        f'<rect class="{word}" x="4" y="4" width="20" height="6"/></svg>{word}</span>'
        for word in _VERDICTS
    )
    return f'<div class="frames">{figures}</div>\n<p class="legend">{legend}</p>'


_VERDICTS: Final = ("kept", "rejected", "unmeasured")

_MOST_NAMED: Final = 14
"""Boxes of a frame that have their classes beside them, the largest."""


def _figure(frame: DrawnFrame) -> str:
    width, height = frame.wh
    image = ""
    if frame.jpeg is not None:
        data = b64encode(frame.jpeg).decode()
        image = (
            f'<image href="data:image/jpeg;base64,{data}" width="{width}" '
            f'height="{height}" preserveAspectRatio="none"/>'
        )
    # Kept boxes last, so that a ghost does not hide them.
    ordered = sorted(frame.boxes, key=lambda box: _VERDICTS[::-1].index(box.verdict))
    size = width / 34
    rects = "".join(_rect(box) for box in ordered)
    names = "".join(_names(frame.boxes, width, size))
    counts = ", ".join(
        f"{count} {word}"
        for word in _VERDICTS
        if (count := sum(box.verdict == word for box in frame.boxes))
    )
    if frame.outside:
        counts += f"{', ' if counts else ''}{frame.outside} outside of the image"
    return (
        f'<figure><svg viewBox="0 0 {width} {height}" role="img" '
        f'aria-label="{html.escape(frame.key)}: {counts or "no boxes"}">{image}{rects}'
        f'{names}</svg><figcaption><span class="path">{html.escape(frame.key)}</span>'
        f'<br><span class="soft">{counts or "no boxes"}</span></figcaption></figure>'
    )


def _rect(box: DrawnBox) -> str:
    x_min, y_min, x_max, y_max = box.xyxy
    place = (
        f'x="{x_min:.1f}" y="{y_min:.1f}" width="{max(0, x_max - x_min):.1f}" '
        f'height="{max(0, y_max - y_min):.1f}"'
    )
    title = html.escape(f"{box.class_name}: {box.explanation}")
    return (
        f'<rect class="case" {place}/>'
        f'<rect class="{box.verdict}" {place}><title>{title}</title></rect>'
    )


def _names(boxes: Sequence[DrawnBox], width: int, size: float) -> Iterator[str]:
    """The classes beside the largest boxes, where they do not cover each other."""

    def area(box: DrawnBox) -> float:
        x_min, y_min, x_max, y_max = box.xyxy
        return (x_max - x_min) * (y_max - y_min)

    taken: list[tuple[float, float, float]] = []
    for box in sorted(boxes, key=area, reverse=True):
        length = 0.62 * size * len(box.class_name)
        x = max(0.0, min(box.xyxy[0], width - length))
        y = max(size, box.xyxy[1] - size / 4)
        end = x + length
        is_free = all(
            end < left or right < x or abs(y - line) > size
            for left, right, line in taken
        )
        if is_free and len(taken) < _MOST_NAMED:
            taken.append((x, end, y))
            at = f'x="{x:.1f}" y="{y:.1f}" font-size="{size:.1f}"'
            yield f"<text {at}>{html.escape(box.class_name)}</text>"


def _classes(inspection: Inspection) -> str:
    if not inspection.classes:
        return ""
    most = max(1, *(class_facts.boxes for class_facts in inspection.classes))
    rows = "".join(_class_row(class_facts, most) for class_facts in inspection.classes)
    head = "".join(
        f"<span>{title}</span>"
        for title in (
            "class",
            "measured as",
            "boxes in all labels",
            "verdicts in the frames that were looked at",
            "unknown pixels in boxes",
        )
    )
    legend = "".join(
        f'<span><i class="{word}"></i>{word}</span>' for word in (*_VERDICTS, "unknown")
    )
    return (
        f'<div class="classes"><div class="head">{head}</div>{rows}</div>'
        f'<p class="legend">{legend}</p>'
    )


def _class_row(class_facts: ClassFacts, most: int) -> str:
    meaning = html.escape(measured_as(class_facts.measured_as, class_facts.nearest))
    if class_facts.measured_as is None:
        meaning = f'<span class="unknown-class">{meaning}</span>'
    tags = (
        f"<small>{html.escape(', '.join(class_facts.tags))}</small>"
        if class_facts.tags
        else ""
    )
    parts = (class_facts.kept, class_facts.looked_at.rejected, class_facts.unmeasured)
    total = class_facts.looked_at.boxes
    verdicts = _bar(
        [(word, part, total) for word, part in zip(_VERDICTS, parts, strict=True)],
        " / ".join(map(str, parts)) if total else "none looked at",
        words="value verdicts",
    )
    share = class_facts.unknown_percent
    unknown = '<span class="soft">not measured</span>'
    if share is not None:
        values = ", ".join(
            f"{each.name}: {each.number:,} px" for each in class_facts.unknown[:4]
        )
        unknown = _bar([("unknown", share, 100)], f"{share:.1f} %", values)
    return (
        f"<div><b>{html.escape(class_facts.name)}</b>"
        f'<span class="meaning">{meaning}{tags}</span>'
        f'<span class="wide"><span class="label">boxes</span>'
        f"{_bar([('count', class_facts.boxes, most)], f'{class_facts.boxes:,}')}</span>"
        f'<span class="wide"><span class="label">kept / rejected / unmeasured</span>'
        f"{verdicts}</span>"
        f'<span class="wide"><span class="label">unknown pixels in boxes</span> '
        f"{unknown}</span></div>"
    )


def _bar(
    parts: Iterable[tuple[str, float, float]],
    text: str,
    small: str = "",
    words: str = "value",
) -> str:
    """A bar of parts, each with its class and its share of a whole."""
    drawn = "".join(
        f'<i class="{word}" style="width:{100 * part / whole:.2f}%"></i>'
        for word, part, whole in parts
        if part and whole
    )
    note = f"<small>{html.escape(small)}</small>" if small else ""
    return (
        f'<span class="{words}"><span class="bar">{drawn}</span>'
        f"<span>{html.escape(text)}</span>{note}</span>"
    )


def _tags(inspection: Inspection) -> str:
    rows = []
    tags = inspection.segmentation
    if tags is not None:
        kinds = {
            "told": tags.told,
            "agrees": tags.agreeing - tags.told,
            "differs": tags.looked_at - tags.agreeing,
        }
        squares = "".join(
            f'<i class="{kind}"></i>' * count for kind, count in kinds.items()
        )
        text = html.escape(segmentation_text(inspection))
        rows.append(("segmentation", f'<span class="images">{squares}</span>{text}'))
        rows += [
            ("", html.escape(f"{count_of(note.number, 'image')}: {note.name}"))
            for note in tags.notes[:5]
        ]
    if inspection.depth is not None:
        rows.append(("depth", html.escape(depth_text(inspection))))
    if not rows:
        return '<p class="soft">There is neither a segmentation nor a depth image.</p>'
    return _definitions(rows)


def _definitions(rows: Iterable[tuple[str, str]]) -> str:
    """Names with their content, which is HTML already."""
    return (
        f"<dl>{''.join(f'<dt>{name}</dt><dd>{text}</dd>' for name, text in rows)}</dl>"
    )


_SPLIT_BY: Final = {
    "folder": "folders (frames)",
    "list": "lists (lines)",
    "labels": "files of labels (frames)",
}

_MOST_STREAMS: Final = 40


def _streams(inspection: Inspection) -> str:
    if not inspection.streams:
        return ""
    rows = "".join(
        f"<tr><td>{html.escape(ROLES.get(stream.role, stream.role))}</td>"
        f'<td class="number">{stream.images:,}</td><td>told by '
        f'{html.escape(told_by(stream))}</td><td class="path">'
        f"{html.escape(stream.example)}</td></tr>"
        for stream in by_role(inspection)[:_MOST_STREAMS]
    )
    more = len(inspection.streams) - _MOST_STREAMS
    rest = f'<p class="soft">and {more:,} more</p>' if more > 0 else ""
    return (
        '<table><thead><tr><th>role</th><th style="text-align:right">images</th>'
        f"<th>what told it</th><th>such as</th></tr></thead><tbody>{rows}</tbody>"
        f"</table>{rest}"
    )


def _details(title: str, listed: Listed, *, with_why: bool = True) -> str:
    """Things of a kind, folded: ten, then a number."""
    texts = [
        f"{name}: {why}" if with_why or why != listed.kind else name
        for name, why in listed.examples
    ]
    if more := listed.count - len(texts):
        texts.append(f"and {more:,} more")
    items = "".join(f'<li class="path">{html.escape(text)}</li>' for text in texts)
    return (
        f"<details><summary><b>{listed.count:,}</b> {html.escape(title)}</summary>"
        f"<ul>{items}</ul></details>"
    )
