"""A POST that is sent twice with one Idempotency-Key is done once.

The key is claimed by the first statement of the request's own transaction and the
answer is stored in it before it commits. Of two requests at the same time, the second
waits for the first and then gets its answer; if the first failed, the second does it.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, Final

from sqlalchemy import Connection, event
from sqlalchemy.orm import Session

from app.db.base import utc_now
from app.errors import BadRequest, IdempotencyKeyReuse
from app.repositories.idempotency import (
    IdempotencyKeys,
    StoredAnswer,
    forget_answers_before,
)

_KEY: Final = re.compile(r"[\x21-\x7e]{1,200}")
_STORED_HEADERS: Final = ("location", "etag")


class AlreadyAnswered(Exception):
    """Raised out of the second request; carries what the first was answered."""

    def __init__(self, answer: StoredAnswer) -> None:
        super().__init__("this request was answered before")
        self.answer = answer


@dataclass(frozen=True)
class RepeatableRequest:
    """What makes two requests the same one."""

    token_id: int
    key: str
    digest: str
    keep: timedelta


def checked_key(key: str) -> str:
    """The Idempotency-Key, if it can be one."""
    if not _KEY.fullmatch(key):
        raise BadRequest(
            "Idempotency-Key must be 1 to 200 visible ASCII characters",
            code="bad_idempotency_key",
        )
    return key


def request_digest(*parts: bytes) -> str:
    """SHA-256 over method, target, media type and body, none running into the next."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "big"))
        digest.update(part)
    return digest.hexdigest()


def claim_on_begin(session: Session, request: RepeatableRequest) -> None:
    """Make claiming the key the first thing that this transaction does.

    Not earlier: what a request computes before it writes should hold no lock.
    """

    def claim(_session: Session, _transaction: object, connection: Connection) -> None:
        _claim(connection, request)

    event.listen(session, "after_begin", claim, once=True)


def _claim(connection: Connection, request: RepeatableRequest) -> None:
    keys = IdempotencyKeys(connection, request.token_id)
    keys.release_if_older(request.key, utc_now() - request.keep)
    if keys.claim(request.key, request.digest):
        return
    answer = keys.stored(request.key)
    if answer.request_digest != request.digest:
        raise IdempotencyKeyReuse(
            f"Idempotency-Key {request.key!r} was used for another request"
        )
    raise AlreadyAnswered(answer)


def store_answer(
    session: Session,
    request: RepeatableRequest,
    *,
    status: int,
    headers: Mapping[str, str],
    body: Any,  # noqa: ANN401  # a streamed answer has no body yet
) -> None:
    """Keep the answer beside the work, in the same transaction.

    One that must not be stored (it shows a secret) is not: the key is free again.
    """
    keys = IdempotencyKeys(session.connection(), request.token_id)
    if not isinstance(body, bytes) or headers.get("cache-control") == "no-store":
        keys.release(request.key)
        return
    kept = {name: headers[name] for name in _STORED_HEADERS if name in headers}
    answer = StoredAnswer(
        request.digest, status, headers.get("content-type", ""), kept, body
    )
    keys.store(request.key, answer)


def forget_old_answers(session: Session, keep: timedelta) -> None:
    """Drop answers that were kept long enough."""
    forget_answers_before(session.connection(), utc_now() - keep)
