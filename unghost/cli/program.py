"""The program: the list of its commands, and the mapping of errors to exit codes."""

from __future__ import annotations

import gc
import inspect
import logging
import os
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from importlib import import_module
from typing import Annotated, Any, Final, NoReturn, TypeAlias

import typer
from typer.core import TyperCommand, TyperGroup

from unghost.cli.options import Action, build_command
from unghost.cli.screen import (
    DONE,
    EXIT_CODES,
    INTERRUPTED,
    REFUSED,
    UNAVAILABLE,
    USAGE,
    Refused,
    Screen,
    one_line,
    printable,
)

COMMANDS: Final = {
    "serve": "serve:serve",
    "login": "remote.access:login",
    "demo": "serve:demo",
    "inspect": "local.inspect:inspect",
    "push": "remote.push:push",
    "filter": "local.filter:filter_local",
    "run": "remote.runs:run",
    "wait": "remote.runs:wait",
    "cancel": "remote.runs:cancel",
    "stats": "remote.datasets:stats",
    "report": "remote.datasets:report",
    "diff": "remote.runs:diff",
    "boxes": "remote.lists:boxes",
    "frames": "remote.lists:frames",
    "problems": "remote.lists:problems",
    "runs": "remote.lists:runs",
    "export": "export:export",
    "versions": "export:versions",
    "convert": "export:convert",
    "evaluate": "local.evaluate:evaluate",
    "worth-it": "local.worth:worth_it",
    "draw": "local.draw:draw",
    "replay": "local.replay:replay",
    "audit": "remote.access:audit",
    "capture": "local.capture:capture",
    "backup": "admin:backup",
    "restore": "admin:restore",
    "doctor": "admin:doctor",
    "gc": "admin:gc",
    "worker": "cluster:worker",
    "scheduler": "cluster:scheduler",
    "certificates": "cluster:certificates",
}
"""Every command and its function, in the order in which they are listed."""

CONFIG_COMMANDS: Final = {
    "show": "remote.runs:show_config",
    "set": "remote.runs:set_config",
    "diff": "remote.runs:diff_config",
}
CLASSES_COMMANDS: Final = {
    "show": "remote.classes:show_classes",
    "rename": "remote.classes:rename_class",
    "merge": "remote.classes:merge_class",
    "remove": "remote.classes:remove_class",
}
DATASET_COMMANDS: Final = {
    "create": "remote.datasets:create",
    "list": "remote.datasets:datasets",
    "show": "remote.datasets:show",
    "edit": "remote.datasets:edit",
    "delete": "remote.datasets:delete",
}
AUTH_COMMANDS: Final = {
    "login": "remote.access:store_token",
    "status": "remote.access:show_stored",
    "logout": "remote.access:forget_token",
}
TOKEN_COMMANDS: Final = {
    "create": "remote.access:create_token",
    "list": "remote.access:list_tokens",
    "revoke": "remote.access:revoke_token",
}
HOOK_COMMANDS: Final = {
    "create": "remote.hooks:create",
    "list": "remote.hooks:hooks",
    "delete": "remote.hooks:delete",
    "deliveries": "remote.hooks:deliveries",
    "ping": "remote.hooks:ping",
}

Context: TypeAlias = Any
"""Click's context. Typer does not export it, and has click from another module in each
of its versions.
"""

_HELP: Final = "--help"


class LazyCommand(TyperCommand):
    """A command that is imported when it is called or listed, and built when called.

    So no command waits for the imports of others.
    """

    def __init__(self, name: str, function: str) -> None:
        super().__init__(name)
        self._function = function

    @property
    def action(self) -> Action:
        """The function that does it, of one dataclass of options."""
        module, _, name = self._function.partition(":")
        action: Action = getattr(import_module(f"unghost.cli.{module}"), name)
        return action

    def build(self) -> TyperCommand:
        """The command with its options."""
        return build_command(str(self.name), self.action)

    def get_short_help_str(self, limit: int = 45) -> str:
        """The first sentence of its help, which needs no options."""
        listed = TyperCommand(self.name, help=inspect.getdoc(self.action))
        return listed.get_short_help_str(limit)

    def make_context(
        self,
        info_name: str | None,
        args: list[str],
        parent: Context = None,
        **extra: object,
    ) -> Context:
        """Parse the arguments with the command that is built for them."""
        self.show_help(info_name, args, parent)
        return self.build().make_context(info_name, args, parent, **extra)

    def show_help(
        self, info_name: str | None, args: list[str], parent: Context
    ) -> None:
        """Print the help and exit if the arguments ask for it; else do nothing.

        The arguments are parsed, because `--help` may be the value of an option, but
        not converted, because that would load pydantic, which help does not need.
        """
        if _HELP not in args:
            return
        built = self.build()
        context = typer.Context(built, info_name=info_name, parent=parent)
        parsed, _, _ = built.make_parser(context).parse_args(list(args))
        if parsed.get("help"):
            typer.echo(built.get_help(context))
            raise typer.Exit


