"""A fixed series of API requests on the frames of `street`, with every response."""

import hashlib
import io
import json
import re
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import cv2
import httpx
import numpy as np

from app.package import VERSION
from tests.pins import street
from tests.pins.street import Frame
from tests.support.archives import tar_archive
from tests.support.waiting import until

BASE: Final = "/api/v1"
DATASET: Final = "street"
FINISHED: Final = ("done", "failed", "cancelled")
# The headers that are kept. Those for security are left out: all answers have the same
# ones, and they have tests of their own.
HEADERS: Final = (
    "accept-ranges",
    "allow",
    "cache-control",
    "content-disposition",
    "content-range",
    "content-type",
    "etag",
    "idempotent-replayed",
    "link",
    "location",
    "retry-after",
    "www-authenticate",
)
_TIME: Final = re.compile(r"20\d\d-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?Z")
_SECRET: Final = re.compile(r"\bu[a-z]+_[\w-]{20,}|(?<=key=)[\w-]{20,}")
# Keys whose values are replaced. Titles are Python's names of statuses, which differ
# between versions; the last use of a token is only stored now and then.
_VARYING_KEYS: Final = ("request_id", "title", "snapshot", "last_used_at", "python")
# Objects whose keys are sorted, since their order depends on the database.
_UNORDERED: Final = ("by_reason", "by_class")
_COUNTED_LATER: Final = ("unghost_blobs gauge", "unghost_blob_bytes gauge")
"""Metrics that are there only after files have been counted, in the background."""
_OF_SQLITE: Final = "unghost_wal_bytes gauge"
_PARTIAL: Final = 206


@dataclass
class Walk:
    """An API client that records its requests and the responses."""

    http: httpx.Client
    steps: list[dict[str, Any]] = field(default_factory=list)

    def ask(self, step: str, method: str, path: str, **request: Any) -> httpx.Response:
        """Send a request, and record the response under the name of the step."""
        response = self.http.request(method, path, **request)
        headers = {
            name: plain_text(response.headers[name])
            for name in HEADERS
            if name in response.headers
        }
        self.steps.append(
            {
                "step": step,
                "asked": f"{method} {plain_text(response.url.raw_path.decode())}",
                "status": response.status_code,
                "headers": headers,
                "body": _body(response),
            }
        )
        return response

    def get(self, step: str, path: str, **parameters: Any) -> Any:
        response = self.ask(step, "GET", BASE + path, params=parameters or None)
        return response.json() if response.content[:1] in (b"{", b"[") else None

    def post(self, step: str, path: str, body: Any = None, **more: Any) -> Any:
        return self.ask(step, "POST", BASE + path, json=body, **more).json()

    def put_frame(self, step: str, frame: Frame, **more: Any) -> Any:
        return self.ask(
            step, "PUT", f"{BASE}/datasets/{DATASET}/frames/{frame.key}",
            files=multipart(frame), **more,
        ).json()  # fmt: skip

    def wait(self, step: str, path: str) -> Any:
        """Ask until a job is over, and record only the last response."""
        until(lambda: self.http.get(BASE + path).json()["state"] in FINISHED, path)
        return self.get(step, path)


def members(number: int, frame: Frame) -> list[tuple[str, bytes]]:
    """The files (name, content) of a frame in a batch's archive."""
    annotation = json.dumps({"key": frame.key, **frame.annotation}).encode()
    suffix = {"lidar": "npy"}
    return [
        (f"{number}.json", annotation),
        *(
            (f"{number}.{kind}.{suffix.get(kind, 'png')}", content)
            for kind, content in frame.files.items()
        ),
    ]


def multipart(frame: Frame) -> dict[str, Any]:
    """The multipart fields of a frame's upload."""
    return {"annotation": json.dumps(frame.annotation).encode(), **frame.files}


def plain(value: Any) -> Any:
    """A JSON value with placeholders for what differs from run to run."""
    if isinstance(value, dict):
        return {key: _plain_item(key, item) for key, item in value.items()}
    if isinstance(value, list):
        return [plain(item) for item in value]
    return plain_text(value) if isinstance(value, str) else value


def _plain_item(key: str, item: Any) -> Any:
    if key in _VARYING_KEYS:
        return f"<{key}>"
    if key in _UNORDERED and isinstance(item, dict):
        item = dict(sorted(item.items()))
    return plain(item)


