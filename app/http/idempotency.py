"""A POST that is sent twice with the same Idempotency-Key is executed once.

The transaction of the request takes the key when it begins, and stores the response
before it is committed (`app.http.transaction` calls both). Of two concurrent requests,
the second waits for the first and then gets its response; if the first failed, the
second is executed.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from datetime import timedelta
from typing import Final

from sqlalchemy import ColumnElement, Connection, delete, event, insert, select, update
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session
from starlette.responses import Response

from app.db.base import utc_now
from app.db.tables.access import IdempotencyKey
from app.errors import BadRequest, IdempotencyKeyReuse

_KEY: Final = re.compile(r"[\x21-\x7e]{1,200}")
_STORED_HEADERS: Final = ("location", "etag")
_LACKS_RESPONSE: Final = "request whose response is not stored"
"""Key of `Session.info`: the conditions of the row that is to get the response."""


class RepeatedRequest(Exception):
    """Raised in a repeated request, with the response of the first one."""

    def __init__(self, response: Response) -> None:
        super().__init__("this request is repeated")
        self.response = response


def checked_key(key: str) -> str:
    """The Idempotency-Key; BadRequest if it is malformed."""
    if not _KEY.fullmatch(key):
        raise BadRequest(
            "Idempotency-Key must be 1 to 200 visible ASCII characters",
            code="bad_idempotency_key",
        )
    return key


def request_digest(*parts: bytes) -> str:
    """SHA-256 over method, target, media type and body, each preceded by its length."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "big"))
        digest.update(part)
    return digest.hexdigest()


def take_key_on_begin(
    session: Session, *, token_id: int, key: str, digest: str, keep: timedelta
) -> None:
    """Take an Idempotency-Key when this session's transaction begins.

    Not earlier: a request must hold no lock while it computes before it writes. Equal
    digests mean equal requests, and `keep` is how long the response is stored. If the
    key is taken, the statement that begins the transaction raises `RepeatedRequest`, or
    IdempotencyKeyReuse if the key was used for another request.
    """
    has_key = (IdempotencyKey.token_id == token_id, IdempotencyKey.key == key)
    session.info[_LACKS_RESPONSE] = has_key

    def take(_session: Session, _begun: object, connection: Connection) -> None:
        is_too_old = IdempotencyKey.created_at < utc_now() - keep
        connection.execute(delete(IdempotencyKey).where(*has_key, is_too_old))
        row = {
            "token_id": token_id,
            "key": key,
            "request_digest": digest,
            "status": 0,
            "media_type": "",
            "headers": "{}",
            "body": b"",
            "created_at": utc_now(),
        }
        try:
            # Waits for a transaction that has taken the key and has not ended.
            with connection.begin_nested():
                connection.execute(insert(IdempotencyKey).values(row))
        except IntegrityError:
            stored = connection.execute(select(IdempotencyKey).where(*has_key)).one()
        else:
            return
        if stored.request_digest != digest:
            raise IdempotencyKeyReuse(
                f"Idempotency-Key {key!r} was used for another request"
            )
        headers = {**json.loads(stored.headers), "Idempotent-Replayed": "true"}
        if stored.media_type:
            headers["Content-Type"] = stored.media_type
        raise RepeatedRequest(Response(stored.body, stored.status, headers))

    event.listen(session, "after_begin", take, once=True)


def lacks_response(session: Session) -> bool:
    """Whether the session has a key whose response is not stored yet."""
    return _LACKS_RESPONSE in session.info


def store_response(session: Session, response: Response) -> None:
    """Store the response in the transaction that did the work, if it has a key.

    One with ``no-store``, such as a secret, is not stored; the key is deleted instead.
    """
    has_key: Sequence[ColumnElement[bool]] = session.info.pop(_LACKS_RESPONSE, ())
    if not has_key:
        return
    connection = session.connection()
    headers, body = response.headers, getattr(response, "body", None)
    if not isinstance(body, bytes) or headers.get("cache-control") == "no-store":
        connection.execute(delete(IdempotencyKey).where(*has_key))
        return
    kept = {name: headers[name] for name in _STORED_HEADERS if name in headers}
    values = {
        "status": response.status_code,
        "media_type": headers.get("content-type", ""),
        "headers": json.dumps(kept),
        "body": body,
    }
    connection.execute(update(IdempotencyKey).where(*has_key).values(values))


def forget_old_responses(session: Session, keep: timedelta) -> None:
    """Delete responses that are older than `keep`."""
    cutoff = utc_now() - keep
    session.execute(delete(IdempotencyKey).where(IdempotencyKey.created_at < cutoff))
