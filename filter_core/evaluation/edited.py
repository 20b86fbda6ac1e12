"""What people did in another program with the boxes of an export, as answers.

An export of CVAT or Label Studio names every box, and these programs keep the names.
A box that is still in the file that they save was kept, and one that is not was
deleted, so the two files together tell the answers.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Final, TypeAlias

import numpy as np

from filter_core.formats.reading import FrameSet, FrameSource, GivenAnswer

_SAME_PX: Final = 0.01
"""By how much a corner may differ: CVAT writes two decimals."""

_Box: TypeAlias = Mapping[str, object]


@dataclass
class EditedExport:
    """The answers that an edited export has, by the key of their frame.

    Attributes
    ----------
    exported, edited : FrameSet
        As it was written, and as the other program saved it, with the same keys.
    by, at : str, datetime
        Who labelled the frames, and when, where the file does not say it.
    counts : Counter of str
        While the answers are read: ``frames`` with answers; ``untouched`` frames, which
        nobody has labelled; ``elsewhere``, which the export does not have; ``faulty``
        ones; boxes that are ``new``, and ``changed`` ones, which have another class or
        rectangle. New boxes and changes are not answers.
    """

    exported: FrameSet
    edited: FrameSet
    by: str
    at: datetime
    counts: Counter[str] = field(default_factory=Counter)

    def answers(self) -> Iterator[tuple[str, GivenAnswer]]:
        """The answers, each with the key of its frame, in the order of `edited`."""
        self.counts.clear()
        exported = {frame.key: _boxes(frame) for frame in self.exported}
        for frame in self.edited:
            before = exported.get(frame.key)
            if frame.problem or before is None:
                self.counts["faulty" if frame.problem else "elsewhere"] += 1
            elif frame.labelled is None:
                self.counts["untouched"] += 1
            else:
                self.counts["frames"] += 1
                by, at = frame.labelled.by or self.by, frame.labelled.at or self.at
                for box, verdict in self._verdicts(frame, before):
                    answer = GivenAnswer(box, verdict, by, "", at.isoformat())
                    yield frame.key, answer

    def _verdicts(
        self, frame: FrameSource, before: Mapping[str, _Box]
    ) -> Iterator[tuple[str, str]]:
        after = _boxes(frame)
        of_export = after.keys() & before.keys()
        self.counts["new"] += len(_list_of(frame)) - len(of_export)
        for name, box in before.items():
            there = after.get(name)
            if there is not None:
                corners, edited = box.get("xyxy"), there.get("xyxy")
                is_same = (
                    box.get("class") == there.get("class")
                    and isinstance(corners, list)
                    and isinstance(edited, list)
                    and np.allclose(corners, edited, rtol=0, atol=_SAME_PX)
                )
                self.counts["changed"] += not is_same
            yield name, "reject" if there is None else "keep"


def _list_of(frame: FrameSource) -> Sequence[_Box]:
    boxes = (frame.annotation or {}).get("boxes")
    return boxes if isinstance(boxes, list) else ()


def _boxes(frame: FrameSource) -> dict[str, _Box]:
    """The boxes of a frame by their ids."""
    return {str(box["id"]): box for box in _list_of(frame) if "id" in box}
