"""An archive is read in the same way, whatever pieces it arrives in."""

from __future__ import annotations

import random

import pytest

from tests.support.archives import batch_results, frame, send, tar_archive


@pytest.mark.parametrize("longest", [3, 700, 200_000])
def test_archive_sent_in_pieces_of_any_size_is_stored_completely(api, longest):
    dataset, chance = api.dataset(), random.Random(longest)
    content = tar_archive([one for n in range(12) for one in frame(f"{n}", number=n)])

    def cut():
        begin = 0
        while begin < len(content):
            end = begin + chance.randint(1, longest)
            yield content[begin:end]
            begin = end

    _, end = batch_results(send(api, dataset, cut()))
    _, again = batch_results(send(api, dataset, content))

    assert (end["stored"], again["same"]) == (12, 12)
