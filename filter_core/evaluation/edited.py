"""What people did in another program with the boxes of an export, as answers.

An export of CVAT or Label Studio names every box, and these programs keep the names.
A box that is still in the file that they save was kept, and one that is not was
deleted, so the two files together tell the answers.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Final, TypeAlias

import numpy as np

from filter_core.formats.reading import FrameSet, FrameSource, GivenAnswer

_SAME_PX: Final = 0.01
"""By how much a corner may differ: CVAT writes two decimals."""

_Box: TypeAlias = Mapping[str, object]


def edited_answers(
    exported: FrameSet, edited: FrameSet, by: str, at: datetime
) -> tuple[list[tuple[str, GivenAnswer]], Counter[str]]:
    """The answers that an edited export has, each with the key of its frame; counts.

    Parameters
    ----------
    exported, edited : FrameSet
        As it was written, and as the other program saved it, with the same keys.
    by, at : str, datetime
        Who labelled the frames, and when, where the file does not say it.

    Returns
    -------
    answers : list of (str, GivenAnswer)
        In the order of `edited`.
    counts : Counter of str
        ``frames`` with answers; ``untouched`` frames, which nobody has labelled;
        ``elsewhere``, which the export does not have; ``faulty`` ones; boxes that are
        ``new``, and ``changed`` ones, which have another class or rectangle. New boxes
        and changes are not answers.
    """
    answers: list[tuple[str, GivenAnswer]] = []
    counts: Counter[str] = Counter()
    before = {frame.key: _boxes(frame) for frame in exported}
    for frame in edited:
        if frame.problem or frame.key not in before:
            counts["faulty" if frame.problem else "elsewhere"] += 1
            continue
        if frame.labelled is None:
            counts["untouched"] += 1
            continue
        counts["frames"] += 1
        person, time = frame.labelled.by or by, frame.labelled.at or at
        after = _boxes(frame)
        kept = before[frame.key].keys() & after.keys()
        counts["new"] += len(_list_of(frame)) - len(kept)
        for name, box in before[frame.key].items():
            verdict = "keep" if name in kept else "reject"
            counts["changed"] += name in kept and not _is_same(box, after[name])
            answer = GivenAnswer(name, verdict, person, "", time.isoformat())
            answers.append((frame.key, answer))
    return answers, counts


def _is_same(box: _Box, edited: _Box) -> bool:
    corners, others = box.get("xyxy"), edited.get("xyxy")
    return (
        box.get("class") == edited.get("class")
        and isinstance(corners, list)
        and isinstance(others, list)
        and np.allclose(corners, others, rtol=0, atol=_SAME_PX)
    )


def _list_of(frame: FrameSource) -> Sequence[_Box]:
    boxes = (frame.annotation or {}).get("boxes")
    return boxes if isinstance(boxes, list) else ()


def _boxes(frame: FrameSource) -> dict[str, _Box]:
    """The boxes of a frame by their ids."""
    return {str(box["id"]): box for box in _list_of(frame) if "id" in box}
