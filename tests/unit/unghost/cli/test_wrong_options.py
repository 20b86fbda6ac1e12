"""A wrong command line is refused with exit code 2, before anything is done."""

import pytest
from typer.testing import CliRunner

from tests.support.frames import write_manifest
from unghost.cli.program import app

USAGE = 2
EXPORT = ("export", "town", "-o", "x.zip", "--format")


def run(*words):
    return CliRunner().invoke(app, [*map(str, words)], env={"COLUMNS": "300"})


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["no-such-command"], "No such command 'no-such-command'"),
        (["stats"], "Missing argument"),
        (["stats", "town", "--no-such-option"], "No such option: --no-such-option"),
        (["push", "no-such-folder", "--dataset", "town"], "does not exist"),
        ([*EXPORT, "yolo", "-O", "split"], "not of the form KEY=VALUE"),
        (
            [*EXPORT, "yolo", "-O", "color=1"],
            "--option color: expected one of include, include_un",
        ),
        ([*EXPORT, "ylo"], "'--format': 'ylo' is not one of 'yolo', 'coco', 'kitti'"),
    ],
)
def test_wrong_command_line_is_refused(words, says):
    result = run(*words)

    assert result.exit_code == USAGE
    assert says in result.output


@pytest.mark.parametrize(
    ("words", "variables", "name"),
    [
        (["tls:/x"], {}, "SCHEDULER"),
        ([], {"UNGHOST_ENGINE": "tls:/x"}, "UNGHOST_ENGINE"),
    ],
)
def test_wrong_scheduler_is_refused_with_the_name_of_its_place(
    monkeypatch, words, variables, name
):
    for variable, text in variables.items():
        monkeypatch.setenv(variable, text)

    answer = run("worker", *words)

    assert answer.exit_code == USAGE
    assert f"Invalid value: {name}: 'tls:/x' is not an engine" in answer.output


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--to", "yolo8"), "'yolo8' is not one of 'yolo', 'coco', 'kitti'"),
        (("--to", "yolo", "--layout", "foo"), "'foo' is not one of 'auto', 'y"),
        (("--to", "yolo", "--classes", "car"), "has no option 'classes'"),
        (("--to", "cvat", "-O", "bands=50"), "bands: format 'cvat' has no option"),
        (("--to", "yolo", "-O", "color=1"), "color: expected one of include, i"),
        (("--to", "yolo", "-O", "split=2"), "split: expected a share from 0 to"),
        (("--to", "yolo", "-O", "include=al"), "one of effective, kept, all"),
        (("--to", "yolo", "-O", "split"), "not of the form KEY=VALUE"),
        (("--to", "yolo", "-O", "split=1", "-O", "split=0"), "split is given twi"),
        (("--to", "yolo", "--config", "frames/manifest.jsonl"), "--filter"),
        (("--to", "yolo", "--palette", "auto"), "--palette is for --filter"),
        (("--to", "yolo", "--channel-order", "bgr"), "--channel-order is for --filter"),
    ],
)
def test_convert_refuses_invalid_options(tmp_path, monkeypatch, words, says):
    monkeypatch.chdir(tmp_path)
    folder = write_manifest(tmp_path / "frames", 1)

    result = run("convert", folder, "-o", "made", *words)

    assert result.exit_code == USAGE
    assert says in " ".join(result.output.split())
    assert not (tmp_path / "made").exists()
