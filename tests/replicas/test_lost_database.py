"""The database server is killed, restarted or unreachable while requests are made.

What was acknowledged is stored, and everything else gets an error to retry.
"""

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import httpx
import pytest

from tests.support import frames as scene
from tests.support.api import BASE, FINISHED, Api
from tests.support.archives import frame, lines_of, send, tar_archive
from tests.support.event_reader import open_events
from tests.support.postgres_cluster import Cluster, own_cluster
from tests.support.servers import RunningServer, running_server
from tests.support.slow_datasets import OTHER_PIXELS, create_slow_dataset
from tests.support.waiting import until

LONG = pytest.mark.long
FRAMES = 60
EXPECTED_STATUSES = {200, 201, 202, 412}


@dataclass(frozen=True)
class ClusterAndServer:
    """A PostgreSQL cluster, the only server that uses it, and a client of an admin."""

    cluster: Cluster
    server: RunningServer
    api: Api


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Iterator[ClusterAndServer]:
    data = tmp_path_factory.mktemp("lost") / "data"
    with own_cluster() as cluster:
        settings = {"UNGHOST_DATABASE_URL": cluster.url, "UNGHOST_WORKERS": "1"}
        with running_server(data, settings) as server:
            api = Api.at(server.url, server.headers)
            with api.http:
                yield ClusterAndServer(cluster, server, api)


@dataclass
class Writers:
    """Clients that upload and review until they are stopped, and note the answers."""

    place: ClusterAndServer
    dataset: str
    over: threading.Event = field(default_factory=threading.Event)
    stored: set[str] = field(default_factory=set)
    kept: set[int] = field(default_factory=set)
    refused: list[httpx.Response] = field(default_factory=list)

    @contextmanager
    def writing(self) -> Iterator[None]:
        threads = [
            threading.Thread(target=work) for work in (self._upload, self._review)
        ]
        for thread in threads:
            thread.start()
        try:
            yield
        finally:
            self.over.set()
            for thread in threads:
                thread.join()

    def _upload(self) -> None:
        with self._client().http as http:
            api, number = Api(http), 0
            while not self.over.is_set():
                number += 1
                annotation = {**scene.annotation(), "number": number}
                response = api.put(self.dataset, f"w/{number:05}", annotation)
                if self._is_accepted_or_recorded(response):
                    self.stored.add(f"w/{number:05}")

    def _review(self) -> None:
        with self._client().http as http:
            api = Api(http)
            while not self.over.is_set():
                listed = api.get("/boxes", dataset=self.dataset, review="none", limit=5)
                if not self._is_accepted_or_recorded(listed):
                    continue
                for box in listed.json()["items"]:
                    response = api.review(box["box_id"], "keep")
                    self._is_accepted_or_recorded(response)
                    if response.status_code == 201:
                        self.kept.add(box["box_id"])

    def _client(self) -> Api:
        return Api.at(self.place.server.url, self.place.server.headers)

    def _is_accepted_or_recorded(self, response: httpx.Response) -> bool:
        if response.status_code in EXPECTED_STATUSES:
            return True
        self.refused.append(response)
        time.sleep(0.05)
        return False

    def check_acknowledged_writes(self) -> None:
        """All that was acknowledged is stored; refusals were 503 with `Retry-After`."""
        for response in self.refused:
            assert response.status_code == 503, response.text
            assert int(response.headers["Retry-After"]) > 0
            assert response.json()["code"] in ("not_ready", "database_busy")
            assert "127.0.0.1" not in response.text
        api = self.place.api
        frames = api.all_items(f"/datasets/{self.dataset}/frames")
        keys = {frame["key"] for frame in frames}
        assert self.stored <= keys
        for box_id in self.kept:
            assert api.json(f"/boxes/{box_id}")["review"]["verdict"] == "keep"
        stats = api.json(f"/datasets/{self.dataset}/stats")
        assert stats["frames"] == len(keys)
        assert stats["kept"] + stats["rejected"] == 2 * len(keys)


def wait_for_recovery(api):
    """Wait until the service, which is not restarted, recovers."""
    until(lambda: api.get("/datasets").status_code == 200)


def wait_for_stored(writers, more):
    """Wait until the writers have stored so many more frames."""
    enough = len(writers.stored) + more
    until(lambda: len(writers.stored) >= enough)


def terminate_connections(cluster):
    assert cluster.kill_backends(signal.SIGTERM) > 0


def kill_a_backend(cluster):
    """Kill one process of PostgreSQL, which then restarts all others to recover."""
    assert cluster.kill_backends() > 0


def restart_cluster(cluster):
    cluster.stop()
    cluster.start()


WAYS_TO_LOSE = [
    pytest.param(terminate_connections, marks=LONG),
    pytest.param(kill_a_backend, marks=LONG),
    restart_cluster,
]


