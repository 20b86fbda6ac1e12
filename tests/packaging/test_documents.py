"""The commands of the documents are run in order, as somebody who reads them would.

In an installation of its own and an empty folder: from the first document on, each
finds the server, the data and the files that the one before has left.
"""

import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.documents import blocks, read
from tests.support.frames import write_manifest
from tests.support.installation import Installation
from tests.support.pictures import plain_png
from tests.support.ports import reserved_port
from tests.support.waiting import until

pytestmark = pytest.mark.long

DOCUMENTS = ("README", *(f"docs/{name}" for name in (
    "quickstart", "training", "pipeline", "security", "operations"
)))  # fmt: skip
CLIENT, _ = blocks(read("README.md"), "python")
ELSEWHERE = re.compile(
    r"^(sudo|make|pip|yolo|createdb|pg_|cp -r|mkdir restored|UNGHOST_DATABASE_URL"
    r"|UNGHOST_HOOK_HOSTS|UNGHOST_ALLOWED_HOSTS|export UNGHOST_|unghost login --open)"
)
"""What needs another machine, another package or a person, and is not run."""


class Reader:
    """Types commands in one folder, where one server runs once it was started."""

    def __init__(self, installation: Installation, folder: Path, port: int) -> None:
        self.folder = folder
        self.server: subprocess.Popen[bytes] | None = None
        self.program = str(installation.command("unghost"))
        self.url = f"http://127.0.0.1:{port}"
        programs = f"{installation.python.parent}{os.pathsep}{os.environ['PATH']}"
        self.environ = {
            "PATH": programs,
            "HOME": str(folder),
            "LANG": "C.UTF-8",
            "UNGHOST_PORT": str(port),
            "UNGHOST_SERVER": self.url,
        }

    def types(self, command: str) -> None:
        """Run a command, which must succeed; `unghost serve` goes on running."""
        if command == "unghost serve":
            if self.server is None:
                self.start()
            return
        shell = ["sh", "-euc", command.replace("http://127.0.0.1:8000", self.url)]
        done = self.run(shell)
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"

    def start(self) -> None:
        self.server = subprocess.Popen(
            [self.program, "serve"],
            cwd=self.folder,
            env=self.environ,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        token = self.folder / "unghost-data/token"
        until(lambda: token.exists() and self.is_ready())

    def run(self, command: list[str]) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            command,
            cwd=self.folder,
            env=self.environ,
            capture_output=True,
            text=True,
            check=False,
        )

    def is_ready(self) -> bool:
        listed = [self.program, "dataset", "list", "--retry-for", "0"]
        return self.run(listed).returncode == 0


@pytest.fixture
def reader(installation: Installation, tmp_path: Path) -> Iterator[Reader]:
    """Somebody with the files that the documents speak of."""
    for name in ("recordings/town10", "recordings/night", "my-recording"):
        write_manifest(tmp_path / name, 12)
    for name in ("000001.png", "000001.seg.png"):
        (tmp_path / name).write_bytes(plain_png(1280, 720, (0, 0, 142)))
    (tmp_path / "filter.yaml").write_text(blocks(read("docs/quickstart.md"), "yaml")[0])
    with reserved_port() as port:
        reader = Reader(installation, tmp_path, port)
        try:
            yield reader
        finally:
            if reader.server is not None:
                reader.server.terminate()
                reader.server.wait()


def commands_of(document: str) -> list[str]:
    """The commands of a document that can be run here, in their order."""
    commands = []
    for block in blocks(read(f"{document}.md"), "sh"):
        joined = block.replace("\\\n", " ")
        if "$(" in joined:  # the next lines use what it sets
            commands.append(joined)
        else:
            lines = [line.partition("   #")[0].strip() for line in joined.splitlines()]
            commands += [line for line in lines if line and line[0] != "#"]
    return [command for command in commands if not ELSEWHERE.match(command)]


def test_every_command_of_the_documents_runs_after_those_before(reader):
    run = []
    for document in DOCUMENTS:
        commands = commands_of(document)
        if document == "README":
            (reader.folder / "client.py").write_text(CLIENT)
            commands.append("python client.py")
        for command in commands:
            reader.types(command)
            run.append(command)

    assert len(run) >= 25, run
    assert (reader.folder / "town10/data.yaml").exists()
    assert (reader.folder / "restored/unghost.db").exists()
