"""Each expected error has an exit code and a message; only bugs have a traceback."""

import json
import logging
import os

import pytest
from typer.testing import CliRunner

from filter_core.errors import LayoutError
from tests.support import response_checks
from tests.support.frames import write_manifest
from tests.support.scripted_server import json_reply, problem
from unghost import wire
from unghost.capture.simulator import ScenarioError, SimulatorAway
from unghost.cli.program import OneLine, app, error_lines, exit_code
from unghost.cli.screen import EXIT_CODES, Refused
from unghost.client import errors
from unghost.client.discovery import BadServerUrl, ForeignServer

ADDRESS = "http://127.0.0.1:8000"
TOWN = {
    **response_checks.DATASET,
    "description": "",
    "classes_frozen": True,
    "has_ignore_mask": False,
    "thumbnail_frame_id": None,
    "counts": dict.fromkeys(wire.DatasetCounts.model_fields, 0),
}
"""A dataset, as the server describes it."""
VERSION = {
    "digest": "0" * 64,
    "config": {},
    "unused_keys": [],
    "created_by": "ada",
    "created_at": "2026-01-01T00:00:00Z",
    "active": True,
}
"""A version of a configuration, as the server describes it."""
PROBLEM = {
    "code": "bad_annotation",
    "detail": "two faults",
    "request_id": "r1",
    "errors": [{"pointer": "/boxes/0", "code": "x", "detail": "is wrong"}],
}


@pytest.mark.parametrize(
    ("error", "code"),
    [
        pytest.param(errors.NotFound(404, PROBLEM), 1, id="refused by the server"),
        pytest.param(LayoutError("no layout"), 1, id="refused by the library"),
        pytest.param(errors.RunFailed("run 1 is failed"), 1, id="work that failed"),
        pytest.param(Refused("no"), 1, id="refused by the command"),
        pytest.param(FileNotFoundError("a"), 1, id="a file that is not there"),
        pytest.param(ForeignServer("x"), 1, id="a token kept from another's server"),
        pytest.param(BadServerUrl("x"), 2, id="a wrong address"),
        pytest.param(errors.InvalidName("x"), 2, id="a name that is no address"),
        pytest.param(errors.NoResponse(ADDRESS, "no", sent=False), 69, id="no answer"),
        pytest.param(errors.Unavailable(503, PROBLEM), 69, id="no answer for now"),
        pytest.param(SimulatorAway("no"), 69, id="no simulator"),
        pytest.param(ScenarioError("no"), 1, id="a wrong scenario"),
        pytest.param(KeyError("x"), None, id="a bug"),
    ],
)
def test_each_expected_error_has_an_exit_code(error, code):
    assert exit_code(error) == code


@pytest.mark.parametrize(
    ("variable", "origin"),
    [
        (None, "This address is the default"),
        ("", "This address is the default"),
        ("http://127.0.0.1:8000/", "This address is from UNGHOST_SERVER"),
        ("http://127.0.0.1:8001", "This address is from --server"),
        ("http://a:x", "This address is from --server"),
    ],
)
def test_connection_error_message_names_address_and_its_origin(
    monkeypatch, tmp_path, variable, origin
):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))  # no server runs
    monkeypatch.delenv("UNGHOST_SERVER", raising=False)
    if variable is not None:
        monkeypatch.setenv("UNGHOST_SERVER", variable)

    lines = list(error_lines(errors.NoResponse(ADDRESS, "refused", sent=False)))

    assert lines == [
        "no response from http://127.0.0.1:8000: refused",
        f"{origin}; --server URL or UNGHOST_SERVER selects another.",
        "Is the server running? `unghost serve` starts one.",
    ]


SINGLE = [{"pointer": "/name", "code": "x", "detail": "expected a text"}]


REFUSALS = {
    "all faults, and how many are not listed": (
        {"more_errors": 2400},
        ["two faults (bad_annotation)", "  /boxes/0: is wrong", "  and 2400 more"],
    ),
    "a single fault once": (
        {"detail": "/name: expected a text", "errors": SINGLE},
        ["/name: expected a text (bad_annotation)"],
    ),
    "control characters that would look like another line": (
        {"detail": "no\n\x1b[2Junghost: done", "errors": []},
        [r"no\u000a\u001b[2Junghost: done (bad_annotation)"],
    ),
}


@pytest.mark.parametrize(("changed", "lines"), REFUSALS.values(), ids=REFUSALS)
def test_message_of_a_refused_request_has_its_faults(changed, lines):
    assert list(error_lines(errors.Invalid(422, {**PROBLEM, **changed}))) == lines


def test_message_has_the_origins_of_tokens_or_the_id_of_a_failed_request():
    *_, hint = error_lines(errors.Unauthorized(401, PROBLEM))

    assert "--token, UNGHOST_TOKEN, `unghost auth login`, or the data" in hint
    assert "r1" in list(error_lines(errors.ServerFault(500, PROBLEM)))[-1]


def test_help_lists_all_exit_codes():
    shown = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "300"}).output

    _, _, told = shown.partition("Exit codes: ")
    assert [int(text.split()[0]) for text in told.split("; ")] == list(EXIT_CODES)


def run(server, *words):
    place = ("--server", server.url, "--token", "secret")
    return CliRunner().invoke(app, [*map(str, words), *place])


def test_settings_of_an_empty_dataset_that_cannot_be_changed_are_named(
    scripted, tmp_path
):
    write_manifest(tmp_path / "frames", 1)
    replies = [json_reply(VERSION), *[json_reply(TOWN)] * 2, problem(409, "run_open")]
    scripted.answer(*replies)

    option = ("--lossy-segmentation", "nearest")
    result = run(scripted, "push", tmp_path / "frames", "--dataset", "town", *option)

    assert result.exit_code == 1
    assert str(result.exception or result.output).startswith(
        "lossy_segmentation of dataset 'town' cannot be changed: it is run_open"
    )


def test_control_characters_about_a_wrong_option_are_escaped(scripted, tmp_path):
    fault = {"pointer": "/options/split", "code": "x", "detail": "no \x1b[2J"}
    refused = problem(422, "bad_options", errors=[fault])
    scripted.answer(json_reply(TOWN), refused)

    result = CliRunner().invoke(
        app,
        [
            *("export", "town", "--format", "yolo", "-o", str(tmp_path / "x.zip")),
            *("--server", scripted.url, "--token", "secret"),
        ],
    )

    assert result.exit_code == 2
    assert r"no \u001b[2J" in result.output


def test_waiting_for_a_server_names_those_that_run_here(tmp_path, monkeypatch):
    notes = tmp_path / "unghost" / "servers"
    notes.mkdir(parents=True)
    url = "http://127.0.0.1:8123"
    (notes / "a.json").write_text(json.dumps({"url": url, "pid": os.getpid()}))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    away = errors.NoResponse("http://127.0.0.1:8000", "refused", sent=False)
    line = logging.LogRecord("n", 30, "", 0, "%s; trying again", (away,), None)

    assert OneLine().format(line) == (
        "no response from http://127.0.0.1:8000: refused; trying again. "
        f"On this machine runs {url}: --server selects it"
    )
