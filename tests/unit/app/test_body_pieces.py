"""A body on its way into the service: its pieces are not copied more than they must."""

from __future__ import annotations

from app.http_protocol import Pieces


def test_a_piece_that_is_alone_is_handed_on_as_it_came():
    pieces, piece = Pieces(), b"x" * 100_000

    pieces += piece

    assert bytes(pieces) is piece


def test_pieces_that_wait_are_handed_on_together():
    pieces = Pieces()
    assert not pieces

    for piece in (b"a", b"", b"bc"):
        pieces += piece

    assert (len(pieces), bytes(pieces)) == (3, b"abc")
