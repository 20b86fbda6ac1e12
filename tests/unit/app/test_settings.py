"""Settings come from UNGHOST_* variables and do not change."""

from pathlib import Path

import pytest
import typer
from pydantic import ValidationError
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

from app.settings import Settings
from unghost.cli.options import settings_of


def test_default_settings_serve_only_this_machine_and_are_immutable(
    tmp_path, monkeypatch
):
    settings = Settings()

    assert (settings.host, settings.port) == ("127.0.0.1", 8000)
    assert settings.data == Path("unghost-data")
    assert settings.served_hosts == {"localhost", "127.0.0.1", "[::1]"}
    in_folder = Settings(data=tmp_path)
    assert in_folder.sqlalchemy_url == f"sqlite:///{tmp_path}/unghost.db"
    with pytest.raises(ValidationError, match="frozen"):
        settings.port = 1  # type: ignore[misc]  # that is the point
    monkeypatch.setenv("UNGHOST_MAX_FAILED_LOGINS", "20")  # of earlier versions
    assert Settings() == settings


@pytest.mark.parametrize(
    ("name", "text", "field", "value"),
    [
        ("UNGHOST_MAX_BODY_BYTES", "5MiB", "max_body_bytes", 5 * 1024**2),
        ("UNGHOST_ALLOWED_HOSTS", "a.example, B.example", "allowed_hosts", None),
        ("UNGHOST_LOG_LEVEL", "WARNING", "log_level", "warning"),
        ("UNGHOST_PORT", "", "port", 8000),
    ],
)
def test_environment_variables_are_parsed(monkeypatch, name, text, field, value):
    monkeypatch.setenv(name, text)

    setting = getattr(Settings(), field)

    assert setting == (value if value is not None else ("a.example", "B.example"))


@pytest.mark.parametrize(
    ("host", "served"),
    [
        ("0.0.0.0", {"localhost", "127.0.0.1", "[::1]", "boxes.example"}),
        ("::1", {"localhost", "127.0.0.1", "[::1]", "boxes.example"}),
        ("10.0.0.7", {"localhost", "127.0.0.1", "[::1]", "10.0.0.7", "boxes.example"}),
    ],
)
def test_listen_address_is_one_of_the_served_hosts(host, served):
    settings = Settings(host=host, allowed_hosts=("Boxes.example",))

    assert settings.served_hosts == served


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("UNGHOST_PORT", "abc", "expected a whole number, found 'abc'"),
        ("UNGHOST_PORT", "99999", "expected at most 65535, found '99999'"),
        ("UNGHOST_MAX_PARTS", "0", "expected at least 3, found '0'"),
        ("UNGHOST_WORKERS", "0", "expected at least 1, found '0'"),
        ("UNGHOST_MAX_BOXES_PER_FRAME", "65537", "at most 65536, found '65537'"),
        ("UNGHOST_MAX_BODY_BYTES", "lots", "expected a size such as 64MiB, found 'l"),
        ("UNGHOST_STORAGE", "ftp://x", "expected folder, s3://BUCKET or s3://BUCKET/"),
        ("UNGHOST_LOG_LEVEL", "loud",
         "expected 'debug', 'info', 'warning' or 'error', found 'loud'"),
        ("UNGHOST_TRUSTED_PROXIES", "127.0.0.1, proxy.lab",
         "expected an address or a network such as 10.0.0.0/8, found 'proxy.lab'"),
        ("UNGHOST_TRUSTED_PROXIES", "127.0.0.1, 10.0.0.1/8",
         "expected '10.0.0.0/8', if the whole network is meant, or '10.0.0.1', if "
         "one address is, found '10.0.0.1/8'"),
        ("UNGHOST_TRUSTED_PROXIES", "fd00::1/64",
         "expected 'fd00::/64', if the whole network is meant"),
        ("UNGHOST_TRUSTED_PROXIES", "*, 10.0.0.0/8",
         "expected addresses and networks, or * alone, found * together with others"),
        ("UNGHOST_ALLOWED_HOSTS", "https://boxes.example.org",
         "expected names without scheme and port, such as boxes.example.org or "
         "[fd00::1], or *, found 'https://boxes.example.org'"),
        ("UNGHOST_ALLOWED_HOSTS", "a.example, boxes:8000", "found 'boxes:8000'"),
        ("UNGHOST_ALLOWED_HOSTS", "fd00::1", "found 'fd00::1'"),
        ("UNGHOST_ALLOWED_HOSTS", "*.example.org", "found '*.example.org'"),
    ],
)  # fmt: skip
def test_invalid_setting_is_refused_with_its_name_and_expected_value(
    monkeypatch, name, text, words
):
    monkeypatch.setenv(name, text)

    with pytest.raises(typer.BadParameter) as refused:
        settings_of()

    assert refused.value.message.startswith(f"{name}: ")
    assert words in refused.value.message
    assert "Value error" not in refused.value.message


def test_invalid_setting_is_refused_with_the_name_of_its_option(monkeypatch):
    def refusal(**values):
        with pytest.raises(typer.BadParameter) as refused:
            settings_of({"workers": "--threads"}, **values)
        return refused.value.message

    assert refusal(engine="tls:/x").startswith("--engine: ")
    assert refusal(port=99999).startswith("--port: ")
    assert refusal(workers=0).startswith("--threads: ")
    monkeypatch.setenv("UNGHOST_ENGINE", "tls:/x")
    assert refusal(engine=None).startswith("UNGHOST_ENGINE: ")


def test_every_accepted_trusted_proxy_is_trusted_by_uvicorn():
    """uvicorn takes what it cannot parse for a name, which matches no connection."""
    written = ("127.0.0.1", "10.0.0.0/8", "fd00::/64", "::1", "172.16.0.0/255.240.0.0")

    async def never_called(_scope, _receive, _send):
        raise AssertionError

    proxies = list(Settings(trusted_proxies=written).trusted_proxies)
    trusted = ProxyHeadersMiddleware(never_called, proxies).trusted_hosts

    assert not trusted.trusted_literals
    for address in ("127.0.0.1", "10.9.9.9", "fd00::9", "::1", "172.31.0.1"):
        assert address in trusted
