"""The examples of docs/client.md are run in order, against a server."""

from typing import Any

import pytest

from tests.support.documents import blocks, read
from tests.support.frames import write_manifest

EXAMPLES = blocks(read("docs/client.md"), "python")


@pytest.fixture
def server_and_recording(start_server, tmp_path, monkeypatch):
    server = start_server()
    monkeypatch.chdir(write_manifest(tmp_path / "recording", 2))
    monkeypatch.setenv("UNGHOST_SERVER", server.url)
    monkeypatch.setenv("UNGHOST_TOKEN", server.token)


@pytest.mark.usefixtures("server_and_recording")
def test_client_examples_run_in_order_and_print_the_expected_output(capsys):
    namespace: dict[str, Any] = {"__name__": "__main__"}

    printed = []
    for example in EXAMPLES:
        exec(compile(example, "client.md", "exec"), namespace)
        printed.append(capsys.readouterr().out.splitlines())
    namespace["client"].close()

    connect, push, put, look, tables, awaited, runs, review, quality, export = printed
    assert connect == ["admin"]
    assert sorted(push) == ["000000 stored", "000001 stored"]
    assert put[0].startswith("rejected: none of its pixels are ")
    assert look == ["1", "000000 7 100.0", "000001 7 100.0"]
    assert tables == ["3 ['kept', 'kept', 'rejected']", "['7', '7', '8']"]
    assert awaited == ["['8']"]
    assert (runs[0], runs[-4]) == ("2", "done")
    assert runs[-3:] == ["{'car': 2}", *["kept -> rejected"] * 2]
    assert review == ["1"]
    assert quality == ["1 1", "1 ()"]
    assert export == ["town10.zip"]
