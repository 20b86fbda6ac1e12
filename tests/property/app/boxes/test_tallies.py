"""The stored counts of boxes equal a recount after any sequence of operations."""

from contextlib import suppress

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from app.errors import Conflict, NotFound
from tests.support import frames as scene
from tests.support.services import ServiceDataset, Services

KEYS = st.sampled_from(["a", "b", "c"])
ANSWERS = st.sampled_from(["keep", "reject", "unsure", "clear"])
RECTANGLES = st.sampled_from(
    [
        scene.ON_THE_CAR,
        scene.IN_THE_SKY,
        [0, 0, 64, 48],
        [30, 20, 64, 48],
        [90, 0, 99, 9],
    ]
)
BOXES = st.lists(
    st.fixed_dictionaries(
        {
            "class": st.sampled_from(["car", "truck", "walker", "dragon"]),
            "xyxy": RECTANGLES,
        }
    ),
    max_size=4,
)
CONFIGS = st.fixed_dictionaries(
    {"threshold_small_box": st.sampled_from([2, 10, 60, 99])},
    optional={
        "classes": st.just({"walker": {"accept": ["Car"]}}),
        "profile": st.just("carlasimu"),
        "size_big_box": st.just(20),
    },
)


class RandomOperations(RuleBasedStateMachine):
    """Random sequences of uploads, reviews, undos, runs and deletions in a dataset."""

    services: Services

    def __init__(self) -> None:
        super().__init__()
        self.street: ServiceDataset = self.services.dataset()
        self.batches: list[int] = []

    @rule(key=KEYS, boxes=BOXES, shift=st.sampled_from([0, 10, None]))
    def put(self, key, boxes, shift):
        files = {} if shift is None else {"segmentation": scene.segmentation(shift)}
        annotation = {**scene.annotation(), "boxes": boxes}
        self.street.put(key, annotation, image=scene.image(), **files)

    @precondition(lambda self: self.street.box_ids())
    @rule(data=st.data(), verdict=ANSWERS)
    def review(self, data, verdict):
        box_id = data.draw(st.sampled_from(self.street.box_ids()))
        self.street.review(box_id, verdict)

    @precondition(lambda self: self.street.box_ids())
    @rule(data=st.data(), verdict=ANSWERS)
    def review_many(self, data, verdict):
        ids = data.draw(st.sets(st.sampled_from(self.street.box_ids()), min_size=1))
        self.batches.append(self.street.bulk(sorted(ids), verdict))

    @precondition(lambda self: self.batches)
    @rule(data=st.data())
    def undo(self, data):
        batch = data.draw(st.sampled_from(self.batches))
        with suppress(Conflict):  # it was undone already
            self.street.undo(batch)

    @rule(config=CONFIGS, activate=st.booleans())
    def run(self, config, activate):
        before = self.street.reasons()

        run = self.street.run(config, activate=activate)

        assert (run.state, run.error) == ("done", None)
        if not activate:
            assert self.street.reasons() == before

    @precondition(lambda self: len(self.batches) % 2 == 1)
    @rule(key=KEYS)
    def delete(self, key):
        with suppress(NotFound):
            self.street.delete(key)

    @invariant()
    def tallies_equal_a_recount(self):
        assert self.street.tallies() == self.street.recounted()


def test_tallies_equal_a_recount_after_any_sequence_of_operations(services):
    RandomOperations.services = services

    run_state_machine_as_test(
        RandomOperations,
        settings=settings(
            max_examples=max(settings().max_examples // 2, 1),
            stateful_step_count=15,
            deadline=None,
            suppress_health_check=list(HealthCheck),
        ),
    )
