"""Starting and stopping the server as a process of its own."""

import errno
import json
import os
import socket
import stat
from contextlib import contextmanager

import pytest

from app.serve import listen
from tests.support import plain_http, without_locks
from tests.support.api import Api
from tests.support.command_line import CommandLine
from tests.support.data_folders import doctor_findings
from tests.support.servers import (
    running_server,
    start,
    stop,
    wait_for_link,
    wait_until_ready,
)
from tests.support.sources import CHECKOUT
from tests.support.waiting import until
from unghost import find_server


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    """A server that tests only look at, or that refuses to share what it uses."""
    with running_server(tmp_path_factory.mktemp("running") / "data") as server:
        yield server


@contextmanager
def first_start(words, data, log):
    """Start a process that serves a new data folder; gives the address.

    Unlike that of `running_server`, its service makes its database itself.
    """
    # A forked process of a module of the tests finds it by PYTHONPATH.
    process = start(words, data, log, {"PYTHONPATH": str(CHECKOUT)})
    try:
        yield wait_for_link(process, log).partition("/#")[0]
    finally:
        stop(process)


SQLITE_ALONE = "several servers may share PostgreSQL"
NOBODY = 65_534
"""The id of another user."""
AS_ROOT = pytest.mark.skipif(
    os.name == "nt" or os.geteuid() != 0, reason="only root can give files away"
)


def database_in(file):
    """The settings of a server whose SQLite database is this file."""
    return {"UNGHOST_DATABASE_URL": f"sqlite:///{file}"}


def entries_in(log):
    """The lines of a server's log, as far as they are complete."""
    return [json.loads(line) for line in log.read_text().split("\n")[:-1]]


def exit_code_of_failed_start(data, log, **settings):
    """Start a server that must fail to start; return its exit code."""
    with start(["app"], data, log, settings) as process:
        try:
            return process.wait(60)
        finally:
            stop(process)


def test_server_note_has_url_token_file_and_pid(running):
    port = running.url.rpartition(":")[2]
    state = running.data.with_name(f"{running.data.name}-state")
    note = state / "unghost" / "servers" / f"127.0.0.1_{port}.json"

    assert json.loads(note.read_text()) == {
        "url": running.url,
        "token_file": str(running.data / "token"),
        "pid": running.process.pid,
    }
    assert stat.S_IMODE(note.stat().st_mode) == 0o600


def test_find_server_finds_the_note_by_another_form_of_the_address(data_dir, tmp_path):
    with running_server(data_dir, {"UNGHOST_HOST": "0:0:0:0:0:0:0:1"}) as server:
        port = server.url.rpartition(":")[2]
        state = data_dir.with_name(f"{data_dir.name}-state")
        environ = {"HOME": str(tmp_path / "nobody"), "XDG_STATE_HOME": str(state)}
        server_note = find_server(f"http://[::1]:{port}", environ=environ)
        notes = list(state.rglob("*.json"))

    assert server_note.token == server.token
    assert len(notes) == 1
    assert list(state.rglob("*.json")) == [], "it is deleted at the shutdown"


@pytest.mark.sqlite_files(SQLITE_ALONE)
def test_second_server_of_a_data_folder_or_database_is_refused(running, tmp_path):
    """It names the address of the first, and what to do."""
    database, link = running.data / "unghost.db", tmp_path / "link.db"
    link.symlink_to(database)
    own = tmp_path / "own.db"
    same = running.url.rpartition(":")[2]
    starts = {
        "folder": (running.data, {"UNGHOST_PORT": same}),
        "database": (tmp_path / "second", database_in(link)),
        "folder with another database": (running.data, database_in(own)),
    }

    said = {}
    for name, (data, settings) in starts.items():
        assert exit_code_of_failed_start(data, tmp_path / name, **settings) == 1
        said[name] = (tmp_path / name).read_text()

    in_use = f"is in use by the server at {running.url}; use that one, or stop it first"
    of_folder = f"the data folder {str(running.data)!r} {in_use}"
    assert said["folder"] == f"{of_folder}. --data chooses another folder\n"
    assert said["database"] == (
        f"the database {str(database)!r} {in_use}. UNGHOST_DATABASE_URL chooses "
        "another database\n"
    )
    assert said["folder with another database"].startswith(of_folder)
    assert not own.exists()
    assert plain_http.get(f"{running.url}/healthz").status_code == 200


