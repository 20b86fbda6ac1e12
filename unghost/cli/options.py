"""Options of commands: groups that several commands share, and their typer commands.

A command is a function of one frozen dataclass, whose fields are its options:

@dataclass(frozen=True, kw_only=True)
class CancelOptions(ServerOptions):
    run: Annotated[int, typer.Argument(help="Number of the run.")]

def cancel(options: CancelOptions) -> None: ...

Dataclasses that inherit share their options.
"""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import MISSING, dataclass, fields
from enum import Enum, EnumMeta
from functools import partial, reduce
from operator import getitem, or_
from pathlib import Path
from types import GenericAlias, UnionType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Final,
    Literal,
    TypeAlias,
    Union,
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
"""The function of a command; its parameter is the dataclass of options."""

read_file: Final = partial(typer.Option, exists=True, dir_okay=False)
"""An option for a file that is read, with this `help`."""
read_folder: Final = partial(typer.Option, exists=True, file_okay=False)
"""An option for a folder that is read."""
written_file: Final = partial(typer.Option, dir_okay=False)
"""An option for a file that is written, or may not exist."""

ConfigFile: TypeAlias = Annotated[
    Path, read_file("--config", help="A filter configuration (YAML).")
]
DataFolder: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--data",
        metavar="DIR",
        help="The data folder; default: UNGHOST_DATA, else ./unghost-data.",
        file_okay=False,
    ),
]


@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """How to print."""

    json: Annotated[
        bool,
        typer.Option("--json", help="Print one JSON object per line instead of text."),
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
            help="Address of the server; default: UNGHOST_SERVER, else "
            "http://127.0.0.1:8000.",
        ),
    ] = None
    token: Annotated[
        str | None,
        typer.Option(
            help="The token; default: UNGHOST_TOKEN, else that of a server on this "
            "machine."
        ),
    ] = None
    retry_for: Annotated[
        float,
        typer.Option(
            metavar="SECONDS",
            min=0,
            help="How long to wait for a server that is away or busy; 0: not at all.",
        ),
    ] = 120

    def connect(self) -> Client:
        """A client of this server; notes the token files that were ignored."""
        from unghost.client.client import Client
        from unghost.client.discovery import IgnoredTokenFile

        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", IgnoredTokenFile)
            try:
                return Client(self.server, self.token, retry_for=self.retry_for)
            finally:
                for warning in caught:
                    if issubclass(warning.category, IgnoredTokenFile):
                        self.screen.note(str(warning.message))


def dataset_names(incomplete: str) -> list[str]:
    """The datasets whose names begin so, for a shell that completes one."""
    from unghost.client.client import Client

    with suppress(Exception), warnings.catch_warnings():  # a shell waits: no message
        warnings.simplefilter("ignore")
        with Client(retry_for=0, timeout=2) as client:
            names = [dataset.name for dataset in client.datasets()]
            return [name for name in names if name.startswith(incomplete)]
    return []


@dataclass(frozen=True, kw_only=True)
class DatasetOptions(ServerOptions):
    """Which dataset, on which server, and how to print."""

    dataset: Annotated[
        str, typer.Argument(help="Name of the dataset.", autocompletion=dataset_names)
    ]


@dataclass(frozen=True, kw_only=True)
class DataOptions(OutputOptions):
    """Which data folder, and how to print."""

    data: DataFolder = None

    @property
    def settings(self) -> Settings:
        """The settings that a server of this folder would have."""
        return settings_of(data=self.data)


def settings_of(
    option_of_setting: Mapping[str, str] | None = None, /, **values: object
) -> Settings:
    """The settings from the environment, overridden by the values that are not None.

    `option_of_setting` has the options that are not called as their setting.

    Raises `typer.BadParameter`: a value is not allowed; names its option, or the
    variable that it comes from.
    """
    from pydantic import ValidationError

    from app.http.problems import in_words
    from app.settings import Settings

    chosen: dict[str, Any] = {
        name: value for name, value in values.items() if value is not None
    }
    options = {name: f"--{name}" for name in chosen} | {**(option_of_setting or {})}
    try:
        return Settings(**chosen)
    except ValidationError as exc:
        faults = []
        for fault in exc.errors():
            name = str(fault["loc"][0])
            variable = f"UNGHOST_{'_'.join(map(str, fault['loc'])).upper()}"
            place = options[name] if name in chosen else variable
            faults.append(f"{place}: {in_words(fault, show=True)}")
        raise typer.BadParameter("; ".join(faults)) from exc


