"""Classes of a dataset: renamed, merged into others, removed."""

import io
import json
import zipfile

import pytest

from tests.support import frames as scene
from tests.support.api import BASE, Api
from tests.support.live import block_jobs
from unghost.wire.datasets import MAX_CLASSES

TAGS_ALONE = {"evidence": "semantic"}
"""With it, a renamed class is counted from stored tags; else images are read again."""


def boxes_named(*classes):
    """A frame with a box on its car for each class, and one in its sky."""
    boxes = [
        {"id": f"{name} {place}", "class": name, "xyxy": xyxy}
        for name in classes
        for place, xyxy in (("car", scene.ON_THE_CAR), ("sky", scene.IN_THE_SKY))
    ]
    return scene.annotation_of(*boxes)


def change(api, dataset, former, **body):
    return api.http.patch(f"{BASE}/datasets/{dataset}/classes/{former}", json=body)


def changed(api, dataset, former, **body):
    """Change a class, and wait for the run, which must succeed."""
    run = api.wait_for_job(change(api, dataset, former, **body))
    assert run["state"] == "done", run
    return run


def exported(api, dataset, form):
    """The files of an export by name."""
    done = api.wait_for_job(api.post(f"/datasets/{dataset}/exports", {"format": form}))
    assert done["state"] == "done", done
    content = api.http.get(done["download"]).content
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {
            name: archive.read(name).decode("latin-1") for name in archive.namelist()
        }


def shown_classes(api, dataset):
    """The classes in the histogram, and in a preview's histogram and counts."""
    response = api.post(f"/datasets/{dataset}/preview", {"config": TAGS_ALONE})
    assert response.status_code == 200, response.text
    preview = response.json()
    return (
        set(api.json(f"/datasets/{dataset}/histogram")["classes"]),
        set(preview["histograms"]["classes"]),
        set(preview["by_class"]),
    )


def named(api, dataset):
    """The class, verdict and answer of each box by its id."""
    return {
        box["id"]: (box["class"], box["verdict"], (box["review"] or {}).get("verdict"))
        for box in api.boxes(dataset)
    }


@pytest.mark.parametrize("config", [TAGS_ALONE, {"evidence": "auto"}])
def test_renamed_class_is_measured_as_its_new_name(api, config):
    name = api.dataset(classes=["Caar", "bus"])
    api.run(name, config)
    stored = api.upload_frame(name, "a", boxes_named("Caar"))
    before = named(api, name)
    api.review(stored["decisions"][1]["box_id"], "keep")

    changed(api, name, "Caar", name="car")
    api.upload_frame(name, "b", boxes_named("Caar"))
    dataset = api.json(f"/datasets/{name}")

    assert {verdict for _, verdict, _ in before.values()} & {"kept"} == set()
    assert dataset["classes"] == ["car", "bus"]
    assert dataset["renamed_classes"] == {"Caar": "car"}
    first, second = (api.json(f"/datasets/{name}/frames/{key}") for key in "ab")
    for frame in (first, second):
        assert [box["class"] for box in frame["boxes"]] == ["car", "car"]
        assert [box["verdict"] for box in frame["boxes"]] == ["kept", "rejected"]
    assert first["boxes"][1]["review"]["verdict"] == "keep"
    by_class = api.json(f"/datasets/{name}/stats")["by_class"]
    assert by_class == {"car": {"kept": 2, "rejected": 2, "unmeasured": 0}}
    assert (
        api.json("/boxes", dataset=name, **{"class": "car"}, count="true")["total"] == 4
    )
    assert api.boxes(name, **{"class": "Caar"}) == []


def test_merged_class_stays_merged_and_is_exported_by_its_new_name(api):
    name = api.dataset(classes=["car"])
    api.upload_frame(name, "a", boxes_named("car", "Caar"))

    run = changed(api, name, "Caar", merge_into="car")
    api.upload_frame(name, "b", boxes_named("Caar"))
    files = exported(api, name, "manifest")
    lines = [json.loads(line) for line in files["manifest.jsonl"].splitlines()]
    diff = api.json(f"/runs/{run['id']}/diff")

    assert api.json(f"/datasets/{name}")["classes"] == ["car"]
    assert {box["class"] for line in lines for box in line["boxes"]} == {"car"}
    manifest = json.loads(files["manifest.json"])
    assert manifest["class_names"] == list(manifest["counts"]["classes"]) == ["car"]
    assert {box["class"] for box in manifest["boxes"]} == {"car"}
    assert diff["by_class"] == {"car": diff["total"]}


