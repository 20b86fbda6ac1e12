"""The cluster's example files for compose and Kubernetes fit the code.

They are read as their programs read them; nginx runs with its real configuration.
"""

import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml

from app.settings import Settings
from tests.support import frames as scene
from tests.support.databases import migrated_postgres
from tests.support.dockerfile import parse_dockerfile
from tests.support.ports import reserved_port
from tests.support.servers import RunningServer, running_server, stop
from tests.support.sources import CHECKOUT
from tests.support.waiting import until
from unghost import Client, OutgoingFrame
from unghost.cli.program import COMMANDS

COMPOSE_FILE = yaml.safe_load(
    (CHECKOUT / "docker-compose.cluster.yml").read_text("utf-8")
)
SERVICES: dict[str, dict[str, Any]] = COMPOSE_FILE["services"]
KUBERNETES: list[dict[str, Any]] = list(
    yaml.safe_load_all((CHECKOUT / "deploy" / "kubernetes.yaml").read_text("utf-8"))
)
OWN_SERVICES = [
    name for name, spec in SERVICES.items() if spec.get("image") == "unghost:cluster"
]
NGINX = shutil.which("nginx", path=f"{os.environ['PATH']}:/usr/sbin")


def environment(name: str) -> dict[str, str]:
    """A container's environment, with "chosen" for each value that users must set."""
    variables: dict[str, str] = SERVICES[name].get("environment", {})
    return {
        key: re.sub(r"\$\{\w+:\?[^}]*\}", "chosen", value)
        for key, value in variables.items()
    }


def test_only_the_proxy_is_published_and_services_share_what_they_store():
    published = {
        name: spec["ports"] for name, spec in SERVICES.items() if "ports" in spec
    }

    assert published == {"proxy": ["127.0.0.1:8000:8080"]}
    assert COMPOSE_FILE["networks"]["inside"]["internal"] is True
    assert {
        name for name, spec in SERVICES.items() if spec["networks"] != ["inside"]
    } == {"proxy"}
    commands = [spec["command"] for spec in SERVICES.values() if "command" in spec]
    assert {words[0] for words in commands} == {"unghost"}
    assert {words[1] for words in commands} <= set(COMMANDS)
    places = ("UNGHOST_DATABASE_URL", "UNGHOST_STORAGE", "UNGHOST_ENGINE")
    of_each = {
        tuple(environment(name)[place] for place in places)
        for name in ("api-1", "api-2", "worker")
    }
    assert len(of_each) == 1


@pytest.mark.parametrize("name", OWN_SERVICES)
def test_settings_of_a_container_exist_and_its_certificates_are_there(
    name, monkeypatch
):
    named = environment(name)
    ours = {key: value for key, value in named.items() if key.startswith("UNGHOST_")}
    fields = {f"UNGHOST_{field.upper()}" for field in Settings.model_fields}
    for key, value in ours.items():
        monkeypatch.setenv(key, value)

    Settings()

    assert set(ours) <= fields
    secrets = [value for value in named.values() if "/run/secrets/" in str(value)]
    shown = {Path(value).name for value in secrets}

    assert shown == set(SERVICES[name]["secrets"])
    assert shown <= set(COMPOSE_FILE["secrets"])
    assert "ca.key" not in COMPOSE_FILE["secrets"]


def containers(part: Any) -> Iterator[dict[str, Any]]:
    """Every container in a part of the Kubernetes example, at any depth."""
    if isinstance(part, dict):
        yield from part.get("containers", ())
        for inner in part.values():
            yield from containers(inner)


def test_kubernetes_example_has_valid_settings_and_commands(monkeypatch):
    fields = {f"UNGHOST_{field.upper()}" for field in Settings.model_fields}
    shared = next(part["data"] for part in KUBERNETES if part["kind"] == "ConfigMap")
    programs = [each for part in KUBERNETES for each in containers(part)]
    own = [
        {variable["name"]: variable["value"] for variable in each["env"]}
        for each in programs
    ]

    for variables in (shared, *own):
        with monkeypatch.context() as patch:
            for name, value in variables.items():
                patch.setenv(name, value)
            Settings()
        assert set(variables) <= fields
    assert [each["name"] for each in programs] == ["unghost", "scheduler", "worker"]
    commands = [each["args"] for each in programs if "args" in each]
    assert {words[0] for words in commands} == {"unghost"}
    assert {words[1] for words in commands} <= set(COMMANDS)