def config_text(path: Path) -> str:
    """The text of a configuration file, as it is sent to a server.

    Raises `Refused`: the file is not UTF-8.
    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as exc:
        raise Refused(
            f"{path}: expected YAML in UTF-8, found other bytes at offset {exc.start}"
        ) from exc


@contextmanager
def error_context(path: Path | None) -> Iterator[None]:
    """Put the name of the configuration file before the error.

    Raises `Refused`: the library or the server refused the file's content.
    """
    from filter_core.errors import FilterError
    from unghost.client.errors import Invalid

    try:
        yield
    except (FilterError, Invalid) as exc:
        if path is None:
            raise
        raise Refused(f"{path}: {exc.detail}") from exc


def note_unknown_classes(
    screen: Screen, config: Mapping[str, object], boxes: Mapping[str, int]
) -> None:
    """Note classes of a configuration that are probably misspelt.

    It is no error, as boxes may have whatever class somebody chooses. The filter's own
    classes are not noted: one configuration may be for several datasets. `boxes` are
    the numbers of boxes of each class that occurs; without any, nothing is known.
    """
    from filter_core.class_names import canonical_class
    from filter_core.classes import CLASSES
    from filter_core.values import similar

    named = config.get("classes")
    if not boxes or not isinstance(named, Mapping):
        return
    classes = {*CLASSES, *map(canonical_class, boxes)}
    for name in named:
        if canonical_class(name) in classes:
            continue
        meant = similar(name, {*classes, *boxes})
        hint = f"; did you mean {meant!r}?" if meant else ""
        count = sum(boxes.values())
        screen.note(
            f"class {name!r} of the configuration occurs in none of {count} boxes{hint}"
        )


def listed(words: object) -> str:
    """The values of a `Literal` as a list in a sentence: "a, b or c"."""
    *first, last = map(str, get_args(words))
    return f"{', '.join(first)} or {last}"


def build_command(name: str, action: Action) -> typer.core.TyperCommand:
    """Make a command of a function of one dataclass; its docstring is the help."""
    options: type[Any] = get_type_hints(action)["options"]
    hints = {
        name: _with_choices(hint)
        for name, hint in get_type_hints(options, include_extras=True).items()
    }

    def call(**values: object) -> None:
        plain = {name: _plain(value) for name, value in values.items()}
        try:
            action(options(**plain))
        except KeyboardInterrupt as stop:
            # Typer would end without a message.
            Screen().note(str(stop) or "interrupted")
            raise typer.Exit(INTERRUPTED) from stop

    call.__doc__ = action.__doc__
    call.__annotations__ = hints
    signature = inspect.Signature(
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
    call.__signature__ = signature  # type: ignore[attr-defined]  # what inspect reads
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command(name)(call)
    built = typer.main.get_command(app)
    assert isinstance(built, typer.core.TyperCommand), "one command makes no group"
    for parameter in built.params:
        # No option of ours is read from the environment by typer, some of whose
        # versions say "(env var: 'None')" of such an option.
        vars(parameter)["show_envvar"] = False
    return built


def _with_choices(hint: object) -> object:
    """The annotation with an enumeration in place of each `Literal`.

    Older versions of typer do not support `Literal`, and none supports lists of it.
    """
    origin, args = get_origin(hint), get_args(hint)
    if origin is Literal:
        return EnumMeta.__call__(Enum, "Word", [(word, word) for word in args])
    if origin is Annotated:
        return getitem(Annotated, (_with_choices(args[0]), *args[1:]))
    if origin in (Union, UnionType):
        return reduce(or_, map(_with_choices, args))
    if origin is list:
        return GenericAlias(list, (_with_choices(args[0]),))
    return hint


def _plain(value: object) -> object:
    if isinstance(value, list):
        return [_plain(each) for each in value]
    return value.value if isinstance(value, Enum) else value
