"""What the server says about people: who they are, and what is next for them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Literal, TypeAlias

from unghost.reading import Result
from unghost.results import Decision

Role: TypeAlias = Literal["viewer", "reviewer", "admin"]
Order: TypeAlias = Literal["doubt", "random", "class", "audit"]


@dataclass(frozen=True, kw_only=True)
class Queue(Result):
    """Boxes to look at next, claimed for five minutes; `remaining` are all of them."""

    items: tuple[Decision, ...] = ()
    remaining: int = 0
    unsure: int = 0
    claimed_by_others: int = 0


@dataclass(frozen=True, kw_only=True)
class Session(Result):
    """Who asks; answers carry this name."""

    name: str
    role: Role
    expires_at: datetime | None = None


@dataclass(frozen=True, kw_only=True)
class Token(Result):
    """A token of someone, without what it opens with."""

    id: int
    name: str
    role: Role
    created_at: datetime | None = None
    expires_at: datetime | None = None
    revoked_at: datetime | None = None
    last_used_at: datetime | None = None


@dataclass(frozen=True, kw_only=True)
class NewToken(Token):
    """A token that was just made; `token` is shown this once."""

    token: str = field(repr=False)


@dataclass(frozen=True, kw_only=True)
class LoginCode(Result):
    """What a login link carries, without the code; it opens one session."""

    id: int
    expires_at: datetime
    used_at: datetime | None = None


@dataclass(frozen=True, kw_only=True)
class NewLoginCode(LoginCode):
    """A code that was just made; `code` is shown this once."""

    code: str = field(repr=False)


@dataclass(frozen=True, kw_only=True)
class AuditEntry(Result):
    """Who did what, when, and to what; without a token it was the server itself."""

    id: int
    actor: str
    action: str
    subject: str
    token_id: int | None = None
    created_at: datetime | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
