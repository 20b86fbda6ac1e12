"""Clients that write to a server until it dies, and note what it confirmed.

Each client has keys and boxes that no other client writes to. So the order of its
notes is the order in which the service must have stored its writes, and when the
server dies at most one of its writes is without an answer.
"""

import hashlib
import json
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Final

import httpx

from tests.support import archives
from tests.support import frames as scene
from tests.support.api import Api

VERDICTS: Final = ("keep", "reject", "unsure", "clear")


@dataclass
class WriteRecord:
    """The writes to one dataset: those that were confirmed, and those in flight."""

    dataset: str
    stored: dict[str, int] = field(default_factory=dict)
    """The number of the content that was confirmed under each key."""
    sending: dict[str, set[int]] = field(default_factory=dict)
    """Contents that were sent without an answer: the service may have them or not."""
    answers: dict[int, list[str]] = field(default_factory=dict)
    """The confirmed answers of each box, in order."""
    maybe_answers: list[tuple[frozenset[int], str]] = field(default_factory=list)
    """Unconfirmed acts: they must be stored for all these boxes or for none."""
    maybe_undone: list[frozenset[int]] = field(default_factory=list)
    digests: set[str] = field(default_factory=set)
    maybe_configs: int = 0
    runs: set[int] = field(default_factory=set)
    maybe_runs: int = 0

    def count_confirmed(self) -> int:
        """How many writes were confirmed."""
        said = sum(map(len, list(self.answers.values())))
        return len(self.stored) + said + len(self.digests) + len(self.runs)


def annotation(number: int) -> dict[str, Any]:
    """An annotation that differs for each number."""
    return {**scene.annotation(), "number": number}


def files(number: int) -> dict[str, bytes]:
    """The image and the segmentation of the frame with this number."""
    return {"image": scene.image(number), "segmentation": scene.segmentation()}


def digest(number: int) -> str:
    """The digest of a frame's content, computed as the documentation defines it."""
    lines = ["frame 1"]
    for name, content in sorted(files(number).items()):
        lines.append(f"{name} {hashlib.sha256(content).hexdigest()}")
    lines.append(json.dumps(annotation(number), sort_keys=True, separators=(",", ":")))
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


@dataclass(frozen=True)
class Writer:
    """One client with its own random numbers and its own boxes."""

    api: Api
    write_record: WriteRecord
    dice: random.Random
    name: str
    box_ids: tuple[int, ...]

    def write(self) -> None:
        """Write again and again until the server no longer answers."""
        acts: dict[str, Callable[[int], None]] = {
            "uploads": self._upload,
            "batches": self._push,
            "reviews": self._review,
            "bulk": self._bulk_and_undo,
            "configs": self._configure,
        }
        act = acts[self.name.partition(" ")[0]]
        try:
            for number in range(10**6):
                act(number)
        except httpx.TransportError:
            return

    def _upload(self, turn: int) -> None:
        key = f"{self.name}/{turn if self.dice.random() < 0.7 else 0}"
        number = 1 + turn
        self.write_record.sending[key] = {number}
        response = self.api.put(
            self.write_record.dataset,
            key,
            annotation(number),
            replace=True,
            **files(number),
        )
        assert response.status_code in (200, 201), response.text
        self._promised(key, number)

    def _promised(self, key: str, number: int) -> None:
        self.write_record.stored[key] = number
        self.write_record.sending.pop(key, None)

    def _push(self, turn: int) -> None:
        numbers = {f"{self.name}/{turn}-{place}": 10 + place for place in range(6)}
        members = [
            member
            for place, (key, number) in enumerate(numbers.items())
            for member in self._members(place, key, number)
        ]
        for key, number in numbers.items():
            self.write_record.sending[key] = {number}
        for line in self._lines(archives.tar_archive(members)):
            if "key" in line:
                assert line["status"] == 201, line
                self._promised(line["key"], numbers[line["key"]])

    def _members(self, place: int, key: str, number: int) -> archives.Members:
        document = json.dumps({**annotation(number), "key": key}).encode()
        parts = files(number).items()
        named = [(f"{place}.{kind}.png", content) for kind, content in parts]
        return [(f"{place}.json", document), *named]

    def _lines(self, archive: bytes) -> Iterator[dict[str, Any]]:
        """Send a batch; yield each line as it arrives, until the server ends."""
        url = f"/api/v1/datasets/{self.write_record.dataset}/batches"
        headers = {"Content-Type": "application/x-tar"}
        with self.api.http.stream(
            "POST", url, content=archive, headers=headers
        ) as response:
            assert response.status_code == 200
            for line in response.iter_lines():
                yield json.loads(line)

    def _review(self, turn: int) -> None:
        box_id, verdict = self.dice.choice(self.box_ids), self.dice.choice(VERDICTS)
        said = self.write_record.answers.setdefault(box_id, [])
        act = (frozenset({box_id}), verdict)
        self.write_record.maybe_answers.append(act)
        response = self.api.review(box_id, verdict, len(said), comment=str(turn))
        assert response.status_code == 201, response.text
        said.append(verdict)
        self.write_record.maybe_answers.remove(act)

    def _bulk_and_undo(self, turn: int) -> None:
        verdict = self.dice.choice(VERDICTS)
        before = {box_id: self._latest(box_id) for box_id in self.box_ids}
        boxes, answers = frozenset(self.box_ids), self.write_record.answers
        self.write_record.maybe_answers.append((boxes, verdict))
        body = {
            "dataset": self.write_record.dataset,
            "box_ids": list(self.box_ids),
            "seen_revisions": [len(answers.get(box_id, [])) for box_id in self.box_ids],
            "verdict": verdict,
        }
        response = self.api.post("/reviews/bulk", body)
        assert response.status_code == 201, response.text
        self._record_answers(dict.fromkeys(self.box_ids, verdict))
        self.write_record.maybe_answers.remove((boxes, verdict))
        if self.dice.random() < 0.5:
            self.write_record.maybe_undone.append(boxes)
            undone = self.api.post(f"/review-batches/{response.json()['id']}/undo")
            assert undone.json()["undone"] == len(boxes), undone.text
            self._record_answers(before)
            self.write_record.maybe_undone.remove(boxes)

    def _latest(self, box_id: int) -> str:
        said = self.write_record.answers.get(box_id, [])
        return said[-1] if said else "clear"

    def _record_answers(self, verdicts: dict[int, str]) -> None:
        for box_id, verdict in verdicts.items():
            self.write_record.answers.setdefault(box_id, []).append(verdict)

    def _configure(self, turn: int) -> None:
        config = {"threshold_small_box": round(1 + turn * 0.01, 2)}
        path = f"/datasets/{self.write_record.dataset}"
        self.write_record.maybe_configs += 1
        response = self.api.post(f"{path}/configs", config)
        assert response.status_code in (200, 201), response.text
        self.write_record.digests.add(response.json()["digest"])
        self.write_record.maybe_configs -= 1
        self.write_record.maybe_runs += 1
        body = {"config": response.json()["digest"], "activate": turn % 2 == 0}
        run = self.api.post(f"{path}/runs", body)
        assert run.status_code == 202, run.text
        self.write_record.runs.add(run.json()["id"])
        self.write_record.maybe_runs -= 1
