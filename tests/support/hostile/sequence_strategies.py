"""Keys, answers, frames and filters from which random test sequences are built."""

import json

from hypothesis import strategies as st

from tests.support import frames as scene
from tests.support.hostile.model import RECTANGLES, Content

KEYS = st.sampled_from(["a", "b/c", "b/ü"])
ANSWERS = st.sampled_from(["keep", "reject", "unsure", "clear"])
CONTENTS = st.builds(
    Content,
    boxes=st.lists(st.sampled_from(RECTANGLES), max_size=4).map(tuple),
    shift=st.sampled_from([0, 10, None]),
    number=st.integers(0, 1),
)
FILTERS = st.fixed_dictionaries(
    {},
    optional={
        "verdict": st.sampled_from(["kept", "rejected", "unmeasured"]),
        "effective": st.sampled_from(["kept", "rejected", "unmeasured"]),
        "review": st.sampled_from(
            ["undecided", "decided", "keep", "reject", "unsure", "none", "any"]
        ),
        "conflict": st.just("true"),
    },
)
FROM_PIXELS: tuple[dict[str, str], ...] = (
    {},
    {"channel_order": "rgb"},
    {"lossy_segmentation": "nearest"},
)


def config_of(threshold, pixels):
    """A configuration with the same threshold for small and large boxes."""
    both = {"threshold_small_box": threshold, "threshold_big_box": threshold}
    return {**both, **pixels}


def annotation_of(content):
    boxes = [{"class": "car", "xyxy": list(xyxy)} for xyxy in content.boxes]
    return {**scene.annotation(), "boxes": boxes}


def files_of(content):
    files = {"image": scene.image(content.number)}
    if content.shift is not None:
        files["segmentation"] = scene.segmentation(content.shift)
    return files


def members_of(number, key, content):
    """The files of one frame as members of a tar archive."""
    document = json.dumps({**annotation_of(content), "key": key}).encode()
    files = files_of(content).items()
    return [
        (f"{number}.json", document),
        *((f"{number}.{kind}.png", data) for kind, data in files),
    ]
