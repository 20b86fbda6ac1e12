"""Boxes are read for display with few statements, and with those that overlap them."""

from collections.abc import Callable

import pytest
from sqlalchemy.orm import Session

from app.boxes.filter import to_filter
from app.boxes.frames import crop_of, describe_frame, overlay_of
from app.boxes.queries import PageRequest
from app.boxes.reader import DecisionReader, describe_box, list_boxes, read_box
from tests.support.sensors import ANNOTATION, cube, sensors
from tests.support.services import ServiceDataset
from tests.support.statements import statements_of
from unghost.wire.boxes import BoxSelection
from unghost.wire.frames import CropQuery, Frame, OverlayQuery

FRAMES = 6
OUTSIDE_M = 1000.0
"""Metres to the right: outside of the image."""


@pytest.fixture(scope="module")
def street(services) -> ServiceDataset:
    """Frames of four boxes: some explain others, one lies outside of the image."""
    street: ServiceDataset = services.dataset()
    for number in range(FRAMES):
        boxes = [cube(str(place), 10.0 + 3 * place + number) for place in range(4)]
        boxes[2]["box3d"]["transform"]["y"] = 12.0
        boxes[3]["box3d"]["transform"]["y"] = OUTSIDE_M
        street.put(str(number), {**ANNOTATION, "boxes": boxes}, **sensors())
    street.run({"evidence": "ordered"})
    for box_id in street.box_ids()[::4]:
        street.review(box_id, "keep")
    return street


def statements_run_by(
    street: ServiceDataset, read: Callable[[Session], object]
) -> list[str]:
    """The statements that `read` runs."""
    with (
        street.context.database.read() as session,
        statements_of(session.connection()) as statements,
    ):
        read(session)
    return [statement for statement, _ in statements]


def frame_id_of_box(street: ServiceDataset, box_id: int) -> int:
    with street.context.database.read() as session:
        frame_id: int = describe_box(session, box_id)["frame_id"]
        return frame_id


def reader_of_page(street: ServiceDataset, limit: int) -> Callable[[Session], object]:
    def read(session: Session) -> object:
        chosen = to_filter(session, street.row(session), BoxSelection())
        request = PageRequest("id", None, limit)
        reader = DecisionReader(session, street.row(session))
        return list_boxes(session, reader, chosen, request)

    return read


def count_selects_from(name: str, statements: list[str]) -> int:
    return sum(f"FROM {name}" in " ".join(text.split()) for text in statements)


def test_page_of_many_frames_needs_no_more_statements_than_one_frame(street):
    one_frame, many = reader_of_page(street, 3), reader_of_page(street, 3 * FRAMES)

    assert len(statements_run_by(street, many)) == len(
        statements_run_by(street, one_frame)
    )


def test_box_is_described_equally_singly_in_a_list_and_with_its_frame(street):
    with street.context.database.read() as session:
        chosen = to_filter(session, street.row(session), BoxSelection())
        request = PageRequest("crowding", None, 100)
        dataset = DecisionReader(session, street.row(session))
        listed, _ = list_boxes(session, dataset, chosen, request)
        alone = [describe_box(session, box["box_id"]) for box in listed]
        frames = sorted({box["frame_id"] for box in listed}, reverse=True)
        framed = dataset.records(dataset.read_frames(frames))

    assert len(listed) == 4 * FRAMES
    assert any(box["explained_by"] for box in listed)
    assert any(box["review"] for box in listed)
    assert alone == listed
    assert framed == sorted(listed, key=lambda box: box["box_id"])


def test_box_and_frame_are_read_with_one_statement_per_table(street):
    box_id = street.box_ids()[5]
    frame_id = frame_id_of_box(street, box_id)

    of_box = statements_run_by(street, lambda session: read_box(session, box_id))
    of_frame = statements_run_by(
        street, lambda session: describe_frame(session, frame_id)
    )

    for table in ("evidence", "decisions"):
        assert count_selects_from(table, of_box) == 1, table
    for table in ("evidence", "frame_files", "decisions", "reviews"):
        assert count_selects_from(table, of_frame) == 1, table


def test_crop_and_overlay_do_not_read_reviews(street):
    box_id, storage = street.box_ids()[0], street.context.storage
    frame_id = frame_id_of_box(street, box_id)
    crop, overlay = CropQuery(layer="segmentation"), OverlayQuery(layer="segmentation")

    statements = [
        *statements_run_by(
            street, lambda session: crop_of(storage, session, box_id, crop)
        ),
        *statements_run_by(
            street, lambda session: overlay_of(storage, session, frame_id, overlay)
        ),
    ]

    assert count_selects_from("reviews", statements) == 0


def test_neighbours_are_the_boxes_of_the_frame_that_overlap(street):
    with street.context.database.read() as session:
        shown = describe_frame(session, frame_id_of_box(street, street.box_ids()[4]))
        boxes = {box.box_id: box.xyxy for box in Frame.model_validate(shown).boxes}
        neighbours_of = {box_id: read_neighbours(session, box_id) for box_id in boxes}

    assert sum(xyxy is None for xyxy in boxes.values()) == 1
    assert any(neighbours_of.values())
    for box_id, neighbours in neighbours_of.items():
        expected = [other for other in boxes if overlap(box_id, other, boxes)]
        assert list(neighbours) == expected


def read_neighbours(session, box_id):
    _, record = read_box(session, box_id)
    return record.neighbours(0)


def overlap(box_id, other, boxes):
    a, b = boxes[box_id], boxes[other]
    if box_id == other or a is None or b is None:
        return False
    return all(a[axis] < b[axis + 2] and b[axis] < a[axis + 2] for axis in (0, 1))
