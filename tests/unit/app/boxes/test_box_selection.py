"""`to_filter` turns the selection of a request into a filter for the database."""

import pytest

from app.boxes.filter import filters_of, to_filter
from app.errors import BadRequest
from filter_core.verdicts import Reason
from unghost.wire.boxes import BoxSelection


@pytest.fixture(scope="module")
def street(services):
    return services.dataset()


def filter_for(street, **selection):
    with street.context.database.read() as session:
        return to_filter(session, street.row(session), BoxSelection(**selection))


def test_empty_selection_selects_all_boxes(street):
    assert filter_for(street).reasons == ()
    assert not filters_of(BoxSelection())
    assert filters_of(BoxSelection(toss_up=False))


@pytest.mark.parametrize(
    ("selection", "reasons"),
    [
        ({"verdict": "kept"}, (Reason.VISIBLE,)),
        (
            {"verdict": "unmeasured"},
            (
                Reason.NO_SEGMENTATION,
                Reason.UNMAPPED_CLASS,
                Reason.PASSED,
                Reason.UNKNOWN_PIXELS,
            ),
        ),
        ({"reason": "unmapped_class"}, (Reason.DROPPED_CLASS, Reason.UNMAPPED_CLASS)),
        (
            {"verdict": "unmeasured", "reason": "unmapped_class"},
            (Reason.UNMAPPED_CLASS,),
        ),
        ({"reason": "visible,degenerate"}, (Reason.DEGENERATE, Reason.VISIBLE)),
        ({"verdict": "kept", "reason": "degenerate"}, (0,)),
    ],
)
def test_verdict_and_reason_are_combined_into_a_set_of_reasons(
    street, selection, reasons
):
    assert filter_for(street, **selection).reasons == tuple(map(int, reasons))


@pytest.mark.parametrize(
    ("selection", "code"),
    [({"reason": "magic"}, "unknown_reason"), ({"review": "maybe"}, "unknown_review")],
)
def test_unknown_reason_or_review_is_refused_by_name(street, selection, code):
    with pytest.raises(BadRequest) as refused:
        filter_for(street, **selection)

    assert refused.value.kind == code
    assert next(iter(selection.values())) in refused.value.detail


def test_thresholds_are_those_of_the_active_config(services):
    street = services.dataset()
    street.run(
        {
            "profile": "carlasimu",
            "threshold_small_box": 60,
            "classes": {"truck": {"threshold_small_box": 2}},
        }
    )

    thresholds = filter_for(street).thresholds

    sides = [
        {(side.reason, side.large): side.threshold for side in each.sides}
        for each in thresholds[:2]
    ]
    passed = [(of[Reason.VISIBLE, False], of[Reason.VISIBLE, True]) for of in sides]
    assert passed == [(60.0, 60.0), (2.0, 50.0)]


def test_unknown_class_selects_no_class(street):
    assert filter_for(street, class_name="dragon").class_ids == ()
    assert len(filter_for(street, class_name="car,truck,dragon").class_ids or ()) == 2
