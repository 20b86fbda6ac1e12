"""Options of the commands that write labels: which format, and how."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final

import typer

FORMATS: Final = (
    "yolo",
    "coco",
    "kitti",
    "voc",
    "cvat",
    "label-studio",
    "manifest",
    "decisions-jsonl",
    "decisions-csv",
    "decisions-parquet",
)
"""The library's table of formats has the same names: loading it here would make every
command start late, so a test compares them."""

FORMATS_HELP: Final = f"{', '.join(FORMATS[:-1])} or {FORMATS[-1]}."
_LISTS: Final = ("bands",)


@dataclass(frozen=True, kw_only=True)
class FormatOptions:
    """How to write a format."""

    option: Annotated[
        list[str] | None,
        typer.Option(
            "--option",
            "-O",
            metavar="KEY=VALUE",
            help="An option of the format, such as include=all, split=0.9 or "
            "bands=50,100.",
        ),
    ] = None

    @property
    def given(self) -> dict[str, object]:
        """The options by name."""
        return dict(_pair(text) for text in self.option or ())


def _pair(text: str) -> tuple[str, object]:
    key, equals, value = text.partition("=")
    if not (key and equals):
        raise typer.BadParameter(f"--option {text!r} is not of the form KEY=VALUE")
    if key in _LISTS:
        return key, [_value(part.strip()) for part in value.split(",") if part.strip()]
    return key, _value(value)


def _value(text: str) -> object:
    """A number or a truth value where it reads like one, as in YAML."""
    if text in ("true", "false"):
        return text == "true"
    try:
        return float(text) if "." in text else int(text)
    except ValueError:
        return text