@pytest.mark.parametrize("lose", WAYS_TO_LOSE)
def test_lost_database_keeps_acknowledged_writes_and_others_get_503(place, lose):
    writers = Writers(place, place.api.dataset())
    with writers.writing():
        for _ in range(2):
            wait_for_stored(writers, 10)
            lose(place.cluster)
            wait_for_recovery(place.api)
        wait_for_stored(writers, 5)

    assert place.server.process.poll() is None
    assert writers.kept
    writers.check_acknowledged_writes()


def test_requests_without_a_database_return_503_immediately(place):
    name = place.api.dataset()
    box = place.api.upload_frame(name, "a")["decisions"][0]["box_id"]
    place.cluster.stop()
    try:
        begun = time.monotonic()
        responses = [
            place.api.get("/datasets"),
            place.api.get("/boxes", dataset=name),
            place.api.put(name, "b"),
            place.api.review(box, "keep"),
            place.api.post(f"/datasets/{name}/queue", {}),
            place.api.post(f"/datasets/{name}/runs", {"config": {}}),
            place.api.http.get("/readyz"),
            place.api.http.get("/"),
            place.api.http.get("/healthz"),
        ]
        took = time.monotonic() - begun
    finally:
        place.cluster.start()
    wait_for_recovery(place.api)

    *others, page, health = responses
    assert [response.status_code for response in others] == [503] * len(others)
    assert all(int(response.headers["Retry-After"]) > 0 for response in others)
    assert (page.status_code, health.status_code) == (200, 200)
    assert took < 10
    assert place.api.review(box, "keep").status_code == 201


@LONG
def test_batch_that_loses_the_database_reports_what_is_stored(place):
    name = place.api.dataset()
    members = [
        member
        for number in range(60)
        for member in frame(f"{number:02}", number=number)
    ]
    lines: list[dict] = []
    with place.api.http.stream(
        "POST",
        f"{BASE}/datasets/{name}/batches",
        content=tar_archive(members),
        headers={"Content-Type": "application/x-tar"},
    ) as response:
        for line in response.iter_lines():
            lines += lines_of(line)
            if len(lines) == 1:
                restart_cluster(place.cluster)
    wait_for_recovery(place.api)
    *told, end = lines
    keys = {item["key"] for item in place.api.all_items(f"/datasets/{name}/frames")}
    again = send(place.api, name, tar_archive(members))

    assert {line["key"] for line in told if line["status"] == 201} <= keys
    assert end["end"] is True
    if "problem" in end:
        assert end["problem"]["status"] == 503
    else:
        assert len(keys) == 60
    summary = lines_of(again.text)[-1]
    assert summary["same"] >= len(keys)
    assert summary["same"] + summary["stored"] == 60


@pytest.fixture(scope="module")
def street(place):
    """A dataset that takes about a second to measure."""
    return create_slow_dataset(place.api, FRAMES)


def wait_for_end(api, where):
    def finished():
        job = api.http.get(where).json()
        return job if job["state"] in FINISHED else None

    return until(finished, lambda: api.http.get(where).json())


@pytest.mark.parametrize(
    "lose", [pytest.param(kill_a_backend, marks=LONG), restart_cluster]
)
def test_run_resumes_by_itself_after_a_database_restart(place, street, lose):
    for config in OTHER_PIXELS[3:]:
        accepted = place.api.post(f"/datasets/{street}/runs", {"config": config})
        with open_events(place.api, accepted.json()["id"]) as events:
            seen = next(event.data for event in events if event.data["done"])
        if seen["done"] < FRAMES:  # otherwise it was over before
            break

    lose(place.cluster)
    wait_for_recovery(place.api)
    run = wait_for_end(place.api, accepted.headers["location"])

    assert seen["done"] < FRAMES
    assert (run["state"], run["done"]) == ("done", FRAMES), run


def test_connection_lost_in_a_transaction_does_not_fail_the_run(place, street):
    """Formerly a run failed with the error "internal" when a connection was ended."""
    accepted = place.api.post(f"/datasets/{street}/runs", {"config": OTHER_PIXELS[2]})
    with open_events(place.api, accepted.json()["id"]) as events:
        next(event.data for event in events if event.data["done"])

    until(place.cluster.end_a_transaction)
    run = wait_for_end(place.api, accepted.headers["location"])

    assert (run["state"], run["done"]) == ("done", FRAMES), run


@LONG
@pytest.mark.parametrize("lose", [kill_a_backend, restart_cluster])
def test_accepted_export_is_written_after_a_database_restart(place, street, lose):
    accepted = place.api.post(f"/datasets/{street}/exports", {"format": "yolo"})
    lose(place.cluster)
    wait_for_recovery(place.api)
    run = wait_for_end(place.api, accepted.headers["location"])

    assert accepted.status_code == 202
    assert (run["state"], run["done"]) == ("done", FRAMES), run
