"""How many lines and seconds do six tasks of a pipeline take?

    python -m benchmarks.bench_tasks [--frames 2000] [--json]

The tasks are the blocks of "Six tasks" in docs/pipeline.md, and the upload with curl of
the README, each run as it is printed, on one server. While the second one sends its
frames, of 64 x 48 pixels, the server is killed and started again. Seconds are from the
start of the program to its end. pandas has to be installed, else its task is left out.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import httpx

from benchmarks.measuring import parser_of
from tests.support.documents import blocks, read
from tests.support.frames import write_manifest
from tests.support.pictures import plain_png
from tests.support.ports import reserved_port

NAMES = ("batch", "export", "pandas", "asyncio", "gate")


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--frames", type=int, default=2000)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, reserved_port() as port:
        figures = dict(measured(Path(name), port, options.frames))
    if options.json:
        print(json.dumps(figures, indent=1))
    else:
        for task, (lines, seconds) in figures.items():
            print(f"{task:10} {lines:3} lines {seconds:8.1f} s")


def tasks() -> dict[str, str]:
    """The text of each task by its name; those in Python begin with an import."""
    section = (
        read("docs/pipeline.md").partition("## Six tasks")[2].partition("\n## ")[0]
    )
    (curl,) = (text for text in blocks(read("README.md"), "sh") if "curl" in text)
    # In the order of the document, whatever their languages.
    found = sorted(
        [*blocks(section, "sh"), *blocks(section, "python")], key=section.index
    )
    return {"curl": curl, **dict(zip(NAMES, found, strict=True))}


def measured(
    folder: Path, port: int, frames: int
) -> Iterator[tuple[str, tuple[int, float]]]:
    """Lines and seconds of each task."""
    write_manifest(folder / "recordings/town10", 200)
    write_manifest(folder / "recordings/night", frames)
    for name in ("000001.png", "000001.seg.png"):
        (folder / name).write_bytes(plain_png(1280, 720, (0, 0, 142)))
    settings = {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "UNGHOST_PORT": str(port),
        "UNGHOST_SERVER": f"http://127.0.0.1:{port}",
        "UNGHOST_LOG_LEVEL": "error",
    }
    environ = {**os.environ, **settings}
    with served(folder, environ):
        first = ["unghost", "push", "recordings/town10", "--dataset", "town10"]
        subprocess.run(first, cwd=folder, env=environ, check=True, capture_output=True)
        for name, text in tasks().items():
            if name == "pandas" and find_spec("pandas") is None:
                print("pandas is not installed", file=sys.stderr)
            elif name != "batch":
                yield name, (lines_of(text), run(text, folder, environ))
    with served(folder, environ) as server:
        yield "batch", killed_in_the_middle(server, folder, environ, frames)


def lines_of(text: str) -> int:
    """How many lines somebody has to write."""
    return len([line for line in text.splitlines() if line.strip()])


def started(
    text: str, folder: Path, environ: dict[str, str]
) -> subprocess.Popen[bytes]:
    """A task that has begun."""
    port = environ["UNGHOST_PORT"]
    is_python = text.startswith(("from ", "import "))
    program = [sys.executable, "-c"] if is_python else ["sh", "-euc"]
    text = text.replace("127.0.0.1:8000", f"127.0.0.1:{port}")
    out = subprocess.DEVNULL
    return subprocess.Popen([*program, text], cwd=folder, env=environ, stdout=out)


def run(text: str, folder: Path, environ: dict[str, str]) -> float:
    """The seconds of a task, which must succeed."""
    begun = time.perf_counter()
    process = started(text, folder, environ)
    if process.wait() != 0:
        raise SystemExit(f"a task has failed with {process.returncode}:\n{text}")
    return time.perf_counter() - begun


def killed_in_the_middle(
    server: subprocess.Popen[bytes], folder: Path, environ: dict[str, str], frames: int
) -> tuple[int, float]:
    """The batch, while which the server is killed and is away for two seconds."""
    text = tasks()["batch"]
    begun = time.perf_counter()
    process = started(text, folder, environ)
    token = (folder / "unghost-data/token").read_text().strip()
    headers = {"Authorization": f"Bearer {token}"}
    url = f"{environ['UNGHOST_SERVER']}/api/v1/datasets/night/stats"
    while httpx.get(url, headers=headers).json().get("frames", 0) < frames // 3:
        time.sleep(0.05)
    server.kill()
    server.wait()
    time.sleep(2)
    with served(folder, environ):
        if process.wait() != 0:
            raise SystemExit(f"the batch has failed with {process.returncode}")
        seconds = time.perf_counter() - begun
        stored = httpx.get(url, headers=headers).json()["frames"]
    if stored != frames:
        raise SystemExit(f"{stored} frames are stored, expected {frames}")
    return lines_of(text), seconds


@contextmanager
def served(folder: Path, environ: dict[str, str]) -> Iterator[subprocess.Popen[bytes]]:
    """A server of the folder's data, which is ready; stopped after the block."""
    out = subprocess.DEVNULL
    process = subprocess.Popen(
        ["unghost", "serve"], cwd=folder, env=environ, stdout=out
    )
    try:
        while not is_ready(environ["UNGHOST_SERVER"]):
            if process.poll() is not None:
                raise SystemExit("the server has ended")
            time.sleep(0.05)
        yield process
    finally:
        process.terminate()
        process.wait()


def is_ready(url: str) -> bool:
    """Whether a server answers and can work."""
    try:
        return httpx.get(f"{url}/readyz").is_success
    except httpx.HTTPError:
        return False


if __name__ == "__main__":
    main()