@pytest.mark.sqlite_files(SQLITE_ALONE)
def test_databases_of_two_servers_may_lie_in_one_folder(running, tmp_path):
    beside = database_in(running.data / "beside.db")
    with running_server(tmp_path / "second", beside) as second:
        wait_until_ready(second.url)


@pytest.mark.sqlite_files(SQLITE_ALONE)
def test_data_folder_without_locks_is_served_after_a_warning(data_dir, tmp_path):
    log = tmp_path / "log"
    words = [without_locks.__name__, "EOPNOTSUPP", "app"]
    with first_start(words, data_dir, log) as url:
        wait_until_ready(url)

    warnings = [
        entry["message"]
        for entry in entries_in(log)
        if entry["level"] == "warning" and "event loop" not in entry["message"]
    ]
    assert warnings == [
        f"the folder {str(data_dir)!r} cannot be locked "
        f"({os.strerror(errno.EOPNOTSUPP)}): a second server that uses it would "
        "not be refused, so start none"
    ]


@pytest.mark.sqlite_files(SQLITE_ALONE)
def test_demo_is_not_rendered_into_a_data_folder_in_use(running, tmp_path):
    unghost = CommandLine(tmp_path, {})

    result = unghost("demo", "--data", running.data, "--port", "0")

    assert result.code == 1
    assert f"is in use by the server at {running.url}" in result.err
    assert not (running.data / "demo").exists()


@pytest.mark.sqlite_files(SQLITE_ALONE)
def test_data_folder_of_a_killed_server_can_be_served_at_once(data_dir):
    with running_server(data_dir) as killed:
        api = Api.at(killed.url, killed.headers)
        with api.http:
            _, (box,) = api.dataset_of_cars(1)
            # A child process draws it, which must not hold the lock as well.
            assert api.get(f"/boxes/{box}/crop").status_code == 200
        killed.process.kill()
        killed.process.wait()

        with running_server(data_dir) as second:
            wait_until_ready(second.url)


def test_invalid_setting_or_a_data_folder_that_is_a_file_fails_with_one_line(tmp_path):
    setting, log = tmp_path / "setting", tmp_path / "log"
    (tmp_path / "data").write_text("not a folder")

    codes = [
        exit_code_of_failed_start(tmp_path / "new", setting, UNGHOST_PORT="many"),
        exit_code_of_failed_start(tmp_path / "data", log),
    ]

    assert codes == [2, 1]
    assert setting.read_text().startswith("UNGHOST_PORT: ")
    assert "many" not in setting.read_text()
    assert "File exists" in log.read_text()
    assert len(log.read_text().splitlines()) == 1


def foreign(path):
    """Give a file, a folder or a link to another user."""
    os.chown(path, NOBODY, NOBODY, follow_symlinks=False)


def everybodys(path):
    """Let everybody write to a file or a folder."""
    path.chmod(path.stat().st_mode | 0o002)


@pytest.mark.parametrize(
    ("name", "spoil", "fault", "remedy"),
    [
        pytest.param(
            "",
            foreign,
            f"the data folder {{path!r}} belongs to another user (uid {NOBODY})",
            "`chown -hR {me} {path}`",
            marks=AS_ROOT,
        ),
        pytest.param(
            "",
            everybodys,
            "everybody can write to the data folder {path!r}",
            "--data {path}/unghost-data",
        ),
        pytest.param(
            "token",
            foreign,
            f"the file {{path!r}} belongs to another user (uid {NOBODY})",
            "`chown -hR {me} {path}`",
            marks=AS_ROOT,
        ),
        pytest.param(
            "unghost.db",
            everybodys,
            "everybody can write to the file {path!r}",
            "`chmod o-w {path}`",
            marks=pytest.mark.sqlite_files("the database is a file of the folder"),
        ),
    ],
)
def test_data_folder_that_others_may_have_filled_is_refused(
    data_dir, tmp_path, name, spoil, fault, remedy
):
    """A planted database has tokens, and a planted link gets its target changed."""
    log, target = tmp_path / "log", tmp_path / "target"
    target.write_text("something else")
    target.chmod(0o644)
    (data_dir / "token").symlink_to(target)
    (data_dir / "unghost.db").touch(0o600)
    path = data_dir / name if name else data_dir
    spoil(path)

    code = exit_code_of_failed_start(data_dir, log)

    words = {"path": str(path), "me": os.geteuid()}
    assert code == 1
    assert log.read_text().startswith(fault.format_map(words))
    assert remedy.format_map(words) in log.read_text()
    assert len(log.read_text().splitlines()) == 1
    assert {each.name for each in data_dir.iterdir()} == {"token", "unghost.db"}
    assert stat.S_IMODE(target.stat().st_mode) == 0o644


