"""The review queue and its counts equal sorting and counting all boxes."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sqlalchemy import select

from app.boxes.counts import count_boxes, count_in_tallies
from app.boxes.current import TallyRepository
from app.boxes.filter import BoxFilter, BoxProbes, to_filter
from app.boxes.orders import BoxPages
from app.boxes.shuffle import HALF_BITS, Shuffle
from app.db.tables import Decision
from app.review.queue import QueueOrder, boxes_in_order
from tests.support import frames as scene
from unghost.wire.boxes import BoxSelection

EXAMPLES = 2 * settings().max_examples
BOXES = [
    {"class": name, "xyxy": xyxy, "distance": distance}
    for name, distance in (("car", 10.0), ("truck", 120.0), ("walker", None))
    for xyxy in (
        scene.ON_THE_CAR,
        scene.IN_THE_SKY,
        [20, 24, 60, 46],
        [15, 20, 64, 48],
        [0, 0, 64, 48],
        [90, 0, 99, 9],
    )
]
FILTERS = st.builds(
    BoxSelection,
    verdict=st.sampled_from([None, "kept", "rejected"]),
    class_name=st.sampled_from([None, "car", "truck,walker", "van"]),
    review=st.sampled_from(
        [None, "undecided", "none", "decided", "unsure", "reject", "any"]
    ),
    conflict=st.sampled_from([None, None, True, False]),
    effective=st.sampled_from([None, None, "kept"]),
    toss_up=st.sampled_from([None, None, True, False]),
    bin=st.sampled_from([None, None, "ask", "wall"]),
    margin_max=st.sampled_from([None, None, 5.0, 60.0]),
    match_min=st.sampled_from([None, None, 0.0, 30.0]),
    match_max=st.sampled_from([None, None, 50.0]),
    distance_max=st.sampled_from([None, None, 10.0]),
)


@pytest.fixture(scope="module")
def street(services):
    """Six frames with the same boxes; every third box has been answered."""
    street = services.dataset()
    for number in range(6):
        annotation = {**scene.annotation(), "boxes": BOXES, "number": number}
        street.put(f"{number}", annotation, segmentation=scene.segmentation())
    for place, box_id in enumerate(street.box_ids()[::3]):
        street.review(box_id, ["keep", "reject", "unsure", "clear"][place % 4])
    return street


def slow_queue_order(
    session, street, box_filter: BoxFilter, order: QueueOrder
) -> list[int]:
    """The ids of all boxes of the filter, in the order of the queue."""
    if order.name in ("random", "audit"):
        ids = street.box_ids()
        shuffle = Shuffle(ids[0], ids[-1], order.seed, order.half_bits)
        chosen = BoxProbes(session).every(box_filter)
        in_order = np.argsort(shuffle.places_of(chosen))
        return [int(box_id) for box_id in chosen[in_order]]
    sort = "id" if box_filter.review == "unsure" else "doubt"
    tallies = TallyRepository(session).of_dataset(street.id)
    listed, _ = BoxPages(session, box_filter, tallies).page(sort, "", 1000)
    if order.name == "doubt":
        return listed
    rows = session.execute(select(Decision.box_id, Decision.class_id))
    class_of = {row[0]: row[1] for row in rows}
    place = [each.class_id for each in box_filter.thresholds]
    return sorted(listed, key=lambda box_id: place.index(class_of[box_id]))


@pytest.mark.parametrize("half_bits", [HALF_BITS, 1], ids=["read all", "probe"])
@settings(max_examples=EXAMPLES, suppress_health_check=list(HealthCheck))
@given(
    chosen=FILTERS,
    name=st.sampled_from(["doubt", "random", "class", "audit"]),
    seed=st.sampled_from(["1", "2"]),
    limit=st.integers(1, 50),
    blocked=st.sets(st.integers(0, 107), max_size=30),
)
def test_queue_is_all_boxes_sorted_without_blocked_ones(
    street, half_bits, chosen, name, seed, limit, blocked
):
    ids = street.box_ids()
    with street.context.database.read() as session:
        box_filter = to_filter(session, street.row(session), chosen)
        tallies = TallyRepository(session).of_dataset(street.id)
        expected = count_in_tallies(tallies, box_filter)
        blocked_ids = {ids[n] for n in blocked}
        order = QueueOrder(name, seed, limit, blocked_ids, expected, half_bits)
        queue = boxes_in_order(session, box_filter, tallies, order)
        slow = slow_queue_order(session, street, box_filter, order)

    free = [box_id for box_id in slow if box_id not in order.blocked]
    assert queue == free[:limit]


@settings(max_examples=EXAMPLES, suppress_health_check=list(HealthCheck))
@given(chosen=FILTERS)
def test_box_counts_equal_counting_every_box(street, chosen):
    with street.context.database.read() as session:
        dataset = street.row(session)
        box_filter = to_filter(session, dataset, chosen)

        count = count_boxes(street.context, session, dataset, box_filter)

        assert count == BoxProbes(session).count(box_filter)
        assert count == len(BoxProbes(session).every(box_filter))
        assert count <= count_in_tallies(
            TallyRepository(session).of_dataset(street.id), box_filter
        )


def test_counts_of_a_match_range_follow_new_frames_and_reviews(services):
    street = services.dataset()
    selection = BoxSelection(match_min=50, review="none")
    counts = []

    for number in range(3):
        annotation = {**scene.annotation(), "boxes": BOXES, "number": number}
        street.put(f"{number}", annotation, segmentation=scene.segmentation())
        for answered in range(2):
            street.review(street.box_ids()[len(BOXES) * number + answered], "keep")
            with street.context.database.read() as session:
                dataset = street.row(session)
                box_filter = to_filter(session, dataset, selection)
                count = count_boxes(street.context, session, dataset, box_filter)
                counts.append((count, BoxProbes(session).count(box_filter)))

    assert all(count == counted for count, counted in counts)
    assert len({count for count, _ in counts}) > 2


@settings(max_examples=EXAMPLES)
@given(
    low=st.integers(0, 5000),
    count=st.integers(1, 200),
    seed=st.text(max_size=5),
    first=st.integers(1, 40),
)
def test_shuffle_yields_every_number_once_in_order_of_its_places(
    low, count, seed, first
):
    shuffle = Shuffle(low, low + count - 1, seed, min_half_bits=1)

    numbers = [n for part in shuffle.slices(first, 2, 64) for n in part]

    assert sorted(numbers) == list(range(low, low + count))
    places = shuffle.places_of(np.array(numbers, np.int64))
    assert (np.diff(places.astype(np.int64)) > 0).all()


def test_place_of_a_box_does_not_depend_on_other_boxes():
    ids = np.arange(1000, 2000)
    shares = Shuffle(1000, 1999, "7").shares_of(ids)

    grown = Shuffle(3, 60_000_000, "7").shares_of(ids)

    np.testing.assert_array_equal(shares, grown)
    assert len(np.unique(shares)) == len(ids)
    assert 0 < shares.min() < shares.max() <= 1


def test_first_slice_of_a_shuffle_is_evenly_distributed():
    shuffle = Shuffle(1, 1_000_000, "7")
    drawn = np.array(next(shuffle.slices(1 << 14, 1, 1 << 14)))

    in_tenths = np.bincount((drawn - 1) // 100_000, minlength=10)

    # The chi-squared statistic of ten equal parts is above 27.9 once in a thousand.
    expected = len(drawn) / 10
    assert ((in_tenths - expected) ** 2 / expected).sum() < 27.9
    neighbours = np.abs(np.diff(drawn))
    assert np.median(neighbours) > 200_000


def test_different_seeds_give_different_orders():
    ids = np.arange(1000)
    first, other = (np.argsort(Shuffle(0, 999, seed).places_of(ids)) for seed in "12")

    assert np.mean(first == other) < 0.02
