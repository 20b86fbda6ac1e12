"""Pins of what a running service answers, stores and writes for frames of `street`."""

import csv
import hashlib
import io
import json
import re
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final

import httpx
import pyarrow.parquet

from filter_core.formats.registry import EXPORT_FORMATS
from tests.pins import street
from tests.pins.walk import BASE, DATASET, FINISHED, plain, plain_text, walked
from tests.support import plain_http
from tests.support.command_line import CommandLine
from tests.support.databases import rows_of
from tests.support.servers import RunningServer, running_server

EXPORTS: Final[Mapping[str, dict[str, Any]]] = {
    "yolo, bands": {"bands": [15, 50], "split": 0.5},
    "coco, everything": {"include": "all", "rejected": "dontcare", "boxes": "tight"},
    "kitti, regions": {"rejected": "dontcare", "boxes": "amodal", "images": "none"},
    "voc, what the filter keeps": {"include": "kept", "rejected": "dontcare"},
    "manifest, unmeasured too": {"include_unmeasured": True, "images": "none"},
}
"""Options of exports that are made in addition to every format with its defaults."""

_STORED: Final = (
    ("measurements", "id digest pixel_digest options", "id"),
    (
        "evidence",
        "measurement_id frame_id numbers tag_counts geometry channels segmentation",
        "measurement_id, frame_id",
    ),
    ("flips", "run_id first_box_id last_box_id boxes", "run_id, first_box_id"),
)
"""(table, its columns, the columns that its rows are ordered by)."""


@cache
def found() -> dict[str, Any]:
    """The values of all pins that need a service, by name, from one service."""
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        with running_server(data) as server, _client(server) as http:
            walk = walked(http)
            exports, archives = _exports(http)
            return {
                "responses": walk,
                "exports": exports,
                "rows": _rows(data),
                "decisions": _decisions(http, archives) | _library(),
                "command_line": _command_line(Path(folder) / "frames"),
            }


def _client(server: RunningServer) -> httpx.Client:
    return plain_http.Client(base_url=server.url, headers=server.headers)


def _exports(http: httpx.Client) -> tuple[dict[str, Any], dict[str, dict[str, bytes]]]:
    options_of = {**{name: {} for name in EXPORT_FORMATS}, **EXPORTS}
    archives = {
        name: _archive(http, name.partition(",")[0], options)
        for name, options in options_of.items()
    }
    digests = {
        name: {
            # Stored as JSON and not by its digest, since its times are replaced.
            file: plain(json.loads(content))
            if file == "manifest.json"
            else digest(file, content)
            for file, content in files.items()
        }
        for name, files in archives.items()
    }
    return digests, archives


def _archive(
    http: httpx.Client, form: str, options: dict[str, Any]
) -> dict[str, bytes]:
    body = {"format": form, "options": options}
    made = http.post(f"{BASE}/datasets/{DATASET}/exports", json=body)
    assert made.status_code == 202, made.text
    place = made.headers["location"]
    # Waits for the job: the stream of events ends when the job does.
    http.get(f"{place}/events")
    assert http.get(place).json()["state"] == FINISHED[0]
    content = http.get(f"{place}/download").content
    with zipfile.ZipFile(io.BytesIO(content)) as packed:
        return {name: packed.read(name) for name in packed.namelist()}


def digest(file: str, content: bytes) -> Any:
    """The SHA-256 of a file; for Parquet, its schema and the SHA-256 of its rows."""
    if file.endswith(".parquet"):
        table = pyarrow.parquet.read_table(io.BytesIO(content))
        rows = json.dumps(table.to_pylist(), ensure_ascii=False).encode()
        return {"schema": _schema(content), "rows": hashlib.sha256(rows).hexdigest()}
    if file == "decisions.jsonl":  # it says when people gave their answers
        content = plain_text(content.decode("utf-8")).encode()
    return hashlib.sha256(content).hexdigest()


