"""A simple model of one dataset, to compare the service's answers with.

It uses plain lists and dictionaries, decides by counting single pixels, and undoes
answers from a stack for each box. It shares no code with the service, only the words
of the API.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from tests.support import frames as scene

CAR: Final = 14
KEPT, REJECTED, UNMEASURED = "kept", "rejected", "unmeasured"
VERDICT_OF_ANSWER: Final = {"keep": KEPT, "reject": REJECTED}
OUTSIDE: Final = (90, 0, 99, 9)
RECTANGLES: Final = (
    tuple(scene.ON_THE_CAR),
    tuple(scene.IN_THE_SKY),
    (0, 0, scene.WIDTH, scene.HEIGHT),
    (30, 20, 64, 48),
    OUTSIDE,
)
THRESHOLDS: Final = (5, 40, 60)
"""In percent; the match of no rectangle in any scene equals one of them."""


@dataclass(frozen=True)
class Content:
    """A frame: its rectangles, and its car's shift (None: without a segmentation)."""

    boxes: tuple[tuple[int, ...], ...]
    shift: int | None
    number: int = 0

    def verdict(self, place: int, threshold: int) -> str:
        """The verdict by the definition: the share of the box's pixels that are car."""
        x0, y0, x1, y1 = self.boxes[place]
        if self.boxes[place] == OUTSIDE:
            return REJECTED
        if self.shift is None:
            return UNMEASURED
        tags = scene.tags(self.shift)
        pixels = [int(tags[y, x]) for y in range(y0, y1) for x in range(x0, x1)]
        return KEPT if 100 * pixels.count(CAR) / len(pixels) >= threshold else REJECTED


@dataclass(frozen=True)
class RecordedAnswer:
    """One answer in a box's history."""

    verdict: str
    batch: int | None = None


@dataclass
class ModelBox:
    """A box of the newest revision of a frame."""

    place: int
    verdict: str
    answers: list[RecordedAnswer] = field(default_factory=list)
    pile: list[tuple[int, RecordedAnswer]] = field(default_factory=list)
    """Answers that are not undone, the newest last, each with its revision."""
    verdicts: list[str] = field(default_factory=list)

    @property
    def review(self) -> str | None:
        """The latest answer; None if there is none or it was cleared."""
        said = self.answers[-1].verdict if self.answers else "clear"
        return None if said == "clear" else said

    @property
    def effective(self) -> str:
        return VERDICT_OF_ANSWER.get(self.review or "", self.verdict)

    @property
    def is_contradicted(self) -> bool:
        """Whether a person's answer is the opposite of the filter's verdict."""
        return (self.review, self.verdict) in (("keep", REJECTED), ("reject", KEPT))

    def passes(self, filters: Mapping[str, str]) -> bool:
        """Whether a list with this filter shows the box."""
        review = self.review
        states = {
            "undecided": review not in VERDICT_OF_ANSWER,
            "decided": review in VERDICT_OF_ANSWER,
            "none": review is None,
            "any": review is not None,
            **{name: review == name for name in ("keep", "reject", "unsure")},
        }
        return (
            filters.get("verdict", self.verdict) == self.verdict
            and filters.get("effective", self.effective) == self.effective
            and (filters.get("conflict", "false") == "false" or self.is_contradicted)
            and states[filters.get("review", "none" if review is None else "any")]
        )

    def answer(self, verdict: str, batch: int | None = None) -> None:
        self.answers.append(RecordedAnswer(verdict, batch))
        self.pile.append((len(self.answers), self.answers[-1]))

    def repeats(self, verdict: str) -> bool:
        """Whether this would be the same answer again, which is not stored."""
        again = len(self.answers), RecordedAnswer(verdict, None)
        return bool(self.pile) and self.pile[-1] == again

    def take_back(self, undo: int | None = None) -> None:
        """Undo the newest answer that is not undone; `undo` is the undo of a batch."""
        self.pile.pop()
        before = self.pile[-1][1].verdict if self.pile else "clear"
        self.answers.append(RecordedAnswer(before, undo))

    def take_back_batch(self, batch: int, undo: int) -> bool:
        """Undo the newest answer if it belongs to this batch; whether it did."""
        if not self.pile or self.pile[-1][1].batch != batch:
            return False
        self.take_back(undo)
        return True


