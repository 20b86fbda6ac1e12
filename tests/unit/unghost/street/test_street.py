"""The demo's rendered frames agree with each other and with their truth."""

from collections import defaultdict
from io import BytesIO

import numpy as np
import pytest

from filter_core.geometry.camera import Camera
from filter_core.pipeline import filter_frame
from filter_core.segmentation.palettes import palette_of
from tests.support.geometry_oracle import box3d_vertices
from tests.support.pictures import tags_of
from unghost.street.sensors import GHOST_KINDS
from unghost.street.street import StreetScene
from unghost.street.towns import STYLES, build_town

# Rendering takes a minute or two; tests/packaging tries the demo itself.
pytestmark = pytest.mark.long

TRAFFIC_CLASSES = {
    "car", "truck", "van", "bus", "motorcycle", "bicycle", "walker", "traffic_light",
}  # fmt: skip


def test_only_the_same_seed_gives_the_same_bytes(demo_frames):
    first = demo_frames[0].frame
    again, other = (StreetScene(seed).render_frame(0) for seed in (0, 1))

    assert vars(again) == vars(first)
    assert other.image_png != first.image_png
    assert other.annotation["boxes"] != first.annotation["boxes"]


def test_frames_alternate_between_the_towns(demo_frames):
    keys = [decoded.frame.key for decoded in demo_frames[:4]]

    assert keys == ["town-a/000000", "town-b/000000", "town-c/000000", "town-a/000001"]


def test_image_sizes_equal_camera_size(demo_frames):
    for decoded in demo_frames:
        camera = decoded.frame.annotation["camera"]
        assert decoded.image.shape == (camera["height"], camera["width"], 3)
        assert decoded.segmentation.shape == decoded.image.shape


def test_segmentation_and_instance_image_have_the_same_tags(demo_frames):
    for decoded in demo_frames:
        tags, _ = decoded.instances
        assert np.array_equal(tags_of(decoded.segmentation, "carla-0.9.14"), tags)


def test_depth_of_sky_is_1000_m_and_other_depth_is_less(demo_frames):
    sky = palette_of("carla-0.9.14").tag_of("Sky")
    for decoded in demo_frames:
        is_sky = decoded.instances[0] == sky
        assert np.all(decoded.depth[is_sky] == pytest.approx(1000.0, abs=1e-4))
        assert decoded.depth[~is_sky].min() >= 0.1
        assert decoded.depth[~is_sky].max() < 1000.0


def test_truth_has_a_line_per_box_with_its_instance_and_visible_pixels(demo_frames):
    for decoded in demo_frames:
        truth, boxes = decoded.frame.truth, decoded.frame.annotation["boxes"]
        assert [(line["id"], line["instance"]) for line in truth] == [
            (box["id"], box["instance_id"]) for box in boxes
        ]
        recount = [len(decoded.own_pixels(line)[0]) for line in truth]
        assert recount == [line["visible_pixels"] for line in truth]
        for line in truth:
            assert line["visible"] == (line["visible_pixels"] > 0)
            assert (line["ghost"] is None) == line["visible"]


def test_every_kind_of_ghost_and_each_class_seen_and_hidden_occurs(demo_frames):
    lines = [line for decoded in demo_frames for line in decoded.frame.truth]

    assert {line["ghost"] for line in lines} == {None, *GHOST_KINDS}
    for visible in (True, False):
        classes = {line["class"] for line in lines if line["visible"] is visible}
        assert classes == TRAFFIC_CLASSES


def test_fewer_actors_reduce_boxes_but_not_scenery():
    full, thin = (build_town(STYLES[1], 0, share) for share in (1.0, 0.2))

    boxes = [sum(thing.has_box for thing in town.things) for town in (full, thin)]
    scenery = [
        [thing.instance for thing in town.things if not thing.has_box]
        for town in (full, thin)
    ]

    assert 0.1 < boxes[1] / boxes[0] < 0.3
    assert scenery[0] == scenery[1]


