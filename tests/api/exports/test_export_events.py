"""The stream of events of an export, which works as that of a run does."""

import pytest

from tests.support.archives import frame, send, tar_archive
from tests.support.event_reader import events, open_events

FRAMES = 30


@pytest.fixture(scope="module")
def dataset(api) -> str:
    name: str = api.dataset()
    send(
        api, name, tar_archive([file for n in range(FRAMES) for file in frame(f"{n}")])
    )
    return name


@pytest.fixture(scope="module")
def export_id(api, dataset) -> int:
    return start_export(api, dataset)


def start_export(api, dataset) -> int:
    response = api.post(f"/datasets/{dataset}/exports", {"format": "yolo"})
    assert response.status_code == 202, response.text
    number: int = response.json()["id"]
    return number


def test_export_events_end_with_a_download_link(api, export_id):
    sent = events(api, export_id, of="exports")
    numbers = [int(event.id) for event in sent]

    assert [event.name for event in sent][-2:] == ["progress", "end"]
    assert numbers == sorted(set(numbers))
    assert sent[-1].data == api.json(f"/exports/{export_id}")
    assert (sent[-1].data["state"], sent[-1].data["done"]) == ("done", FRAMES)
    assert api.http.get(sent[-1].data["download"]).status_code == 200


def test_events_of_a_run_and_an_export_with_the_same_id_differ(start_api):
    _, api = start_api()
    name = api.dataset()
    number = start_export(api, name)
    while api.run(name, {})["id"] < number:
        pass

    with (
        open_events(api, number) as of_run,
        open_events(api, number, of="exports") as of_export,
    ):
        run, export = next(of_run).data, next(of_export).data

    assert (run["id"], export["id"]) == (number, number)
    assert ("config" in run, "format" in run) == (True, False)
    assert ("config" in export, "format" in export) == (False, True)
