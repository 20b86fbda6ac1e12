"""The real service compared with a model of it, after any sequence of requests.

By default it runs a few fixed sequences; ``make test-long`` tries 500 random ones
(MACHINE_RUNS).
"""

import io
import json
import os
import zipfile
from collections import Counter

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from tests.support import archives
from tests.support import frames as scene
from tests.support.hostile.model import RECTANGLES, THRESHOLDS, Content, Model
from tests.support.hostile.restarts import WAYS_TO_RESTART, Restarting
from tests.support.hostile.sequence_strategies import (
    ANSWERS,
    CONTENTS,
    FILTERS,
    FROM_PIXELS,
    KEYS,
    annotation_of,
    config_of,
    files_of,
    members_of,
)

RUNS = int(os.environ.get("MACHINE_RUNS", "3"))
IS_LONG = RUNS > 100
STEPS = 12
RESTART = 9 if IS_LONG else 3
"""Restarts take seconds: one happens only if this number, the highest, is drawn."""


class ServiceAgainstModel(RuleBasedStateMachine):
    """One dataset on a server that other sequences use, too, and a model of it."""

    place: Restarting

    def __init__(self) -> None:
        super().__init__()
        self.name = self.api.dataset()
        self.model = Model(THRESHOLDS[0])
        self._run(THRESHOLDS[0], {}, activate=True)

    @property
    def api(self):
        return self.place.api

    def _run(self, threshold, pixels, *, activate):
        config = config_of(threshold, pixels)
        run = self.api.run(self.name, config, activate=activate)
        assert (run["state"], run["error"]) == ("done", None)
        assert run["changed"] == self.model.run(threshold, activate=activate)

    @rule(key=KEYS, content=CONTENTS, replace=st.booleans())
    def upload(self, key, content, replace):
        expected = self.model.expected_status(key, content, replace=replace)
        response = self.api.put(
            self.name, key, annotation_of(content), replace=replace, **files_of(content)
        )
        assert response.status_code == expected, response.text
        if expected == 201:
            decisions = response.json()["decisions"]
            self.model.store(key, content, [box["box_id"] for box in decisions])

    @rule(data=st.data(), replace=st.booleans())
    def push(self, data, replace):
        # Keys are unique, as no list shows boxes that the same archive has replaced.
        by_key = (lambda frame: frame[0]) if replace else None
        several = st.lists(st.tuples(KEYS, CONTENTS), max_size=4, unique_by=by_key)
        frames = data.draw(several)
        members = [
            member
            for number, (key, content) in enumerate(frames)
            for member in members_of(number, key, content)
        ]
        newer = {"replace": "true"} if replace else {}
        archive = archives.tar_archive(members)
        response = archives.send(self.api, self.name, archive, **newer)
        *lines, end = archives.lines_of(response.text)
        assert end["frames"] == len(lines) == len(frames)
        for line, (key, content) in zip(lines, frames, strict=True):
            expected = self.model.expected_status(key, content, replace=replace)
            assert (line["key"], line["status"]) == (key, expected)
            if expected == 201:
                frame = self.api.json(f"/frames/{line['frame_id']}")
                ids = [box["box_id"] for box in frame["boxes"]]
                self.model.store(key, content, ids)

    @rule(key=KEYS, again=st.integers(0, 3))
    def delete(self, key, again):
        if again:  # delete in only one of four draws
            return
        response = self.api.http.delete(f"/api/v1/datasets/{self.name}/frames/{key}")
        there = self.model.frames.pop(key, None) is not None
        assert response.status_code == (204 if there else 404)

    @rule(
        threshold=st.sampled_from(THRESHOLDS),
        pixels=st.sampled_from(FROM_PIXELS),
        activate=st.booleans(),
    )
    def run(self, threshold, pixels, activate):
        self._run(threshold, pixels, activate=activate)

    @precondition(lambda self: self.model.boxes())
    @rule(data=st.data(), verdict=ANSWERS, is_late=st.booleans())
    def review(self, data, verdict, is_late):
        number = data.draw(st.sampled_from(sorted(self.model.boxes())))
        box = self.model.boxes()[number]
        seen = len(box.answers)
        if is_late and seen:
            late = self.api.review(number, verdict, seen - 1)
            assert late.status_code == 412
            assert late.json()["current"]["revision"] == seen
            return
        repeats = box.repeats(verdict)
        response = self.api.review(number, verdict, seen)
        assert response.status_code == (200 if repeats else 201), response.text
        if not repeats:
            box.answer(verdict)
        stored = response.json()
        assert stored["revision"] == len(box.answers)
        assert stored["effective_verdict"] == box.effective

    @precondition(lambda self: self.model.boxes())
    @rule(data=st.data(), verdict=ANSWERS)
    def bulk(self, data, verdict):
        numbers = sorted(self.model.boxes())
        ids = sorted(data.draw(st.sets(st.sampled_from(numbers), min_size=1)))
        seen = [len(self.model.boxes()[number].answers) for number in ids]
        body = {"dataset": self.name, "box_ids": ids, "verdict": verdict}
        response = self.api.post("/reviews/bulk", body | {"seen_revisions": seen})
        assert response.status_code == 201, response.text
        batch = response.json()
        count = self.model.new_in_bulk(ids, verdict)
        assert (batch["count"], batch["skipped"]) == (count, [])
        self.model.bulk(batch["id"], ids if count else [], verdict)

    @rule(filters=FILTERS)
    def filter(self, filters):
        page = self.api.json(
            "/boxes", dataset=self.name, limit=1000, count="true", **filters
        )
        expected = self.model.selected(filters)
        assert [box["box_id"] for box in page["items"]] == expected
        assert page["total"] == len(expected)

    @rule(filters=FILTERS, verdict=ANSWERS, is_late=st.sampled_from([0, 0, 0, 1]))
    def bulk_by_filter(self, filters, verdict, is_late):
        seen = self.api.json("/boxes", dataset=self.name, count="true", **filters)
        ids = self.model.selected(filters)
        if is_late and ids:
            box = self.model.boxes()[ids[0]]
            late = "keep" if box.review == "unsure" else "unsure"
            assert self.api.review(ids[0], late, len(box.answers)).is_success
            box.answer(late)
        body = {"dataset": self.name, "verdict": verdict, "filter": filters}
        response = self.api.post("/reviews/bulk", body | {"snapshot": seen["snapshot"]})
        if is_late and ids:
            assert (response.status_code, response.json()["code"]) == (
                412,
                "stale_snapshot",
            )
            return
        assert response.status_code == 201, response.text
        count = self.model.new_in_bulk(ids, verdict)
        assert response.json()["count"] == count
        self.model.bulk(response.json()["id"], ids if count else [], verdict)

    @precondition(lambda self: any(box.pile for box in self.model.boxes().values()))
    @rule(data=st.data())
    def undo_answer(self, data):
        answered = {id: box for id, box in self.model.boxes().items() if box.pile}
        number, box = data.draw(st.sampled_from(sorted(answered.items())))
        revision = data.draw(st.sampled_from([revision for revision, _ in box.pile]))
        undone = self.api.post(f"/boxes/{number}/reviews/{revision}/undo")
        if revision != box.pile[-1][0]:
            assert (undone.status_code, undone.json()["code"]) == (409, "not_in_force")
            return
        assert undone.status_code == 201, undone.text
        box.take_back()
        stored = undone.json()
        assert stored["revision"] == len(box.answers)
        assert stored["effective_verdict"] == box.effective

    @precondition(lambda self: self.model.batches)
    @rule(data=st.data())
    def undo(self, data):
        batch = data.draw(st.sampled_from(sorted(self.model.batches)))
        response = self.api.post(f"/review-batches/{batch}/undo")
        if batch in self.model.undone:
            assert (response.status_code, response.json()["code"]) == (
                409,
                "already_undone",
            )
            return
        assert response.status_code == 200, response.text
        undo = response.json()
        assert undo["undone"] == self.model.undo(batch, undo["id"])

    @rule(order=st.sampled_from(["doubt", "random", "class"]), limit=st.integers(1, 5))
    def queue(self, order, limit):
        filters = {"review": "undecided"}  # in doubt or not
        body = {"order": order, "limit": limit, "filters": filters}
        response = self.api.post(f"/datasets/{self.name}/queue", body).json()
        boxes = self.model.boxes()
        unanswered = [number for number, box in boxes.items() if box.review is None]
        unsure = [number for number, box in boxes.items() if box.review == "unsure"]
        assert (response["remaining"], response["unsure"]) == (
            len(unanswered),
            len(unsure),
        )
        ids = [box["box_id"] for box in response["items"]]
        assert len(set(ids)) == len(ids) == min(limit, len(unanswered) + len(unsure))
        first = ids[: len(unanswered)]
        assert set(first) <= set(unanswered)
        assert set(ids[len(first) :]) <= set(unsure)

    @rule(form=st.sampled_from(["decisions-jsonl", "yolo"]))
    def export(self, form):
        accepted = self.api.post(f"/datasets/{self.name}/exports", {"format": form})
        export = self.api.wait_for_job(accepted)
        assert export["state"] == "done", export
        response = self.api.get(f"/exports/{export['id']}/download")
        with zipfile.ZipFile(io.BytesIO(response.content)) as archive:
            texts = {
                name: archive.read(name).decode()
                for name in archive.namelist()
                if name.endswith((".txt", ".jsonl"))
            }
        boxes = self.model.boxes()
        if form == "yolo":
            labels = "".join(text for name, text in texts.items() if "labels/" in name)
            # Unmeasured boxes are exported as they came.
            left = [box for box in boxes.values() if box.effective != "rejected"]
            outside = [box for number, box in boxes.items() if self._is_outside(number)]
            assert len(labels.splitlines()) == sum(box not in outside for box in left)
            return
        (text,) = (text for name, text in texts.items() if name.endswith(".jsonl"))
        lines = map(json.loads, text.splitlines())
        assert {
            decision["box_id"]: (decision["verdict"], decision["effective_verdict"])
            for line in lines
            for decision in line["decisions"]
        } == {number: (box.verdict, box.effective) for number, box in boxes.items()}

    def _is_outside(self, number):
        return any(
            number in frame.boxes
            and frame.content.boxes[frame.boxes[number].place][0] >= scene.WIDTH
            for frame in self.model.frames.values()
        )

    @rule(lot=st.integers(0, RESTART), way=st.sampled_from(WAYS_TO_RESTART))
    def restart(self, lot, way):
        if lot == RESTART:
            self.place.restart(way)

    @invariant()
    def lists_and_counts_equal_the_model(self):
        boxes = self.model.boxes()
        shown = {
            box["box_id"]: (
                box["verdict"],
                box["effective_verdict"],
                (box["review"] or {}).get("verdict"),
                box["revision"],
            )
            for box in self.api.boxes(self.name, limit=1000)
        }
        assert shown == {
            number: (box.verdict, box.effective, box.review, len(box.answers))
            for number, box in boxes.items()
        }
        stats, expected = (
            self.api.json(f"/datasets/{self.name}/stats"),
            self.model.stats(),
        )
        assert {name: stats[name] for name in expected} == expected

    def teardown(self):
        """After each sequence, compare all frames and the history of each box."""
        if not hasattr(self, "model"):
            return
        frames = self.api.json(f"/datasets/{self.name}/frames")["items"]
        assert [frame["key"] for frame in frames] == sorted(self.model.frames)
        for number, box in self.model.boxes().items():
            items = self.api.json(f"/boxes/{number}/history", limit=1000)["items"]
            said = [
                (entry["revision"], entry["verdict"], entry["batch"])
                for entry in items
                if entry["kind"] == "review"
            ]
            assert sorted(said) == [
                (place, answer.verdict, answer.batch)
                for place, answer in enumerate(box.answers, start=1)
            ]
            decided = Counter(
                entry["verdict"] for entry in items if entry["kind"] == "decision"
            )
            assert decided == Counter(box.verdicts)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    restarting = Restarting(tmp_path_factory.mktemp("modelled") / "data")
    yield restarting
    restarting.close()