class LazyGroup(TyperGroup):
    """A group of commands, such as `config`, or all commands."""

    def make_context(
        self,
        info_name: str | None,
        args: list[str],
        parent: Context = None,
        **extra: object,
    ) -> Context:
        """Parse the arguments up to the command, unless its help is requested."""
        self.show_help(info_name, args, parent)
        return super().make_context(info_name, args, parent, **extra)

    def show_help(
        self, info_name: str | None, args: list[str], parent: Context
    ) -> None:
        """Print the help of the named command and exit, if it is requested."""
        command = self.commands.get(args[0]) if _HELP in args else None
        if isinstance(command, LazyCommand | LazyGroup):
            context = typer.Context(self, info_name=info_name, parent=parent)
            command.show_help(args[0], args[1:], context)


def _lazily(functions: Mapping[str, str]) -> list[LazyCommand]:
    return [LazyCommand(name, function) for name, function in functions.items()]


_GROUPS: Final = {
    "dataset": ("Create, list, show, edit and delete datasets.", DATASET_COMMANDS),
    "config": ("Show, set or compare a dataset's configuration.", CONFIG_COMMANDS),
    "classes": (
        "Show, rename, merge or remove the classes of a dataset.",
        CLASSES_COMMANDS,
    ),
    "auth": (
        "Store a server with its token for later commands, or forget it.",
        AUTH_COMMANDS,
    ),
    "token": (
        "Create, list and revoke people's tokens; needs an admin's token.",
        TOKEN_COMMANDS,
    ),
    "hook": (
        "Let the server call an address when work has ended; needs an admin's token.",
        HOOK_COMMANDS,
    ),
}


class Program(LazyGroup):
    """All commands, and groups of commands."""

    def __init__(self, **arguments: Any) -> None:  # noqa: ANN401  # what typer passes on
        super().__init__(**arguments)
        groups = [
            LazyGroup(
                name=name,
                help=text,
                commands=_lazily(commands),
                no_args_is_help=True,
                rich_markup_mode=None,
            )
            for name, (text, commands) in _GROUPS.items()
        ]
        for command in (*_lazily(COMMANDS), *groups):
            self.add_command(command)

    def invoke(self, ctx: Context) -> object:
        """Run a command; errors about its options are safe to print."""
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            # Newer versions of Typer check values with pydantic, which puts this before
            # its errors.
            error.message = printable(error.message.removeprefix("Value error, "))
            raise


_EXIT_CODES: Final = "; ".join(
    f"{code} {re.split('[,:]', meaning)[0]}" for code, meaning in EXIT_CODES.items()
)

app = typer.Typer(
    cls=Program,
    name="unghost",
    help="Finds the boxes that CARLA's camera cannot see, and explains why.",
    epilog=f"Exit codes: {_EXIT_CODES}.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _print_version(is_asked: bool) -> None:
    if is_asked:
        from importlib.metadata import version

        Screen().text(f"unghost {version('unghost')}")
        raise typer.Exit


@app.callback()
def unghost(
    _version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_print_version,
            is_eager=True,
            help="Print the version and exit.",
        ),
    ] = False,
) -> None:
    """Finds the boxes that CARLA's camera cannot see, and explains why."""


