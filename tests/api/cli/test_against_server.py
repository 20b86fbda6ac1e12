"""The command line against a real server: what it prints, and its exit codes."""

import asyncio
import fcntl
import json
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest
from typer.testing import CliRunner

from filter_core.segmentation.palettes import FAMILIES
from tests.support import frames
from tests.support.command_line import CommandLine
from tests.support.folders import LAYOUT_FILES, write_files
from tests.support.frames import write_manifest
from tests.support.pictures import jpeg, painted, png
from tests.support.ports import reserved_port
from tests.support.sensors import write_coarse_depth
from tests.support.servers import RunningServer, running_server
from unghost import AsyncClient, Client
from unghost.cli.program import app

DONE, REFUSED, USAGE, PARTLY, GATE, UNAVAILABLE, INTERRUPTED = 0, 1, 2, 3, 4, 69, 130


@pytest.fixture
def cli_without_server(tmp_path: Path) -> Iterator[CommandLine]:
    """The command line, pointed at a port where no server listens."""
    with reserved_port() as port:
        yield CommandLine(tmp_path, {"UNGHOST_SERVER": f"http://127.0.0.1:{port}"})


@pytest.fixture
def name(request: pytest.FixtureRequest) -> str:
    """The name of a dataset of the test's own."""
    test = str(request.node.name)
    plain = "".join(each if each.isalnum() else "-" for each in test)
    return f"cli-{plain.strip('-')[:80]}"


@pytest.fixture(scope="module")
def unchanged_dataset(server: RunningServer) -> str:
    """A dataset with the same three frames, for tests that change no verdict in it."""
    with Client(server.url, server.token) as client:
        name = client.create_dataset("cli-unchanged").name
        for number in range(3):
            frames.put(client, name, f"run/{number:06}", number)
    return name


@pytest.fixture
def pushed_dataset(unghost: CommandLine, name: str, tmp_path: Path) -> str:
    """A dataset with three frames."""
    assert unghost("push", frames_in(tmp_path, 3), "--dataset", name).code == DONE
    return name


def frames_in(folder: Path, count: int, **options: frozenset[int]) -> Path:
    return write_manifest(folder / f"frames-{count}", count, **options)


def write_config(folder: Path, text: str) -> Path:
    file = folder / "filter.yaml"
    file.write_text(text)
    return file


def test_push_creates_the_dataset_and_prints_counts(unghost, name, tmp_path):
    result = unghost("push", frames_in(tmp_path, 3), "--dataset", name)

    assert result.code == DONE
    assert result.out == (
        "3 stored\t0 already_there\t0 refused\t3 kept\t3 rejected\t0 unmeasured\n"
    )
    assert "3 of 3 frames" in result.err


def test_push_with_an_invalid_frame_exits_with_3_and_lists_it(unghost, name, tmp_path):
    folder = frames_in(tmp_path, 4, bad=frozenset({2}))
    invalid = frames_in(tmp_path, 2, bad=frozenset({0, 1}))

    result = unghost("push", folder, "--dataset", name)
    records = unghost("push", folder, "--dataset", f"{name}-json", "--json").records
    refused = unghost("push", invalid, "--dataset", f"{name}-invalid")

    assert (result.code, refused.code) == (PARTLY, REFUSED)
    assert "3 stored" in result.out
    assert 'refused: run/000002: box 0 (id "x"), xyxy[2]: expected' in result.err
    assert result.err.count('"wide"') == 1
    assert "Traceback" not in result.err
    outcomes = {each["key"]: each["outcome"] for each in records[:-1]}
    assert outcomes == {
        **{f"run/{number:06}": "stored" for number in (0, 1, 3)},
        "run/000002": "refused",
    }
    assert records[-1]["dataset"] == f"{name}-json"
    assert records[-1]["refused"] == 1


