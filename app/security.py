"""Pure functions for secrets, roles and origins, without requests or tables."""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, get_args

from unghost.wire.words import Role

# Prefixes let secret scanners, and our own log, recognise what has leaked.
TOKEN_PREFIX: Final = "ug_"
SESSION_PREFIX: Final = "us_"
LOGIN_CODE_PREFIX: Final = "uc_"
DOWNLOAD_PREFIX: Final = "ud_"
SAFE_METHODS: Final = frozenset({"GET", "HEAD", "OPTIONS"})
_SECRET_BYTES: Final = 32
_PORT: Final = re.compile(r":\d{1,5}$")


def includes(role: Role, other: Role) -> bool:
    """True if the role has all rights of the other."""
    roles = get_args(Role)
    return roles.index(role) >= roles.index(other)


@dataclass(frozen=True)
class Principal:
    """The caller of a request, identified by a token or by a session of the page.

    `name` is the name of the reviewer; `session_hash` is None if a token was sent.
    """

    token_id: int
    name: str
    role: Role
    session_hash: str | None = None


def new_secret(prefix: str) -> str:
    """A secret that nobody can guess; its prefix says what it is for.

    Random and stored as a hash, rather than signed: logging out, or revoking the
    token, ends a session at once, and there is no signing key to lose.
    """
    return prefix + secrets.token_urlsafe(_SECRET_BYTES)


def hash_secret(secret: str) -> str:
    """The hash of a secret, as it is stored in the database.

    SHA-256 without salt or stretching is enough for 256 random bits.
    """
    return hashlib.sha256(secret.encode("utf-8", "surrogatepass")).hexdigest()


def same_hash(digest: str, other: str) -> bool:
    """Whether two hashes are equal, compared in constant time."""
    return hmac.compare_digest(digest, other)


def bearer_token(authorization: str) -> str | None:
    """The secret of an ``Authorization: Bearer`` header; None for any other."""
    scheme, _, token = authorization.strip().partition(" ")
    return token.strip() if scheme.lower() == "bearer" and token.strip() else None


def host_name(host: str) -> str:
    """A Host header without its port, in lower case."""
    return _PORT.sub("", host).lower()


def comes_from_no_other_page(headers: Mapping[str, str]) -> bool:
    """True unless a browser says that another page sent this request."""
    origin, site = headers.get("origin"), headers.get("sec-fetch-site")
    if site is not None and site.lower() not in ("same-origin", "none"):
        return False
    if origin is None:
        return True
    # The scheme is ignored: a proxy in front may terminate TLS.
    _, separator, place = origin.partition("://")
    return bool(separator) and place.lower() == headers.get("host", "").lower()
