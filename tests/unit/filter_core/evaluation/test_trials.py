"""Comparing trials: differences are paired, and shown only where they are sure."""

import numpy as np
import pytest

from filter_core.evaluation.detections import Detections, Objects
from filter_core.evaluation.trials import EvaluationSet, Trial, TrialKey, compare

FRAMES = 40


def evaluation_set(drives=FRAMES):
    """One object in each frame, half of them tight."""
    frame = np.arange(FRAMES)
    xyxy = np.tile([10.0, 10.0, 30.0, 30.0], (FRAMES, 1))
    objects = Objects(
        frame, 0 * frame, xyxy, np.zeros(FRAMES, np.bool_), np.full(FRAMES, 20.0)
    )
    ghosts = Objects(
        frame, 0 * frame, xyxy + 50, np.zeros(FRAMES, np.bool_), np.full(FRAMES, np.nan)
    )
    tight = np.where(frame[:, None] % 2, np.nan, xyxy)
    return EvaluationSet("town", ("car",), objects, tight, ghosts, frame % drives)


def trial(test, arm, seed, frames):
    """Finds the objects of so many frames, and a ghost in each."""
    rows = np.random.default_rng(seed).permutation(FRAMES)[:frames]
    objects, ghosts = test.objects[rows], test.ghosts
    detections = Detections(
        np.concatenate([objects.frame, ghosts.frame]),
        np.zeros(frames + FRAMES, np.int64),
        np.concatenate([objects.xyxy, ghosts.xyxy]),
        np.concatenate([np.full(frames, 0.9), np.full(FRAMES, 0.1)]),
    )
    return Trial(TrialKey(0, arm, seed), detections, test.ghosts)


def compared(found_by_arm, seeds=3, drives=FRAMES):
    test = evaluation_set(drives)
    trials = [
        trial(test, arm, seed, frames)
        for arm, frames in found_by_arm.items()
        for seed in range(seeds)
    ]
    return compare([test], trials)


def test_large_difference_is_shown_and_an_equal_arm_is_not():
    table = compared({"raw": 10, "paper": 10, "depth": 30, "perfect": 40})

    differences = {name: row["map50"] for name, row in table["differences"].items()}
    assert {name: row["shown"] for name, row in differences.items()} == {
        "paper": False,
        "depth": True,
        "perfect": True,
    }
    depth = differences["depth"]
    assert depth["low"] > 0.2
    assert depth["value"] == pytest.approx(0.5, abs=0.01)
    assert list(depth["by_seed"]) == ["0", "1", "2"]
    assert table["verdict"].startswith("mAP50 against raw: better: depth +0.")
    assert "no difference shown: paper +0.000" in table["verdict"]
    assert "perfect (ceiling) +0.74" in table["verdict"]


def test_one_seed_or_seeds_that_disagree_show_no_difference():
    alone = compared({"raw": 10, "depth": 30}, seeds=1)
    test = evaluation_set()
    counts = [("raw", 0, 10), ("raw", 1, 30), ("depth", 0, 30), ("depth", 1, 10)]
    split = compare([test], [trial(test, *count) for count in counts])

    difference = alone["differences"]["depth"]["map50"]
    assert (difference["low"] > 0, difference["shown"]) == (True, False)
    assert "no difference shown: depth" in alone["verdict"]
    both = split["differences"]["depth"]["map50"]
    assert [round(value, 1) for value in both["by_seed"].values()] == [0.5, -0.5]
    assert not both["shown"]


def test_drives_are_drawn_as_a_whole_if_there_are_enough():
    assert evaluation_set(drives=10).drawn.tolist() == [n % 10 for n in range(FRAMES)]
    assert evaluation_set(drives=3).drawn.tolist() == list(range(FRAMES))


def test_score_of_an_arm_says_what_flatters_and_what_it_mistakes():
    arm = compared({"raw": 40})["arms"]["raw"]

    assert arm["map50"]["value"] == pytest.approx(1.0)
    assert (
        arm["means"]["tight_map50"] < 0.6
    )  # the other half of the objects is not tight
    assert arm["means"]["own_map50"] > 0.3
    assert (arm["means"]["false_positives"], arm["means"]["on_ghosts"]) == (0, 0)
    assert arm["by_class"]["car"]["objects"] == FRAMES
    assert arm["by_distance"]["0-50"]["recall"] == 1.0


def test_test_sets_have_the_same_weight():
    first, second = evaluation_set(), evaluation_set()
    trials = [
        Trial(TrialKey(number, arm, seed), drawn.detections, drawn.own)
        for number, test, frames in ((0, first, 40), (1, second, 0))
        for arm in ("raw", "auto")
        for seed in range(2)
        for drawn in [trial(test, arm, seed, frames)]
    ]

    arms = compare([first, second], trials)["arms"]

    assert arms["raw"]["map50"]["value"] == pytest.approx(0.5, abs=0.01)