@pytest.mark.long
@pytest.mark.parametrize("way", WAYS_TO_RESTART)
def test_state_equals_the_model_after_each_kind_of_restart(place, way):
    ServiceAgainstModel.place = place
    state = ServiceAgainstModel()
    for key, shift in (("a", 0), ("b/ü", 10), ("b/c", None)):
        state.upload(key, Content(RECTANGLES, shift), replace=False)
    state.bulk_by_filter({"verdict": "kept"}, "reject", is_late=False)
    state.run(60, {"channel_order": "rgb"}, activate=True)
    state.bulk_by_filter({"conflict": "true"}, "unsure", is_late=False)

    state.restart(RESTART, way)

    state.lists_and_counts_equal_the_model()
    state.queue("doubt", 5)
    state.filter({"review": "unsure"})
    state.export("decisions-jsonl")
    state.upload("a", Content(RECTANGLES, 10), replace=True)
    state.lists_and_counts_equal_the_model()
    state.teardown()


@pytest.mark.timeout(14400)
def test_state_equals_the_model_after_any_sequence_of_operations(place):
    ServiceAgainstModel.place = place

    run_state_machine_as_test(
        ServiceAgainstModel,
        settings=settings(
            max_examples=RUNS,
            stateful_step_count=STEPS,
            derandomize=not IS_LONG,
            # A failing sequence is short already: to shorten it would take minutes.
            phases=(Phase.explicit, Phase.generate),
            report_multiple_bugs=False,
            database=None,
            deadline=None,
            suppress_health_check=list(HealthCheck),
        ),
    )
    print(f"{RUNS} sequences, {place.restarts} restarts")