def test_push_uploads_no_file_outside_the_folder_unless_it_is_allowed(
    unghost, server, name, tmp_path
):
    folder = frames_in(tmp_path, 3)
    manifest = folder / "manifest.jsonl"
    linked, named = folder / "rgb/000001.png", folder / "rgb/000002.png"
    linked.symlink_to(linked.rename(tmp_path / "1.png"))
    private = named.rename(tmp_path / "2.png")
    manifest.write_text(manifest.read_text().replace("rgb/000002.png", str(private)))

    with Client(server.url, server.token) as client:
        refused = unghost("push", folder, "--dataset", name)
        stored = [frame.key for frame in client.frames(name)]
        one_root = unghost("push", folder, "--dataset", name, "--root", tmp_path)
        allowed = unghost("push", folder, "--dataset", name, "--outside-files")

    assert refused.code == PARTLY
    assert stored == ["run/000000"]
    for key, line in (("run/000001", 2), ("run/000002", 3)):
        assert (
            f"refused: {key}: manifest.jsonl, line {line}, image: expected a file in "
            "the manifest's folder, found"
        ) in refused.err
    assert "--outside-files (outside_files) allows all" in refused.err
    assert (one_root.code, allowed.code) == (DONE, DONE)
    assert "2 stored\t1 already_there" in one_root.out
    assert "3 already_there" in allowed.out


def test_push_and_export_name_a_class_that_is_not_known(unghost, name, tmp_path):
    manifest = frames_in(tmp_path, 2) / "manifest.jsonl"
    manifest.write_text(manifest.read_text().replace('"car"', '"caar"'))
    push = ("push", manifest, "--dataset", name)

    stopped = unghost(*push)
    stored = unghost("stats", name)
    results = [unghost(*push, "--allow-unmapped") for _ in range(2)]
    results.append(unghost("export", name, "--format", "kitti", "-o", tmp_path / "e"))

    assert (stopped.code, stored.code) == (REFUSED, REFUSED)
    assert "nothing was written" in stopped.err
    expected = (
        "4 boxes are unmeasured and exported as they came, since the filter does not "
        f"know their class: caar (4; `unghost classes merge {name} caar car`); "
        "`classes: {NAME: CLASS}`"
    )
    for result in results:
        assert (result.code, expected in result.err) == (PARTLY, True), result.err
    assert unghost("classes", "merge", name, "caar", "car").code == DONE
    assert unghost(*push).code == DONE


def test_export_names_boxes_of_a_class_that_only_one_of_two_versions_knows(
    unghost, server, name, tmp_path
):
    boxes = [{"class": "train", "xyxy": frames.ON_THE_CAR}]
    with Client(server.url, server.token) as client:
        client.create_dataset(name)
        for version, family in (("0.9.15", "carla-0.9.14"), ("0.9.12", "carla-0.9.10")):
            palette = FAMILIES[family]
            tags = np.full((frames.HEIGHT, frames.WIDTH), palette.tag_of("Sky"))
            tags[20:] = palette.tag_of("Train" if version == "0.9.15" else "Vehicle")
            client.put_frame(
                name,
                version,
                {**frames.annotation_of(*boxes), "carla_version": version},
                image=frames.image(),
                segmentation=png(painted(tags.astype(np.uint8), family)),
            )
        counts = client.stats(name)

    result = unghost("export", name, "--format", "kitti", "-o", tmp_path / "e")

    assert counts.by_class["train"].kept == 1
    assert counts.reasons_by_class == {"train": {"unmapped_class": 1, "visible": 1}}
    assert result.code == PARTLY
    assert "1 box is unmeasured" in result.err
    assert "since the filter does not know its class: train (1)" in result.err


def test_push_says_that_no_frame_has_a_box_also_when_repeated(unghost, name, tmp_path):
    write_files(tmp_path / "runs", {"Camera/1.png": None})
    push = ("push", "runs", "--dataset", name)

    first, again = unghost(*push), unghost(*push)

    for result in (first, again):
        assert result.code == DONE
        assert "no frame has a box (1 read, layout pairs, which expects" in result.err


def test_push_refuses_changed_frames_and_says_what_replacing_them_has_set_aside(
    unghost, server, pushed_dataset, tmp_path
):
    with Client(server.url, server.token) as client:
        frame = client.frame_by_key(pushed_dataset, "run/000001")
        (ghost,) = [box for box in frame.boxes if box.id == "ghost"]
        client.review(ghost.box_id, "keep", seen_revision=0)
    manifest = tmp_path / "frames-3" / "manifest.jsonl"
    lines = manifest.read_text().splitlines()
    # The key, the number of boxes and the kinds of files stay as they are.
    lines[1] = lines[1].replace('"id": "ghost"', '"id": "other"')
    manifest.write_text("\n".join(lines))
    again = ("push", tmp_path / "frames-3", "--dataset", pushed_dataset)

    refused = unghost(*again)
    replaced, repeated = (unghost(*again, "--replace") for _ in range(2))

    assert refused.code == PARTLY
    assert "0 stored\t2 already_there\t1 refused" in refused.out
    assert "another frame 'run/000001'" in refused.err
    assert (
        "1 frame has other content on the server; --replace replaces it" in refused.err
    )
    assert replaced.code == DONE
    assert "1 stored\t2 already_there\t0 refused" in replaced.out
    assert (
        "run/000001: 1 answer was set aside, on boxes that changed or are gone: ghost\n"
    ) in replaced.err
    assert replaced.out.endswith("\t1 answers_set_aside\n")
    assert "set aside" not in repeated.err + repeated.out