def test_boxes_are_box3d_and_in_fourth_frame_of_a_town_xyxy(demo_frames):
    forms = {
        decoded.frame.key: {
            "xyxy" if "xyxy" in box else "box3d"
            for box in decoded.frame.annotation["boxes"]
        }
        for decoded in demo_frames
    }

    assert forms["town-a/000000"] == {"box3d"}
    assert forms["town-a/000003"] == {"xyxy"}


def test_filled_share_of_visible_boxes_is_realistic(demo_frames):
    fill: dict[str, list[float]] = defaultdict(list)
    for decoded in demo_frames:
        for line, box in zip(decoded.frame.truth, decoded.geometry.xyxy, strict=True):
            own = decoded.own_pixels(line)
            if len(own[0]) > 150 and not np.isnan(box).any():
                share = _fill_share_unless_hidden(
                    own, box, whole=line["class"] == "traffic_light"
                )
                fill[line["class"]] += share
    medians = {name: float(np.median(shares)) for name, shares in fill.items()}

    assert 0.65 < medians["car"] < 0.85
    assert 0.40 < medians["walker"] < 0.70
    assert 0.02 < medians["traffic_light"] < 0.14


def _fill_share_unless_hidden(own, box, *, whole):
    """The filled share of the tight rectangle, or of the `whole` box; a list.

    The list is empty for things that something hides: their pixels do not reach almost
    all sides of the box. The pole of a traffic light has other tags, so those of its
    head may end above the ground.
    """
    rows, columns = own
    tight = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
    size = np.tile(box[2:] - box[:2], 2)
    gaps = np.abs(tight - box) / size
    if gaps[:3].max() > 0.22 or gaps[3] > (0.4 if whole else 0.12):
        return []
    width, height = size[:2] if whole else tight[2:] - tight[:2]
    return [len(rows) / (width * height)]


def test_pixels_of_an_object_are_inside_its_3d_box(demo_frames):
    for decoded in demo_frames:
        camera = Camera.from_fov(
            1280, 720, 90, decoded.frame.annotation["camera"]["transform"]
        )
        for line, box in zip(
            decoded.frame.truth, decoded.frame.annotation["boxes"], strict=True
        ):
            if "box3d" in box and line["visible"]:
                own = decoded.pixels_of(line["instance"])
                assert (
                    _max_distance_outside_m(decoded, camera, own, box["box3d"]) < 0.05
                ), line


def _max_distance_outside_m(decoded, camera, own, box3d):
    """How many metres the farthest of these pixels lies outside a box."""
    row, column = own
    depth = decoded.depth[row, column]
    right = (column + 0.5 - 640) / 640 * depth
    up = (360 - row - 0.5) / 640 * depth
    local = np.stack([depth, right, up, np.ones_like(depth)], axis=1)
    world = (local @ np.linalg.inv(camera.world_to_camera).T)[:, :3]
    corners = box3d_vertices(**box3d)
    worst = 0.0
    for end in (1, 2, 4):
        axis = corners[end] - corners[0]
        length = np.linalg.norm(axis)
        along = (world - corners[0]) @ (axis / length)
        worst = max(worst, -along.min(), along.max() - length)
    return worst


def test_lidar_points_hit_only_visible_objects(demo_frames):
    for decoded in demo_frames[:3]:
        points = np.load(BytesIO(decoded.frame.lidar_npy))
        visible = {int(line["id"]) for line in decoded.frame.truth if line["visible"]}
        boxed = {int(line["id"]) for line in decoded.frame.truth}

        assert len(points) > 5_000
        assert set(points["ObjIdx"].tolist()) & boxed <= visible
        assert np.all((points["CosAngle"] >= 0) & (points["CosAngle"] <= 1.001))


def test_filter_rejects_most_ghost_boxes_of_the_demo(demo_frames):
    rejected, ghosts = 0, 0
    for decoded in demo_frames[:3]:
        frame = decoded.frame
        decisions = filter_frame(frame.annotation, frame.segmentation_png).decisions
        for decision, line in zip(decisions, frame.truth, strict=True):
            if not line["visible"]:
                ghosts += 1
                rejected += decision["verdict"] == "rejected"

    assert rejected / ghosts > 0.6
