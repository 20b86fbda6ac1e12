"""The transaction of a request that writes: committed before the response is sent.

A route that writes takes a `WriteSession`. Its transaction has five steps:

1. It begins with the first statement of the route, which waits for its turn
   (`app.db.turns`).
2. The caller is checked again: its token may have been revoked while the body arrived.
3. If the request has an Idempotency-Key, the key is stored before anything else. If an
   earlier request has stored it already, `RepeatedRequest` is raised, and the client
   gets the response of the earlier request (`repeat_response`).
4. The route does its work. Its response is stored beside the key, if there is one.
5. It is committed, and only then is the response sent. `write_session` commits after
   the route has returned; a route that is called very often commits by itself, with
   `commit_and_respond`.

If any of this raises, everything is rolled back, and the key is free again. The rows of
keys are in `app.http.idempotency`.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from datetime import timedelta
from functools import partial
from typing import Annotated, Final, TypeVar

from anyio import CapacityLimiter, WouldBlock, fail_after, to_thread
from fastapi import Depends, Request, Response
from sqlalchemy import Connection, event
from sqlalchemy.orm import Session

from app.errors import DatabaseBusy
from app.http.bodies import run_off_loop
from app.http.deps import Gate, admission_of, database_of, settings_of
from app.http.idempotency import (
    RepeatedRequest,
    lacks_response,
    request_digest,
    store_response,
    take_key_on_begin,
)
from app.security import Principal

WRITE_WAIT_S: Final = 30
_Result = TypeVar("_Result")


async def writers_turn(request: Request) -> AsyncIterator[None]:
    """Let only some of the requests that write have a thread; the others wait without.

    Only one transaction writes at a time, and the threads of other requests wait until
    it ends. If all threads waited, no thread would be left to commit it.
    """
    places = admission_of(request).writers
    try:
        places.acquire_on_behalf_of_nowait(request)
    except WouldBlock:
        try:
            with fail_after(WRITE_WAIT_S):
                await places.acquire_on_behalf_of(request)
        except TimeoutError as exc:
            raise DatabaseBusy("too many writes are waiting; try again") from exc
    try:
        yield
    finally:
        places.release_on_behalf_of(request)


WritersTurn = Annotated[None, Depends(writers_turn, scope="function")]


async def write_session(request: Request, _turn: WritersTurn) -> AsyncIterator[Session]:
    """The session of a route that writes: one transaction, described above.

    It is committed when the route has returned, unless the route has done so itself,
    and rolled back on an exception.
    """
    transaction = database_of(request).write(person=True)
    session = transaction.__enter__()
    request.state.write_session = session
    principal: Principal | None = getattr(request.state, "principal", None)
    if principal is not None:  # logging in identifies its caller by the body
        gate: Gate = request.app.state.gate

        # It must not refer to the request: that would keep the body in memory.
        def check(_session: Session, _begun: object, connection: Connection) -> None:
            gate.require_valid(connection, principal)

        event.listen(session, "after_begin", check, once=True)
    take_key: Callable[[Session], None] | None = getattr(
        request.state, "take_key", None
    )
    if take_key is not None:
        take_key(session)
    try:
        yield session
    except BaseException as exc:
        await _in_own_thread(
            partial(transaction.__exit__, type(exc), exc, exc.__traceback__)
        )
        raise
    # Commits what is not committed yet, and calls the functions of `once_committed`.
    end = partial(transaction.__exit__, None, None, None)
    if session.in_transaction():
        await _in_own_thread(end)
    else:  # The route has committed; the rest is quick, and needs no thread.
        end()


# scope="function": the transaction is committed before the response is sent.
WriteSession = Annotated[Session, Depends(write_session, scope="function")]


def commit_and_respond(session: Session, response: Response) -> Response:
    """Commit the `WriteSession` of a route, in the route's thread; return the response.

    For routes that are called very often: otherwise `write_session` commits later, in
    another thread, and no other transaction can write until then.
    """
    store_response(session, response)
    session.commit()
    return response


async def respond_once(
    endpoint: Callable[[Request], Awaitable[Response]], request: Request, *, key: str
) -> Response:
    """Call an endpoint that takes a `WriteSession`, for a request with this key."""
    url = request.url
    about = (
        request.method.encode(),
        f"{url.path}?{url.query}".encode(),
        request.headers.get("content-type", "").encode(),
    )
    request.state.take_key = partial(
        take_key_on_begin,
        token_id=request.state.principal.token_id,
        key=key,
        digest=await run_off_loop(
            request, await request.body(), partial(request_digest, *about)
        ),
        keep=timedelta(hours=settings_of(request).idempotency_hours),
    )
    response = await endpoint(request)
    session: Session = request.state.write_session
    if lacks_response(session):
        await _in_own_thread(partial(store_response, session, response))
    return response


async def repeat_response(_request: Request, exc: Exception) -> Response:
    """The exception handler of `RepeatedRequest`: sends the stored response."""
    if not isinstance(exc, RepeatedRequest):
        raise exc
    return exc.response


async def _in_own_thread(call: Callable[[], _Result]) -> _Result:
    # Not one of the shared threads: all of them may be waiting for this transaction.
    return await to_thread.run_sync(call, limiter=CapacityLimiter(1))
