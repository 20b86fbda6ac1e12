"""Asking S3: how patiently, and what its refusals mean. Blobs are not known here.

With `s3`, the only module that imports obstore.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import TYPE_CHECKING, Final

from obstore.exceptions import AlreadyExistsError, BaseError
from obstore.store import S3Store

from app.errors import StorageAway
from app.logs import error_log
from app.storage_url import Bucket

if TYPE_CHECKING:
    from obstore.store import ClientConfig, RetryConfig, S3Config

CONNECT_S: Final = 3
PROBE_S: Final = 5.0
"""Whoever asks whether the store is there does not wait longer for one try."""
MOST_RETRIES: Final = 4
TRUST_S: Final = 300.0
"""How long a blob that was made here is taken to be there without asking.

Rows are written by one at a time, and nobody should wait for a store in that turn.
"""
NO_BUCKET: Final = "NoSuchBucket"
NO_KEYS: Final = "NoKeys"
_ROLES: Final = "169.254.169.254"
_CODE: Final = re.compile(r"<Code>(\w{1,64})</Code>")


@dataclass(frozen=True)
class S3Place:
    """Where a bucket is, and how patiently it is asked.

    An `endpoint` without TLS needs `plain`; no `region` is the one of the environment.
    `timeout_s` limits one try, and the time after which no other one begins.
    """

    bucket: Bucket
    endpoint: str
    region: str | None
    plain: bool
    timeout_s: float
    trust_s: float = TRUST_S


def patient(place: S3Place) -> S3Store:
    """A client that tries again."""
    return _opened(place, place.timeout_s, MOST_RETRIES)


def brief(place: S3Place) -> S3Store:
    """A client for those who hold others up while they ask."""
    return _opened(place, min(PROBE_S, place.timeout_s), 1)


def _opened(place: S3Place, timeout_s: float, retries: int) -> S3Store:
    patience = timedelta(seconds=timeout_s)
    config: S3Config = {"endpoint": place.endpoint}
    if place.region is not None:
        config["region"] = place.region
    client: ClientConfig = {
        "allow_http": place.plain,
        "connect_timeout": f"{CONNECT_S}s",
        "timeout": f"{round(timeout_s * 1000)}ms",
    }
    retry: RetryConfig = {"max_retries": retries, "retry_timeout": patience}
    return S3Store(
        place.bucket.name,
        prefix=place.bucket.prefix or None,
        config=config,
        client_options=client,
        retry_config=retry,
    )


@contextmanager
def answers(*, absent: bool = False) -> Iterator[None]:
    """Say in the service's words that the store does not do what was asked.

    With `absent` a FileNotFoundError is passed on, unless it is the bucket that is
    missing; AlreadyExistsError always is. What the library says is passed on nowhere:
    it quotes answers of the server, and those may quote headers of the request.
    """
    try:
        yield
    except AlreadyExistsError:
        raise
    except FileNotFoundError as exc:
        if absent and _reason(exc) != NO_BUCKET:
            raise
        raise _away(NO_BUCKET) from None
    except BaseError as exc:
        raise _away(_reason(exc)) from None


def _away(reason: str) -> StorageAway:
    error_log.warning("the store of the files does not answer: %s", reason)
    return StorageAway(reason)


def _reason(exc: Exception) -> str:
    """What S3 calls it, else what kind of failure it is."""
    text = str(exc)
    code = _CODE.search(text)
    if code:
        return code[1]
    # Without keys in the environment, the role of the machine is asked for some.
    return NO_KEYS if _ROLES in text else type(exc).__name__