@dataclass
class ModelFrame:
    """The newest revision of the frame with a key."""

    content: Content
    boxes: dict[int, ModelBox]


@dataclass
class Model:
    """A dataset: its frames by key, and the active threshold."""

    threshold: int
    frames: dict[str, ModelFrame] = field(default_factory=dict)
    batches: dict[int, list[int]] = field(default_factory=dict)
    undone: set[int] = field(default_factory=set)
    runs: int = 0

    def boxes(self) -> dict[int, ModelBox]:
        """The boxes of all frames, by the server's id."""
        return {
            number: box
            for frame in self.frames.values()
            for number, box in frame.boxes.items()
        }

    def expected_status(self, key: str, content: Content, *, replace: bool) -> int:
        """The status code with which an upload must be answered."""
        frame = self.frames.get(key)
        if frame is None:
            return 201
        if frame.content == content:
            return 200
        return 201 if replace else 409

    def store(self, key: str, content: Content, box_ids: list[int]) -> None:
        """Store a new revision of a frame; unchanged boxes keep their answer."""
        before = self.frames.get(key)
        boxes: dict[int, ModelBox] = {}
        for place, number in enumerate(box_ids):
            box = ModelBox(place, content.verdict(place, self.threshold))
            box.verdicts.append(box.verdict)
            former = self._former(before, content, place)
            if former is not None and former.review is not None:
                box.answer(former.review)
            boxes[number] = box
        self.frames[key] = ModelFrame(content, boxes)

    @staticmethod
    def _former(
        before: ModelFrame | None, content: Content, place: int
    ) -> ModelBox | None:
        same = before is not None and before.content.boxes[place : place + 1] == (
            content.boxes[place],
        )
        if before is None or not same:
            return None
        return next(box for box in before.boxes.values() if box.place == place)

    def selected(self, filters: Mapping[str, str]) -> list[int]:
        """The ids of the boxes that a filter selects, sorted."""
        return sorted(
            number for number, box in self.boxes().items() if box.passes(filters)
        )

    def run(self, threshold: int, *, activate: bool) -> int:
        """Decide all boxes with this threshold; how many change their verdict."""
        changed = 0
        for frame in self.frames.values():
            for box in frame.boxes.values():
                verdict = frame.content.verdict(box.place, threshold)
                if verdict != box.verdict:
                    changed += 1
                    box.verdicts.append(verdict)
                if activate:
                    box.verdict = verdict
        if activate:
            self.threshold = threshold
        self.runs += 1
        return changed

    def new_in_bulk(self, box_ids: list[int], verdict: str) -> int:
        """How many boxes a bulk answer is stored on: none if all have it already."""
        boxes = [self.boxes()[box_id] for box_id in box_ids]
        is_repeated = all(
            box.pile
            and box.pile[-1][0] == len(box.answers)
            and box.pile[-1][1].verdict == verdict
            for box in boxes
        )
        return 0 if is_repeated else len(boxes)

    def bulk(self, batch: int, box_ids: list[int], verdict: str) -> None:
        for number in box_ids:
            self.boxes()[number].answer(verdict, batch)
        self.batches[batch] = box_ids

    def undo(self, batch: int, undo: int) -> int:
        """Undo a batch on the boxes where it is the newest answer; on how many."""
        boxes = self.boxes()
        of_batch = [boxes[number] for number in self.batches[batch] if number in boxes]
        self.undone.add(batch)
        return sum([box.take_back_batch(batch, undo) for box in of_batch])

    def stats(self) -> dict[str, Any]:
        """The counts under the names that the service uses."""
        boxes = list(self.boxes().values())
        verdicts = Counter(box.verdict for box in boxes)
        effective = Counter(box.effective for box in boxes)
        return {
            "frames": len(self.frames),
            "boxes": len(boxes),
            **{name: verdicts[name] for name in (KEPT, REJECTED, UNMEASURED)},
            "reviewed": sum(box.review in VERDICT_OF_ANSWER for box in boxes),
            "unsure": sum(box.review == "unsure" for box in boxes),
            "conflicts": sum(box.is_contradicted for box in boxes),
            "effective": {
                name: effective[name] for name in (KEPT, REJECTED, UNMEASURED)
            },
        }
