"""Runs the trials of an experiment, each in a folder of its own, and reads them back.

A trainer is a command. It trains on the data set of one arm and writes what it detects
in the part ``val`` as ``predictions.json``: results as COCO has them [1]_.

References
----------
.. [1] "COCO results format", https://cocodataset.org/#format-results
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Final, TypedDict

import numpy as np

from filter_core.arrays import BoxesXYXY, FloatArray
from filter_core.evaluation.arms import NoiseObject
from filter_core.evaluation.detections import Detections, Objects
from filter_core.evaluation.trials import EvaluationSet, Trial, TrialKey
from filter_core.formats.files import json_bytes, write_whole
from filter_core.processes import module_command
from unghost.experiment.datasets import (
    OWN_LABELS,
    TRUTH,
    AnnotationObject,
    TruthObject,
    arm_folder,
)

BUILT_IN: Final = "torchvision"

PREDICTIONS: Final = "predictions.json"

SETTINGS: Final = "experiment.json"
"""The file that says what the data sets were made with."""

_RESULT: Final = "result.json"
"""Written last: a trial that has it is finished."""

_TRAINER: Final = "trainer.txt"

_LOG: Final = "log.txt"

_PLACES: Final = ("data", "seed", "output")

_POLL_S: Final = 0.5

_TAIL: Final = 2000
"""Characters of a log that an error shows."""


class SettingsObject(TypedDict):
    """The file `SETTINGS`: what data sets were made with, and what came out."""

    source: str
    truth: str
    object_pixels: int
    split: float
    config: str
    noise: NoiseObject
    frames: dict[str, int]


class TrialError(Exception):
    """A trainer that cannot run, has failed, or has written something else."""


class TrialInterrupted(Exception):
    """A trial that was ended before it was finished."""


def trainer_command(trainer: str, *, is_here: bool = True) -> list[str]:
    """The words of a trainer's command, with ``{data}``, ``{seed}`` and ``{output}``.

    `trainer` is a command, or `BUILT_IN` with its own options, whose libraries this
    machine needs only if it trains itself (`is_here`).

    Raises `TrialError` if a place is missing, or such a library.
    """
    words = shlex.split(trainer)
    if words[:1] == [BUILT_IN]:
        missing = [name for name in ("torch", "torchvision") if find_spec(name) is None]
        if missing and is_here:
            raise TrialError(
                f"--trainer {BUILT_IN} needs {' and '.join(missing)}, which "
                f"{'are' if len(missing) > 1 else 'is'} not installed: "
                "pip install 'unghost[train]', or name a command of another environment"
            )
        module = [sys.executable, "-m", "unghost.experiment"]
        return [*module, *(f"{{{place}}}" for place in _PLACES), *words[1:]]
    for place in _PLACES:
        if not any(f"{{{place}}}" in word for word in words):
            raise TrialError(
                f"--trainer: expected {BUILT_IN} or a command with {{data}}, {{seed}} "
                f"and {{output}}, found none of {{{place}}} in {trainer[:80]!r}"
            )
    return words


@dataclass(frozen=True)
class Experiment:
    """The folder of an experiment: the arms' data sets, and its trials."""

    folder: Path

    @property
    def data(self) -> Path:
        """The folder of the data sets; it is there when they are complete."""
        return self.folder / "data"

    @cached_property
    def settings(self) -> SettingsObject:
        """What the data sets were made with, and their label noise."""
        text = (self.data / SETTINGS).read_text("utf-8")
        settings: SettingsObject = json.loads(text)
        return settings

    def require_trainer(self, trainer: str) -> None:
        """Note the trainer of the first trial; all others must have the same.

        Raises `TrialError`: earlier trials have another one.
        """
        path = self.folder / _TRAINER
        if not path.exists():
            write_whole(path, trainer.encode())
        elif (first := path.read_text("utf-8")) != trainer:
            raise TrialError(
                f"{self.folder}: expected the trainer of its other trials, {first!r}, "
                f"found {trainer!r}; choose another --output"
            )

    def trial_folder(self, arm: str, seed: int) -> Path:
        """The folder of a trial."""
        return self.folder / "trials" / arm / f"seed-{seed}"

    def is_finished(self, arm: str, seed: int) -> bool:
        """Whether a trial is."""
        return (self.trial_folder(arm, seed) / _RESULT).is_file()

    def finished(self) -> list[tuple[str, int]]:
        """The arms and seeds of all finished trials, by name and number."""
        paths = (self.folder / "trials").glob(f"*/seed-*/{_RESULT}")
        trials = ((path.parent.parent.name, path.parent.name) for path in paths)
        return sorted((arm, int(seed.removeprefix("seed-"))) for arm, seed in trials)

    def run(
        self,
        arm: str,
        seed: int,
        command: Sequence[str],
        parallel: int = 1,
        may_continue: Callable[[], bool] = lambda: True,
    ) -> None:
        """Train and detect; the trainer's output goes into a log.

        `parallel` trials run at the same time, which share the cores. `may_continue` is
        asked twice a second; if it is false, the trainer is ended.

        Raises `TrialError` if the command failed, with the end of its log, or wrote no
        predictions; `TrialInterrupted` if `may_continue` has said no.
        """
        output = self.trial_folder(arm, seed).resolve()
        output.mkdir(parents=True, exist_ok=True)
        places = {
            "data": str(arm_folder(self.data, arm).resolve()),
            "seed": str(seed),
            "output": str(output),
        }
        words = list(command)
        for place, value in places.items():
            words = [word.replace(f"{{{place}}}", value) for word in words]
        # Libraries of arrays would each take all cores, and wait for each other.
        threads = max((os.cpu_count() or 1) // parallel, 1)
        environment = {"OMP_NUM_THREADS": str(threads), **os.environ}
        begun = time.monotonic()
        with (
            (output / _LOG).open("wb") as log,
            subprocess.Popen(
                module_command("unghost.experiment.tied", *words),
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=environment,
            ) as trainer,
        ):
            while trainer.poll() is None:
                if not may_continue():  # leaving the block ends the trainer
                    raise TrialInterrupted(f"arm {arm}, seed {seed}")
                with suppress(subprocess.TimeoutExpired):
                    trainer.wait(_POLL_S)
        if trainer.returncode:
            said = (output / _LOG).read_text("utf-8", "replace")[-_TAIL:]
            raise TrialError(
                f"arm {arm}, seed {seed}: the trainer ended with exit code "
                f"{trainer.returncode}; the end of {output / _LOG}:\n{said}"
            )
        paths = [path.name for path in output.rglob(PREDICTIONS)]
        if len(paths) != 1:
            raise TrialError(
                f"arm {arm}, seed {seed}: expected one {PREDICTIONS} below {output}, "
                f"found {len(paths)}"
            )
        result = {
            "arm": arm,
            "seed": seed,
            "command": shlex.join(words),
            "seconds": round(time.monotonic() - begun, 1),
            "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        }
        write_whole(output / _RESULT, json_bytes(result))

    @cached_property
    def _truth(self) -> TruthObject:
        truth: TruthObject = json.loads((self.data / TRUTH).read_text("utf-8"))
        return truth

    @cached_property
    def _row_of_image(self) -> dict[int, int]:
        return {image["id"]: row for row, image in enumerate(self._truth["images"])}

    def test_set(self, name: str) -> EvaluationSet:
        """The truth that all arms are scored against."""
        truth = self._truth
        tight = [
            annotation["tight_bbox"] or [math.nan] * 4
            for annotation in truth["annotations"]
        ]
        drives: dict[object, int] = {}
        return EvaluationSet(
            name=name,
            classes=tuple(category["name"] for category in truth["categories"]),
            objects=self._objects(truth["annotations"]),
            tight_xyxy=_xyxy(tight),
            ghosts=self._objects(truth["ghosts"]),
            drive=np.array(
                [
                    drives.setdefault(image["sequence"] or image["key"], len(drives))
                    for image in truth["images"]
                ],
                np.int64,
            ),
        )

    def trial(self, key: TrialKey) -> Trial:
        """A finished trial."""
        labels = arm_folder(self.data, key.arm) / OWN_LABELS
        own = json.loads(labels.read_text("utf-8"))["annotations"]
        (path,) = self.trial_folder(key.arm, key.seed).rglob(PREDICTIONS)
        return Trial(key, self._detections(path), self._objects(own))

    def _objects(self, rows: Sequence[AnnotationObject]) -> Objects:
        distance = [row.get("distance") for row in rows]
        return Objects(
            np.array([self._row_of_image[row["image_id"]] for row in rows], np.int64),
            np.array([row["category_id"] - 1 for row in rows], np.int64),
            _xyxy([row["bbox"] for row in rows]),
            np.array([row.get("ignore", 0) for row in rows], np.bool_),
            np.array([math.nan if d is None else d for d in distance], np.float64),
        )

    def _detections(self, path: Path) -> Detections:
        """Results as COCO has them; images may be called by their files' names, too.

        Raises `TrialError`: names the result that has an error.
        """
        names = {
            name: self._row_of_image[image["id"]]
            for image in self._truth["images"]
            for name in (image["id"], image["file_name"], Path(image["file_name"]).stem)
        }
        classes = len(self._truth["categories"])
        frame, label, boxes, score = [], [], [], []
        try:
            results = json.loads(path.read_text("utf-8"))
            for number, result in enumerate(results):
                row, category = names.get(result["image_id"]), result["category_id"]
                box = np.array(result["bbox"], np.float64)
                if row is None or category not in range(1, classes + 1):
                    raise TrialError(
                        f"{path}, result {number}: expected an image_id of the part "
                        f"val and a category_id from 1 to {classes}, found "
                        f"{result['image_id']!r} and {category!r}"
                    )
                if box.shape != (4,) or not np.isfinite(box).all() or box[2:].min() < 0:
                    raise TrialError(
                        f"{path}, result {number}: expected a bbox as x, y, width and "
                        f"height in pixels, found {result['bbox']!r}"
                    )
                frame.append(row)
                label.append(category - 1)
                boxes.append(box)
                score.append(float(result["score"]))
        except (ValueError, TypeError, KeyError) as error:
            raise TrialError(
                f"{path}: expected results as COCO has them, a list of objects with "
                f"image_id, category_id, bbox and score ({type(error).__name__}: "
                f"{error})"
            ) from error
        return Detections(
            np.array(frame, np.int64),
            np.array(label, np.int64),
            _xyxy(boxes),
            np.array(score, np.float64),
        )


def joined(folders: Sequence[Path]) -> tuple[list[EvaluationSet], int, Iterator[Trial]]:
    """The finished trials of several experiments: test sets, their number, and trials.

    Experiments with the same truth have one test set. Of trials of the same arm and
    seed in one test set, the first is taken. Trials are ordered by arm.

    Raises `TrialError` if a folder has no data sets, or no trial is finished.
    """
    tests: list[EvaluationSet] = []
    numbers: dict[bytes, int] = {}
    arms: dict[str, None] = {}
    taken: dict[TrialKey, Experiment] = {}
    for experiment in map(Experiment, folders):
        path = experiment.data / TRUTH
        if not path.is_file():
            raise TrialError(
                f"{experiment.folder}: expected {TRUTH} in data, found none"
            )
        digest = hashlib.sha256(path.read_bytes()).digest()
        if digest not in numbers:
            numbers[digest] = len(tests)
            tests.append(experiment.test_set(experiment.folder.resolve().name))
        arms |= dict.fromkeys(experiment.settings["noise"]["arms"])
        for arm, seed in experiment.finished():
            taken.setdefault(TrialKey(numbers[digest], arm, seed), experiment)
    if not taken:
        raise TrialError(f"{folders[0]}: no trial is finished")
    order = list(arms)
    keys = sorted(taken, key=lambda key: (order.index(key.arm), key.test, key.seed))
    return tests, len(keys), (taken[key].trial(key) for key in keys)


def _xyxy(boxes: Sequence[Sequence[float] | FloatArray]) -> BoxesXYXY:
    """Corners (N, 4) of boxes given by a corner and the size."""
    xyxy = np.array(boxes, np.float64).reshape(-1, 4)
    xyxy[:, 2:] += xyxy[:, :2]
    return xyxy
