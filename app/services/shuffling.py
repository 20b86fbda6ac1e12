"""A random order of numbers that needs no list of them: any place in it, at once.

A Feistel network turns places into numbers and back, one to one, whatever its rounds
compute. Its places are a power of four; numbers beyond the span are left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import blake2b
from typing import Final

import numpy as np
from numpy.typing import NDArray

from filter_core.types import IntArray

_ROUNDS: Final = 4
_Words = NDArray[np.uint64]


@dataclass(frozen=True)
class Shuffle:
    """The numbers from `low` to `high` in an order of the seed's own."""

    low: int
    high: int
    seed: str

    @property
    def half_bits(self) -> int:
        """Half the bits that the span needs, so that it can be halved."""
        return max(1, ((self.high - self.low).bit_length() + 1) // 2)

    @property
    def places(self) -> int:
        """How many places there are; less than four times as many as numbers."""
        return 1 << 2 * self.half_bits

    def portions(self, first: int, growth: int, most: int) -> Iterator[list[int]]:
        """All numbers in order, in portions that grow to `most` places."""
        start, size = 0, first
        while start < self.places:
            stop = min(start + size, self.places)
            yield self.numbers(np.arange(start, stop, dtype=np.uint64)).tolist()
            start, size = stop, min(size * growth, most)

    def numbers(self, places: _Words) -> IntArray:
        """The numbers at these places; those beyond the span are left out."""
        left, right = places >> self._shift, places & self._mask
        for key in self._keys():
            left, right = right, left ^ self._mixed(right, key)
        found = (left << self._shift | right).astype(np.int64) + self.low
        inside: IntArray = found[found <= self.high]
        return inside

    def places_of(self, numbers: IntArray) -> _Words:
        """Where these numbers stand; the inverse of `numbers`."""
        words = (numbers - self.low).astype(np.uint64)
        left, right = words >> self._shift, words & self._mask
        for key in reversed(self._keys()):
            left, right = right ^ self._mixed(left, key), left
        return left << self._shift | right

    @property
    def _shift(self) -> np.uint64:
        shift: np.uint64 = np.uint64(self.half_bits)
        return shift

    @property
    def _mask(self) -> np.uint64:
        mask: np.uint64 = np.uint64((1 << self.half_bits) - 1)
        return mask

    def _keys(self) -> list[np.uint64]:
        digest = blake2b(self.seed.encode(), digest_size=8 * _ROUNDS).digest()
        return list(np.frombuffer(digest, "<u8"))

    def _mixed(self, half: _Words, key: np.uint64) -> _Words:
        # The finaliser of splitmix64: every bit of the key and the half reaches all.
        word = half + key
        word = (word ^ word >> np.uint64(30)) * np.uint64(0xBF58476D1CE4E5B9)
        word = (word ^ word >> np.uint64(27)) * np.uint64(0x94D049BB133111EB)
        mixed: _Words = (word ^ word >> np.uint64(31)) & self._mask
        return mixed
