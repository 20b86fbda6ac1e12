"""Adds to the demo what people would: answers of two reviewers, a run, an export."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from unghost import Client, Decision
from unghost.wire.words import Answer

DATASET: Final = "demo"
_SEED: Final = 7
_EACH_VERDICT: Final = 420
_SHARED: Final = 260
"""Boxes that both answer, so that their agreement can be measured."""
_DOUBT_PERCENT: Final = 9.0
_SPREAD_PERCENT: Final = 2.6
_UNSURE_WITHIN: Final = 0.8


def add_activity(url: str, token: str) -> None:
    """Add answers of Ada and Bo, a run and an export, unless the demo has answers."""
    with Client(url, token) as client:
        if client.dataset(DATASET).counts.reviewed:
            return
        # Measured boxes of both verdicts, shuffled with a fixed seed.
        rng, sample = np.random.default_rng(_SEED), list[Decision]()
        for verdict in ("kept", "rejected"):
            measured = [
                box
                for box in client.boxes(DATASET, verdict=verdict)
                if box.match_percent is not None and (box.area_percent or 0) > 0
            ]
            order = rng.permutation(len(measured))[:_EACH_VERDICT]
            sample.extend(measured[index] for index in order)
        boxes = [sample[index] for index in rng.permutation(len(sample))]
        rng = np.random.default_rng(_SEED)
        people = {"ada": boxes, "bo": boxes[:_SHARED]}
        for earlier, (name, own) in enumerate(people.items()):
            # Bo has seen Ada's answers, each of which made a new revision of its box.
            seen = [box.model_copy(update={"revision": earlier}) for box in own]
            answers = list(_answers(own, rng))
            with Client(url, client.create_token(name).token) as reviewer:
                for verdict in sorted(set(answers)):
                    pairs = zip(seen, answers, strict=True)
                    chosen = [box for box, answer in pairs if answer == verdict]
                    reviewer.bulk_review(DATASET, verdict, chosen)
        client.wait(client.start_run(DATASET, {"threshold_small_box": 8}))
        client.wait_for_export(client.start_export(DATASET, "yolo"))


def _answers(boxes: Sequence[Decision], rng: np.random.Generator) -> Iterator[Answer]:
    """Answers that are sure of clear boxes, and divided over those with few pixels."""
    for box in boxes:
        lead = (box.match_percent or 0.0) - _DOUBT_PERCENT
        if abs(lead) < _UNSURE_WITHIN and rng.random() < 0.5:
            yield "unsure"
            continue
        keeps = rng.random() < 1 / (1 + np.exp(-lead / _SPREAD_PERCENT))
        yield "keep" if keeps else "reject"
