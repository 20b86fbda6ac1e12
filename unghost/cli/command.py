"""Commands whose options are a frozen dataclass, so that groups of options are shared.

@dataclass(frozen=True, kw_only=True)
class StatsOptions(ServerOptions):
    dataset: Annotated[str, typer.Argument(help="The dataset.")]

@command(app, "stats")
def stats(options: StatsOptions) -> None: ...
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import MISSING, fields
from typing import Any, TypeVar, get_type_hints

import typer

from unghost.cli.exits import INTERRUPTED
from unghost.cli.screen import Screen

OptionsT = TypeVar("OptionsT")
Action = Callable[[OptionsT], None]


def command(
    app: typer.Typer, name: str
) -> Callable[[Action[OptionsT]], Action[OptionsT]]:
    """Register a function of one options dataclass; its docstring is the help."""

    def register(action: Action[OptionsT]) -> Action[OptionsT]:
        options: type[Any] = get_type_hints(action)["options"]

        def call(**given: object) -> None:
            try:
                action(options(**given))
            except KeyboardInterrupt as stop:
                # Typer would end without a word. Whoever can say more put it there.
                Screen().note(str(stop) or "interrupted")
                raise typer.Exit(INTERRUPTED) from stop

        hints = get_type_hints(options, include_extras=True)
        call.__doc__ = action.__doc__
        call.__annotations__ = hints
        call.__signature__ = _signature(options, hints)  # type: ignore[attr-defined]  # what inspect reads
        app.command(name)(call)
        return action

    return register


def _signature(options: type[Any], hints: dict[str, Any]) -> inspect.Signature:
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
