"""Lists, tables, datasets and stored servers on the command line."""

import csv
import io
import json
import re

import pyarrow.parquet
import pytest

from tests.support import frames
from tests.support.command_line import CommandLine
from tests.support.frames import write_manifest
from tests.support.receiver import receiving
from tests.support.waiting import until
from unghost import Client, Invalid

NAME = "lists"


@pytest.fixture(scope="module")
def dataset(server):
    with Client(server.url, server.token) as client:
        client.create_dataset(NAME, classes=["car"])
        for number in range(3):
            frames.put(client, NAME, f"run/{number:06}", number)
        client.add_config(NAME, {"threshold_small_box": 99.5})
        client.wait(client.set_config(NAME, {"threshold_small_box": 99.5}))
    return NAME


def test_boxes_are_written_as_csv_json_and_parquet(unghost, dataset, tmp_path):
    filters = (
        "--verdict",
        "rejected",
        "--map",
        "Town10HD",
        "--fields",
        "frame,box,toss_up",
    )
    text = unghost("boxes", dataset, *filters)
    lines = unghost("boxes", dataset, *filters, "--format", "json").records
    saved = unghost("boxes", dataset, "-o", tmp_path / "a.parquet")
    table = pyarrow.parquet.read_table(tmp_path / "a.parquet")

    rows = list(csv.DictReader(io.StringIO(text.out)))
    expected = [f"run/{number:06}" for number in range(3)]
    assert rows == [
        {"frame": key, "box": "ghost", "toss_up": "false"} for key in expected
    ]
    assert lines == [
        {"frame": key, "box": "ghost", "toss_up": False} for key in expected
    ]
    assert saved.err.splitlines()[-1].startswith("6 boxes in ")
    assert table["box"].to_pylist() == ["real", "ghost"] * 3
    assert unghost("boxes", dataset, "--format", "parquet").code == 1


def test_frames_problems_and_runs_are_listed(unghost, dataset, server):
    with Client(server.url, server.token) as client, pytest.raises(Invalid):
        client.put_frame(dataset, "bad", {"boxes": [{"class": "car"}]})
    listed = unghost("frames", dataset, "--key", "run/", "--json").records
    refused = unghost("problems", dataset).out
    runs = unghost("runs", dataset, "--state", "done", "--json").records
    all_runs = unghost("runs", "--json").records

    assert [frame["key"] for frame in listed] == [
        f"run/{number:06}" for number in range(3)
    ]
    assert refused.startswith("bad\t")
    assert [run["state"] for run in runs] == ["done", "done"]
    assert {run["id"] for run in runs} <= {run["id"] for run in all_runs}


def test_lists_end_where_asked_for(unghost, server):
    name = "limited"
    with Client(server.url, server.token) as client:
        client.create_dataset(name, classes=["car"])
        for number in range(3):
            frames.put(client, name, f"{number}", number)
            with pytest.raises(Invalid):
                client.put_frame(name, f"bad-{number}", {"boxes": [{"class": "car"}]})
            client.wait(client.set_config(name, {"threshold_small_box": 90 + number}))

    def listed(limit: int) -> list[int]:
        words = (name, "--limit", limit, "--json")
        commands = ("boxes", "frames", "problems", "runs")
        return [len(unghost(command, *words).records) for command in commands]

    assert listed(1) == [1, 1, 1, 1]
    # A run when the dataset was created, and one for each configuration.
    assert listed(0) == [6, 3, 3, 4]


def test_datasets_are_created_shown_edited_and_deleted(unghost):
    name = "by-hand"
    made = unghost("dataset", "create", name, "--classes", "car,van")
    again = unghost("dataset", "create", name)
    kept = unghost("dataset", "create", name, "--exist-ok", "--json").records
    edited = unghost(
        "dataset", "edit", name, "--description", "rain", "--palette", "carla-0.9.14"
    )
    shown = unghost("dataset", "show", name).out.splitlines()
    misspelt = unghost("dataset", "show", "by-hnd")
    unconfirmed = unghost("dataset", "delete", name)
    deleted = unghost("dataset", "delete", name, "--yes")

    assert made.out == f"{name}: car, van\n"
    (created_at,) = [line for line in shown if line.startswith("created at")]
    assert re.fullmatch(r"created at\t[\d-]{10} [\d:]{8}\+00:00", created_at)
    assert (again.code, kept[0]["classes"]) == (1, ["car", "van"])
    assert edited.code == 0, edited.err
    assert {"description\train", "palette\tcarla-0.9.14", "frames\t0"} <= set(shown)
    assert "there is no dataset 'by-hnd'; did you mean 'by-hand'?" in misspelt.err
    assert (unconfirmed.code, "--yes" in unconfirmed.err) == (1, True)
    assert deleted.err.endswith("deleted\n")
    assert unghost("dataset", "show", name).code == 1


