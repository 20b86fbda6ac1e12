"""Options of commands: the groups that several share, and how they become typer's.

A command is a function of one frozen dataclass, whose fields are its options:

@dataclass(frozen=True, kw_only=True)
class StatsOptions(ServerOptions):
    dataset: Annotated[str, typer.Argument(help="The dataset.")]

def stats(options: StatsOptions) -> None: ...

Dataclasses that inherit share their options.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from dataclasses import MISSING, dataclass, fields
from enum import Enum, EnumMeta
from operator import getitem
from pathlib import Path
from types import GenericAlias
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    TypeAlias,
    get_args,
    get_origin,
    get_type_hints,
)

import typer

from unghost.cli.screen import INTERRUPTED, Refused, Screen

if TYPE_CHECKING:
    from app.settings import Settings
    from unghost.client.client import Client

Action: TypeAlias = Callable[[Any], None]
"""What a command does, given its dataclass of options."""

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
DataFolder: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--data",
        metavar="DIR",
        help="The data folder; else UNGHOST_DATA, else ./unghost-data.",
        file_okay=False,
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
        """A client of this server."""
        from unghost.client.client import Client

        return Client(self.server, self.token)


@dataclass(frozen=True, kw_only=True)
class DataOptions(OutputOptions):
    """Which data folder, and how to print."""

    data: DataFolder = None

    @property
    def settings(self) -> Settings:
        """The settings that a server of this folder would have."""
        return settings_of(data=self.data)


def settings_of(**given: object) -> Settings:
    """The environment's settings, with those on top that were given.

    Raises
    ------
    typer.BadParameter
        A value is not allowed; names its variable.
    """
    from pydantic import ValidationError

    from app.http.problems import in_words
    from app.settings import Settings

    chosen: dict[str, Any] = {
        name: value for name, value in given.items() if value is not None
    }
    try:
        return Settings(**chosen)
    except ValidationError as exc:
        faults = [
            f"UNGHOST_{'_'.join(map(str, each['loc'])).upper()}: "
            f"{in_words(each, show=True)}"
            for each in exc.errors()
        ]
        raise typer.BadParameter("; ".join(faults)) from exc


def config_text(path: Path) -> str:
    """The text of a configuration file, as it is sent to a server.

    Raises
    ------
    Refused
        The file is not UTF-8.
    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as exc:
        raise Refused(
            f"{path}: expected YAML in UTF-8, found other bytes at offset {exc.start}"
        ) from exc


@contextmanager
def error_context(path: Path | None) -> Iterator[None]:
    """Put the name of the configuration file before what is wrong with it.

    Raises
    ------
    Refused
        The library or the server refused the file's content.
    """
    from filter_core.errors import FilterError
    from unghost.client.errors import Invalid

    try:
        yield
    except (FilterError, Invalid) as exc:
        if path is None:
            raise
        raise Refused(f"{path}: {exc.detail}") from exc


@dataclass(frozen=True)
class Words:
    """The words that an option takes; stands in the option's annotation.

    They are read from the table that owns them, and only when they are needed: to load
    the library takes most of the time of a command that does little.

    Attributes
    ----------
    load : callable
        Gives the words.
    checked : bool
        Whether typer refuses other words, and lists these itself. If not, they are read
        for the help alone, which has them in place of `{words}`; other words are
        refused by whoever gets the option.
    """

    load: Callable[[], Iterable[str]]
    checked: bool = True


def build_command(
    name: str, action: Action, *, with_help: bool
) -> typer.core.TyperCommand:
    """Make typer's command of a function of one options dataclass.

    Parameters
    ----------
    name : str
    action : callable
        Its docstring is the help.
    with_help : bool
        Also list the words that only help texts name.
    """
    options: type[Any] = get_type_hints(action)["options"]
    hints = {
        name: _with_words(hint, with_help=with_help)
        for name, hint in get_type_hints(options, include_extras=True).items()
    }

    def call(**given: object) -> None:
        plain = {name: _plain(value) for name, value in given.items()}
        try:
            action(options(**plain))
        except KeyboardInterrupt as stop:
            # Typer would end without a message. Its text says what goes on.
            Screen().note(str(stop) or "interrupted")
            raise typer.Exit(INTERRUPTED) from stop

    call.__doc__ = action.__doc__
    call.__annotations__ = hints
    call.__signature__ = _signature(options, hints)  # type: ignore[attr-defined]  # what inspect reads
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command(name)(call)
    built = typer.main.get_command(app)
    assert isinstance(built, typer.core.TyperCommand), "one command makes no group"
    return built


def _signature(options: type[Any], hints: Mapping[str, Any]) -> inspect.Signature:
    return inspect.Signature(
        [
            inspect.Parameter(
                each.name,
                inspect.Parameter.KEYWORD_ONLY,
                annotation=hints[each.name],
                default=inspect.Parameter.empty
                if each.default is MISSING
                else each.default,
            )
            for each in fields(options)
        ]
    )


def _with_words(hint: Any, *, with_help: bool) -> Any:  # noqa: ANN401  # annotations
    """The annotation as typer takes it: an enumeration, or a help text with a list."""
    if get_origin(hint) is not Annotated:
        return hint
    kind, *notes = get_args(hint)
    words = next((each for each in notes if isinstance(each, Words)), None)
    if words is None or not (words.checked or with_help):
        return hint
    listed = tuple(words.load())
    if words.checked:
        # What typer offers as choices, in all of its versions.
        choices = EnumMeta.__call__(Enum, "Word", [(word, word) for word in listed])
        is_list = any(get_origin(part) is list for part in get_args(kind))
        kind = (GenericAlias(list, (choices,)) if is_list else choices) | None
    else:
        notes[0] = copy(notes[0])
        listing = f"{', '.join(listed[:-1])} or {listed[-1]}"
        notes[0].help = notes[0].help.format(words=listing)
    return getitem(Annotated, (kind, *notes))


def _plain(value: object) -> object:
    if isinstance(value, list):
        return [_plain(each) for each in value]
    return value.value if isinstance(value, Enum) else value
