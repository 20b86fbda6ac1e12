"""The addresses that the service listens on, and those that it cannot listen on."""

import gc
import socket
import warnings

import pytest

from app.serve import CannotServe, check_free, listen
from app.settings import Settings, bracketed
from tests.support import plain_http


def test_a_socket_that_cannot_listen_is_closed():
    gc.collect()  # what earlier tests have left
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        with pytest.raises(OverflowError):
            listen("127.0.0.1", 70_000)
        gc.collect()

    assert [str(warning.message) for warning in told] == []


@pytest.mark.parametrize("host", ["x" * 64 + ".example", "a..b"])
def test_invalid_host_name_raises_cannot_serve(tmp_path, host):
    with pytest.raises(CannotServe, match="cannot listen on"):
        check_free(Settings(data=tmp_path, host=host, allowed_hosts=["*"]))


@pytest.mark.parametrize(
    ("host", "taken"), [("127.0.0.1", "::1"), ("0.0.0.0", "::1"), ("::1", "127.0.0.1")]
)
def test_port_of_another_program_at_the_other_loopback_address_is_refused(
    tmp_path, host, taken
):
    """To a browser, that program would be this service at ``http://localhost``."""
    family = socket.AF_INET6 if ":" in taken else socket.AF_INET
    for _ in range(20):
        with listen(taken, 0, family) as neighbour:
            port = neighbour.getsockname()[1]
            with pytest.raises(CannotServe) as refused:
                check_free(Settings(data=tmp_path, host=host, port=port))

        text = str(refused.value)
        # Another program may have this port at the first address.
        if f"cannot listen on {bracketed(host)}:{port}" not in text:
            break

    place = f"{bracketed(taken)}:{port}"
    assert f"cannot listen on {place}: Address already in use" in text
    assert "is another server running there? --port chooses another port" in text


def test_service_answers_at_both_loopback_addresses(server):
    port = server.url.rpartition(":")[2]

    statuses = [
        plain_http.get(f"http://{host}:{port}/healthz").status_code
        for host in ("127.0.0.1", "[::1]", "localhost")
    ]

    assert statuses == [200, 200, 200]