def test_new_data_folder_in_a_folder_of_everybody_is_private(data_dir, tmp_path):
    data_dir.chmod(0o1777)  # as /tmp
    log = tmp_path / "log"

    code = exit_code_of_failed_start(data_dir, log)

    new = data_dir / "unghost-data"
    assert code == 1
    assert f"--data {new}" in log.read_text()
    assert "chmod" not in log.read_text()
    with first_start(["app"], new, tmp_path / "again.log"):
        assert stat.S_IMODE(new.stat().st_mode) == 0o700


@pytest.mark.sqlite_files("the database is a file of the folder")
def test_invalid_database_file_fails_with_a_message(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "unghost.db").write_bytes(b"not a database" * 100)
    log = tmp_path / "log"

    code = exit_code_of_failed_start(tmp_path / "data", log)

    assert code == 1
    assert "file is not a database" in log.read_text()
    said = log.read_text().splitlines()[-1]
    assert said.startswith("the service could not start")
    assert said.endswith("`unghost doctor` says more")
    assert "database" in doctor_findings(tmp_path / "data")


@pytest.mark.sqlite_files(SQLITE_ALONE)
def test_of_two_servers_started_together_one_is_refused(tmp_path):
    data, logs = tmp_path / "data", [tmp_path / "log0", tmp_path / "log1"]
    processes = [start(["app"], data, log, {}) for log in logs]

    refused = until(lambda: [n for n in (0, 1) if processes[n].poll() is not None])
    try:
        wait_for_link(processes[1 - refused[0]], logs[1 - refused[0]])
    finally:
        for process in processes:
            stop(process)

    assert sorted(process.wait() for process in processes) == [0, 1]
    assert "is in use by" in logs[refused[0]].read_text()


def test_token_is_not_logged_and_a_line_break_in_a_path_is_escaped(running):
    plain_http.get(f"{running.url}/version?token={running.token}")
    plain_http.get(f"{running.url}/version", headers=running.headers)
    plain_http.get(f"{running.url}/a%0A2026-01-01%20forged%1b[2J")

    escaped = "/a\\u000a2026-01-01 forged\\u001b[2J"
    until(lambda: escaped in [entry.get("path") for entry in entries_in(running.log)])
    until(lambda: running.log.read_text().count("GET /version ") == 2)
    assert running.token not in running.log.read_text()


@pytest.mark.sqlite_files("the database is a file of the folder")
def test_data_files_are_private_even_in_a_world_readable_folder(data_dir, tmp_path):
    data_dir.chmod(0o775)  # the group may write, as to a volume of Kubernetes
    with first_start(["app"], data_dir, tmp_path / "log") as url:
        plain_http.get(f"{url}/readyz")
        modes = {
            path.name: stat.S_IMODE(path.stat().st_mode) for path in data_dir.iterdir()
        }
    (data_dir / "unghost.db").chmod(0o644)  # the mode that older versions gave it
    with running_server(data_dir):
        again = stat.S_IMODE((data_dir / "unghost.db").stat().st_mode)

    private = {0o600, 0o700}
    assert {"unghost.db", "unghost.db-wal", "token", "blobs"} <= modes.keys()
    assert {name for name, mode in modes.items() if mode not in private} == set()
    assert again == 0o600


def test_listening_socket_is_declared_as_tcp_for_no_delay():
    """asyncio turns Nagle's algorithm off only on sockets that are declared as TCP."""
    with listen("127.0.0.1", 0) as listener:
        assert listener.proto == socket.IPPROTO_TCP
