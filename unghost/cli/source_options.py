"""Options of the commands that read a folder of frames."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated, Final

import typer

LAYOUTS: Final = ("auto", "yolo", "coco", "kitti", "voc", "manifest", "carlasimu")
"""The library's list has the same names: loading it here would make every command
start late, so a test compares them."""


class Palette(str, Enum):
    """Tag families by CARLA's version."""

    AUTO = "auto"
    CARLA_0_9_0 = "carla-0.9.0"
    CARLA_0_9_10 = "carla-0.9.10"
    CARLA_0_9_14 = "carla-0.9.14"
    PAPER_TABLE1 = "paper-table1"


class Encoding(str, Enum):
    """How tags are written in a segmentation."""

    AUTO = "auto"
    PALETTE = "palette"
    RAW = "raw"


class ChannelOrder(str, Enum):
    """Order of a segmentation's colour channels."""

    AUTO = "auto"
    RGB = "rgb"
    BGR = "bgr"


class Lossy(str, Enum):
    """What to do with a segmentation that was saved as JPEG."""

    REFUSE = "refuse"
    NEAREST = "nearest"


@dataclass(frozen=True, kw_only=True)
class SourceOptions:
    """How to read a folder of frames."""

    layout: Annotated[
        str,
        typer.Option(
            metavar="LAYOUT",
            help=f"How the folder is laid out: {', '.join(LAYOUTS[:-1])} or "
            f"{LAYOUTS[-1]}.",
        ),
    ] = "auto"
    segmentation: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of the segmentations, if it is not the layout's own.",
            exists=True,
            file_okay=False,
        ),
    ] = None
    labels: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of the labels, if it is not the layout's own.",
            exists=True,
            file_okay=False,
        ),
    ] = None
    classes: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Names of the classes by number, separated by commas, if the folder "
            "has no list of its own.",
        ),
    ] = None
    default_class: Annotated[
        str, typer.Option(metavar="NAME", help="Class of labels that carry none.")
    ] = "unknown"

    @property
    def class_list(self) -> tuple[str, ...] | None:
        """The names of the classes, if they were given."""
        if self.classes is None:
            return None
        return tuple(name.strip() for name in self.classes.split(","))


@dataclass(frozen=True, kw_only=True)
class SegmentationReading:
    """How segmentations are to be read, where their files do not tell."""

    palette: Annotated[
        Palette | None, typer.Option(help="Tag family of the segmentations.")
    ] = None
    encoding: Annotated[Encoding | None, typer.Option(help="How they write tags.")] = (
        None
    )
    channel_order: Annotated[
        ChannelOrder | None, typer.Option(help="Order of their colour channels.")
    ] = None
    lossy_segmentation: Annotated[
        Lossy | None, typer.Option(help="What to do with JPEG segmentations.")
    ] = None

    @property
    def reading(self) -> dict[str, str]:
        """What was said, by the names that datasets and the library use."""
        given = {
            "palette": self.palette,
            "encoding": self.encoding,
            "channel_order": self.channel_order,
            "lossy_segmentation": self.lossy_segmentation,
        }
        return {name: one.value for name, one in given.items() if one is not None}


@dataclass(frozen=True, kw_only=True)
class LocalFilterOptions(SourceOptions, SegmentationReading):
    """A folder, and how it is filtered on this machine."""

    source: Annotated[
        Path,
        typer.Argument(
            metavar="SOURCE",
            help="A folder in a recognised layout, or a manifest.jsonl.",
            exists=True,
        ),
    ]
    config: Annotated[
        Path | None,
        typer.Option(
            help="A filter configuration (YAML); else the defaults.",
            exists=True,
            dir_okay=False,
        ),
    ] = None
    workers: Annotated[
        int | None,
        typer.Option(min=1, max=256, help="Frames at the same time; else all cores."),
    ] = None
