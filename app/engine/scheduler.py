"""The scheduler: knows who works, passes on what is to be done, and keeps nothing."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from app.engine.jobs import UnusableEngine
from app.engine.wire import Certificates, prepare, reason_of, security
from app.engine_address import EngineAddress, is_loopback

if TYPE_CHECKING:
    from distributed.node import ServerNode

NOWHERE: Final = "127.0.0.1:0"
"""Where dask's dashboards begin to listen; they are stopped at once."""


def run_scheduler(
    host: str, port: int, certificates: Certificates, ready: Callable[[str], None]
) -> None:
    """Listen until told to stop; `ready` gets the address.

    Raises
    ------
    UnusableEngine
        It would let anybody in, or cannot listen there.
    """
    encrypted = any(certificates)
    if not encrypted and not is_loopback(host):
        raise UnusableEngine(
            f"a scheduler at {host} without certificates would let anybody run code on "
            "every worker; give --ca, --cert and --key (`unghost certificates`)"
        )
    prepare()
    address = EngineAddress("tls" if encrypted else "tcp", host, port)
    asyncio.run(_serve(address, certificates, ready))


async def _serve(
    address: EngineAddress, certificates: Certificates, ready: Callable[[str], None]
) -> None:
    from distributed import Scheduler

    scheduler = Scheduler(
        host=address.host,
        port=address.port,
        protocol=f"{address.scheme}://",
        security=security(certificates, encrypted=address.is_encrypted),
        dashboard=False,
        dashboard_address=NOWHERE,
    )
    try:
        await scheduler
    except (OSError, RuntimeError) as exc:
        detail = f"cannot listen at {address}: {reason_of(exc)}"
        raise UnusableEngine(detail) from exc
    close_dashboard(scheduler)
    over = when_told_to_stop()
    ready(str(scheduler.address))
    await over.wait()
    await scheduler.close()


def close_dashboard(node: ServerNode) -> None:
    """Let nothing of a node listen but its port for work."""
    node.http_server.stop()


def when_told_to_stop() -> asyncio.Event:
    """Set by the first SIGTERM or SIGINT."""
    over, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, over.set)
    return over
