"""A preview returns the counts and changes that a run with the same config then has."""

from collections import Counter

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from filter_core.verdicts import Reason
from tests.support import frames as scene

SIDES = st.tuples(st.integers(-10, 70), st.integers(-10, 70))
BOXES = st.lists(
    st.builds(
        lambda name, xs, ys, distance: {
            "class": name,
            "xyxy": [min(xs), min(ys), max(xs), max(ys)],
            "distance": distance,
        },
        st.sampled_from(["car", "truck", "walker", "dragon"]),
        SIDES,
        SIDES,
        st.sampled_from([None, 5.0, 60.0]),
    ),
    min_size=1,
    max_size=12,
)
PERCENT = st.sampled_from([0, 1, 10, 30, 70, 100])
CONFIGS = st.fixed_dictionaries(
    {"profile": st.just("paper")},  # numbers of channels would need the images again
    optional={
        "threshold_small_box": PERCENT,
        "threshold_big_box": PERCENT,
        "size_big_box": PERCENT,
        "min_visible_pixels": st.integers(0, 300),
        "max_distance": st.just(50),
        "classes": st.sampled_from(
            [
                {"walker": {"accept": ["Car", "Road"]}},
                {"dragon": {"accept": ["Sky"], "threshold_small_box": 1}},
            ]
        ),
    },
)


@settings(suppress_health_check=list(HealthCheck))
@given(boxes=BOXES, before=CONFIGS, after=CONFIGS)
def test_preview_has_the_counts_and_flips_of_the_run(services, boxes, before, after):
    street = services.dataset()
    annotation = {**scene.annotation(), "boxes": boxes}
    street.put("seen", annotation, segmentation=scene.segmentation())
    street.put("unseen", annotation, image=scene.image())
    street.run(before)
    was = street.reasons()

    promised = street.preview(after)
    run = street.run(after)

    now = street.reasons()
    verdicts = {box: Reason(reason).verdict.value for box, reason in now.items()}
    flipped = [
        box for box in now if Reason(was[box]).verdict is not Reason(now[box]).verdict
    ]
    assert promised["counts"] == run.counts
    assert promised["by_reason"] == Counter(Reason(r).label for r in now.values())
    assert Counter(verdicts.values()) == Counter(promised["counts"])
    assert sorted(each["box_id"] for each in promised["flips"]["items"]) == flipped
    assert run.changed == sum(was[box] != now[box] for box in now)
    assert street.tallies() == street.recounted()