def _schema(content: bytes) -> list[str]:
    schema = pyarrow.parquet.read_schema(io.BytesIO(content))
    return [f"{column.name}: {column.type}" for column in schema]


def _rows(data: Path) -> dict[str, Any]:
    """Every row of evidence and of flips; for bytes, their number and SHA-256."""
    return {
        table: [
            dict(zip(columns.split(), map(_cell, row), strict=True))
            for row in rows_of(
                data, f"SELECT {columns.replace(' ', ', ')} FROM {table} ORDER BY {key}"
            )
        ]
        for table, columns, key in _STORED
    }


def _cell(cell: object) -> object:
    if isinstance(cell, (bytes, memoryview)):
        content = bytes(cell)
        return f"{len(content)} bytes, {hashlib.sha256(content).hexdigest()}"
    if isinstance(cell, str) and cell[:1] in ("{", "["):
        return json.loads(cell)
    return cell


def _decisions(
    http: httpx.Client, archives: Mapping[str, Mapping[str, bytes]]
) -> dict[str, list[str]]:
    def get(path: str, **parameters: Any) -> Any:
        return http.get(BASE + path, params=parameters).json()

    boxes = get("/boxes", dataset=DATASET, limit=100)["items"]
    frame = get(f"/frames/{boxes[0]['frame_id']}")
    queue = http.post(f"{BASE}/datasets/{DATASET}/queue", json={"limit": 20}).json()
    lines = archives["decisions-jsonl"]
    (jsonl,) = (lines[name] for name in lines if name.endswith(".jsonl"))
    (table,) = (
        content
        for name, content in archives["decisions-csv"].items()
        if name.endswith(".csv")
    )
    return {
        "in the list of boxes": keys_of(boxes),
        "in a frame": keys_of(frame["boxes"]),
        "in the queue": keys_of(queue["items"]),
        "alone": keys_of([get(f"/boxes/{box['box_id']}") for box in boxes[:9]]),
        "in decisions-jsonl": keys_of(map(json.loads, jsonl.splitlines())),
        "in decisions-csv": next(csv.reader(io.StringIO(table.decode("utf-8")))),
    }


def _library() -> dict[str, list[str]]:
    from filter_core import filter_frame

    frame, *_ = street.frames()
    result = filter_frame(frame.annotation, frame.files["segmentation"])
    return {"in the library": keys_of(result.decisions)}


def keys_of(objects: Any) -> list[str]:
    """The keys of some objects in order, with those of nested objects."""
    return list(dict.fromkeys(key for each in objects for key in _keys(each)))


def _keys(value: Mapping[str, Any], before: str = "") -> Iterator[str]:
    for key, item in value.items():
        yield before + key
        if isinstance(item, list):
            item = next(iter(item), None)
        if isinstance(item, dict):
            yield from _keys(item, f"{before}{key}.")


def _command_line(folder: Path) -> list[Any]:
    """What ``unghost filter --json`` prints for the same frames in a folder."""
    lines = []
    for frame in street.frames():
        paths = {}
        for kind, content in frame.files.items():
            suffix = ".npy" if kind == "lidar" else ".png"
            path = folder / kind / f"{frame.key.replace('/', '-')}{suffix}"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
            paths[kind] = path.relative_to(folder).as_posix()
        lines.append(json.dumps({"key": frame.key, **paths, **frame.annotation}))
    lines.append(json.dumps({"key": "town/broken", "boxes": [{"class": "car"}]}))
    (folder / "manifest.jsonl").write_text("\n".join(lines) + "\n", "utf-8")
    (folder / "filter.yaml").write_text("evidence: auto\n", "utf-8")
    words = ("filter", ".", "--json", "--workers", "1", "--config", "filter.yaml")
    done = CommandLine(folder, {})(*words)
    written = [plain(record) for record in done.records]
    said = re.sub(r"[\d.]+ frames/s", "<some> frames/s", done.err)
    return [{"exit": done.code, "said": said}, *written]
