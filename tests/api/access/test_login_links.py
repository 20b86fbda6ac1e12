"""Login links of the command line: each works once and no other user can see it."""

import json
import os
import signal
import stat
import sys
from pathlib import Path

import pytest

from tests.support import plain_http
from tests.support.command_line import CommandLine
from tests.support.page.windows import ARGUMENTS
from tests.support.servers import running_server, token_of
from tests.support.waiting import until
from tools.ensure_chromium import system_chromium
from unghost import Client

DONE, REFUSED = 0, 1
PATIENCE_S = 60
BROWSER = """#!/bin/sh
# Notes what it was given, and shows it in a browser.
echo "$1" > "{notes}/address"
cp -p "${{1#file://}}" "{notes}/page"
"{python}" -c "{in_own_group}" \
    "{chromium}" {arguments} --headless=new --user-data-dir="{notes}/profile" "$1" \
    > /dev/null 2>&1 &
echo $! > "{notes}/pid"
"""
IN_OWN_GROUP = "import os, sys; os.setsid(); os.execv(sys.argv[1], sys.argv[1:])"


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    """A server, and the command line on the same machine."""
    folder = tmp_path_factory.mktemp("machine")
    with running_server(folder / "data") as server:
        state = server.data.with_name(f"{server.data.name}-state")
        settings = {"UNGHOST_SERVER": server.url, "XDG_STATE_HOME": str(state)}
        yield server, CommandLine(folder, settings)


@pytest.fixture
def browser(tmp_path):
    """A program that opens a page in Chromium and notes what it was given."""
    chromium = system_chromium()
    if chromium is None:
        pytest.skip("there is no Chromium here")
    notes = tmp_path / "notes"
    notes.mkdir()
    program = notes / "browser"
    arguments = " ".join(ARGUMENTS)
    program.write_text(
        BROWSER.format(
            notes=notes,
            python=sys.executable,
            in_own_group=IN_OWN_GROUP,
            chromium=chromium,
            arguments=arguments,
        )
    )
    program.chmod(0o700)
    yield program
    if (notes / "address").exists():
        until(lambda: (notes / "pid").exists() and (notes / "pid").read_text())
        # Debian's chromium is a script: the browser is a child of what was started.
        os.killpg(int((notes / "pid").read_text()), signal.SIGKILL)


def first_line(process):
    """The line that the service prints when it is ready."""
    return process.stdout.readline()


def process_arguments_and_environments():
    """Arguments and environment of every process, as far as they can be read."""
    content = b""
    for process in Path("/proc").glob("[0-9]*"):
        for name in ("cmdline", "environ"):
            try:
                content += (process / name).read_bytes()
            except OSError:  # the process has ended meanwhile
                continue
    return content


def test_login_prints_a_link_that_works_once(machine):
    server, unghost = machine

    result = unghost("login")

    url, _, code = result.out.strip().partition("/#code=")
    assert (result.code, url) == (DONE, server.url)
    assert server.token not in result.out
    session = f"{url}/api/v1/session"
    opened = [
        plain_http.post(session, json={"code": code}).status_code for _ in range(2)
    ]
    assert opened == [201, 401]


def test_login_finds_the_one_server_that_runs_on_this_machine(machine):
    server, unghost = machine
    state = unghost.settings["XDG_STATE_HOME"]
    unnamed = CommandLine(unghost.folder, {"XDG_STATE_HOME": state})

    result = unnamed("login")
    other = unnamed(
        "dataset", "list", "--server", "http://127.0.0.1:1", "--retry-for", 0
    )

    assert (result.code, result.out.partition("/#code=")[0]) == (DONE, server.url)
    assert f"the server at {server.url} (--server: another)" in result.err
    assert f"On this machine runs {server.url}." in other.err


def test_login_link_belongs_to_the_given_token(machine):
    server, unghost = machine
    with Client(server.url, server.token) as admin:
        token = admin.create_token("bo", "viewer").token

    (record,) = unghost("login", "--token", token, "--json").records

    opened = plain_http.post(
        f"{server.url}/api/v1/session", json={"code": record["code"]}
    )
    assert record["login_link"] == f"{server.url}/#code={record['code']}"
    assert (opened.json()["name"], opened.json()["role"]) == ("bo", "viewer")


def test_login_without_a_token_fails_with_a_message(machine, tmp_path):
    server, _ = machine
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()

    result = CommandLine(elsewhere, {"UNGHOST_SERVER": server.url})("login")

    assert (result.code, result.out) == (REFUSED, "")
    assert "token" in result.err


def logins_by_code(server_url, token):
    with Client(server_url, token) as admin:
        acts = [(entry.action, entry.details) for entry in admin.audit()]
    return acts.count(("session.opened", {"by": "code"}))


def test_serve_open_leaks_no_secret_to_processes_and_leaves_no_file(tmp_path, browser):
    """Every user can see the arguments of a browser, so they must hold no secret."""
    unghost = CommandLine(tmp_path, {"BROWSER": str(browser)}, anew=True)
    notes = browser.parent

    with unghost.running(
        "serve", "--data", "here", "--port", "0", "--json", "--open"
    ) as process:
        url, _, printed = json.loads(first_line(process))["login_link"].partition(
            "/#code="
        )
        token = token_of(tmp_path / "here")
        until(lambda: (notes / "pid").exists())
        listed = process_arguments_and_environments()
        until(lambda: logins_by_code(url, token))
        listed += process_arguments_and_environments()
        page = Path((notes / "address").read_text().strip().removeprefix("file://"))
        until(lambda: not page.exists())
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE_S)

    handed_over = (notes / "page").read_text()
    assert process.returncode == DONE
    assert page.parent == tmp_path / "here"
    assert stat.S_IMODE((notes / "page").stat().st_mode) == 0o600
    assert printed in handed_over
    for secret in (token, printed):
        assert secret.encode() not in listed
    assert list((tmp_path / "here").glob("login-*")) == []


def test_serve_open_without_a_browser_leaves_no_file_and_removes_a_stale_one(tmp_path):
    unghost = CommandLine(tmp_path, {"BROWSER": "no-such-browser", "PATH": ""})
    (tmp_path / "here").mkdir(mode=0o700)
    left = tmp_path / "here" / "login-left.html"
    left.write_text("a code that is over")

    with unghost.running(
        "serve", "--data", "here", "--port", "0", "--json", "--open"
    ) as process:
        assert first_line(process)
        assert not left.exists()
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE_S)

    assert process.returncode == DONE
    assert list((tmp_path / "here").glob("login-*")) == []


def test_login_open_starts_the_browser_and_exits_once_link_is_used(machine, browser):
    server, unghost = machine
    settings = {**unghost.settings, "BROWSER": str(browser)}
    before = logins_by_code(server.url, server.token)

    result = CommandLine(unghost.folder, settings)("login", "--open")

    notes = browser.parent
    page = Path((notes / "address").read_text().strip().removeprefix("file://"))
    assert (result.code, result.out) == (DONE, "")
    assert "#code=uc_" in (notes / "page").read_text()
    assert stat.S_IMODE((notes / "page").stat().st_mode) == 0o600
    assert not page.exists()
    assert logins_by_code(server.url, server.token) == before + 1
