"""Whether the server is there, can work, and which one it is."""

from __future__ import annotations

from unghost.calls.base import Calls
from unghost.errors import Unavailable
from unghost.transport import Call
from unghost.work_results import Version


class HealthCalls(Calls):
    """Methods on the server itself."""

    def version(self) -> Version:
        """The program's version."""
        return self._get(Version, "/version")

    def ready(self) -> bool:
        """Whether the server can take work now; asks once."""
        try:
            self._transport.send(Call("GET", "/readyz", retried=False))
        except Unavailable:
            return False
        return True