def plain_text(text: str) -> str:
    """A text with placeholders for times, secrets and the version."""
    if text == VERSION:
        return "<version>"
    return _SECRET.sub("<secret>", _TIME.sub("<time>", text))


def _body(response: httpx.Response) -> Any:
    """What is recorded of a response's body, by its type."""
    kind = response.headers.get("content-type", "").partition(";")[0]
    if response.url.path == "/readyz":
        return {"checks": list(response.json()["checks"])}
    if response.status_code == _PARTIAL:
        return _digest(response.content)
    if kind in _READERS:
        return _READERS[kind](response)
    if kind.startswith("text/plain") and response.url.path == "/metrics":
        types = re.findall(r"^# TYPE (\S+ \S+)$", response.text, re.MULTILINE)
        return sorted({*types} - {_OF_SQLITE, *_COUNTED_LATER})
    return _digest(response.content) if response.content else None


def _digest(content: bytes) -> dict[str, str]:
    return {"sha256": hashlib.sha256(content).hexdigest()}


def _json(response: httpx.Response) -> Any:
    return plain(response.json())


def _lines(response: httpx.Response) -> Any:
    return [plain(json.loads(line)) for line in response.text.splitlines()]


def _files(response: httpx.Response) -> Any:
    with zipfile.ZipFile(io.BytesIO(response.content)) as archive:
        return {name: _digest(archive.read(name)) for name in archive.namelist()}


def _size(response: httpx.Response) -> Any:
    picture = cv2.imdecode(np.frombuffer(response.content, np.uint8), -1)
    return {"height, width, channels": None if picture is None else picture.shape}


def _last_event(response: httpx.Response) -> Any:
    # The number of earlier events depends on the speed of the machine.
    *_, last = response.text.strip().split("\n\n")
    event = dict(line.split(": ", 1) for line in last.splitlines())
    return {"event": event["event"], "data": plain(json.loads(event["data"]))}


_READERS: Final[Mapping[str, Callable[[httpx.Response], Any]]] = {
    "application/json": _json,
    "application/problem+json": _json,
    "application/x-ndjson": _lines,
    "application/zip": _files,
    "image/jpeg": _size,
    "image/webp": _size,
    "text/event-stream": _last_event,
}
"""What is recorded of a body, by media type; of other types, the SHA-256."""


def walked(http: httpx.Client) -> list[dict[str, Any]]:
    """All steps of the walk, which leaves a dataset with frames, a run and answers."""
    walk = Walk(http)
    for part in _PARTS:
        part(walk)
    return walk.steps


def _datasets(walk: Walk) -> None:
    body = {"name": DATASET, "description": "a", "classes": ["walker", "car"]}
    walk.post("create a dataset", "/datasets", body)
    walk.post("create it again", "/datasets", body)
    walk.post("create one with a bad name", "/datasets", {"name": "a/b", "x": 1})
    walk.ask(
        "change it", "PATCH", f"{BASE}/datasets/{DATASET}", json={"description": "b"}
    )
    walk.get("list datasets", "/datasets")
    walk.get("no such dataset", "/datasets/none")