def test_push_says_how_images_were_read(unghost, name, tmp_path):
    folder, config = write_coarse_depth(tmp_path)

    text = unghost("push", folder, "--dataset", name, "--config", config)
    records = unghost(
        "push", folder, "--dataset", f"{name}-json", "--config", config, "--json"
    ).records

    note = "depth is not used as evidence: the depth image: "
    assert f"2 frames: {note}" in text.err
    assert text.err.count(note) == 1
    assert [record["notes"][0].startswith(note) for record in records[:2]] == [True] * 2


def test_push_names_the_family_of_tags_that_the_recording_shows(
    unghost, server, name, tmp_path
):
    folder = frames_in(tmp_path, 3)
    palette = FAMILIES["carla-0.9.10"]
    for number, tag in enumerate(("Road", "Terrain", "Road")):
        tags = np.full((frames.HEIGHT, frames.WIDTH), palette.tag_of(tag), np.uint8)
        tags[20:] = palette.tag_of("Vehicle")
        content = png(painted(tags, palette.name))
        (folder / f"seg/{number:06}.png").write_bytes(content)
    manifest = folder / "manifest.jsonl"
    without_version = manifest.read_text().replace('"carla_version": "0.9.15", ', "")
    manifest.write_text(without_version.replace('"car"', '"bus"'))
    with Client(server.url, server.token) as client:
        client.create_dataset(f"{name}-empty")
        client.create_dataset(f"{name}-used")
        frames.put(client, f"{name}-used", "x", 0)

    local = unghost("filter", folder, "-o", tmp_path / "local.jsonl")
    pushed = [
        unghost("push", folder, "--dataset", f"{name}{more}")
        for more in ("", "-empty", "-used")
    ]

    told = "tags of carla-0.9.10: told by 1 of the 3 segmentations"
    assert all(told in result.err for result in (local, *pushed))
    with Client(server.url, server.token) as client:
        for more in ("", "-empty"):
            dataset = client.dataset(f"{name}{more}")
            assert dataset.palette == "carla-0.9.10"
            assert f"\t{dataset.counts.kept} kept" in local.out
            assert dataset.counts.frames == 3
    assert "its settings do not name palette carla-0.9.10: each seg" in pushed[2].err
    assert "refused: " in pushed[2].err


def test_push_changes_the_settings_of_a_dataset_without_frames(
    unghost, server, name, tmp_path
):
    folder = frames_in(tmp_path, 2)
    for file in (folder / "seg").iterdir():
        file.write_bytes(jpeg(painted(frames.tags(), frames.FAMILY)))
    command = ("push", folder, "--dataset", name)

    refused = unghost(*command)
    stored = unghost(*command, "--lossy-segmentation", "nearest")
    other = unghost(*command, "--lossy-segmentation", "refuse")

    assert refused.code == REFUSED
    assert (
        "--lossy-segmentation nearest (lossy_segmentation: nearest in the settings of "
        "a dataset that has frames) reads it by the nearest colour"
    ) in refused.err
    assert (stored.code, stored.out[:8]) == (DONE, "2 stored")
    assert other.code == REFUSED
    assert "has lossy_segmentation 'nearest', not 'refuse'" in other.err


def test_interrupted_push_resumes_when_repeated(unghost, name, tmp_path):
    folder = frames_in(tmp_path, 80)
    command = ("push", folder, "--dataset", name, "--json", "--workers", 1)
    with unghost.running(*command) as process:
        # Too small for all its lines: the command waits for a reader, and does not end.
        fcntl.fcntl(process.stdout, fcntl.F_SETPIPE_SZ, 4096)
        first = process.stdout.readline()
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)

    assert '"stored"' in first
    assert process.returncode == INTERRUPTED
    assert "the same command continues" in err
    assert "Traceback" not in err
    again = unghost(*command).records[-1]
    assert again["already_there"] > 0
    assert again["stored"] + again["already_there"] == 80


