"""Keys of a recording's description in the configuration of a dataset."""

from filter_core.config.filter import FilterConfig
from unghost.cli.remote.target import GivenConfig

DESCRIBED = {
    "threshold_small_box": 5,
    "classes": {"van": {"size_big_box": 90}, "bus": {"size_big_box": 80}},
}


def test_keys_of_a_file_have_priority_over_those_of_the_description(tmp_path):
    file = tmp_path / "filter.yaml"
    file.write_text("threshold_small_box: 25\nclasses: {bus: {size_big_box: 60}}\n")

    whole = GivenConfig.of(file, DESCRIBED).over(FilterConfig().as_dict())

    assert whole["threshold_small_box"] == 25
    assert whole["classes"] == {
        "bus": {"size_big_box": 60},
        "van": {"size_big_box": 90},
    }


def test_without_a_file_the_description_completes_the_active_configuration():
    active = FilterConfig.from_mapping(
        {"min_distance": 3, "classes": {"van": {"size_big_box": 1}, "car": {}}}
    )

    whole = GivenConfig.of(None, DESCRIBED).over(active.as_dict())

    assert whole["min_distance"] == 3
    assert whole["threshold_small_box"] == 5
    assert whole["classes"] == DESCRIBED["classes"]
    assert GivenConfig.of(None, {}).over(active.as_dict()) == active.as_dict()
