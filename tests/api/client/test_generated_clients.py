"""Clients that generators make of the OpenAPI document create a dataset and a frame."""

import json
import os
import shutil
import subprocess
import venv

import pytest

from tests.support import frames, plain_http
from tests.support.sources import CHECKOUT
from tests.support.waiting import until

pytestmark = pytest.mark.long

PROGRAMS = CHECKOUT / "tests" / "data" / "clients"
NODE_TOOLS = CHECKOUT / "tools" / "page_types" / "node_modules" / ".bin"


@pytest.fixture
def workshop(service, tmp_path):
    """A folder with the OpenAPI document, as anybody gets it, and a segmentation."""
    with plain_http.Client(base_url=service.url) as anybody:
        (tmp_path / "openapi.json").write_bytes(anybody.get("/openapi.json").content)
    (tmp_path / "seg.png").write_bytes(frames.segmentation())
    return tmp_path


def run(*words, cwd):
    done = subprocess.run(
        [str(word) for word in words],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done


def assert_uploaded(service, name, printed):
    with service.admin() as client:
        config = client.get(f"/api/v1/datasets/{name}/config").json()["config"]
        stored = client.get(f"/api/v1/datasets/{name}/frames/town/1").json()
    assert (config["profile"], config["evidence"]) == ("paper", "semantic")
    assert [box["id"] for box in stored["boxes"]] == [printed.stdout.strip()] == ["217"]
    assert stored["has_segmentation"]


def test_client_of_openapi_python_client_uploads_a_frame(service, workshop):
    # In an environment of its own: it wants older libraries than Unghost.
    venv.create(workshop / "generator", with_pip=True)
    python = workshop / "generator/bin/python"
    install = [python, "-m", "pip", "install", "-q", "openapi-python-client>=0.26"]
    subprocess.run(install, check=True)
    (workshop / "config.json").write_text(json.dumps({"post_hooks": []}))
    said = run(
        *(python, "-m", "openapi_python_client", "generate"),
        *("--path", "openapi.json", "--config", "config.json"),
        *("--meta", "none", "--output-path", "api"),
        cwd=workshop,
    )

    # Only archives are left out: tar is no media type that the generator knows.
    assert said.stderr.count("Endpoint will not be generated") == 2
    assert "removal of" not in said.stderr
    shutil.copy(PROGRAMS / "upload.py.txt", workshop / "upload.py")
    arguments = (service.url, service.token, "by-python", "seg.png")
    printed = run(python, "upload.py", *arguments, cwd=workshop)
    assert_uploaded(service, "by-python", printed)


@pytest.mark.skipif(
    not os.environ.get("CI")
    and not (shutil.which("node") and (NODE_TOOLS / "openapi-typescript").exists()),
    reason="needs Node and the tools of tools/page_types",
)
def test_types_of_openapi_typescript_describe_an_upload(service, workshop):
    # Another part of the tests may be installing it.
    until((NODE_TOOLS / "openapi-typescript").exists)
    run(NODE_TOOLS / "openapi-typescript", "openapi.json", "-o", "api.ts", cwd=workshop)
    shutil.copy(PROGRAMS / "upload.ts", workshop)
    (workshop / "node.d.ts").write_text(
        'declare module "node:fs" {'
        " export function readFileSync(path: string): Uint8Array<ArrayBuffer>; }"
    )
    run(
        *(NODE_TOOLS / "tsc", "--strict", "--noUncheckedIndexedAccess"),
        *("--target", "es2022", "--module", "commonjs", "--lib", "es2022,dom"),
        *("node.d.ts", "upload.ts"),
        cwd=workshop,
    )

    arguments = (service.url, service.token, "by-typescript", "seg.png")
    printed = run("node", "upload.js", *arguments, cwd=workshop)
    assert_uploaded(service, "by-typescript", printed)