def _uploads(walk: Walk) -> None:
    first, *others = street.frames()
    stored = walk.put_frame("upload a frame", first)
    walk.put_frame("upload it again", first)
    other = Frame(first.key, {**first.annotation, "map": "Town01"}, first.files)
    walk.put_frame("upload another under its key", other)
    for frame in others:
        walk.put_frame(f"upload {frame.key}", frame)
    boxes = [
        {"class": "car", "xyxy": [0, 0, "wide"]},
        {"class": 7, "xywh": [1, 2, 3, 4]},
    ]
    wrong = Frame("town/wrong", {**first.annotation, "boxes": boxes}, first.files)
    walk.put_frame("upload wrong boxes", wrong)
    files = {**first.files, "segmentation": first.files["segmentation"][:900]}
    walk.put_frame(
        "upload a broken picture", Frame("town/cut", first.annotation, files)
    )
    files = {**first.files, "lidar": b"not a cloud"}
    walk.put_frame(
        "upload a broken cloud", Frame("town/lidar", first.annotation, files)
    )
    path = f"{BASE}/datasets/{DATASET}/frames/{first.key}"
    walk.ask("upload JSON", "PUT", path, json=first.annotation)
    walk.ask("upload without annotation", "PUT", path, files={"image": b"1"})
    walk.put_frame("replace a frame", other, params={"replace": "true"})
    replaced = walk.put_frame("put it back", first, params={"replace": "true"})
    keys = {"keys": [first.key, "town/none"]}
    walk.post("ask for known frames", f"/datasets/{DATASET}/known-frames", keys)
    walk.get("a frame that was replaced", f"/frames/{stored['frame']['id']}")
    walk.get("a frame by its key", f"/datasets/{DATASET}/frames/{first.key}")
    page = walk.get("list frames", f"/datasets/{DATASET}/frames", limit=2)
    walk.get(
        "list on", f"/datasets/{DATASET}/frames", limit=2, cursor=page["next_cursor"]
    )
    walk.get("list by a cursor that is none", f"/datasets/{DATASET}/frames", cursor="x")
    walk.get("no such frame", "/frames/4000")
    image = f"/frames/{replaced['frame']['id']}/image"
    walk.get("an image", image)
    walk.ask("a part of it", "GET", BASE + image, headers={"Range": "bytes=8-15"})
    tag = walk.http.get(BASE + image).headers["etag"]
    walk.ask("it unchanged", "GET", BASE + image, headers={"If-None-Match": tag})
    walk.get("a thumbnail", f"/frames/{replaced['frame']['id']}/thumbnail")
    walk.get("an overlay", f"/frames/{replaced['frame']['id']}/overlay")
    walk.get("problems", f"/datasets/{DATASET}/problems")


def _boxes(walk: Walk) -> list[dict[str, Any]]:
    page = walk.get("list boxes", "/boxes", dataset=DATASET, limit=100)
    walk.get(
        "a page of doubtful ones", "/boxes", dataset=DATASET, sort="doubt", limit=2
    )
    walk.get(
        "by what they are", "/boxes", dataset=DATASET, limit=2, count="true",
        verdict="rejected", reason="no_visible_pixels", **{"class": "car"},
    )  # fmt: skip
    walk.get("by a filter that there is not", "/boxes", dataset=DATASET, colour="red")
    box = page["items"][0]["box_id"]
    walk.get("a box", f"/boxes/{box}")
    walk.get("its crop", f"/boxes/{box}/crop")
    walk.get("no such box", "/boxes/40000")
    walk.get("no number", "/boxes/first")
    items: list[dict[str, Any]] = page["items"]
    return items


def _review(walk: Walk) -> None:
    boxes = [box["box_id"] for box in _boxes(walk)]
    path = f"/boxes/{boxes[0]}/reviews"
    answer = {"verdict": "reject", "seen_revision": 0, "comment": "zu klein"}
    key = {"Idempotency-Key": "the-first-answer"}
    walk.post("answer", path, answer, headers=key)
    walk.post("answer by the same key", path, answer, headers=key)
    walk.post("answer what has changed", path, {**answer, "verdict": "keep"})
    walk.post("answer with what is none", path, {"verdict": "maybe"})
    walk.post("answer again", path, {"verdict": "unsure", "seen_revision": 1})
    walk.post("take it back", path, {"verdict": "clear", "seen_revision": 2})
    walk.get("the box then", f"/boxes/{boxes[0]}")
    walk.post("answer a third time", path, {"verdict": "reject", "seen_revision": 3})
    walk.post(
        "answer another",
        f"/boxes/{boxes[3]}/reviews",
        {"verdict": "keep", "seen_revision": 0},
    )
    walk.post("answer once more", path, {"verdict": "unsure", "seen_revision": 4})
    walk.post("undo an answer", f"{path}/5/undo")
    walk.post("undo it again", f"{path}/5/undo")
    walk.get("its history", f"/boxes/{boxes[0]}/history")
    bulk: dict[str, Any] = {"dataset": DATASET, "verdict": "reject"}
    bulk |= {"box_ids": [*boxes[:3], 40_000]}
    seen = {"seen_revisions": [0, 0, 0, 0]}
    batch = walk.post("answer many", "/reviews/bulk", {**bulk, **seen})
    walk.post("expect others", "/reviews/bulk", {**bulk, "expected_count": 9})
    path = f"/review-batches/{batch['id']}/undo"
    walk.post("undo them", path)
    walk.post("undo them again", path)
    selection: dict[str, Any] = {"verdict": "kept", "class": "walker"}
    listed = walk.get(
        "count a filter", "/boxes", dataset=DATASET, count="true", limit=1, **selection
    )
    bulk = {"dataset": DATASET, "verdict": "keep", "filter": selection}
    walk.post(
        "answer a filter", "/reviews/bulk", {**bulk, "snapshot": listed["snapshot"]}
    )
    walk.post(
        "answer it as it was", "/reviews/bulk", {**bulk, "snapshot": listed["snapshot"]}
    )