def test_unavailable_server_exits_with_69(cli_without_server):
    result = cli_without_server("stats", "town", "--retry-for", 0)

    assert result.code == UNAVAILABLE
    assert "unghost: no response from http://127.0.0.1:" in result.err
    assert result.err.count("no response from") == 1
    assert "from UNGHOST_SERVER; --server URL or" in result.err
    assert "Traceback" not in result.err
    assert result.out == ""


def test_counts_are_tab_separated_lines_or_json_and_labels_a_file(
    unghost, unchanged_dataset, tmp_path
):
    listed = unghost("dataset", "list").out
    records = unghost("dataset", "list", "--json").records
    lines = unghost("stats", unchanged_dataset).out.splitlines()
    (stats,) = unghost("stats", unchanged_dataset, "--json").records
    result = unghost(
        "export", unchanged_dataset, "--format", "yolo", "-o", tmp_path / "out.zip"
    )

    assert f"{unchanged_dataset}\t3\t6\t3\t3\t0" in listed
    assert unchanged_dataset in [record["name"] for record in records]
    assert {"boxes\t6", "reason\tno_visible_pixels\t3\t50.0"} <= set(lines)
    assert "class\tcar\t6\t3\t3\t0\t50.0" in lines
    assert stats["by_reason"]["visible"] == 3
    assert (result.code, result.out) == (DONE, f"{tmp_path / 'out.zip'}\n")
    assert "3 of 6 boxes written, 3 left out; reasons: " in result.err
    assert (tmp_path / "out.zip").read_bytes()[:2] == b"PK"


def test_push_gives_a_new_dataset_what_its_folder_was_read_with(
    unghost, name, tmp_path
):
    described = {"segmentation": {"folder": "gt"}, "classes": {"Misc": "pass"}}
    files = {**LAYOUT_FILES["pairs"], "1.png": None, "gt/1.png": None}
    folder = write_files(
        tmp_path / "town", {**files, "recording.yaml": json.dumps(described)}
    )
    elsewhere = write_files(tmp_path / "tags", {"1.png": None})

    unghost("push", folder, "--dataset", name)
    unghost("push", folder, "--dataset", f"{name}-2", "--segmentation", elsewhere)

    kept = {
        record["name"]: record
        for record in unghost("dataset", "list", "--json").records
    }
    left = {"companions": {".": 1}}  # the segmentation beside the image
    assert kept[name]["recording"] == {"layout": "pairs", **described, **left}
    assert kept[f"{name}-2"]["recording"] == {
        "layout": "pairs",
        "classes": {"Misc": "pass"},
        "companions": {".": 1},
    }
    lines = unghost("dataset", "list").out.splitlines()
    line = next(line for line in lines if f"{name}\t" in line)
    assert line.endswith("\tdescribed")


def test_report_is_one_file_with_counts_exports_and_pictures(unghost, pushed_dataset):
    unghost(
        "export", pushed_dataset, "--format", "yolo", "--name", "v1", "-o", "v1.zip"
    )
    result = unghost("report", pushed_dataset, "-o", "report.html", "--json")

    assert result.code == DONE
    page = (unghost.folder / "report.html").read_text("utf-8")
    stats = unghost("stats", pushed_dataset, "--json").records[0]
    assert "<td>v1</td><td>yolo</td>" in page
    assert result.records == [{"output": "report.html", "boxes": stats["boxes"]}]
    assert f"{stats['boxes']:,} boxes" in page
    assert all(f"<td>{name}</td>" in page for name in stats["by_class"])
    assert "data:image/webp;base64," in page
    assert "http" not in page.replace("http://www.w3.org", "")


def test_config_show_diff_and_set(unghost, pushed_dataset, tmp_path):
    file = write_config(tmp_path, "min_visible_pixels: 500\n")

    assert "min_visible_pixels: 10" in unghost("config", "show", pushed_dataset).out
    compared = unghost("config", "diff", pushed_dataset, "--config", file)
    assert compared.out == "min_visible_pixels\t10\t500\n"
    assert "3 boxes would flip" in compared.err
    assert unghost("config", "set", pushed_dataset, file).code == DONE
    assert "min_visible_pixels: 500" in unghost("config", "show", pushed_dataset).out
    (record,) = unghost("stats", pushed_dataset, "--json").records
    assert record["rejected"] == 6


