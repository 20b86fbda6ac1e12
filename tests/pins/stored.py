"""Writes and reads the stored files of pins, and lists differences in words."""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

FOLDER: Final = Path(__file__).parent / "stored"
_MOST_SHOWN: Final = 20
_ABSENT: Final = object()


def write(name: str, found: Any) -> Path:
    """Store the value of a pin; each item of a list is written on its own line."""
    path = FOLDER / f"{name}.json"
    FOLDER.mkdir(exist_ok=True)
    path.write_text(_text(found) + "\n", "utf-8")
    return path


def _text(found: Any) -> str:
    if isinstance(found, list):
        lines = (json.dumps(item, ensure_ascii=False) for item in found)
        return "[\n" + ",\n".join(lines) + "\n]"
    return json.dumps(found, indent=1, ensure_ascii=False)


def read(name: str) -> Any:
    return json.loads((FOLDER / f"{name}.json").read_text("utf-8"))


def complaint(name: str, found: Any) -> str:
    """A message that lists the differences from the stored file; empty if none."""
    # Through JSON, so that tuples become lists as in the file.
    differing = list(differences(read(name), json.loads(json.dumps(found))))
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


def differences(stored: Any, found: Any, place: str = "") -> Iterator[str]:
    """One line for each place that differs, with both values."""
    if isinstance(stored, dict) and isinstance(found, dict):
        yield from _of_objects(stored, found, place)
    elif isinstance(stored, list) and isinstance(found, list):
        yield from _of_lists(stored, found, place)
    elif stored != found or type(stored) is not type(found):
        at = place or "all of it"
        yield f"  {at}: it was {_shown(stored)}, it is {_shown(found)}"


def _of_objects(
    stored: dict[str, Any], found: dict[str, Any], place: str
) -> Iterator[str]:
    for key in {**stored, **found}:
        at = f"{place} > {key}" if place else key
        before, now = stored.get(key, _ABSENT), found.get(key, _ABSENT)
        if before is _ABSENT or now is _ABSENT:
            yield f"  {at}: it was {_shown(before)}, it is {_shown(now)}"
        else:
            yield from differences(before, now, at)
    if stored.keys() == found.keys() and list(stored) != list(found):
        yield f"  {place}: the order of the keys differs: {_order(stored, found)}"


def _of_lists(stored: list[Any], found: list[Any], place: str) -> Iterator[str]:
    if all(isinstance(item, str) for item in (*stored, *found)) and stored != found:
        yield from _of_words(stored, found, place)
        return
    for at, (before, now) in enumerate(zip(stored, found, strict=False)):
        yield from differences(before, now, f"{place}[{_step(before, at)}]")
    if len(stored) != len(found):
        yield f"  {place}: there were {len(stored)}, there are {len(found)}"


def _of_words(stored: list[str], found: list[str], place: str) -> Iterator[str]:
    gone = [word for word in stored if word not in found]
    new = [word for word in found if word not in stored]
    if gone or new:
        yield f"  {place}: gone {gone}, new {new}"
    else:
        yield f"  {place}: the order differs: {_order(stored, found)}"


def _order(stored: Iterable[str], found: Iterable[str]) -> str:
    """The first place at which two orders of the same words differ."""
    at, (before, now) = next(
        (at, pair)
        for at, pair in enumerate(zip(stored, found, strict=True))
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
