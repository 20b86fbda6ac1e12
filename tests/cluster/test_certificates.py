"""What `unghost certificates` writes, and what other commands refuse."""

import re
import socket
import ssl
import stat
from datetime import datetime, timedelta, timezone
from ipaddress import ip_address

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec

from app.engine.certificates import NODES
from app.engine.chunk import UnusableEngine
from app.engine.dask import Certificates, run_scheduler
from tests.support.command_line import CommandLine
from tests.support.services import running_services
from tests.support.threads import in_thread

EXIT_UNREACHABLE = 69
HOSTS = ("scheduler.lab", "10.0.0.5")


@pytest.fixture(scope="module")
def issued(tmp_path_factory):
    """The folder of new certificates, and the answers to the command and a second."""
    folder = tmp_path_factory.mktemp("made")
    words = [word for host in HOSTS for word in ("--host", host)]
    unghost = CommandLine(folder, {})
    first = unghost("certificates", "nodes", *words, "--days", "30", "--json")
    return folder / "nodes", first, unghost("certificates", "nodes", *words)


def read_certificate(folder, name):
    return x509.load_pem_x509_certificate((folder / f"{name}.pem").read_bytes())


def test_certificates_are_never_overwritten_and_keys_are_private(issued):
    folder, first, second = issued
    files = {file.name: stat.S_IMODE(file.stat().st_mode) for file in folder.iterdir()}

    assert first.code == 0, first.err
    assert len(first.records) == 8
    assert {mode for name, mode in files.items() if name.endswith(".key")} == {0o600}
    assert set(files) == {
        f"{name}{end}" for name in ("ca", *NODES) for end in (".pem", ".key")
    }
    assert second.code == 1
    assert "has ca.pem" in second.err


@pytest.mark.parametrize("host", ["münchen", ""])
def test_host_that_no_certificate_can_name_is_refused_before_anything_is_written(
    tmp_path, host
):
    said = CommandLine(tmp_path, {})("certificates", "nodes", "--host", host)

    assert said.code == 1
    assert f"expected an address or a name in ASCII as host, found {host!r}" in said.err
    assert not (tmp_path / "nodes").exists()


def test_each_certificate_is_signed_for_its_hosts_and_days(issued):
    folder = issued[0]
    authority = read_certificate(folder, "ca")
    context = ssl.create_default_context(cafile=str(folder / "ca.pem"))
    soon = datetime.now(timezone.utc) + timedelta(days=30)
    for name in NODES:
        leaf = read_certificate(folder, name)
        leaf.verify_directly_issued_by(authority)
        names = leaf.extensions.get_extension_for_class(x509.SubjectAlternativeName)
        key = leaf.public_key()

        assert names.value.get_values_for_type(x509.DNSName) == [HOSTS[0]]
        assert names.value.get_values_for_type(x509.IPAddress) == [ip_address(HOSTS[1])]
        assert isinstance(key, ec.EllipticCurvePublicKey)
        assert key.curve.name == "secp256r1"
        assert abs(leaf.not_valid_after_utc - soon) < timedelta(hours=1)
        basic = leaf.extensions.get_extension_for_class(x509.BasicConstraints)
        assert not basic.value.ca
        # Raises if the key does not belong to the certificate.
        context.load_cert_chain(folder / f"{name}.pem", folder / f"{name}.key")


def test_scheduler_without_certificates_is_refused_on_public_address():
    with pytest.raises(UnusableEngine, match="let anybody run code"):
        in_thread(run_scheduler, "0.0.0.0", 0, Certificates(), print)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"ca": "scheduler.key"}, r"UNGHOST_TLS_CA: .*scheduler.key.* no certificate"),
        ({"cert": "ca.key"}, r"UNGHOST_TLS_CERT: .*ca.key.* no certificate"),
        ({"key": "ca.pem"}, r"UNGHOST_TLS_KEY: .*ca.pem.* no private key"),
        ({"key": "worker.key"}, r"UNGHOST_TLS_KEY: .*worker.key.* does not belong to"),
        ({"cert": "nothing.pem"}, r"there is no file .*nothing.pem"),
    ],
)
def test_wrong_certificate_or_key_file_is_refused_and_named(issued, wrong, words):
    names = {"ca": "ca.pem", "cert": "scheduler.pem", "key": "scheduler.key"} | wrong
    shown = Certificates(**{part: issued[0] / name for part, name in names.items()})

    with pytest.raises(UnusableEngine, match=words):
        in_thread(run_scheduler, "127.0.0.1", 0, shown, print)


def test_scheduler_on_a_port_in_use_exits_with_a_message(issued, tmp_path):
    files = ("--ca", "ca.pem", "--cert", "scheduler.pem", "--key", "scheduler.key")
    folder = issued[0]
    words = [str(folder / word) if "." in word else word for word in files]
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])

        # In a process: the library that listens closes its socket only at the exit.
        result = CommandLine(tmp_path, {})(
            "scheduler", "--host", "127.0.0.1", "--port", port, *words
        )

    assert result.code == 1
    assert f"cannot listen at tls://127.0.0.1:{port}: Address already in" in result.err


@pytest.mark.long
def test_worker_without_a_scheduler_exits_with_69_and_the_reason(issued, tmp_path):
    with running_services(tmp_path / "data"):
        pass
    with socket.create_server(("127.0.0.1", 0)) as nobody:
        address = f"tls://127.0.0.1:{nobody.getsockname()[1]}"
    names = {"CA": "ca.pem", "CERT": "worker.pem", "KEY": "worker.key"}
    settings = {
        f"UNGHOST_TLS_{key}": str(issued[0] / name) for key, name in names.items()
    }

    result = CommandLine(tmp_path, settings, anew=True)(
        *("worker", address, "--data", "data", "--patience", "1")
    )

    assert result.code == EXIT_UNREACHABLE
    words = rf"the scheduler at {address}: (Connection refused|Timed out [a-z ]+)"
    assert re.search(words, result.err), result.err
