"""Suggested thresholds for each class, from boxes whose true visibility is known."""

import numpy as np

from filter_core.config.filter import ClassConfig, FilterConfig
from filter_core.evaluation.thresholds import Goal, TruthCollector, with_thresholds
from tests.support.evidence import evidence_of

POLE = {"class_index": 0, "match_percent": 6.0}
POLE_IN_FRONT_OF_ONE = {"class_index": 0, "match_percent": 1.0}
CAR = {"class_index": 1, "match_percent": 70.0}


def filled_collector(config=None):
    """A collector of two frames that list the same classes in different orders."""
    collector = TruthCollector(config or FilterConfig())
    poles = [POLE, POLE_IN_FRONT_OF_ONE, CAR]
    names = ("traffic_light", "car")
    collector.add(evidence_of(poles, names), np.array([True, False, True]))
    swapped = [{**box, "class_index": 1 - box["class_index"]} for box in poles]
    collector.add(evidence_of(swapped, names[::-1]), np.array([True, False, True]))
    return collector


def test_classes_are_identified_by_name_in_any_order():
    (light,) = filled_collector().suggestions(Goal())

    assert (light.class_name, light.boxes) == ("traffic_light", 4)
    assert (light.key, light.at_current.threshold) == ("threshold_small_box", 10)
    assert 1 < light.threshold < 6
    assert TruthCollector(FilterConfig()).suggestions(Goal()) == []


def test_with_thresholds_keeps_all_other_settings():
    config = FilterConfig(
        max_distance=80,
        evidence="depth",
        classes={
            "street_light": ClassConfig(min_visible_pixels=2),
            "van": ClassConfig(accept=("Car",)),
        },
    )
    collector = filled_collector(config)
    suggestions = collector.suggestions(Goal())

    new = with_thresholds(collector.config, suggestions)

    assert (new.evidence, new.max_distance) == ("semantic", 80)
    assert new.limits_of("traffic_light").min_visible_pixels == 2
    assert new.limits_of("traffic_light").threshold_small_box == (
        suggestions[0].threshold
    )
    assert new.of_class("van") == config.of_class("van")