def pods(part: Any) -> Iterator[dict[str, Any]]:
    """Every pod specification in a part of the Kubernetes example, at any depth."""
    if isinstance(part, dict):
        yield from [part] if "containers" in part else []
        for inner in part.values():
            yield from pods(inner)


def test_pods_disable_the_service_links_of_kubernetes(monkeypatch):
    """Kubernetes would set UNGHOST_PORT=tcp://... for a Service called unghost.

    Formerly that ended each pod.
    """
    monkeypatch.setenv("UNGHOST_PORT", "tcp://10.0.0.1:80")
    all_pods = [pod for part in KUBERNETES for pod in pods(part)]

    with pytest.raises(ValueError, match="port"):
        Settings()
    assert [pod.get("enableServiceLinks") for pod in all_pods] == [False] * 3


def test_image_installs_the_locked_packages_that_the_cluster_needs():
    last = parse_dockerfile((CHECKOUT / "Dockerfile").read_text("utf-8"))[-1]

    assert last.all("ARG") == ["LOCK=requirements.lock"]
    assert '--require-hashes --requirement "/locks/$LOCK"' in last.all("RUN")[0]
    assert {SERVICES[name]["build"]["args"]["LOCK"] for name in OWN_SERVICES} == {
        "requirements-cluster.lock"
    }


@contextmanager
def nginx(folder: Path, port: int, ports: list[int]) -> Iterator[str]:
    """Run nginx with the configuration of `deploy`, its addresses replaced.

    It listens on `port`, at the address that this gives, and passes requests to servers
    on `ports`.
    """
    assert NGINX is not None
    text = (CHECKOUT / "deploy" / "nginx.conf").read_text("utf-8")
    for number, own in enumerate(ports, 1):
        text = text.replace(f"api-{number}:8000", f"127.0.0.1:{own}")
    text = text.replace("listen 8080", f"listen 127.0.0.1:{port}")
    text = text.replace("/tmp/", f"{folder}/")
    file = folder / "nginx.conf"
    # As root, nginx would run its workers as another user, who may not write here.
    user = "user root;\n" if os.geteuid() == 0 else ""
    file.write_text(user + text, "utf-8")
    command = [NGINX, "-p", str(folder), "-c", str(file), "-g", "daemon off;"]
    url = f"http://127.0.0.1:{port}"

    def is_ready() -> bool:
        try:
            return httpx.get(f"{url}/readyz", timeout=5).is_success
        except httpx.TransportError:
            return False

    running = subprocess.Popen(command)
    try:
        until(is_ready, f"{url} is not ready")
        yield url
    finally:
        running.terminate()
        running.wait(30)


@pytest.fixture
def servers(tmp_path) -> Iterator[list[RunningServer]]:
    """Two services that share one database and one data folder."""
    with migrated_postgres() as url, ExitStack() as stack:
        extra = {"UNGHOST_DATABASE_URL": url}
        yield [
            stack.enter_context(running_server(tmp_path / "data", extra, anew=True))
            for _ in range(2)
        ]


@pytest.mark.long
@pytest.mark.skipif(NGINX is None, reason="nginx is not installed")
def test_proxy_passes_uploads_and_keeps_working_after_a_service_stops(
    servers, tmp_path
):
    first, second = servers
    ports = [int(server.url.rpartition(":")[2]) for server in servers]
    folder = tmp_path / "nginx"
    folder.mkdir()
    frames = [
        OutgoingFrame(
            f"{number:03}",
            scene.annotation(),
            {"image": scene.image(number), "segmentation": scene.segmentation()},
        )
        for number in range(40)
    ]
    with (
        reserved_port() as port,
        nginx(folder, port, ports) as url,
        Client(url, token=first.token) as client,
    ):
        client.create_dataset("street")
        stored = [outcome.word for outcome in client.push("street", frames)]
        run = client.start_run("street", {"min_visible_pixels": 500})
        watched = [each.state for each in client.events(run)]
        stop(second.process)
        after = [client.dataset("street").name for _ in range(8)]
        hidden = httpx.get(f"{url}/metrics", headers=first.headers)

    assert stored == ["stored"] * 40
    assert watched[-1] == "done"
    assert after == ["street"] * 8
    assert hidden.status_code == 404
