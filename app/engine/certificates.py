"""Certificates for the nodes of a cluster: an authority's and those it has signed.

Every node with a certificate of the authority is trusted by all others, and anyone with
the authority's key can sign more of them. Dask checks the signature, not the names.
"""

from __future__ import annotations

import os
from datetime import datetime, timedelta, timezone
from ipaddress import ip_address
from pathlib import Path
from typing import Final, TypeAlias

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


Signed: TypeAlias = tuple[x509.Certificate, EllipticCurvePrivateKey]
"""A certificate and its key."""


def make_certificates(folder: Path, hosts: tuple[str, ...], days: int) -> list[Path]:
    """Write certificates and keys of an authority and of each kind of node.

    Raises UnusableEngine if one of the files exists already, or a host is neither an
    address nor a name in ASCII. Nothing is written then.
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
    for name, (certificate, key) in {AUTHORITY: authority, **signed}.items():
        private = key.private_bytes(
            form.Encoding.PEM, form.PrivateFormat.PKCS8, form.NoEncryption()
        )
        _create(folder / f"{name}.key", private, _PRIVATE)
        public = certificate.public_bytes(form.Encoding.PEM)
        _create(folder / f"{name}.pem", public, _READABLE)
    return files


def _sign(
    name: str, hosts: tuple[str, ...], days: int, authority: Signed | None
) -> Signed:
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"Unghost {name}")])
    issuer, signer = subject, key
    if authority is not None:
        issuer, signer = authority[0].subject, authority[1]
    now = datetime.now(timezone.utc)
    usage = x509.KeyUsage(
        digital_signature=authority is not None,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=authority is None,
        crl_sign=authority is None,
        encipher_only=False,
        decipher_only=False,
    )
    of_issuer = x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.public_key())
    of_subject = x509.SubjectKeyIdentifier.from_public_key(key.public_key())
    depth = 0 if authority is None else None
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _CLOCKS_DIFFER)
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.BasicConstraints(authority is None, depth), True)
        .add_extension(usage, True)
        .add_extension(of_subject, False)
        .add_extension(of_issuer, False)
    )
    if authority is not None:
        # Nodes are both servers and clients: a scheduler connects to workers as well.
        both = x509.ExtendedKeyUsage([Usage.SERVER_AUTH, Usage.CLIENT_AUTH])
        names = x509.SubjectAlternativeName(list(map(_name, hosts)))
        builder = builder.add_extension(both, False).add_extension(names, False)
    return builder.sign(signer, hashes.SHA256()), key


def _name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ip_address(host.strip("[]")))
    except ValueError:
        return x509.DNSName(host)


def _create(file: Path, content: bytes, mode: int) -> None:
    descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    with os.fdopen(descriptor, "wb") as stream:
        stream.write(content)