def test_class_gets_its_former_name_back(api):
    name = api.dataset(classes=["bus", "car"])
    api.upload_frame(name, "a", boxes_named("car"))

    changed(api, name, "car", name="auto")
    assert api.json(f"/datasets/{name}")["classes"] == ["bus", "auto"]
    assert {verdict for _, verdict, _ in named(api, name).values()} & {"kept"} == set()
    changed(api, name, "auto", name="car")

    dataset = api.json(f"/datasets/{name}")
    assert dataset["classes"] == ["bus", "car"]
    assert dataset["renamed_classes"] == {"auto": "car"}
    assert named(api, name) == {
        "car car": ("car", "kept", None),
        "car sky": ("car", "rejected", None),
    }


def test_class_keeps_its_place_through_a_chain_of_renames(api):
    name = api.dataset(classes=["bus", "Caar", "van"])
    api.run(name, TAGS_ALONE)
    api.upload_frame(name, "a", boxes_named("Caar", "van"))
    assert shown_classes(api, name) == ({"Caar", "van"},) * 3

    for former, new in (("Caar", "caar"), ("caar", "car"), ("car", "auto")):
        changed(api, name, former, name=new)
        assert api.json(f"/datasets/{name}")["classes"] == ["bus", new, "van"]
        assert shown_classes(api, name) == ({new, "van"},) * 3

    changed(api, name, "auto", merge_into="van")
    assert api.json(f"/datasets/{name}")["classes"] == ["bus", "van"]
    assert shown_classes(api, name) == ({"van"},) * 3


def test_class_without_boxes_is_removed(api):
    name = api.dataset(classes=["car", "bus", "van"])
    api.upload_frame(name, "a", boxes_named("van"))
    path = f"/datasets/{name}/classes"

    used = api.delete(f"{path}/van")
    removed = api.delete(f"{path}/bus")
    again = api.delete(f"{path}/bus")

    assert (used.status_code, used.json()["code"]) == (409, "class_in_use")
    assert "has 2 boxes; merge it" in used.json()["detail"]
    assert (removed.status_code, again.status_code) == (204, 404)
    assert api.json(f"/datasets/{name}")["classes"] == ["car", "van"]
    api.upload_frame(name, "b", boxes_named("bus"))
    assert api.json(f"/datasets/{name}")["classes"] == ["car", "bus", "van"]
    run = changed(api, name, "car", name="auto")
    entries = api.json("/audit", limit=2)["items"]
    assert [entry["details"] for entry in entries] == [
        {"changed": ["classes"], "name": "auto", "former": "car", "run": run["id"]},
        {"changed": ["classes"], "removed": "bus"},
    ]


def boxes_of(*classes):
    boxes = [{"id": name, "class": name, "xyxy": scene.ON_THE_CAR} for name in classes]
    return scene.annotation_of(*boxes)


def test_classes_that_came_with_a_frame_go_with_it(api):
    name = api.dataset(classes=["car", "bus"])
    invented = [f"dragon {number}" for number in range(MAX_CLASSES - 3)]
    api.upload_frame(name, "a", boxes_of("car", *invented))
    api.upload_frame(name, "b", boxes_of("griffin"))
    api.put(name, "b", boxes_of("dragon 7"), replace=True)

    full = api.put(name, "c", boxes_of("hydra"))
    api.delete(f"/datasets/{name}/frames/a")
    left = api.json(f"/datasets/{name}")["classes"]
    more = [f"hydra {number}" for number in range(MAX_CLASSES - 3)]
    refused = api.put(name, "c", boxes_of(*more))
    api.upload_frame(name, "c", boxes_of(*more[1:]))

    assert (full.status_code, refused.status_code) == (422, 422)
    assert left == ["car", "bus", "dragon 7"]
    assert f"found {MAX_CLASSES + 1} with" in refused.json()["detail"]
    assert "(1 of them was renamed or removed)" in refused.json()["detail"]
    assert set(api.json(f"/datasets/{name}")["classes"]) == {*left, *more[1:]}
    assert set(shown_classes(api, name)[0]) == {"dragon 7", *more[1:]}


def test_classes_of_a_deleted_frame_stay_where_others_need_them(api):
    """A renamed class, whose name boxes come with, and the numbers of an export."""
    name = api.dataset(classes=["tram"])
    api.upload_frame(name, "a", boxes_of("Caar", "bus", "van"))
    api.upload_frame(name, "b", boxes_of("bus"))
    changed(api, name, "Caar", name="car")

    api.delete(f"/datasets/{name}/frames/a")
    renamed = api.json(f"/datasets/{name}")["classes"]
    api.upload_frame(name, "a", boxes_of("Caar", "van"))
    exported(api, name, "yolo")
    api.delete(f"/datasets/{name}/frames/a")

    assert renamed == ["tram", "car", "bus"]
    assert api.json(f"/datasets/{name}")["classes"] == [*renamed, "van"]
    assert api.put(name, "c", boxes_of("Caar", "van")).status_code == 201