def test_gates_of_push_and_stats_end_with_4_and_name_the_figure(
    unghost, name, tmp_path
):
    gates = ("--fail-if", "rejected > 5%", "--fail-if", "refused > 0")

    pushed = unghost("push", frames_in(tmp_path, 2), "--dataset", name, *gates)
    counted = unghost("stats", name, *gates, "--json")

    assert (pushed.code, counted.code) == (GATE, GATE)
    for result in (pushed, counted):
        assert "gate failed: rejected > 5%, it is 50.00% (2 of 4 boxes)" in result.err
        assert "gate passed: refused > 0, it is 0" in result.err
    assert counted.records[0]["boxes"] == 4


def test_config_set_lists_what_returns_to_its_default_and_merge_keeps_it(
    unghost, name, server, tmp_path
):
    first = "size_big_box: 7\nclasses: {van: {threshold_small_box: 3, accept: [Car]}}\n"
    more = "min_visible_pixels: 3\nclasses: {van: {threshold_small_box: 4}}\n"
    with Client(server.url, server.token) as client:
        client.create_dataset(name)
        unghost("config", "set", name, write_config(tmp_path, first))
        file = write_config(tmp_path, more)

        merged = unghost("config", "set", name, file, "--merge")
        kept = client.active_config(name).config
        replaced = unghost("config", "set", name, file)
        left = client.active_config(name).config

    assert (merged.code, "default" in merged.err) == (DONE, False)
    assert (kept["size_big_box"], kept["min_visible_pixels"]) == (7, 3)
    assert kept["classes"]["van"] == {"threshold_small_box": 4, "accept": ["Car"]}
    assert [line for line in replaced.err.splitlines() if "default" in line] == [
        "size_big_box is not in filter.yaml and gets its default: 7 -> 70 "
        "(--merge keeps it)",
        'classes.van.accept is not in filter.yaml and gets its default: ["Car"] -> '
        "null (--merge keeps it)",
    ]
    assert left["classes"]["van"] == {"threshold_small_box": 4}


def test_config_show_tells_settings_of_the_dataset_that_are_used_instead(
    unghost, server, name, unchanged_dataset
):
    with Client(server.url, server.token) as client:
        client.create_dataset(name, lossy_segmentation="nearest")

    shown = unghost("config", "show", name)
    other = unghost("config", "show", unchanged_dataset)

    comment = "# the dataset's own setting is used: lossy_segmentation: nearest\n"
    assert comment in shown.out
    assert "\nlossy_segmentation: refuse\n" in shown.out
    assert "own setting" not in other.out


def test_run_wait_returns_when_the_run_is_done(unghost, unchanged_dataset, tmp_path):
    file = write_config(tmp_path, "min_visible_pixels: 500\n")

    result = unghost("run", unchanged_dataset, "--config", file, "--wait", "--json")

    assert result.code == DONE
    assert result.records[0]["state"] == "done"
    (stats,) = unghost("stats", unchanged_dataset, "--json").records
    assert stats["rejected"] == 3


def test_first_export_says_that_it_freezes_the_classes_even_of_an_empty_dataset(
    unghost, server, name, tmp_path
):
    with Client(server.url, server.token) as client:
        client.create_dataset(name, classes=["car"])
        command = ("export", name, "-o", tmp_path / "out.zip", "--format")

        of_names = unghost(*command, "kitti")
        first, second = unghost(*command, "yolo"), unghost(*command, "yolo")

        assert client.dataset(name).classes_frozen
    said = f"the classes of {name} are frozen from now on"
    has_said = [said in result.err for result in (of_names, first, second)]
    assert has_said == [False, True, False]
    assert "freezes" in unghost("export", "--help").out


