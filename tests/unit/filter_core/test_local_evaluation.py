"""Evaluating frames locally against a file of truths or against their instances."""

import json

import pytest

from filter_core.config.filter import FilterConfig
from filter_core.errors import LayoutError
from filter_core.formats.reading import FrameSource
from filter_core.local import EvaluationTask, evaluate_source, read_truth
from tests.support.sensors import scene_source


@pytest.fixture
def source(tmp_path):
    return scene_source(tmp_path)


@pytest.mark.parametrize("truth", [None, {"a": {"217": True, "218": False}}])
def test_the_truth_comes_from_instances_or_from_a_file(source, truth):
    seen: list[tuple[str, ...]] = []
    task = EvaluationTask(FilterConfig(), truth, ("semantic", "depth"))

    evaluation, left_out = evaluate_source([source] * 3, task, progress=seen.append)

    scores = evaluation.scores.items()
    ghosts = {name: score.total.kept_hidden for name, score in scores}
    assert ghosts == {"semantic": 3, "depth": 0}
    assert (left_out, seen) == ([], [()] * 3)


def test_invalid_frames_and_boxes_without_truth_are_not_evaluated(source):
    broken = FrameSource("b", None, problem=LayoutError("b: no labels"))
    task = EvaluationTask(truth={"a": {"218": False}})

    evaluation, left_out = evaluate_source([broken, source], task)

    assert (evaluation.frames, evaluation.unfiltered.boxes) == (1, 1)
    problems = [(frame.key, frame.problem.detail) for frame in left_out]
    assert problems == [("b", "b: no labels")]


def test_read_truth_reads_json_lines(tmp_path):
    path = tmp_path / "truth.jsonl"
    lines = [
        {"key": "a", "id": "217", "visible": True, "ghost": None},
        {"key": "a", "id": 218, "visible": False},
    ]
    path.write_text("\n".join(map(json.dumps, lines)) + "\n\n")

    assert read_truth(path) == {"a": {"217": True, "218": False}}


@pytest.mark.parametrize(
    "line", ["{", "[]", '{"key": "a"}', '{"key": "a", "id": "1", "visible": 1}']
)
def test_invalid_truth_line_error_names_the_line(tmp_path, line):
    path = tmp_path / "truth.jsonl"
    path.write_text('{"key": "a", "id": "1", "visible": true}\n' + line)

    with pytest.raises(LayoutError, match=r"truth\.jsonl, line 2"):
        read_truth(path)