def main() -> NoReturn:
    """Run the command line and exit with one of the documented codes."""
    # What is imported lives to the end; at Python's 700 it is scanned over and over.
    gc.set_threshold(10_000)
    notes = logging.StreamHandler()
    notes.setFormatter(OneLine("unghost: %(message)s"))
    # Not of "unghost": a server logs its own messages below it, in its own form.
    logging.getLogger("unghost.client").addHandler(notes)
    try:
        app(prog_name="unghost")
    except KeyboardInterrupt:
        Screen().note("interrupted")
        sys.exit(INTERRUPTED)
    except BrokenPipeError:
        # The program that reads the output has ended, as in `| head`.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(REFUSED)
    except Exception as error:
        code = exit_code(error)
        if code is None:
            raise
        for line in error_lines(error):
            Screen().note(f"unghost: {line}" if line[:1] != " " else line)
        sys.exit(code)
    sys.exit(DONE)


class OneLine(logging.Formatter):
    """Escapes what a server or a file may have put into a message.

    While no server answers, it says at once which servers run on this machine.
    """

    def format(self, record: logging.LogRecord) -> str:
        from unghost.client.errors import NoResponse

        text = one_line(super().format(record))
        error = record.args[0] if isinstance(record.args, tuple) else None
        others = _others(error.address) if isinstance(error, NoResponse) else ""
        return f"{text}. {others}: --server selects it" if others else text


def _others(address: str) -> str:
    """Which other servers run on this machine, as a sentence; empty if none do."""
    from unghost.client.discovery import noted_servers

    others = sorted({*noted_servers(os.environ)} - {address})
    return f"On this machine runs {' and '.join(others)}" if others else ""


_TOKEN_HINT: Final = (
    "The token comes from --token, UNGHOST_TOKEN, `unghost auth login`, or the data "
    "folder of a server on this machine (UNGHOST_DATA, else ./unghost-data)."
)


def exit_code(error: Exception) -> int | None:
    """The exit code for an error that people can understand; None for a bug."""
    # Imported here, because a command that succeeds needs none of them.
    from unghost.client.discovery import BadServerUrl, ForeignServer
    from unghost.client.errors import (
        ApiError,
        DamagedDownload,
        InvalidName,
        RunFailed,
        Unavailable,
    )

    if isinstance(error, Unavailable):
        return UNAVAILABLE
    if isinstance(error, BadServerUrl | InvalidName):
        return USAGE
    refusals = (Refused, ApiError, RunFailed, DamagedDownload, ForeignServer, OSError)
    if isinstance(error, refusals):
        return REFUSED
    # Last, because both load the library.
    from filter_core.errors import FilterError
    from unghost.capture.simulator import CaptureError, SimulatorAway

    if isinstance(error, SimulatorAway):
        return UNAVAILABLE
    return REFUSED if isinstance(error, FilterError | CaptureError) else None


def error_lines(error: Exception) -> Iterator[str]:
    """The error message: a sentence, then lines with details."""
    from unghost.client.errors import ApiError, NoResponse, Unauthorized

    if isinstance(error, NoResponse):
        yield one_line(error.detail)
        origin = _origin(error.address)
        yield f"{origin}; --server URL or UNGHOST_SERVER selects another."
        if others := _others(error.address):
            yield f"{others}."
        else:
            yield "Is the server running? `unghost serve` starts one."
    elif isinstance(error, ApiError):
        yield one_line(f"{error.detail} ({error.code})")
        faults = error.errors
        if len(faults) > 1 or any(fault.detail not in error.detail for fault in faults):
            yield from (one_line(f"  {fault}") for fault in faults)
            if error.more_errors:
                yield f"  and {error.more_errors} more"
        if isinstance(error, Unauthorized):
            yield _TOKEN_HINT
        if error.status >= 500 and error.request_id:
            yield f"The server's log has details under request id {error.request_id}."
    else:
        from unghost.cli.sources import with_options

        yield with_options(str(error)) or type(error).__name__


def _origin(address: str) -> str:
    """Which setting an address is from: the beginning of a sentence."""
    import httpx

    from unghost.client.discovery import DEFAULT_URL, SERVER_VARIABLE, stored_servers
    from unghost.client.transport import address_of

    variable = os.environ.get(SERVER_VARIABLE)
    with suppress(httpx.InvalidURL):  # not used, then
        if variable and address_of(httpx.URL(variable)) == address:
            return f"This address is from {SERVER_VARIABLE}"
    stored = stored_servers(os.environ)
    if not variable and address == (stored.default or DEFAULT_URL):
        origin = "from `unghost auth login`" if stored.default else "the default"
        return f"This address is {origin}"
    return "This address is from --server"
