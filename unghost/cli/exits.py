"""The exit codes, and which exception stands for which."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import httpx

from unghost.discovery import BadServerUrl, ForeignServer
from unghost.errors import (
    ApiError,
    DamagedDownload,
    RunFailed,
    Unauthorized,
    Unavailable,
)

DONE: Final = 0
REFUSED: Final = 1
USAGE: Final = 2
PARTLY: Final = 3
SERVER_AWAY: Final = 69
INTERRUPTED: Final = 130

_LOGIN_HINT: Final = (
    "The token comes from --token, UNGHOST_TOKEN, or the data folder of a server on "
    "this machine (UNGHOST_DATA, else ./unghost-data)."
)


class Refused(Exception):
    """The command cannot do what was asked; the text says why."""


def exit_code(error: Exception) -> int | None:
    """The code for an error that has a message for people; None: it is a bug."""
    if isinstance(error, httpx.TransportError | Unavailable):
        return SERVER_AWAY
    if isinstance(error, BadServerUrl):
        return USAGE
    # Only needed when something failed: a command without boxes starts without it.
    from filter_core.errors import FilterError

    expected = (ApiError, FilterError, RunFailed, DamagedDownload, Refused)
    also = (ForeignServer, OSError)
    return REFUSED if isinstance(error, (*expected, *also)) else None


def explain(error: Exception) -> Iterator[str]:
    """Lines for people; the first one says it all."""
    if isinstance(error, httpx.TransportError):
        yield f"no answer from {_address(error)}: {str(error) or type(error).__name__}"
        yield "Is the server running? `unghost serve` starts one."
    elif isinstance(error, ApiError):
        yield f"{error.detail} ({error.code})"
        faults = error.errors
        if len(faults) > 1 or any(one.detail not in error.detail for one in faults):
            yield from (f"  {fault}" for fault in faults)
            if error.more_errors:
                yield f"  and {error.more_errors} more"
        if isinstance(error, Unauthorized):
            yield _LOGIN_HINT
        if error.status >= 500 and error.request_id:
            yield f"The server's log has more under request id {error.request_id}."
    else:
        yield str(error) or type(error).__name__


def _address(error: httpx.TransportError) -> str:
    try:
        url = error.request.url
    except RuntimeError:  # httpx: no request belongs to this error
        return "the server"
    return str(url.copy_with(path="/", query=None)).rstrip("/")
