"""An archive is read as a whole, whatever pieces it arrives in."""

from __future__ import annotations

import random

import pytest

from tests.support.archives import frame, packed, send, told


@pytest.mark.parametrize("longest", [3, 700, 200_000])
def test_an_archive_arrives_whole_however_it_is_cut(api, longest):
    dataset, chance = api.dataset(), random.Random(longest)
    content = packed([one for n in range(12) for one in frame(f"{n}", number=n)])

    def cut():
        begin = 0
        while begin < len(content):
            end = begin + chance.randint(1, longest)
            yield content[begin:end]
            begin = end

    _, end = told(send(api, dataset, cut()))
    _, again = told(send(api, dataset, content))

    assert (end["stored"], again["same"]) == (12, 12)