def test_export_of_one_table_is_one_file_unless_a_zip_is_named(
    unghost, unchanged_dataset, tmp_path
):
    command = ("export", unchanged_dataset, "--format", "decisions-csv", "-o")

    table = unghost(*command, tmp_path / "out" / "dec.csv")
    archive = unghost(*command, tmp_path / "dec.zip")

    assert (table.code, archive.code) == (DONE, DONE), table.err
    assert [file.name for file in (tmp_path / "out").iterdir()] == ["dec.csv"]
    with ZipFile(tmp_path / "dec.zip") as opened:
        assert (tmp_path / "out" / "dec.csv").read_bytes() == opened.read(
            "decisions.csv"
        )


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("split=often", "--option split: expected a number"),
        ("split=2", "--option split: expected at most 1.0, found 2"),
        (
            "include=keptt",
            "--option include: expected 'effective', 'kept' or 'all', found 'keptt'",
        ),
    ],
)
def test_export_option_refused_by_the_server_is_named(
    server, unchanged_dataset, option, words
):
    result = CliRunner().invoke(
        app,
        [
            *("export", unchanged_dataset, "--format", "yolo", "-o", "x.zip"),
            *("-O", option, "--server", server.url, "--token", server.token),
        ],
    )

    assert result.exit_code == USAGE
    assert words in result.output


def test_refused_name_of_a_dataset_names_the_option_or_the_other_dataset(
    unghost, server, name, tmp_path
):
    with Client(server.url, server.token) as client:
        client.create_dataset(name.upper())
    folder = frames_in(tmp_path, 1)
    write_files(tmp_path / "town", {"labels/1.txt": "", "classes.txt": "car\n" * 2})

    result = unghost("push", folder, "--dataset", "Town 10")
    taken = unghost("push", folder, "--dataset", name)
    classes = unghost("push", tmp_path / "town", "--dataset", f"{name}-classes")

    assert result.code == USAGE
    assert "--dataset: expected 1 to 100 of a-z" in result.err
    assert result.err.rstrip().endswith(", found 'Town 10'")
    assert (taken.code, classes.code) == (REFUSED, REFUSED)
    said = f"--dataset {name}: a dataset {name.upper()!r} exists already"
    assert said in taken.err
    assert "classes" in classes.err


def test_classes_are_shown_merged_renamed_and_removed(unghost, name, tmp_path):
    """A misspelt class becomes the right one, also for frames that are pushed later."""
    source = frames_in(tmp_path, 2)
    text = (source / "manifest.jsonl").read_text()
    (source / "manifest.jsonl").write_text(text.replace('"car"', '"Caar"', 1))
    assert unghost("push", source, "--dataset", name).code in (DONE, PARTLY)

    merged = unghost("classes", "merge", name, "Caar", "car")
    renamed = unghost(
        "classes", "rename", name, "van", "minivan", "--no-wait", "--json"
    )
    assert unghost("wait", renamed.records[0]["id"]).code == DONE
    removed = unghost("classes", "remove", name, "bus")
    used = unghost("classes", "remove", name, "car")
    shown = {
        record["class"]: record
        for record in unghost("classes", "show", name, "--json").records
    }

    assert (merged.code, merged.out.split("\t")[1]) == (DONE, "done")
    assert (removed.code, removed.out) == (DONE, "bus\tremoved\n")
    assert (used.code, "has 4 boxes; merge it" in used.err) == (REFUSED, True)
    assert list(shown)[:4] == ["car", "truck", "minivan", "motorcycle"]
    assert (shown["car"]["boxes"], shown["car"]["former_names"]) == (4, ["Caar"])
    assert "Caar" in unghost("classes", "show", name).out


def test_command_that_waits_for_the_first_start_takes_its_token(tmp_path):
    data = tmp_path / "data"
    with reserved_port() as port:
        settings = {
            "UNGHOST_DATA": str(data),
            "UNGHOST_SERVER": f"http://127.0.0.1:{port}",
        }
        early = CommandLine(tmp_path, settings)
        with early.running("dataset", "list", "--json") as process:
            with pytest.raises(subprocess.TimeoutExpired):
                process.wait(1)
            with running_server(data, {"UNGHOST_PORT": str(port)}):
                out, err = process.communicate(timeout=60)

    assert (process.wait(), out) == (DONE, ""), err


def test_client_with_an_event_loop_takes_the_token_of_the_first_start(
    tmp_path, monkeypatch
):
    data = tmp_path / "data"
    monkeypatch.setenv("UNGHOST_DATA", str(data))

    async def role_of(url: str, settings: dict[str, str]) -> str:
        async with AsyncClient(url) as client:
            assert client.token is None
            with running_server(data, settings):
                return (await client.session()).role

    with reserved_port() as port:
        url, settings = f"http://127.0.0.1:{port}", {"UNGHOST_PORT": str(port)}
        assert asyncio.run(role_of(url, settings)) == "admin"
