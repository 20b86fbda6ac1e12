"""Answers of people come back from a file of decisions, with reviewer and time."""

import json
import re
import zipfile
from datetime import datetime, timedelta, timezone
from itertools import count

import pytest

from tests.support import frames as scene
from tests.support.command_line import CommandLine
from unghost import Client, Forbidden

_numbers = count(1)


@pytest.fixture
def person(server, client):
    """Opens a client with the token of a person of a new name."""
    opened = []

    def make(role="reviewer"):
        token = client.create_token(f"person-{next(_numbers)}", role)
        opened.append(Client(server.url, token.token))
        return opened[-1], token.name, token.token

    yield make
    for opened_client in opened:
        opened_client.close()


@pytest.fixture
def answered(client, person):
    """A dataset with two frames, whose first two boxes two people have answered."""
    name = f"answered-{next(_numbers)}"
    client.create_dataset(name)
    for key in ("run/1", "run/2"):
        scene.put(client, name, key)
    boxes = list(client.boxes(name))
    for box, verdict in zip(boxes, ("reject", "unsure"), strict=False):
        reviewer, _, _ = person()
        reviewer.review(box.box_id, verdict, seen_revision=0, comment=f"as {verdict}")
    return name


def marks(client, dataset):
    """The answers in force by frame and box: verdict, reviewer, comment and time."""
    return {
        (box.frame, box.id): (
            *(box.review.verdict, box.review.reviewer),
            *(box.review.comment, box.review.created_at),
        )
        for box in client.boxes(dataset)
        if box.review
    }


def exported(client, dataset, folder, form="decisions-jsonl"):
    """The unpacked export of a dataset."""
    done = client.wait_for_export(client.start_export(dataset, form))
    archive = client.download(done, folder / "decisions.zip")
    with zipfile.ZipFile(archive) as packed:
        packed.extractall(folder / "decisions")
    return folder / "decisions"


def push(server, folder, dataset, token, tmp_path, *options):
    settings = {"UNGHOST_SERVER": server.url, "UNGHOST_TOKEN": token}
    unghost = CommandLine(tmp_path, settings)
    return unghost("push", folder, "--dataset", dataset, *options)


def test_answers_of_a_file_come_back_with_reviewer_and_time(
    server, client, answered, tmp_path
):
    folder = exported(client, answered, tmp_path)
    before = marks(client, answered)
    again = f"{answered}-again"

    first = push(server, folder, again, server.token, tmp_path)
    second = push(server, folder, again, server.token, tmp_path)

    assert len(before) == 2
    assert marks(client, again) == before
    rectangles = [
        {(box.frame, box.id): box.xyxy for box in client.boxes(name)}
        for name in (answered, again)
    ]
    assert rectangles[0] == rectangles[1]
    assert "answers of people: 2 imported, 0 there already" in first.err
    assert "answers of people: 0 imported, 2 there already" in second.err
    box = next(box for box in client.boxes(again) if box.review)
    entry, *_ = client.history(box.box_id)
    assert (entry.reviewer, entry.imported_by) == (box.review.reviewer, "admin")
    noted = [entry for entry in client.audit() if entry.action == "reviews.imported"]
    (about,) = [entry for entry in noted if entry.subject == again]
    assert (about.actor, about.details["answers"]) == ("admin", 2)


META = (
    "<task><name>t</name><updated>2026-11-29 10:00:00.25+00:00</updated>"
    "<owner><username>boss</username></owner>"
    "<assignee><username>ada</username></assignee></task>"
)


def edited_cvat(folder):
    """As CVAT saves it: one box deleted, one moved, one drawn; nothing of ours else."""
    text = (folder / "annotations.xml").read_text("utf-8")
    _, _, images = text.partition("</meta>")
    drawn = '    <box label="car" xtl="1" ytl="1" xbr="9" ybr="9"/>\n'
    images = re.sub("    <box.*?</box>\n", drawn, images, count=1, flags=re.DOTALL)
    images = images.replace('xbr="', 'xbr="1', 2).replace('xbr="19"', 'xbr="9"')
    edited = folder.parent / "from-cvat.xml"
    edited.write_text(f"<annotations><meta>{META}</meta>{images}", "utf-8")
    return edited