def test_push_tries_without_storing_and_refuses_unknown_classes(unghost, tmp_path):
    folder = write_manifest(tmp_path / "recording", 2)
    push = ("push", folder, "--dataset", "tried")
    before = unghost(*push, "--dry-run")
    nothing = unghost("dataset", "show", "tried")
    stored = unghost(*push)
    after = unghost(*push, "--dry-run", "--json").records

    assert before.out.startswith("tried (would be created): 2 frames would be sent")
    assert (nothing.code, stored.code) == (1, 0)
    numbers = {"new": 0, "there": 2, "different": 0, "unreadable": 0}
    assert after == [{"dataset": "tried", **numbers}]

    manifest = folder / "manifest.jsonl"
    manifest.write_text(manifest.read_text().replace('"car"', '"spaceship"', 1))
    strict = unghost("push", folder, "--dataset", "strict", "--strict-classes")
    assert strict.code == 1
    assert "found spaceship (1)" in strict.err
    assert unghost("dataset", "show", "strict").code == 1


def test_server_and_token_are_stored_shown_used_and_forgotten(bare_unghost, server):
    login = ("auth", "login", "--server", server.url)
    wrong = bare_unghost(*login, "--token", "unghost_wrong")
    right = bare_unghost(*login, "--token", server.token, "--json")
    status = bare_unghost("auth", "status")
    used = bare_unghost("dataset", "list")
    file = bare_unghost.folder / "state/unghost/auth.json"
    mode = file.stat().st_mode & 0o777
    forgotten = bare_unghost("auth", "logout")

    assert wrong.code == 1
    assert right.records[0]["server"] == server.url
    assert status.out == f"{server.url} *\tadmin\tadmin\tworks\n"
    assert (used.code, mode) == (0, 0o600)
    assert server.token not in right.out + right.err + status.out
    assert forgotten.code == 0
    assert json.loads(file.read_text()) == {"default": None, "servers": {}}
    assert bare_unghost("auth", "status").code == 1


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        ("unghost stats li", {NAME}),
        (
            "unghost export lists --format de",
            {"decisions-csv", "decisions-jsonl", "decisions-parquet"},
        ),
        ("unghost push . --layout ca", {"carlasimu"}),
        ("unghost data", {"dataset"}),
    ],
)
def test_shells_complete_names_formats_and_layouts(unghost, dataset, typed, words):
    environ = {
        "_UNGHOST_COMPLETE": "complete_bash",
        "COMP_WORDS": typed,
        "COMP_CWORD": str(len(typed.split()) - 1),
    }
    shell = CommandLine(unghost.folder, {**unghost.settings, **environ})

    # A shell is not kept waiting for a busy server: it gets no names.
    until(lambda: words <= {row.split(",")[-1] for row in shell().out.splitlines()})


def test_hooks_are_created_tried_listed_and_deleted(unghost, dataset):
    with receiving() as receiver:
        made = unghost("hook", "create", receiver.url, "--dataset", dataset)
        number = made.err.split()[1].rstrip(":")
        tried = unghost("hook", "ping", number)
        receiver.statuses = [500]
        failed = unghost("hook", "ping", number)
    listed = unghost("hook", "list").out
    log = unghost("hook", "deliveries", number, "--json").records
    deleted = unghost("hook", "delete", number)
    elsewhere = unghost("hook", "create", "https://ci.example.org/")

    assert made.out.startswith("whsec_")
    assert receiver.received[0].is_signed_with(made.out.strip())
    assert tried.out == f"hook {number}: status 200\n"
    assert (failed.code, "the receiver responded with 500" in failed.err) == (1, True)
    assert f"{number}\t{receiver.url}\t" in listed
    assert [delivery["state"] for delivery in log] == ["waiting", "delivered"]
    assert deleted.code == 0
    assert (elsewhere.code, "UNGHOST_HOOK_HOSTS" in elsewhere.err) == (1, True)
