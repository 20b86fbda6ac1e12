"""Agreement of reviewers and suggested thresholds equal counting by hand."""

from itertools import combinations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from filter_core.evaluation.agreement import agreement
from filter_core.evaluation.scores import Confusion
from filter_core.evaluation.thresholds import Answers, Goal, suggest

ANSWERS = st.dictionaries(
    st.tuples(st.integers(1, 6), st.integers(0, 4)), st.booleans(), max_size=25
)
MATCH = st.sampled_from([0.0, 0.5, 9.5, 10.0, 10.5, 30.0, 99.0, 100.0])
MATCHES_AND_ANSWERS = st.lists(st.tuples(MATCH, st.booleans()), min_size=1, max_size=30)


@given(said=ANSWERS)
def test_agreement_and_pairs_equal_counting_by_hand(said):
    keys = list(said)

    result = agreement(
        np.array([box for box, _ in keys], np.int64),
        np.array([who for _, who in keys], np.int64),
        np.array([said[key] for key in keys], bool),
    )

    by_box = {box: [k for k in keys if k[0] == box] for box, _ in keys}
    several = [group for group in by_box.values() if len(group) > 1]
    alike = [group for group in several if len({said[key] for key in group}) == 1]
    assert (result.boxes, result.agreed) == (len(several), len(alike))
    slow: dict[tuple[int, int], list[tuple[bool, bool]]] = {}
    for group in several:
        for first, other in combinations(sorted(group, key=lambda key: key[1]), 2):
            slow.setdefault((first[1], other[1]), []).append((said[first], said[other]))
    assert {(p.a, p.b): p.boxes for p in result.pairs} == {
        pair: len(answers) for pair, answers in slow.items()
    }
    for pair in result.pairs:
        answers = slow[pair.a, pair.b]
        assert pair.agreed == sum(first == other for first, other in answers)
        assert int(pair.table[1, 0]) == answers.count((True, False))


def confusion_at(some, threshold, strict) -> Confusion:
    kept = [m > threshold if strict else m >= threshold for m, _ in some]
    keep = [said for _, said in some]
    return Confusion.of(np.array(kept), np.array(keep))


@settings(max_examples=150)
@given(some=MATCHES_AND_ANSWERS, current=MATCH, strict=st.booleans())
def test_suggested_threshold_has_the_best_f1(some, current, strict):
    match, keep = (np.array(column) for column in zip(*some, strict=True))

    suggestion = suggest(Answers(match, keep, strict=strict), current, Goal())

    if suggestion is None:
        assert keep.all() or not keep.any()
        return
    every = np.unique(np.concatenate([match, match + 0.25, match - 0.25])).clip(0, 100)
    scores = [confusion_at(some, threshold, strict).f1 for threshold in every]
    best = max(score.value for score in scores if score is not None)
    chosen = confusion_at(some, suggestion.threshold, strict).f1
    assert chosen is not None
    assert abs(chosen.value - best) < 1e-9
    assert abs((suggestion.at_suggested.f1 or 0) - best) < 1e-9
    assert 0 <= suggestion.threshold <= 100
    for point in suggestion.curve[::10]:
        by_hand = confusion_at(some, point.threshold, strict)
        assert point.recall == (by_hand.recall and by_hand.recall.value)
        assert point.precision == (by_hand.precision and by_hand.precision.value)
