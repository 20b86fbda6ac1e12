"""Addresses of the engine: this process, or a scheduler that workers have joined."""

from __future__ import annotations

from ipaddress import ip_address
from typing import Final, NamedTuple

LOCAL: Final = "local"
PORT: Final = 8786
_FORM: Final = "local, tls://HOST:PORT, or tcp://HOST:PORT on this machine"


class EngineAddress(NamedTuple):
    """Where a scheduler listens."""

    scheme: str
    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> EngineAddress:
        """The parts of an address; ValueError says what one looks like."""
        scheme, found, place = text.partition("://")
        host, _, port = place.rpartition(":")
        if not found or scheme not in ("tls", "tcp") or not host:
            raise ValueError(f"{text!r} is no engine; expected {_FORM}")
        if not port.isdigit() or int(port) > 65535:
            raise ValueError(f"{text!r} has no port; expected {_FORM}")
        return cls(scheme, host.strip("[]"), int(port))

    @property
    def is_encrypted(self) -> bool:
        """Whether both sides show a certificate."""
        return self.scheme == "tls"

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach it."""
    if host.lower() == "localhost":
        return True
    try:
        return ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def checked_engine(text: str, *, insecure: bool) -> str:
    """An engine as settings may name it.

    Raises
    ------
    ValueError
        It is none, or whoever reaches it could run code on every worker.
    """
    if text.lower() == LOCAL:
        return LOCAL
    address = EngineAddress.parse(text)
    if not (address.is_encrypted or insecure or is_loopback(address.host)):
        raise ValueError(
            f"{address} is not encrypted: whoever reaches it can run code on every "
            "worker. Use tls:// with certificates (`unghost certificates`); "
            "UNGHOST_ENGINE_INSECURE=true allows it all the same"
        )
    return str(address)
