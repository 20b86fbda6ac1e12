"""Services and clients: one that tests share, one per module, one of a test's own."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.security import TOKEN_PREFIX, hash_secret, new_secret
from tests.support import frames as scene
from tests.support.api import Api
from tests.support.command_line import CommandLine
from tests.support.live import Live, live
from tests.support.sensors import depth_png, experiment_report, street_metres
from tests.support.servers import RunningServer
from tests.support.slow_datasets import slow_server
from unghost import Client
from unghost.wire.words import Role

LIMITS: dict[str, object] = {"max_json_bytes": 5_000, "max_body_bytes": 10_000}
LIMITS |= {"max_batch_bytes": 1_000_000, "max_answers_per_box": 12}
LIMITS |= {"hook_hosts": ("127.0.0.1",)}
MARKUP = "<img src=x onerror=alert(1)>"
STREET = "/api/v1/datasets/street"
Serve = Callable[..., Live]
AsRole = Callable[[Role], httpx.Client]


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    """One service for the module, with small limits."""
    folder = tmp_path_factory.mktemp("service") / "data"
    with live(folder, **LIMITS) as running:
        yield running


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Serve]:
    """Starts services on the test's own data folder; each call uses the same one."""
    with ExitStack() as started:

        def start(**settings: object) -> Live:
            return started.enter_context(live(tmp_path / "data", **settings))

        yield start


@pytest.fixture
def admin(service: Live) -> Iterator[httpx.Client]:
    with service.admin() as client:
        yield client


@pytest.fixture(scope="module")
def own_api(service: Live) -> Iterator[Api]:
    """An admin's client of the module's service."""
    with service.admin() as client:
        yield Api(client)


@pytest.fixture
def anonymous(service: Live) -> Iterator[httpx.Client]:
    with service.client() as client:
        yield client


@pytest.fixture
def as_role(service: Live) -> Iterator[AsRole]:
    """Makes a client with a new token of a role, which is written to the database."""
    from app.db.tables.access import Token

    with ExitStack() as opened:

        def client(role: Role) -> httpx.Client:
            token = new_secret(TOKEN_PREFIX)
            digest = hash_secret(token)
            with service.app.state.database.write() as session:
                session.add(Token(name=digest[:20], role=role, hash=digest))
            return opened.enter_context(service.client(Authorization=f"Bearer {token}"))

        yield client


@pytest.fixture(scope="module")
def slow(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[RunningServer, Api, str]]:
    """A server that measures one frame at a time, a client, and a slow dataset.

    The dataset has as many frames as the test module says in `FRAMES`.
    """
    folder = tmp_path_factory.mktemp("slow")
    with slow_server(folder, request.module.FRAMES) as slow:
        yield slow


@pytest.fixture(scope="session")
def api(server: RunningServer) -> Iterator[Api]:
    """An admin's client of the server that all tests share.

    Tests only add to that server; each makes its own datasets.
    """
    opened = Api.at(server.url, server.headers)
    with opened.http:
        yield opened


@pytest.fixture
def unghost(server: RunningServer, tmp_path: Path) -> CommandLine:
    """The command line in an empty folder, with that server's address and a token."""
    settings = {"UNGHOST_SERVER": server.url, "UNGHOST_TOKEN": server.token}
    return CommandLine(tmp_path, settings)


@pytest.fixture
def client(server: RunningServer) -> Iterator[Client]:
    """A Python client of the server that all tests share, as admin."""
    with Client(server.url, server.token) as opened:
        yield opened


@pytest.fixture
def dataset(api: Api) -> str:
    """A dataset of three frames, each with a car and a ghost."""
    return api.dataset_of_frames(3)


@pytest.fixture
def ghosts(api: Api, dataset: str) -> list[int]:
    """The ids of the rejected boxes of `dataset`."""
    return api.box_ids(dataset, verdict="rejected")


@pytest.fixture(scope="module")
def path_values(service: Live) -> dict[str, Any]:
    """Stores something for every GET route; gives the values for their paths."""
    with service.admin() as admin:
        body = {"name": "street", "description": MARKUP}
        admin.post("/api/v1/datasets", json=body)
        annotation: dict[str, Any] = scene.annotation()
        marked = {"id": MARKUP, "class": MARKUP, "xyxy": scene.ON_THE_CAR}
        boxes = [*annotation["boxes"], marked]
        files = {
            "annotation": scene.as_json({**annotation, "boxes": boxes}),
            "image": scene.image(),
            "segmentation": scene.segmentation(),
            "depth": depth_png(street_metres(scene.HEIGHT, scene.WIDTH)),
        }
        frame = admin.put(f"{STREET}/frames/a", files=files).json()
        box = frame["decisions"][0]["box_id"]
        answer = {"verdict": "keep", "comment": MARKUP, "seen_revision": 0}
        admin.post(f"/api/v1/boxes/{box}/reviews", json=answer)
        admin.put(f"{STREET}/experiment", json=experiment_report())
        export = admin.post(f"{STREET}/exports", json={"format": "yolo"}).json()["id"]
        admin.get(f"/api/v1/exports/{export}/events")  # returns when the export is done
        link = admin.post(f"/api/v1/exports/{export}/download-links").json()["url"]
        code = admin.post("/api/v1/login-codes").json()["id"]
        # Of a dataset where nothing happens, so that nothing is sent meanwhile.
        admin.post("/api/v1/datasets", json={"name": "quiet"})
        hook = {"url": "http://127.0.0.1:9/", "dataset": "quiet"}
        hook_id = admin.post("/api/v1/hooks", json=hook).json()["id"]
        dataset = admin.get(STREET).json()
    return {
        "code_id": code,
        "hook_id": hook_id,
        "key": link.partition("?key=")[2],
        "dataset": "street",
        "key:any": "a",
        "kind": "image",
        "name:path": "js/main.js",
        "frame_id": frame["frame"]["id"],
        "box_id": box,
        "export_id": export,
        "run_id": dataset["active_run"],
        "digest": dataset["config"],
    }
