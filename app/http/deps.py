"""Dependencies of routes: services, the caller, ids and names in paths, reading.

The session of a route that writes is `WriteSession` in `app.http.transaction`.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator
from typing import Annotated, Final, Protocol

from fastapi import Depends, Path, Request
from fastapi.security import HTTPBearer
from sqlalchemy import Connection
from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.db.base import MAX_ID, MAX_REVISION
from app.db.engine import Database, once_committed
from app.errors import Forbidden
from app.http.admission import Admission
from app.security import Principal, includes
from app.settings import Settings
from app.storage import room
from unghost.wire.words import Role

RowId = Annotated[int, Path(ge=1, le=MAX_ID)]
"""An id in a path; larger ones would overflow the database's integers."""

AnswerRevision = Annotated[int, Path(ge=1, le=MAX_REVISION)]
"""The revision that an answer has given its box, in a path."""


def settings_of(request: Request) -> Settings:
    """The settings that this service was started with."""
    settings: Settings = request.app.state.settings
    return settings


def database_of(request: Request) -> Database:
    database: Database = request.app.state.database
    return database


def services_of(request: Request) -> ServiceContext:
    """The objects that the whole service shares."""
    services: ServiceContext = request.app.state.services
    return services


def admission_of(request: Request) -> Admission:
    """How many requests the process works on at the same time."""
    return services_of(request).one(Admission)


class Gate(Protocol):
    """Identifies callers. It is `app.access.gate.TokenGate`, which `app.main` sets."""

    async def identify(self, request: Request) -> Principal:
        """The caller, by the request's secret; raises Unauthorised or Forbidden."""

    def require_valid(self, connection: Connection, principal: Principal) -> None:
        """Raise Unauthorised if the caller's token or session has ended since."""


async def authorise(request: Request, needed: Role) -> Principal:
    """Identify the caller and check its role.

    `app.http.routing` calls this for every route that needs a token, before the body is
    read. Raises Unauthorised: there is no valid token or session; Forbidden: the role
    does not suffice, or another web page sent the request.
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
    """The caller, as `authorise` found it."""
    principal: Principal = request.state.principal
    return principal


def read_session(request: Request) -> Iterator[Session]:
    """A session that reads one consistent snapshot for the whole request."""
    with database_of(request).read() as session:
        yield session


def make_room(services: ServiceContext, session: Session) -> None:
    """Release the disk reserve if the disk is too full to commit these deletes.

    Call it after the statements that delete, and before the commit. The reserve is
    restored as soon as there is space.
    """
    if room.Reserve(services.settings.data).give_up(room.DELETING_BYTES):
        once_committed(session, services.one(room.DeletionSignal).set)


def require_room_to_write(services: ServiceContext, session: Session) -> None:
    """Refuse to store what a request has sent if the disk is too full.

    This begins the transaction: of several such requests, each sees the disk as the one
    before has left it. Raises StorageFull: fewer than `min_free_bytes` are free.
    """
    session.connection()
    room.require_room(services.settings, services.storage)


def begin_answer(services: ServiceContext, session: Session) -> None:
    """Begin the transaction of an answer on a single box, or of its undo.

    A request that repeats an idempotency key gets its stored response there, which
    needs no room. Then the answer is refused if the disk is almost full; not with
    PostgreSQL, as answers are on its disk. Raises StorageFull: less than a quarter of
    `min_free_bytes` is free.
    """
    session.connection()
    file = services.database.file
    if file is not None:
        room.require_room_for_answer(services.settings, file.parent)


BEARER = Depends(
    HTTPBearer(
        auto_error=False,
        scheme_name="token",
        description="A token (ug_...), or the session of the page (us_...).",
    )
)


async def app_services(request: Request) -> ServiceContext:
    """As `services_of`; async, as FastAPI would call that in a thread."""
    return services_of(request)


AppServices = Annotated[ServiceContext, Depends(app_services)]

ROLE_OF: Final[dict[object, Role]] = {}
"""The role that each of the dependencies `Viewer`, `Reviewer` and `Admin` needs."""


def _with_role(role: Role) -> Callable[[Request], Awaitable[Principal]]:
    async def caller(request: Request) -> Principal:
        return current_principal(request)

    ROLE_OF[caller] = role
    return caller


Viewer = Annotated[Principal, Depends(_with_role("viewer"))]
"""The caller of a route, who has at least this role; so have the two below.

`app.http.routing` checks it before the body is read, so each route that needs a token
names one of them in its signature."""
Reviewer = Annotated[Principal, Depends(_with_role("reviewer"))]
Admin = Annotated[Principal, Depends(_with_role("admin"))]

ReadSession = Annotated[Session, Depends(read_session, scope="function")]

DatasetName = Annotated[str, Path(max_length=100)]
FrameKey = Annotated[str, Path(max_length=2000)]
