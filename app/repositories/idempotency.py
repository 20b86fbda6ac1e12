"""Answers that a repeated POST gets again."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import datetime
from typing import NamedTuple

from sqlalchemy import ColumnElement, Connection, delete, insert, select, update
from sqlalchemy.exc import IntegrityError

from app.db.access_tables import IdempotencyKey
from app.db.base import utc_now


class StoredAnswer(NamedTuple):
    """What a request was, and what it was answered; status 0: not yet answered."""

    request_digest: str
    status: int
    media_type: str
    headers: Mapping[str, str]
    body: bytes


class IdempotencyKeys:
    """Keys of one token, inside a transaction that has begun."""

    def __init__(self, connection: Connection, token_id: int) -> None:
        self._connection = connection
        self._token_id = token_id

    def claim(self, key: str, request_digest: str) -> bool:
        """Take the key for this request; False if it is taken.

        A second claim waits until the transaction of the first one has ended.
        """
        row = {
            "token_id": self._token_id,
            "key": key,
            "request_digest": request_digest,
            "status": 0,
            "media_type": "",
            "headers": "{}",
            "body": b"",
            "created_at": utc_now(),
        }
        try:
            with self._connection.begin_nested():
                self._connection.execute(insert(IdempotencyKey).values(row))
        except IntegrityError:
            return False
        return True

    def stored(self, key: str) -> StoredAnswer:
        """What is stored under a key that is taken."""
        columns = (
            IdempotencyKey.request_digest,
            IdempotencyKey.status,
            IdempotencyKey.media_type,
            IdempotencyKey.headers,
            IdempotencyKey.body,
        )
        statement = select(*columns).where(*self._is(key))
        digest, status, media_type, headers, body = self._connection.execute(
            statement
        ).one()
        return StoredAnswer(digest, status, media_type, json.loads(headers), body)

    def store(self, key: str, answer: StoredAnswer) -> None:
        """Keep the answer of the request that claimed the key."""
        statement = (
            update(IdempotencyKey)
            .where(*self._is(key))
            .values(
                status=answer.status,
                media_type=answer.media_type,
                headers=json.dumps(dict(answer.headers)),
                body=answer.body,
            )
        )
        self._connection.execute(statement)

    def release(self, key: str) -> None:
        """Give the key back: this kind of answer cannot be kept."""
        self._connection.execute(delete(IdempotencyKey).where(*self._is(key)))

    def release_if_older(self, key: str, cutoff: datetime) -> None:
        """Give the key back if its answer is no longer promised."""
        self._connection.execute(
            delete(IdempotencyKey).where(
                *self._is(key), IdempotencyKey.created_at < cutoff
            )
        )

    def _is(self, key: str) -> tuple[ColumnElement[bool], ...]:
        return (IdempotencyKey.token_id == self._token_id, IdempotencyKey.key == key)


def forget_answers_before(connection: Connection, cutoff: datetime) -> None:
    """Drop the answers that are no longer promised."""
    connection.execute(delete(IdempotencyKey).where(IdempotencyKey.created_at < cutoff))
