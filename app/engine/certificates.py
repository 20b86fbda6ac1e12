"""Certificates for the nodes of a cluster: an authority's and those it has signed.

Every node with a certificate of the authority is trusted by all others, and anyone with
the authority's key can sign more of them. Dask checks the signature, not the names.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from ipaddress import ip_address
from pathlib import Path
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives import serialization as form
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
from cryptography.x509.oid import ExtendedKeyUsageOID as Usage
from cryptography.x509.oid import NameOID

from app.engine.chunk import UnusableEngine

NODES: Final = ("scheduler", "worker", "client")
AUTHORITY: Final = "ca"
_CLOCKS_DIFFER: Final = timedelta(minutes=5)
_PRIVATE, _READABLE = 0o600, 0o644


@dataclass(frozen=True)
class Signed:
    """A certificate and its key."""

    certificate: x509.Certificate
    key: EllipticCurvePrivateKey


def make_certificates(folder: Path, hosts: tuple[str, ...], days: int) -> list[Path]:
    """Write certificates and keys of an authority and of each kind of node.

    Raises
    ------
    UnusableEngine
        One of the files exists already, or a host is neither an address nor a name in
        ASCII. Nothing is written then.
    """
    names = (AUTHORITY, *NODES)
    files = [folder / f"{name}{end}" for name in names for end in (".pem", ".key")]
    there = [file.name for file in files if file.exists()]
    if there:
        raise UnusableEngine(
            f"{str(folder)!r} has {', '.join(there)} already; nodes that have their "
            "certificates would no longer be trusted. Choose another folder"
        )
    for host in hosts:
        if not (host and host.isascii()):
            raise UnusableEngine(
                f"expected an address or a name in ASCII as host, found {host!r}; "
                "names with other letters have an ASCII form that begins with xn--"
            )
    authority = _sign(AUTHORITY, (), days, None)
    signed = {name: _sign(name, hosts, days, authority) for name in NODES}
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    for name, one in {AUTHORITY: authority, **signed}.items():
        _write(folder, name, one)
    return files


def _sign(
    name: str, hosts: tuple[str, ...], days: int, authority: Signed | None
) -> Signed:
    key = ec.generate_private_key(ec.SECP256R1())
    subject = _subject(f"Unghost {name}")
    now = datetime.now(timezone.utc)
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(authority.certificate.subject if authority else subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _CLOCKS_DIFFER)
        .not_valid_after(now + timedelta(days=days))
    )
    for extension, critical in _extensions(key, hosts, authority):
        builder = builder.add_extension(extension, critical)
    signer = authority.key if authority else key
    return Signed(builder.sign(signer, hashes.SHA256()), key)


def _subject(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _extensions(
    key: EllipticCurvePrivateKey, hosts: tuple[str, ...], authority: Signed | None
) -> list[tuple[x509.ExtensionType, bool]]:
    is_authority = authority is None
    signer = key if authority is None else authority.key
    found: list[tuple[x509.ExtensionType, bool]] = [
        (x509.BasicConstraints(is_authority, 0 if is_authority else None), True),
        (_usage(is_authority), True),
        (x509.SubjectKeyIdentifier.from_public_key(key.public_key()), False),
        (
            x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.public_key()),
            False,
        ),
    ]
    if not is_authority:
        # Nodes are both servers and clients: a scheduler connects to workers as well.
        both = x509.ExtendedKeyUsage([Usage.SERVER_AUTH, Usage.CLIENT_AUTH])
        found.append((both, False))
        found.append((x509.SubjectAlternativeName(list(map(_name, hosts))), False))
    return found


def _usage(is_authority: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not is_authority,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=is_authority,
        crl_sign=is_authority,
        encipher_only=False,
        decipher_only=False,
    )


def _name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ip_address(host.strip("[]")))
    except ValueError:
        return x509.DNSName(host)


def _write(folder: Path, name: str, signed: Signed) -> None:
    key = signed.key.private_bytes(
        form.Encoding.PEM, form.PrivateFormat.PKCS8, form.NoEncryption()
    )
    certificate = signed.certificate.public_bytes(form.Encoding.PEM)
    _create(folder / f"{name}.key", key, _PRIVATE)
    _create(folder / f"{name}.pem", certificate, _READABLE)


def _create(file: Path, content: bytes, mode: int) -> None:
    descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    with os.fdopen(descriptor, "wb") as stream:
        stream.write(content)
