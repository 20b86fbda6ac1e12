"""People: what to look at next, and who may come in."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from typing import Any

from unghost.calls.base import Calls, dataset_path
from unghost.people_results import (
    AuditEntry,
    LoginCode,
    NewLoginCode,
    NewToken,
    Order,
    Queue,
    Role,
    Session,
    Token,
)
from unghost.transport import API, Call


class PeopleCalls(Calls):
    """Methods on the queue, tokens and the session."""

    def queue(
        self,
        dataset: str,
        *,
        order: Order = "doubt",
        limit: int = 10,
        filters: Mapping[str, Any] | None = None,
        exclude: Sequence[int] = (),
    ) -> Queue:
        """The next boxes to look at, claimed for five minutes by this token's name.

        `filters` are those of `boxes`, by the names of the API; `exclude` are boxes
        that are at hand already.
        """
        body = {
            "order": order,
            "limit": limit,
            "filters": filters or {},
            "exclude": list(exclude),
        }
        return self._post(Queue, dataset_path(dataset, "queue"), body)

    def session(self) -> Session:
        """Who this client's token stands for."""
        return self._get(Session, f"{API}/session")

    def tokens(self) -> Iterator[Token]:
        """Every token, revoked ones included, oldest first; for admins."""
        return self._all(Token, f"{API}/tokens")

    def create_token(
        self,
        name: str,
        role: Role = "reviewer",
        *,
        expires_at: datetime | None = None,
        expires_in_days: int | None = 90,
    ) -> NewToken:
        """A new token; its text is in this answer and nowhere else. For admins.

        It ends at `expires_at`, else after so many days; None: never.
        """
        body: dict[str, Any] = {"name": name, "role": role}
        if expires_at is not None:
            body["expires_at"] = expires_at.isoformat()
        else:
            body["expires_in_days"] = expires_in_days
        return self._post(NewToken, f"{API}/tokens", body)

    def revoke_token(self, token_id: int) -> None:
        """Take a token back, with the sessions that it opened. For admins."""
        self._transport.send(Call("DELETE", f"{API}/tokens/{token_id}"))

    def create_login_code(self) -> NewLoginCode:
        """A code that logs a browser in as you, once, within ten minutes.

        The link to open is the server's address, `/#code=`, and the code.
        """
        return self._post(NewLoginCode, f"{API}/login-codes", {})

    def login_code(self, code_id: int) -> LoginCode:
        """Whether a login code of yours was used."""
        return self._get(LoginCode, f"{API}/login-codes/{code_id}")

    def audit(self) -> Iterator[AuditEntry]:
        """Who did what, as the server's audit log has it, newest first; for admins."""
        return self._all(AuditEntry, f"{API}/audit")
