"""Doubt that another version of the code has stored is replaced as a service starts."""

from sqlalchemy import select, update

from app.db.tables import Dataset, Decision
from app.runs.activate import refresh_doubt
from filter_core.decisions.doubt import DOUBT_VERSION
from tests.support import frames as scene

BOXES = [
    {"class": "car", "xyxy": xyxy, "distance": distance}
    for xyxy in (scene.ON_THE_CAR, scene.IN_THE_SKY, [2, 2, 4, 4], [90, 0, 99, 9])
    for distance in (10, 20)
]


def stored(services, street):
    """The doubt about each box, and the version of the code that it is of."""
    with services.context.database.read() as session:
        rows = select(Decision.box_id, Decision.doubt).order_by(Decision.box_id)
        stored = session.execute(rows.where(Decision.dataset_id == street.id))
        return {row[0]: row[1] for row in stored}, street.row(session).doubt_version


def test_doubt_of_another_version_is_computed_again_with_its_tallies(services):
    street = services.dataset()
    for number in range(3):
        annotation = {**scene.annotation(), "boxes": BOXES, "number": number}
        street.put(f"{number}", annotation, segmentation=scene.segmentation())
    street.review(street.box_ids()[0], "keep")
    doubt, tallies = stored(services, street), street.tallies()
    with services.context.database.write() as session:
        of_dataset = Decision.dataset_id == street.id
        session.execute(update(Decision).where(of_dataset).values(doubt=7))
        this = Dataset.id == street.id
        session.execute(update(Dataset).where(this).values(doubt_version=0))

    refresh_doubt(services.context)

    assert stored(services, street) == doubt
    assert doubt[1] == DOUBT_VERSION
    assert {min(each, 1) for each in doubt[0].values()} == {1, 0, -1, -2}
    assert street.tallies() == tallies == street.recounted()
