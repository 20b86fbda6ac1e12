"""An HTTP client of the service: one method for each thing a user does.

The methods return the responses of httpx unless they say otherwise.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count
from typing import Any

import httpx

from tests.support import frames as scene
from tests.support import plain_http

BASE = "/api/v1"
BY_TAGS = {"profile": "paper"}
"""The configuration of a dataset that is decided by tags, as in the paper."""
FINISHED = ("done", "failed", "cancelled")
MOST_LOOKS = 20_000
LOOK_EVERY_S = 0.03
"""Polling without a pause would take the processor from the run that is waited for."""
_numbers = count(1)


@dataclass(frozen=True)
class Api:
    """A client of a running service; it sends a token with each request."""

    http: httpx.Client

    @classmethod
    def at(cls, url: str, headers: Mapping[str, str]) -> Api:
        return cls(plain_http.Client(base_url=url, headers=headers))

    def get(self, path: str, **parameters: Any) -> httpx.Response:
        return self.http.get(BASE + path, params=parameters or None)

    def json(self, path: str, **parameters: Any) -> Any:
        """GET a path, which must be answered with 200, and return the parsed body."""
        response = self.get(path, **parameters)
        assert response.status_code == 200, response.text
        return response.json()

    def post(self, path: str, body: Any = None) -> httpx.Response:
        return self.http.post(BASE + path, json=body)

    def delete(self, path: str) -> httpx.Response:
        return self.http.delete(BASE + path)

    def all_items(self, path: str) -> list[Any]:
        """All items of a list, page by page."""
        items: list[Any] = []
        cursor: dict[str, str] | None = {}
        while cursor is not None:
            page = self.json(path, limit=1000, **cursor)
            items += page["items"]
            cursor = page["next_cursor"] and {"cursor": page["next_cursor"]}
        return items

    def person(self, role: str = "reviewer") -> Api:
        """A client of the same service, with a new token of this role."""
        body = {"name": f"person-{next(_numbers)}", "role": role}
        token = self.post("/tokens", body).json()["token"]
        return Api.at(str(self.http.base_url), {"Authorization": f"Bearer {token}"})

    def dataset(self, **body: Any) -> str:
        """Create a dataset with an unused name, and return the name."""
        name = f"street-{next(_numbers)}"
        response = self.post("/datasets", {"name": name, **body})
        assert response.status_code == 201, response.text
        return name

    def dataset_of_one_frame(
        self, *args: Any, config: Mapping[str, Any] | None = None, **more: Any
    ) -> str:
        """Create a dataset with one frame, "a", and return the name of the dataset.

        The other arguments are those of `put` after the key.
        """
        name = self.dataset(config=config)
        self.upload_frame(name, "a", *args, **more)
        return name

    def dataset_of_frames(self, count: int, **body: Any) -> str:
        """Create a dataset of so many frames, each with a car and a ghost.

        Their keys are numbers. The other arguments are those of `dataset`.
        """
        name = self.dataset(**body)
        for number in range(count):
            self.upload_frame(
                name, f"{number}", {**scene.annotation(), "number": number}
            )
        return name

    def dataset_of_cars(self, boxes: int) -> tuple[str, list[int]]:
        """Create a dataset with one frame, "a", of so many boxes; its name, their ids.

        All boxes are on the car of the frame.
        """
        name = self.dataset()
        cars = [{"class": "car", "xyxy": scene.ON_THE_CAR}] * boxes
        annotation = {**scene.annotation(), "boxes": cars}
        decisions = self.upload_frame(name, "a", annotation)["decisions"]
        return name, [box["box_id"] for box in decisions]

    def put(
        self,
        dataset: str,
        key: str,
        annotation: Any = None,
        *,
        replace: bool = False,
        **files: bytes,
    ) -> httpx.Response:
        """Upload a frame; by default the frame of `frames`, with a car and a ghost."""
        if annotation is None:
            annotation = scene.annotation()
        files = files or {"image": scene.image(), "segmentation": scene.segmentation()}
        if not isinstance(annotation, bytes):
            annotation = json.dumps(annotation).encode()
        return self.http.put(
            f"{BASE}/datasets/{dataset}/frames/{key}",
            files={"annotation": annotation, **files},
            params={"replace": "true"} if replace else None,
        )

    def upload_frame(self, dataset: str, key: str, *args: Any, **more: Any) -> Any:
        """Upload a frame, which must succeed, and return the body of the response."""
        response = self.put(dataset, key, *args, **more)
        assert response.status_code in (200, 201), response.text
        return response.json()

    def review(
        self, box_id: int, verdict: str, seen: int = 0, **more: Any
    ) -> httpx.Response:
        body = {"verdict": verdict, "seen_revision": seen, **more}
        return self.post(f"/boxes/{box_id}/reviews", body)

    def wait_for_job(self, accepted: httpx.Response) -> Any:
        """Wait until the run or export that a 202 announced has ended; returns it."""
        assert accepted.status_code == 202, accepted.text
        for _ in range(MOST_LOOKS):
            run = self.http.get(accepted.headers["location"]).json()
            if run["state"] in FINISHED:
                return run
            time.sleep(LOOK_EVERY_S)
        raise AssertionError(run)

    def run(self, dataset: str, config: Any, *, activate: bool = True) -> Any:
        body = {"config": config, "activate": activate}
        return self.wait_for_job(self.post(f"/datasets/{dataset}/runs", body))

    def remove(self, dataset: str) -> None:
        """Delete a dataset."""
        response = self.http.delete(f"{BASE}/datasets/{dataset}?confirm={dataset}")
        assert (response.status_code, response.content) == (204, b"")

    def boxes(self, dataset: str, **filters: Any) -> list[Any]:
        items: list[Any] = self.json("/boxes", dataset=dataset, **filters)["items"]
        return items

    def box_ids(self, dataset: str, **filters: Any) -> list[int]:
        """The server's ids of boxes."""
        return [box["box_id"] for box in self.boxes(dataset, **filters)]

    def verdicts(self, dataset: str) -> dict[str, str]:
        """The filter's verdicts by the sender's box ids; for a dataset of one frame."""
        return {box["id"]: box["verdict"] for box in self.boxes(dataset)}
