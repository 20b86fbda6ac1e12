"""If server or client are killed during a push, no frame reported as stored is lost.

Not part of every test run; ``make test-long`` does fifty rounds (KILL_ROUNDS).
"""

import hashlib
import json
import os
import random
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.support import plain_http
from tests.support.command_line import CommandLine
from tests.support.databases import problems_of
from tests.support.frames import write_manifest
from tests.support.servers import RunningServer, running_server
from unghost import Client, OutgoingFrame

pytestmark = pytest.mark.long

ROUNDS = int(os.environ.get("KILL_ROUNDS", "1"))
SEED = int(os.environ.get("KILL_SEED", str(random.SystemRandom().randrange(10**6))))
FRAMES = 80
DONE, UNAVAILABLE = 0, 69
VICTIMS = ("client", "server", "server that comes back", "both")


@pytest.fixture(scope="module")
def push_folder(tmp_path_factory) -> Path:
    """A folder with the frames to push; the server's data folder is created in it."""
    folder: Path = tmp_path_factory.mktemp("killed")
    write_manifest(folder / "frames", FRAMES)
    return folder


@contextmanager
def served(push_folder: Path, port: int = 0) -> Iterator[RunningServer]:
    settings = {"UNGHOST_LOG_LEVEL": "warning", "UNGHOST_PORT": str(port)}
    with running_server(push_folder / "data", settings) as server:
        yield server


def command_line(push_folder: Path, server: RunningServer) -> CommandLine:
    return CommandLine(
        push_folder, {"UNGHOST_SERVER": server.url, "UNGHOST_TOKEN": server.token}
    )


def test_acknowledged_frames_survive_a_kill_of_client_or_server_during_push(
    push_folder,
):
    print(f"KILL_SEED={SEED}")
    dice = random.Random(SEED)
    expected = digests(push_folder)

    for number in range(ROUNDS):
        dataset = f"round-{number}"
        # Taken in turn, so that four rounds have each kind of death.
        victim = VICTIMS[(SEED + number) % len(VICTIMS)]
        acknowledged = push_and_kill(push_folder, dataset, victim, dice)
        with served(push_folder) as server, Client(server.url, server.token) as client:
            stored = check_stored_frames(push_folder, client, dataset, expected)
            assert set(acknowledged) <= set(stored), (number, victim)
            again = command_line(push_folder, server)(
                "push", "frames", "--dataset", dataset, "--json"
            )
            check_complete(client, dataset, again, (expected, stored))
        assert problems_of(push_folder / "data") == []


def push_and_kill(push_folder, dataset, victim, dice) -> list[str]:
    """Begin a push and kill the client, the server or both.

    Returns the keys that the client has reported as stored or already there.
    """
    with served(push_folder) as server:
        words = ("push", "frames", "--dataset", dataset, "--json")
        with command_line(push_folder, server).running(*words) as client:
            assert client.stdout is not None
            told = [client.stdout.readline() for _ in range(dice.randrange(FRAMES))]
            time.sleep(dice.uniform(0, dice.choice([0.02, 1.5])))
            if victim in ("client", "both"):
                client.kill()
            if victim != "client":
                server.process.kill()
                server.process.wait()
            if victim == "server that comes back":
                port = int(server.url.rpartition(":")[2])
                with served(push_folder, port):
                    told += client.stdout.readlines()
            else:
                told += client.stdout.readlines()
            code = client.wait()
    assert code in (DONE, UNAVAILABLE, -9), victim
    return list(reported_keys(told))


def reported_keys(lines: list[str]) -> Iterator[str]:
    """Keys that are reported as stored or already there; a cut-off line is skipped."""
    for line in lines:
        if line.endswith("\n"):
            record = json.loads(line)
            if record.get("outcome") in ("stored", "already_there"):
                yield record["key"]


def digests(push_folder: Path) -> dict[str, str]:
    """The digest of each frame, as documented, by its key."""
    digests_by_key = {}
    for line in (push_folder / "frames" / "manifest.jsonl").read_text().splitlines():
        frame = json.loads(line)
        files = {
            name: push_folder / "frames" / frame.pop(name)
            for name in ("image", "segmentation")
        }
        key = frame.pop("key")
        digests_by_key[key] = OutgoingFrame(key, frame, files).digest()
    return digests_by_key


def check_stored_frames(push_folder, client, dataset, expected) -> list[str]:
    """Check that stored frames have all bytes and decisions; returns their keys."""
    if dataset not in [each.name for each in client.datasets()]:
        return []
    stored = []
    for listed in client.frames(dataset):
        frame = client.frame(listed.id)
        assert {box.verdict for box in frame.boxes} == {"kept", "rejected"}
        lines = ["frame 1"]
        for name in sorted(frame.files):
            content = client.frame_file(frame.id, name)
            lines.append(f"{name} {hashlib.sha256(content).hexdigest()}")
            assert frame.files[name].sha256 == lines[-1].partition(" ")[2]
        assert sorted(frame.files) == ["image", "segmentation"]
        stored.append(frame.key)
    assert known(client, dataset, stored) == {key: expected[key] for key in stored}
    return stored


def known(client: Client, dataset: str, keys: list[str]) -> dict[str, str]:
    """The digests that the server returns for these frames, by key."""
    response = plain_http.post(
        f"{client.url}/api/v1/datasets/{dataset}/known-frames",
        json={"keys": keys},
        headers={"Authorization": f"Bearer {client.token}"},
    )
    return {item["key"]: item["digest"] for item in response.json()["items"]}


def check_complete(client, dataset, again, before) -> None:
    """Check that the second push sent only what was missing, and that all is stored."""
    expected, stored = before
    assert again.code == DONE, again.err
    summary = again.records[-1]
    assert summary["already_there"] == len(stored)
    assert summary["stored"] == FRAMES - len(stored)
    stats = client.stats(dataset)
    assert (stats.frames, stats.kept, stats.rejected) == (FRAMES, FRAMES, FRAMES)
    assert known(client, dataset, list(expected)) == expected
    assert list(client.problems(dataset)) == []
