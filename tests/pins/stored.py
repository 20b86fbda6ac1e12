"""Writes and reads the stored files of pins, and lists differences in words."""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

FOLDER: Final = Path(__file__).parent / "stored"
_MOST_SHOWN: Final = 20
_ABSENT: Final = object()


def write(name: str, value: Any) -> Path:
    """Store the value of a pin; each item of a list is written on its own line."""
    path = FOLDER / f"{name}.json"
    FOLDER.mkdir(exist_ok=True)
    path.write_text(_text(value) + "\n", "utf-8")
    return path


def _text(value: Any) -> str:
    if isinstance(value, list):
        lines = (json.dumps(item, ensure_ascii=False) for item in value)
        return "[\n" + ",\n".join(lines) + "\n]"
    return json.dumps(value, indent=1, ensure_ascii=False)


def read(name: str) -> Any:
    return json.loads((FOLDER / f"{name}.json").read_text("utf-8"))


def complaint(name: str, value: Any) -> str:
    """A message that lists the differences from the stored file; empty if none."""
    # Through JSON, so that tuples become lists as in the file.
    differing = list(differences(read(name), json.loads(json.dumps(value))))
    if not differing:
        return ""
    shown = differing[:_MOST_SHOWN]
    if len(differing) > len(shown):
        shown.append(f"... and {len(differing) - len(shown)} more")
    return "\n".join(
        [
            f"{name} is not what it was:",
            *shown,
            f"If users are meant to see this: `python -m tests.pins.write {name}`, "
            "and a line of CHANGELOG.md that says so.",
        ]
    )


def differences(stored: Any, value: Any, place: str = "") -> Iterator[str]:
    """One line for each place that differs, with both values."""
    if isinstance(stored, dict) and isinstance(value, dict):
        yield from _of_objects(stored, value, place)
    elif isinstance(stored, list) and isinstance(value, list):
        yield from _of_lists(stored, value, place)
    elif stored != value or type(stored) is not type(value):
        at = place or "all of it"
        yield f"  {at}: it was {_shown(stored)}, it is {_shown(value)}"


def _of_objects(
    stored: dict[str, Any], value: dict[str, Any], place: str
) -> Iterator[str]:
    for key in {**stored, **value}:
        at = f"{place} > {key}" if place else key
        before, now = stored.get(key, _ABSENT), value.get(key, _ABSENT)
        if before is _ABSENT or now is _ABSENT:
            yield f"  {at}: it was {_shown(before)}, it is {_shown(now)}"
        else:
            yield from differences(before, now, at)
    if stored.keys() == value.keys() and list(stored) != list(value):
        yield f"  {place}: the order of the keys differs: {_order(stored, value)}"


def _of_lists(stored: list[Any], value: list[Any], place: str) -> Iterator[str]:
    if all(isinstance(item, str) for item in (*stored, *value)) and stored != value:
        yield from _of_words(stored, value, place)
        return
    for at, (before, now) in enumerate(zip(stored, value, strict=False)):
        yield from differences(before, now, f"{place}[{_step(before, at)}]")
    if len(stored) != len(value):
        yield f"  {place}: there were {len(stored)}, there are {len(value)}"


def _of_words(stored: list[str], value: list[str], place: str) -> Iterator[str]:
    gone = [word for word in stored if word not in value]
    new = [word for word in value if word not in stored]
    if gone or new:
        yield f"  {place}: gone {gone}, new {new}"
    else:
        yield f"  {place}: the order differs: {_order(stored, value)}"


def _order(stored: Iterable[str], value: Iterable[str]) -> str:
    """The first place at which two orders of the same words differ."""
    at, (before, now) = next(
        (at, pair)
        for at, pair in enumerate(zip(stored, value, strict=True))
        if pair[0] != pair[1]
    )
    return f"at {at} it was {before!r}, it is {now!r}"


def _step(item: Any, at: int) -> str:
    """How a message names an item of a list; steps of a walk have a name."""
    named = isinstance(item, dict) and isinstance(item.get("step"), str)
    return f"{at}: {item['step']}" if named else str(at)


def _shown(value: Any) -> str:
    if value is _ABSENT:
        return "absent"
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 300 else f"{text[:300]}…"
