"""Tokens and the audit log on the command line, with a server of its own."""

from datetime import datetime, timedelta, timezone

import pytest

from tests.support.command_line import CommandLine
from tests.support.servers import running_server
from unghost import Client

pytestmark = pytest.mark.long

DONE, REFUSED, USAGE = 0, 1, 2


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    """A server of this module's own."""
    folder = tmp_path_factory.mktemp("machine")
    with running_server(folder / "data") as server:
        yield server


@pytest.fixture
def unghost(machine, tmp_path):
    """The command line without a token: it finds the note that the server left."""
    state = {
        "XDG_STATE_HOME": str(machine.data.with_name(f"{machine.data.name}-state"))
    }
    return CommandLine(tmp_path, {"UNGHOST_SERVER": machine.url, **state})


def test_created_token_is_printed_once_and_authenticates(unghost, machine):
    made = unghost("token", "create", "ada")

    token = made.out.strip()
    assert (made.code, token[:3], len(token)) == (DONE, "ug_", 46)
    assert "'ada', reviewer, until " in made.err
    assert token not in made.err
    assert token not in unghost("token", "list", "--json").out
    with Client(machine.url, token) as ada:
        assert (ada.session().name, ada.session().role) == ("ada", "reviewer")


def test_token_create_sets_role_and_expiry(unghost):
    words = ("token", "create", "guest", "--role", "viewer", "--days", 7, "--json")

    (record,) = unghost(*words).records

    until = datetime.fromisoformat(record["expires_at"].replace("Z", "+00:00"))
    left = until - datetime.now(timezone.utc)
    assert record["role"] == "viewer"
    assert timedelta(days=6, hours=23) < left <= timedelta(days=7)


def test_token_list_shows_every_token_and_its_state(unghost):
    unghost("token", "create", "listed", "--days", 1)
    unghost("token", "create", "gone")
    unghost("token", "revoke", "gone")

    rows = [line.split("\t") for line in unghost("token", "list").out.splitlines()]

    states = {name: (role, state) for _, name, role, _, _, _, state in rows}
    assert states["admin"] == ("admin", "valid")
    assert states["listed"] == ("reviewer", "valid")
    assert states["gone"] == ("reviewer", "revoked")


@pytest.mark.parametrize("by", ["name", "number"])
def test_revoked_token_is_refused(unghost, by):
    (made,) = unghost("token", "create", f"by-{by}", "--json").records
    which = made["name"] if by == "name" else made["id"]

    revoked = unghost("token", "revoke", which)

    assert (revoked.code, revoked.out.split("\t")[-1].strip()) == (DONE, "revoked")
    refused = unghost("dataset", "list", "--token", made["token"])
    assert (refused.code, "token_revoked" in refused.err) == (REFUSED, True)


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["create", "admin"], REFUSED, "a token named 'admin' exists already"),
        (["create", "kim", "--days", "-1"], USAGE, "--days"),
        (["create", "kim", "--role", "owner"], USAGE, "--role"),
        (["create", "kim", "--data", "here"], USAGE, "--data is for --offline"),
        (
            ["create", "kim", "--offline", "--server", "http://127.0.0.1:1"],
            USAGE,
            "--server is not for --offline",
        ),
        (["create", "kim", "--offline", "--token", "ug_x"], USAGE, "--token is not"),
        (["revoke", "nobody"], REFUSED, "there is no token 'nobody'; `unghost tok"),
        (["revoke", "admni"], REFUSED, "there is no token 'admni'; the nearest is 'ad"),
        (["revoke", "admin"], REFUSED, "the last one of an admin"),
    ],
)
def test_failed_token_command_prints_the_reason(unghost, words, code, said):
    result = unghost("token", *words)

    assert result.code == code
    assert said in result.err
    assert "Traceback" not in result.err


def test_token_and_audit_commands_need_the_role_admin(unghost):
    token = unghost("token", "create", "curious").out.strip()

    results = [
        unghost("token", "list", "--token", token),
        unghost("token", "create", "more", "--token", token),
        unghost("audit", "--token", token),
    ]

    assert {result.code for result in results} == {REFUSED}
    assert all("needs the role admin" in result.err for result in results)


def test_audit_command_lists_actor_action_and_subject(unghost):
    unghost("token", "create", "watched", "--role", "viewer")
    unghost("token", "revoke", "watched")

    plain, records = unghost("audit", "--limit", 2), unghost("audit", "--json").records

    cells = [line.split("\t")[1:4] for line in plain.out.splitlines()]
    assert cells == [
        ["admin", "token.revoked", "watched"],
        ["admin", "token.created", "watched"],
    ]
    assert [record["action"] for record in records[:2]] == [
        "token.revoked",
        "token.created",
    ]
    assert "ug_" not in plain.out