def _queue(walk: Walk) -> None:
    path = f"/datasets/{DATASET}/queue"
    walk.post("the queue", path, {"limit": 2})
    walk.post("in a random order", path, {"limit": 2, "order": "random", "seed": 7})
    walk.post("for an audit", path, {"limit": 2, "order": "audit"})
    walk.post("in no order", path, {"order": "size"})
    walk.get("statistics", f"/datasets/{DATASET}/stats")
    walk.get("a histogram", f"/datasets/{DATASET}/histogram", bins=4)
    walk.get("quality", f"/datasets/{DATASET}/quality")


def _configs(walk: Walk) -> None:
    path = f"/datasets/{DATASET}/config"
    before = walk.get("the configuration", path)
    config = {
        "threshold_small_box": 60,
        "classes": {"truck": {"accept": ["Car", "Truck"]}},
    }
    made = walk.post("make another", f"{path}s", config)
    walk.post("make it again", f"{path}s", config)
    walk.post("make a wrong one", f"{path}s", {"treshold_small_box": 60})
    walk.get("list configurations", f"{path}s")
    walk.get("one of them", f"/configs/{made['digest']}")
    walk.get("none of them", f"/configs/{'0' * 64}")
    preview = f"/datasets/{DATASET}/preview"
    walk.post("preview it", preview, {"config": config, "limit": 3, "bins": 2})
    walk.post("preview pixels", preview, {"config": {"profile": "carlasimu"}})
    for step, body in _RUNS.items():
        run = walk.post(step, f"/datasets/{DATASET}/runs", body)["id"]
        walk.wait(f"{step}: over", f"/runs/{run}")
        walk.get(f"{step}: diff", f"/runs/{run}/diff", limit=2)
        walk.get(f"{step}: events", f"/runs/{run}/events")
    walk.post(
        "run a wrong one",
        f"/datasets/{DATASET}/runs",
        {"config": {"evidence": "radar"}},
    )
    walk.post("run what is none", f"/datasets/{DATASET}/runs", {"config": 7})
    walk.get("list runs", f"/datasets/{DATASET}/runs")
    walk.post("cancel what is over", f"/runs/{run}/cancel")
    walk.get("no such run", "/runs/4000")
    walk.get("boxes by channels", "/boxes", dataset=DATASET, limit=50)
    walk.ask("activate none", "PUT", BASE + path, json={"digest": "0" * 64})
    digest = {"digest": before["digest"]}
    run = walk.ask("activate the first", "PUT", BASE + path, json=digest).json()["id"]
    walk.wait("activate the first: over", f"/runs/{run}")


_RUNS: Final[Mapping[str, dict[str, Any]]] = {
    "decide by thresholds": {"config": {"threshold_small_box": 60}},
    "decide and activate": {"config": {"min_visible_pixels": 30}, "activate": True},
    "measure as carlasimu": {"config": {"profile": "carlasimu"}, "activate": True},
    "measure by depth": {"config": {"evidence": "depth", "depth_tolerance": 0.5}},
    "measure by channels": {"config": {"evidence": "auto"}, "activate": True},
}


def _exports(walk: Walk) -> None:
    path = f"/datasets/{DATASET}/exports"
    made = walk.post("export", path, {"format": "kitti", "options": {"images": "none"}})
    walk.get("export: events", f"/exports/{made['id']}/events")
    over = walk.wait("export: over", f"/exports/{made['id']}")
    assert over["state"] == "done", over
    walk.get("list exports", path)
    download = f"{BASE}/exports/{made['id']}/download"
    walk.ask("download it", "GET", download)
    walk.ask("a part of it", "GET", download, headers={"Range": "bytes=0-3"})
    link = walk.post("an address of it", f"/exports/{made['id']}/download-links")
    walk.ask("download it there", "GET", link["url"], headers={"Authorization": ""})
    walk.post("cancel it", f"/exports/{made['id']}/cancel")
    walk.post("export to what is none", path, {"format": "ylo"})
    walk.post(
        "export with an option it lacks",
        path,
        {"format": "cvat", "options": {"bands": [9]}},
    )
    walk.get("no such export", "/exports/4000/download")


