"""Options that several commands share."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from unghost.cli.screen import Screen
from unghost.client import Client

DatasetName: TypeAlias = Annotated[str, typer.Argument(help="Name of the dataset.")]
ConfigFile: TypeAlias = Annotated[
    Path,
    typer.Option(
        "--config",
        help="A filter configuration (YAML).",
        exists=True,
        dir_okay=False,
        readable=True,
    ),
]


@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """How to print."""

    json: Annotated[
        bool, typer.Option("--json", help="Print JSON lines instead of text.")
    ] = False

    @property
    def screen(self) -> Screen:
        """Where the output goes."""
        return Screen(as_json=self.json)


@dataclass(frozen=True, kw_only=True)
class ServerOptions(OutputOptions):
    """Which server, and how to print."""

    server: Annotated[
        str | None,
        typer.Option(
            metavar="URL",
            help="The server; else UNGHOST_SERVER, else http://127.0.0.1:8000.",
        ),
    ] = None
    token: Annotated[
        str | None,
        typer.Option(
            help="The token; else UNGHOST_TOKEN, else that of a server on this machine."
        ),
    ] = None

    def connect(self) -> Client:
        """A client of the server that was meant."""
        return Client(self.server, self.token)


@dataclass(frozen=True, kw_only=True)
class SourceOptions:
    """How to read a folder of frames."""

    layout: Annotated[
        str,
        typer.Option(
            metavar="LAYOUT",
            help="How the folder is laid out: auto, manifest, carlasimu, yolo or voc.",
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
