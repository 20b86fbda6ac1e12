"""What routes depend on: sessions, services, who is asking, ids and names in paths."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from typing import Annotated, Final, Protocol, TypeVar

from anyio import CapacityLimiter, WouldBlock, fail_after, to_thread
from fastapi import Depends, Path, Query, Request
from fastapi.security import HTTPBearer
from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.db.base import MAX_ID
from app.db.engine import Database, once_committed
from app.errors import DatabaseBusy, Forbidden
from app.http.idempotency import claim_on_begin
from app.security import (
    Principal,
    includes,
)
from app.settings import Settings
from app.storage.room import DELETING_BYTES, DeletionSignal, Reserve
from unghost.wire.words import Role

Result = TypeVar("Result")

MAX_WRITERS: Final = 12
MAX_UPLOADS: Final = 8
MAX_BATCHES: Final = 4
"""Together well below the 40 threads that anyio gives to the routes of a process, and
below the connections that it may have. Frames have places of their own: no answer of a
person is to wait for them."""
MAX_FOLDERS: Final = 2
"""Dropped folders that are read at the same time, each by a child process."""
WRITE_WAIT_S: Final = 30

RowId = Annotated[int, Path(ge=1, le=MAX_ID)]
"""An id in a path; larger ones would overflow the database's integers."""

RowIdQuery = Annotated[int, Query(ge=1, le=MAX_ID)]
"""An id in a query."""


def settings_of(request: Request) -> Settings:
    """The settings this service was started with."""
    settings: Settings = request.app.state.settings
    return settings


def database_of(request: Request) -> Database:
    """The service's database."""
    database: Database = request.app.state.database
    return database


def services_of(request: Request) -> ServiceContext:
    """What services share for the life of the process."""
    services: ServiceContext = request.app.state.services
    return services


class Gate(Protocol):
    """Who knows who is asking: `app.access.gate.TokenGate`, as `app.main` says."""

    async def identify(self, request: Request) -> Principal:
        """Who showed the secret of this request; Unauthorised or Forbidden."""


async def authorise(request: Request, needed: Role) -> Principal:
    """The one place where it is decided who may come in.

    Called for each route by `app.http.routing`, before the body is read.

    Raises
    ------
    Unauthorised
        No valid token or session.
    Forbidden
        Not with this role, or a browser sent it for another page.
    """
    gate: Gate = request.app.state.gate
    principal = await gate.identify(request)
    request.state.principal = principal
    if not includes(principal.role, needed):
        raise Forbidden(
            f"this needs the role {needed}, "
            f"token {principal.name!r} has {principal.role}"
        )
    return principal


def current_principal(request: Request) -> Principal:
    """Who is asking, as `authorise` found."""
    principal: Principal = request.state.principal
    return principal


def admin(request: Request) -> None:
    """Refuse everyone but an admin, on a route that others share a router with."""
    principal = current_principal(request)
    if not includes(principal.role, "admin"):
        raise Forbidden(
            f"this needs the role admin, token {principal.name!r} has {principal.role}"
        )


def read_session(request: Request) -> Iterator[Session]:
    """One consistent state of the database for the whole request."""
    with database_of(request).read() as session:
        yield session


async def writers_turn(request: Request) -> AsyncIterator[None]:
    """A place among the requests that write; the others wait without a thread.

    Only one transaction writes at a time. If all threads waited for it, it would not
    get one itself to make its answer and to commit.
    """
    places: CapacityLimiter = request.app.state.writers
    try:
        places.acquire_on_behalf_of_nowait(request)
    except WouldBlock:
        await _wait_for(places, request)
    try:
        yield
    finally:
        places.release_on_behalf_of(request)


async def _wait_for(places: CapacityLimiter, request: Request) -> None:
    try:
        with fail_after(WRITE_WAIT_S):
            await places.acquire_on_behalf_of(request)
    except TimeoutError as exc:
        raise DatabaseBusy("too many writes are waiting; try again") from exc


WritersTurn = Annotated[None, Depends(writers_turn, scope="function")]


async def write_session(request: Request, _turn: WritersTurn) -> AsyncIterator[Session]:
    """One transaction per request: commit on return, leave no trace on raise.

    It begins with the route's first statement. A route that has its answer ready may
    commit in its own thread; what is left to do here then needs none.
    """
    transaction = database_of(request).write(person=True)
    session = transaction.__enter__()
    request.state.write_session = session
    repeatable = getattr(request.state, "repeatable", None)
    if repeatable is not None:
        claim_on_begin(session, repeatable)
    try:
        yield session
    except BaseException as exc:
        await _in_own_thread(transaction.__exit__, type(exc), exc, exc.__traceback__)
        raise
    if session.in_transaction():
        await _in_own_thread(transaction.__exit__, None, None, None)
    else:
        transaction.__exit__(None, None, None)


def make_room(services: ServiceContext, session: Session) -> None:
    """Give up the reserve if the disk is too full for what this session deleted.

    To be called once there was something to delete that may be deleted, and before the
    commit, which writes it down. The reserve is taken again as soon as there is room.
    """
    if Reserve(services.settings.data).give_up(DELETING_BYTES):
        once_committed(session, services.one(DeletionSignal).set)


async def _in_own_thread(call: Callable[..., object], *args: object) -> None:
    # Not one of the shared ones: they may all be waiting for this transaction to end.
    await to_thread.run_sync(call, *args, limiter=CapacityLimiter(1))


ADMIN = Depends(admin)
BEARER = Depends(
    HTTPBearer(
        auto_error=False,
        scheme_name="token",
        description="A token (ug_...), or the session of the page (us_...).",
    )
)


def _inline(
    read: Callable[[Request], Result],
) -> Callable[[Request], Awaitable[Result]]:
    """A dependency that only looks something up: not worth a thread of its own."""

    async def look_up(request: Request) -> Result:
        return read(request)

    return look_up


AppSettings = Annotated[Settings, Depends(_inline(settings_of))]
AppServices = Annotated[ServiceContext, Depends(_inline(services_of))]
AppDatabase = Annotated[Database, Depends(_inline(database_of))]
CurrentPrincipal = Annotated[Principal, Depends(_inline(current_principal))]
ReadSession = Annotated[Session, Depends(read_session, scope="function")]
# scope="function": it ends, and commits, before the answer is sent. 201 means stored.
WriteSession = Annotated[Session, Depends(write_session, scope="function")]

DatasetName = Annotated[str, Path(max_length=100)]