def _evaluations(walk: Walk) -> None:
    path = f"/datasets/{DATASET}/evaluations"
    run = walk.post("evaluate", path, {})["id"]
    walk.wait("evaluate: over", f"/runs/{run}")
    walk.get("evaluations", path)


def _people(walk: Walk) -> None:
    walk.get("who am I", "/session")
    token = {"name": "anna", "role": "viewer", "expires_in_days": 1}
    made = walk.post("make a token", "/tokens", token)
    walk.post("make a wrong token", "/tokens", {"name": "anna", "role": "king"})
    walk.get("list tokens", "/tokens")
    viewer = {"Authorization": f"Bearer {made['token']}"}
    body = {"name": "mine"}
    walk.post("a viewer makes a dataset", "/datasets", body, headers=viewer)
    none = {"Authorization": "Bearer none"}
    walk.ask("nobody lists", "GET", f"{BASE}/datasets", headers=none)
    code = walk.post("make a login code", "/login-codes", headers=viewer)
    used = f"{BASE}/login-codes/{code['id']}"
    walk.ask("whether it was used", "GET", used, headers=viewer)
    opened = walk.post("log in", "/session", {"code": code["code"]})
    walk.post("log in by the same code", "/session", {"code": code["code"]})
    page = {"Authorization": f"Bearer {opened['session']}"}
    walk.ask("log out", "DELETE", f"{BASE}/session", headers=page)
    walk.ask("log out again", "DELETE", f"{BASE}/session", headers=page)
    walk.ask("revoke it", "DELETE", f"{BASE}/tokens/{made['id']}")
    walk.get("the audit log", "/audit")


def _ends(walk: Walk) -> None:
    walk.ask("no such address", "GET", f"{BASE}/nothing")
    walk.ask("no such method", "PUT", f"{BASE}/datasets")
    text = {"Content-Type": "application/json"}
    walk.ask("no JSON", "POST", f"{BASE}/datasets", content=b"{", headers=text)
    walk.ask("alive", "GET", "/healthz")
    walk.ask("ready", "GET", "/readyz")
    walk.ask("version", "GET", "/version")
    walk.ask("metrics", "GET", "/metrics")
    path = f"{BASE}/datasets/short"
    walk.post("create a short one", "/datasets", {"name": "short"})
    first = street.frames()[0]
    frame = f"{path}/frames/{first.key}"
    walk.ask("upload into it", "PUT", frame, files=multipart(first))
    walk.ask("delete the frame", "DELETE", frame)
    walk.ask("delete the frame again", "DELETE", frame)
    _batches(walk, f"{path}/batches")
    walk.ask("delete it unasked", "DELETE", path)
    walk.ask("delete it", "DELETE", path, params={"confirm": "short"})
    walk.ask("delete it again", "DELETE", path, params={"confirm": "short"})


def _batches(walk: Walk, path: str) -> None:
    """Upload batches with frames that are new, already there, or refused."""
    first, second, _ = street.frames()
    other = Frame(second.key, {**second.annotation, "map": "Town01"}, second.files)
    cut = {**first.files, "segmentation": first.files["segmentation"][:900]}
    sent = [first, second, first, other, Frame("town/cut", first.annotation, cut)]
    wrong = Frame("town/wrong", {**first.annotation, "boxes": [{}]}, first.files)
    archive = tar_archive(
        [member for place in enumerate([*sent, wrong]) for member in members(*place)]
    )
    tar = {"headers": {"Content-Type": "application/x-tar"}}
    walk.ask("send many at once", "POST", path, content=archive, **tar)
    walk.ask("send them again", "POST", path, content=archive, **tar)
    newer = {"params": {"replace": "true"}, **tar}
    walk.ask(
        "send another", "POST", path, content=tar_archive(members(0, other)), **newer
    )
    walk.ask("send what is no archive", "POST", path, content=b"{}" * 512, **tar)
    walk.ask("send JSON", "POST", path, json={})
    none = f"{BASE}/datasets/none/batches"
    walk.ask("send them to no dataset", "POST", none, content=archive, **tar)


_PARTS: Final[tuple[Callable[[Walk], Any], ...]] = (
    _datasets,
    _uploads,
    _review,
    _queue,
    _configs,
    _exports,
    _evaluations,
    _people,
    _ends,
)
