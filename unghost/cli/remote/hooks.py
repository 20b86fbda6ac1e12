"""Commands about hooks: addresses that the server calls when work has ended."""

from __future__ import annotations

import time
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Annotated, Final

import typer

from unghost.cli.options import ServerOptions, dataset_names
from unghost.cli.screen import Refused, naming_options
from unghost.wire.words import HookEvent

if TYPE_CHECKING:
    from unghost.wire import Delivery

_DELIVERY_COLUMNS: Final = ("when", "event", "state", "attempts", "status", "why", "id")
_PING_WITHIN_S: Final = 30.0
_LOOK_EVERY_S: Final = 0.5


@dataclass(frozen=True, kw_only=True)
class CreateOptions(ServerOptions):
    url: Annotated[str, typer.Argument(metavar="URL", help="Where to send events.")]
    event: Annotated[
        list[HookEvent] | None,
        typer.Option(help="Of what it is told; may be repeated. Default: of all."),
    ] = None
    dataset: Annotated[
        str | None,
        typer.Option(help="Only events of this dataset.", autocompletion=dataset_names),
    ] = None


def create(options: CreateOptions) -> None:
    """Register a hook and print the secret that signs it; it is not shown again."""
    named = naming_options(
        {"/url": "URL", "/dataset": "--dataset"}, {"URL": options.url}
    )
    with options.connect() as client, named:
        events = {"events": options.event} if options.event else {}
        made = client.create_hook(options.url, **events, dataset=options.dataset)
    options.screen.record(made.raw, made.secret)
    options.screen.note(
        f"hook {made.id}: the secret is not shown again; `unghost hook ping {made.id}` "
        "tries it"
    )


def hooks(options: ServerOptions) -> None:
    """List the hooks."""
    with options.connect() as client:
        options.screen.listing(
            ("number", "address", "events", "dataset", "made", "by"),
            client.hooks(),
            lambda hook: (
                hook.id,
                hook.url,
                ", ".join(hook.events),
                hook.dataset or "all",
                f"{hook.created_at:%Y-%m-%d}",
                hook.created_by,
            ),
        )


@dataclass(frozen=True, kw_only=True)
class HookOptions(ServerOptions):
    """Options of commands about one hook."""

    hook: Annotated[
        int, typer.Argument(metavar="NUMBER", help="Number of the hook.", min=1)
    ]


def delete(options: HookOptions) -> None:
    """Delete a hook with its log; what waits for it is not sent any more."""
    with options.connect() as client:
        client.delete_hook(options.hook)
    options.screen.record({"deleted": options.hook}, f"hook {options.hook} is deleted")


@dataclass(frozen=True, kw_only=True)
class DeliveriesOptions(HookOptions):
    limit: Annotated[
        int, typer.Option(min=0, help="Maximum number, newest first; 0 for all.")
    ] = 20


def deliveries(options: DeliveriesOptions) -> None:
    """List what was and will be sent to a hook, and why attempts have failed."""
    with options.connect() as client:
        listed = islice(client.hook_deliveries(options.hook), options.limit or None)
        options.screen.listing(_DELIVERY_COLUMNS, listed, _delivery_row)


def _delivery_row(delivery: Delivery) -> tuple[object, ...]:
    why = delivery.error or ""
    if delivery.due_at is not None and delivery.attempts:
        why += f"; again at {delivery.due_at:%H:%M:%S} UTC"
    when = f"{delivery.created_at:%Y-%m-%d %H:%M:%S}"
    status = delivery.status or ""
    return (
        when,
        delivery.event,
        delivery.state,
        delivery.attempts,
        status,
        why,
        delivery.webhook_id,
    )


def ping(options: HookOptions) -> None:
    """Send an event `ping` to a hook, and wait for the response of the receiver."""
    with options.connect() as client:
        sent = client.ping_hook(options.hook)
        until = time.monotonic() + _PING_WITHIN_S
        while not sent.attempts and time.monotonic() < until:
            time.sleep(_LOOK_EVERY_S)
            listed = client.hook_deliveries(options.hook)
            sent = next(
                (delivery for delivery in listed if delivery.id == sent.id), sent
            )
    if sent.error or not sent.attempts:
        raise Refused(f"hook {options.hook}: {sent.error or 'it was not sent yet'}")
    options.screen.record(sent.raw, f"hook {options.hook}: status {sent.status}")
