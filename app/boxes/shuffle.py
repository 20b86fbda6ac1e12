"""The random order of a dataset's boxes, in which every box has a permanent place.

The places are permanent random numbers [1]_: the place of a box depends on its id and
the seed alone, not on other boxes, on answers or on time. So the boxes up to any place
are a simple random sample of all boxes, whoever has answered which of them, and why;
and boxes that are uploaded later fall into this sample as often as others.

The order comes from a Feistel network, a one-to-one mapping from places to ids and back
that needs no list. The number of places is a power of four; ids that a dataset does not
have are left out.

References
----------
.. [1] E. Ohlsson, "Coordination of samples using permanent random numbers", in Business
   Survey Methods, 1995, chapter 9.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import blake2b
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from app.boxes.filter import BoxProbes
from app.catalog.datasets import DatasetRepository
from filter_core.arrays import FloatArray, IntArray

HALF_BITS: Final = 13
"""Half the bits of a place: room for 67 million ids. If a dataset's highest id passes
this number, its order changes, and again each time that id has grown fourfold."""

_MAX_PLACES: Final = 1 << 20
"""Places of a slice, at most: 8 MB for each of its arrays."""

_ROUNDS: Final = 4
_Words = NDArray[np.uint64]


@dataclass(frozen=True)
class Shuffle:
    """The numbers from `low` to `high` in a pseudo-random order of the seed."""

    low: int
    high: int
    seed: str
    min_half_bits: int = HALF_BITS

    @property
    def half_bits(self) -> int:
        """Half the number of bits of a place, which is even."""
        return max(self.min_half_bits, (self.high.bit_length() + 1) // 2)

    @property
    def places(self) -> int:
        return 1 << 2 * self.half_bits

    def slices(
        self, first: int, growth: int, most: int, places: int | None = None
    ) -> Iterator[list[int]]:
        """All numbers in order, in slices that grow: about `first` to `most` numbers.

        With `places`, only the numbers at the first so many places.
        """
        end = self.places if places is None else min(places, self.places)
        places_per_number = self.places // (self.high - self.low + 1)
        start, size = 0, first
        while start < end:
            width = min(max(1, size * places_per_number), _MAX_PLACES)
            stop = min(start + width, end)
            yield self.numbers(np.arange(start, stop, dtype=np.uint64)).tolist()
            start, size = stop, min(size * growth, most)

    def numbers(self, places: _Words) -> IntArray:
        """The numbers at these places; those outside `low` and `high` are left out."""
        left, right = places >> self._shift, places & self._mask
        for key in self._keys():
            left, right = right, left ^ self._mixed(right, key)
        numbers = (left << self._shift | right).astype(np.int64)
        inside: IntArray = numbers[(numbers >= self.low) & (numbers <= self.high)]
        return inside

    def places_of(self, numbers: IntArray) -> _Words:
        """The places of these numbers; the inverse of `numbers`."""
        words = numbers.astype(np.uint64)
        left, right = words >> self._shift, words & self._mask
        for key in reversed(self._keys()):
            left, right = right ^ self._mixed(left, key), left
        return left << self._shift | right

    def shares_of(self, numbers: IntArray) -> FloatArray:
        """The part of the order that ends with each of these numbers, above 0 to 1.

        It is the probability of any number to be among those up to this place.
        """
        shares: FloatArray = (self.places_of(numbers) + np.uint64(1)) / self.places
        return shares

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


def shuffle_of(session: Session, dataset_id: int) -> Shuffle | None:
    """The random order of a dataset unless another seed is wanted; None if empty."""
    class_ids = DatasetRepository(session).classes(dataset_id).values()
    span = BoxProbes(session).span(dataset_id, class_ids)
    return Shuffle(*span, str(dataset_id)) if span else None
