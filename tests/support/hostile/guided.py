"""A fuzzer that is guided by the lines of code that its inputs reach.

An input is kept and changed further if it reaches a new line, or takes more work for
its size than any before it. Work is counted in executed lines of Python, so the result
does not depend on the machine or its load. A reader that never ends, or whose work
grows faster than its input, is stopped, and the test fails. Time in C code is limited
by processor seconds.
"""

import base64
import random
import sys
import time
import tracemalloc
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import CodeType, FrameType
from typing import Any

from tests.support.hostile.mutations import MEANINGFUL_PIECES

MOST_BYTES = 1 << 16
"""The longest input: long enough to notice work that grows with the square of it."""

Read = Callable[[bytes], object]
Repair = Callable[[bytes], bytes]


class TooMuchWork(BaseException):
    """Raised inside a reader that works for too long; no code of ours catches it."""


@dataclass(frozen=True)
class Bounds:
    """The most lines, processor seconds and bytes that reading one input may take."""

    lines: int = 20_000
    lines_per_byte: float = 30
    seconds: float = 3.0
    """Processor time, including the cost of tracing."""
    memory: int = 96 * 1024**2

    def lines_for(self, content: bytes) -> int:
        return int(self.lines + self.lines_per_byte * len(content))


@dataclass
class Fuzzer:
    """Tries inputs on one reader, and collects those that reach something new.

    `errors` are the reader's own exceptions for bad input; `folders` hold its code;
    `repair` restores what any random change breaks, such as checksums.
    """

    read: Read
    errors: tuple[type[BaseException], ...]
    folders: Sequence[str]
    bounds: Bounds = field(default_factory=Bounds)
    repair: Repair | None = None
    corpus: list[bytes] = field(default_factory=list)
    lines_seen: set[tuple[CodeType, int]] = field(default_factory=set)
    most_per_byte: float = 0.0

    def run(self, samples: Sequence[bytes], tries: int, seed: int) -> None:
        """Try all samples, then `tries` inputs that are changed from kept ones.

        Raises
        ------
        AssertionError
            An input took too much, or raised an error that is not one of `errors`; the
            text contains the input.
        """
        dice = random.Random(seed)
        for sample in samples:
            self._try(sample, seed)
            self.corpus.append(sample)
        for _ in range(tries):
            content = self._changed(dice)
            if self._try(content, seed):
                self.corpus.append(content)

    def _changed(self, dice: random.Random) -> bytes:
        content = dice.choice(self.corpus)
        for _ in range(dice.choice((1, 1, 2, 3, 8))):
            content = changed(content, dice.choice(self.corpus), dice)[:MOST_BYTES]
        if self.repair is not None and dice.random() < 0.8:
            content = self.repair(content)
        return content

    def _try(self, content: bytes, seed: int) -> bool:
        """Read one input within the bounds; whether it reached something new."""
        lines: set[tuple[CodeType, int]] = set()
        most = self.bounds.lines_for(content)
        told = f"seed {seed}, input {packed(content)}"
        begun = time.process_time()
        try:
            with little_memory(self.bounds.memory, told):
                count = self._traced(content, lines, most)
        except TooMuchWork:
            raise AssertionError(
                f"more than {most:,} lines for {len(content):,} bytes; {told}"
            ) from None
        except Exception as error:
            raise AssertionError(f"{type(error).__name__}: {error}; {told}") from error
        seconds = time.process_time() - begun
        assert seconds < self.bounds.seconds, f"{seconds:.1f} s; {told}"
        per_byte = max(0.0, count - 1000) / (len(content) + 1)
        tells = not lines <= self.lines_seen or per_byte > 1.2 * self.most_per_byte
        self.lines_seen |= lines
        self.most_per_byte = max(self.most_per_byte, per_byte)
        return tells

    def _traced(
        self, content: bytes, lines: set[tuple[CodeType, int]], most: int
    ) -> int:
        count = 0

        def in_reader(frame: FrameType, event: str, _arg: Any) -> Any:
            nonlocal count
            if event == "line":
                count += 1
                lines.add((frame.f_code, frame.f_lineno))
                if count > most:
                    raise TooMuchWork
            return in_reader

        def entered(frame: FrameType, _event: str, _arg: Any) -> Any:
            name = frame.f_code.co_filename
            return in_reader if any(folder in name for folder in self.folders) else None

        before = sys.gettrace()
        sys.settrace(entered)
        try:
            self.read(content)
        except self.errors:
            pass
        finally:
            sys.settrace(before)
        return count


def changed(content: bytes, other: bytes, dice: random.Random) -> bytes:
    """`content` with one random change, as often a small one as a large one."""
    # Prefer the beginning, where the headers are.
    start = dice.randint(0, min(len(content), dice.choice((16, MOST_BYTES))))
    length = min(dice.choice((0, 1, 2, 4, 16, 512)), len(content) - start)
    before, after = content[:start], content[start + length :]
    taken = content[start : start + length]
    way = dice.randrange(8)
    if way == 0:
        return before + dice.choice(MEANINGFUL_PIECES) + after
    if way == 1:
        return before + dice.choice(MEANINGFUL_PIECES) + taken + after
    if way == 2:
        return before + taken * dice.choice((2, 3, 16, 256, 4096)) + after
    if way == 3:
        return before + dice.randbytes(dice.choice((1, 2, 4, 16))) + after
    if way == 4:
        return before + after
    if way == 5:
        at = dice.randint(0, len(other))
        return before + other[at : at + dice.choice((4, 64, 4096))] + after
    if way == 6 and taken:
        flipped = taken[0] ^ 1 << dice.randrange(8)
        return before + bytes([flipped]) + taken[1:] + after
    return before if dice.random() < 0.2 else before + taken + after


def packed(content: bytes) -> str:
    """An input as short text for messages; `unpacked` turns it back."""
    return base64.b85encode(zlib.compress(content, 9)).decode()


def unpacked(text: str) -> bytes:
    return zlib.decompress(base64.b85decode(text))


@contextmanager
def little_memory(most: int, told: str) -> Iterator[None]:
    """Fail if the block holds more than `most` bytes at any moment."""
    was_tracing = tracemalloc.is_tracing()
    if not was_tracing:
        tracemalloc.start()
    tracemalloc.reset_peak()
    before, _ = tracemalloc.get_traced_memory()
    try:
        yield
        _, peak = tracemalloc.get_traced_memory()
    finally:
        if not was_tracing:
            tracemalloc.stop()
    assert peak - before < most, f"{peak - before:,} bytes of memory; {told}"