def edited_label_studio(folder):
    """As Label Studio saves it: one task submitted without a box, one left alone."""
    first, second = json.loads((folder / "tasks.json").read_text("utf-8"))
    at = {"created_at": "2026-11-28T09:00:00Z", "updated_at": "2026-11-28T09:00:00Z"}
    first["annotations"][0] |= {
        **at,
        "lead_time": 9.5,
        "completed_by": {"email": "ada"},
    }
    first["annotations"][0]["updated_at"] = "2026-11-29T10:00:00.250000Z"
    second["annotations"][0] |= {**at, "lead_time": None, "completed_by": 3}
    del first["annotations"][0]["result"][0]
    edited = folder.parent / "from-label-studio.json"
    edited.write_text(json.dumps([first, second]), "utf-8")
    return edited


@pytest.mark.parametrize(
    ("form", "edit"), [("cvat", edited_cvat), ("label-studio", edited_label_studio)]
)
def test_boxes_kept_and_deleted_in_another_program_are_answers(
    server, client, tmp_path, form, edit
):
    name = f"edited-{form}"
    client.create_dataset(name)
    boxes = [{"id": n, "class": "car", "xyxy": scene.ON_THE_CAR} for n in "abc"]
    for key in ("run/1", "run/2"):
        scene.put(client, name, key, boxes=boxes)
    folder = exported(client, name, tmp_path, form)
    edited = edit(folder)
    labelled = ("run/1", "run/2") if form == "cvat" else ("run/1",)
    expected = {(key, box["id"]): "keep" for key in labelled for box in boxes}
    expected["run/1", "a"] = "reject"

    results = [
        push(server, folder, name, server.token, tmp_path, "--edited", edited)
        for _ in range(2)
    ]

    imported = marks(client, name)
    assert {place: mark[0] for place, mark in imported.items()} == expected
    at = datetime(2026, 11, 29, 10, 0, 0, 250_000, timezone.utc)
    assert {
        (mark[1], datetime.fromisoformat(mark[3])) for mark in imported.values()
    } == {("ada", at)}
    assert all(result.code == 0 for result in results), results[0].err
    assert f"answers of people: {len(expected)} imported" in results[0].err
    assert f"answers of people: 0 imported, {len(expected)} there" in results[1].err
    if form == "cvat":
        assert "1 boxes are new" in results[0].err
        assert "1 boxes have another class" in results[0].err
    else:
        assert "1 frames were not: no answers" in results[0].err
    assert client.stats(name).frames == 2


def test_newer_answers_stay_and_others_are_told(client, answered):
    box, *_ = (box for box in client.boxes(answered) if box.review)
    now = datetime.now(timezone.utc)
    line = {"frame": box.frame, "box": box.id, "verdict": "keep", "reviewer": "old"}

    def imported(at, **more):
        answer = {**line, "created_at": at.isoformat(), **more}
        return client.import_answers(answered, [answer])

    earlier = imported(now - timedelta(days=1))
    elsewhere = imported(now, box="none")
    later = imported(now + timedelta(days=9), reviewer="new")

    assert (earlier.newer, earlier.imported) == (1, 0)
    assert (elsewhere.unknown, elsewhere.unknown_boxes) == (1, (f"{box.frame} none",))
    assert later.imported == 1
    verdict, reviewer, _, at = marks(client, answered)[box.frame, box.id]
    assert (verdict, reviewer) == ("keep", "new")
    assert datetime.fromisoformat(at.replace("Z", "+00:00")) < now + timedelta(
        minutes=5
    )  # nobody answers in the future


def test_only_admins_import_answers(server, client, answered, person, tmp_path):
    reviewer, _, token = person()
    folder = exported(client, answered, tmp_path)

    with pytest.raises(Forbidden):
        reviewer.import_answers(answered, [])
    pushed = push(server, folder, f"{answered}-mine", token, tmp_path)

    assert "2 answers of people were not imported" in pushed.err
    assert marks(client, f"{answered}-mine") == {}