@pytest.mark.parametrize(
    ("form", "is_frozen"),
    [("yolo", True), ("coco", True), ("kitti", False), ("decisions-csv", False)],
)
def test_only_a_format_with_class_numbers_freezes_the_classes(api, form, is_frozen):
    name = api.dataset(classes=["car", "bus"])
    api.upload_frame(name, "a")

    exported(api, name, form)
    removed = api.delete(f"/datasets/{name}/classes/bus")
    response = change(api, name, "car", name="auto")

    assert api.json(f"/datasets/{name}")["classes_frozen"] is is_frozen
    if is_frozen:
        assert (response.status_code, response.json()["code"]) == (
            409,
            "classes_frozen",
        )
        assert "configuration with `classes: {car: NAME}`" in response.json()["detail"]
        assert removed.json()["code"] == "classes_frozen"
    else:
        assert (response.status_code, removed.status_code) == (202, 204)


IMPOSSIBLE: tuple[tuple[str, dict[str, str], int, str], ...] = (
    ("car", {"name": "bus"}, 409, "class_exists"),
    ("car", {"merge_into": "car"}, 409, "same_class"),
    ("car", {"merge_into": "bsu"}, 404, "not_found"),
    ("cra", {"name": "auto"}, 404, "not_found"),
    ("car", {"name": "auto", "merge_into": "bus"}, 422, "invalid_request"),
    ("car", {}, 422, "invalid_request"),
)


def test_change_that_cannot_be_made_is_refused(api):
    name = api.dataset(classes=["car", "bus"])
    for former, body, status, code in IMPOSSIBLE:
        response = change(api, name, former, **body)
        assert (response.status_code, response.json()["code"]) == (status, code), body
        if status == 404:
            meant = "car" if former == "cra" else "bus"
            assert f"did you mean '{meant}'?" in response.json()["detail"]


def test_classes_that_were_renamed_or_removed_count_as_well(api):
    name = api.dataset(classes=[f"class {number}" for number in range(MAX_CLASSES - 1)])
    changed(api, name, "class 7", name="car")
    api.delete(f"/datasets/{name}/classes/class 8")

    renamed = change(api, name, "class 9", name="bus")
    frame = api.put(name, "a", boxes_named("griffin"))
    reused = api.put(name, "b", boxes_named("class 8"))
    changed(api, name, "class 9", merge_into="car")
    changed(api, name, "car", name="class 7")

    classes = f"expected at most {MAX_CLASSES} classes in dataset {name!r}, found "
    for response, status in ((renamed, 409), (frame, 422)):
        problem = response.json()
        assert (response.status_code, problem["code"]) == (status, "too_many_classes")
        assert classes + f"{MAX_CLASSES + 1} with" in problem["detail"]
        assert "2 of them were renamed or removed" in problem["detail"]
    assert reused.status_code == 201
    assert api.json(f"/datasets/{name}")["classes"][7:9] == ["class 7", "class 8"]


def test_while_a_run_renames_nothing_may_depend_on_numbers(serve):
    """Frames that arrive meanwhile are renamed, too; cancelled, it changes nothing."""
    service = serve(workers=1)
    engine = service.app.state.services.engine
    with service.admin() as http:
        api = Api(http)
        name = api.dataset(classes=["Caar", "bus"])
        api.upload_frame(name, "a", boxes_named("Caar"))
        before = api.json(f"/datasets/{name}"), api.boxes(name)
        assert shown_classes(api, name) == ({"Caar"},) * 3

        with block_jobs(engine):
            cancelled = change(api, name, "Caar", name="car")
            assert shown_classes(api, name) == ({"Caar"},) * 3
            export = api.post(f"/datasets/{name}/exports", {"format": "yolo"})
            second = change(api, name, "bus", name="coach")
            api.post(f"/runs/{cancelled.json()['id']}/cancel")
        assert api.wait_for_job(cancelled)["state"] == "cancelled"
        assert (api.json(f"/datasets/{name}"), api.boxes(name)) == before
        assert shown_classes(api, name) == ({"Caar"},) * 3

        with block_jobs(engine):
            run = change(api, name, "Caar", name="car")
            api.upload_frame(name, "b", boxes_named("Caar"))
        assert api.wait_for_job(run)["state"] == "done"

        refused = [
            (response.status_code, response.json()["code"])
            for response in (export, second)
        ]
        assert refused == [(409, "classes_change")] * 2
        assert {box["class"] for box in api.boxes(name)} == {"car"}
        assert api.json(f"/datasets/{name}")["classes"] == ["car", "bus"]
        assert api.json(f"/datasets/{name}")["classes_frozen"] is False
        assert shown_classes(api, name) == ({"car"},) * 3
