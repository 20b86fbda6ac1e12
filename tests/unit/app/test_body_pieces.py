"""`Pieces` buffers received bytes with little copying and little memory."""

import time
import tracemalloc

import pytest

from app.incoming import Pieces


def test_pieces_are_returned_joined_and_a_single_one_without_a_copy():
    pieces, piece = Pieces(), b"x" * 100_000
    assert not pieces

    pieces += piece
    assert bytes(pieces) is piece

    for more in (b"a", b"", b"bc"):
        pieces += more
    assert (len(pieces), bytes(pieces)) == (100_003, piece + b"abc")


@pytest.mark.parametrize("length", [1, 10, 900])
def test_small_pieces_use_little_more_memory_than_their_size(length):
    source = bytes(length)
    tracemalloc.start()
    try:
        pieces = Pieces()
        for _ in range(400_000 // length):
            pieces += memoryview(source)
        held, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()

    assert held < 1.5 * len(pieces)
    assert peak < 3 * len(pieces)


def test_time_to_join_pieces_is_linear_in_their_number():
    def seconds_of(count):
        pieces, begun = Pieces(), time.process_time()
        for _ in range(count):
            pieces += b"x"
        assert bytes(pieces) == b"x" * count
        return time.process_time() - begun

    few = min(seconds_of(50_000) for _ in range(3))

    assert min(seconds_of(400_000) for _ in range(3)) < 4 * 8 * few
