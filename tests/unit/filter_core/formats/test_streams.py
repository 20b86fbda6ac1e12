"""Which images of a folder are frames, and which belong to one."""

import json
from itertools import product

import numpy as np
import pytest

from filter_core.config.filter import FilterConfig
from filter_core.errors import LayoutError
from filter_core.formats.reading import RECORDING_NAME
from filter_core.formats.recording import (
    RecordingDescription,
    describe,
    description_text,
)
from filter_core.formats.registry import read_source
from filter_core.formats.streams import Streams
from filter_core.formats.streams.looks import look_of
from filter_core.formats.tables.patterns import FilePattern
from filter_core.local import filter_source
from tests.support.folders import BOX, LAYOUT_FILES, YOLO_LINE, street_tags, write_files
from tests.support.pictures import jpeg, painted, png
from tests.support.shared_data import shared

WIDTH, HEIGHT = 80, 60
_NUMBERS = np.random.default_rng(7)


def photo(*, grey=False):
    """A smooth picture with some noise."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    smooth = np.dstack([x + y, 2 * x + 30, 200 - y])
    noisy = smooth + _NUMBERS.integers(0, 9, (HEIGHT, WIDTH, 3))
    pixels = np.clip(noisy, 0, 255).astype(np.uint8)
    return np.repeat(pixels[:, :, :1], 3, axis=2) if grey else pixels


def raw_tags(*, factor=1):
    red = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    red[:, :, 0] = street_tags() * factor
    return red


def drawn():
    """A few flat surfaces in colours that mean nothing."""
    colors = np.random.default_rng(2).integers(50, 250, (7, 3), np.uint8)
    return np.repeat(np.repeat(colors[:, None], 60, 1), 7, 0)


def grey_tags(factor):
    return np.repeat(raw_tags(factor=factor)[:, :, :1], 3, axis=2)


def depth(*, swapped=False):
    """A wall seen from the side, as CARLA's 24 bits, below a sky without end."""
    metres = np.linspace(4, 60, WIDTH)[None, :] + np.zeros((HEIGHT, 1))
    metres[: HEIGHT // 3] = 1000
    code = (metres / 1000 * (2**24 - 1)).astype(np.uint32)
    pixels = np.dstack([code & 255, code >> 8 & 255, code >> 16]).astype(np.uint8)
    return pixels[:, :, ::-1].copy() if swapped else pixels


def instances(*, swapped=False):
    pixels = np.dstack([street_tags(), street_tags() // 14 * 30, street_tags() * 9])
    pixels = pixels.astype(np.uint8)
    return pixels[:, :, ::-1].copy() if swapped else pixels


LOOKS = [
    (photo(), "photo"),
    (photo(grey=True), "grey"),
    (painted(street_tags()), "segmentation"),
    (painted(street_tags())[:, :, ::-1].copy(), "segmentation"),
    (raw_tags(), "segmentation"),
    (grey_tags(1), "segmentation"),
    (grey_tags(9), "segmentation"),
    (depth(), "depth"),
    (depth(swapped=True), "depth"),
    (instances(), "instances"),
    (instances(swapped=True), "instances"),
    (np.full((HEIGHT, WIDTH, 3), 128, np.uint8), None),
]


def test_pixels_tell_what_carla_and_its_users_write(tmp_path):
    looks = []
    for pixels, _look in LOOKS:
        write_files(tmp_path, {"1.png": png(pixels)})
        looks.append(look_of(tmp_path / "1.png"))
    write_files(tmp_path, {"2.jpg": jpeg(photo()), "3.png": b"", "4.png": b"\x89PNG"})

    assert looks == [look for _, look in LOOKS]
    assert [look_of(tmp_path / name) for name in ("2.jpg", "3.png", "4.png")] == [
        "photo", None, None
    ]  # fmt: skip


def frames_of(recording):
    """Each frame's key, and its auxiliary images relative to the folder."""
    frames = {}
    for frame in recording:
        files = {"segmentation": frame.segmentation, **frame.others}
        root = frame.image.parents[len(frame.key.split("/")) - 1]
        frames[frame.key] = {
            role: path.relative_to(root).as_posix()
            for role, path in files.items()
            if path is not None
        }
    return frames


@pytest.mark.parametrize(
    ("key", "segmentation"),
    [
        ("rgb/1", "seg/1.png"),
        ("rgb/1", "seg/rgb/1.png"),
        ("rgb/1", "Semantic_Segmentation/1.png"),
        ("front/rgb/1", "front/seg/1.png"),
        ("rgb/front/1", "SEM/front/1.png"),
        ("CAM_FRONT/1", "SEGCAM_FRONT/1.png"),
        ("RgbCamera/1", "SemanticCamera/1.png"),
        ("1", "images_segmentation/1.png"),
        ("TRAINING/rgb_2/1", "training/../TRAINING/semseg_2/1.png"),
        ("out/1", r"out\seg/1.png"),
        ("1", "1_semseg.png"),
        ("cam/1", "cam/1-SEG.png"),
        ("rgb20191104-142916", "sem20191104-142916.png"),
        ("rgb_000001", "seg_000001.png"),
        ("front_rgb_1", "front_seg_1.png"),
        ("000001/rgb", "000001/semantic.png"),
        ("a/b/1", "seg/1.png"),
    ],
)
def test_segmentation_is_told_by_words_of_its_path(tmp_path, key, segmentation):
    write_files(tmp_path, {f"{key}.png": png(photo()), "TRAINING/x.md": ""})
    (tmp_path / "training").mkdir(exist_ok=True)
    write_files(tmp_path, {segmentation: png(painted(street_tags()))})

    recording = read_source(tmp_path)
    (frame,) = recording

    assert frame.key == key
    assert frame.segmentation is not None
    assert frame.segmentation.samefile(tmp_path / segmentation)
    assert recording.unmatched == ()


def test_each_camera_keeps_its_own_images_of_every_kind(tmp_path):
    """24 of 36 images are no pictures; left has no depth, and gets none of front."""
    drawn = {"rgb": photo(), "seg": painted(street_tags()), "instances": instances()}
    contents = {kind: png(pixels) for kind, pixels in drawn.items()}
    for camera, number in product(("front", "left"), range(6)):
        names = {f"{camera}/{kind}/{number:06d}.png": kind for kind in contents}
        write_files(tmp_path, {name: contents[kind] for name, kind in names.items()})
    write_files(tmp_path, {"front/depth/000000.png": png(depth())})

    recording = read_source(tmp_path)
    frames = frames_of(recording)

    assert len(frames) == 12
    assert recording.unmatched == ()
    assert frames["front/rgb/000000"]["depth"] == "front/depth/000000.png"
    left = frames["left/rgb/000000"]
    assert left == {
        role: f"left/{folder}/000000.png"
        for role, folder in (("segmentation", "seg"), ("instances", "instances"))
    }


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        # Names of folders that nobody could know.
        ({"x/1.png": photo(), "y/1.png": painted(street_tags())},
         {"x/1": {"segmentation": "y/1.png"}}),
        # One folder with names that differ in the kind by a word that nobody knows.
        ({"1.png": photo(), "2.png": painted(street_tags()), "3.png": photo()},
         {"1": {}, "3": {}}),
        ({"masks/1.png": raw_tags(), "1.png": photo()},
         {"1": {"segmentation": "masks/1.png"}}),
        ({"masks/1.png": photo(grey=True), "1.png": photo()}, {"1": {}}),
        ({"1.png": photo(), "zz/1.png": depth()}, {"1": {"depth": "zz/1.png"}}),
        # The name says a picture, the pixels do not: a question, not a guess.
        ({"rgb/1.png": photo(), "rgb2/1.png": painted(street_tags())}, {"rgb/1": {}}),
        # Grey beside colour: depth that was saved for people, or a picture?
        ({"rgb/1.png": photo(), "k/1.png": photo(grey=True)}, {"rgb/1": {}}),
        # Neither name nor pixels tell what it is, such as depth of a drawn scene.
        ({"rgb/1.png": photo(), "stuff/1.png": drawn()}, {"rgb/1": {}}),
        ({"x/1.png": photo(), "stuff/1.png": drawn()}, {"x/1": {}, "stuff/1": {}}),
        # A camera without colours.
        ({"k/1.png": photo(grey=True)}, {"k/1": {}}),
        # Words of roles that mean something else.
        ({"seg_1.png": photo(), "seg_2.png": photo()}, {"seg_1": {}, "seg_2": {}}),
        ({"depth_test/images/1.png": photo()}, {"depth_test/1": {}}),
        ({"rgb/1.png": photo(), "normals/1.png": photo()}, {"rgb/1": {}}),
    ],
)  # fmt: skip
def test_pixels_decide_where_names_say_nothing(tmp_path, files, expected):
    write_files(tmp_path, {name: png(pixels) for name, pixels in files.items()})

    recording = read_source(tmp_path)
    frames = frames_of(recording)

    assert frames == expected
    used = {f"{key}.png" for key in frames}
    used |= {path for frame in frames.values() for path in frame.values()}
    unused = {name.replace("images/", "") for name in files} - used
    assert {file.path for file in recording.unmatched} == unused
    assert all(file.why for file in recording.unmatched)


def test_auxiliary_images_are_no_images_of_labels(tmp_path):
    """An image `seg/1.png` is not that of the label `labels/1.txt`."""
    files = {"labels/1.txt": YOLO_LINE, "classes.txt": "car"}
    images = {"pictures/1.jpg": jpeg(photo()), "depth/1.png": png(depth())}
    write_files(tmp_path, {**files, **images, "seg/1.png": png(raw_tags())})

    (frame,) = read_source(tmp_path)

    assert frame.image == tmp_path / "pictures/1.jpg"
    assert frame.segmentation == tmp_path / "seg/1.png"
    assert frame.others == {"depth": tmp_path / "depth/1.png"}
    assert frame.annotation == {"boxes": [BOX]}
    named = tmp_path / "named"
    write_files(named, dict.fromkeys(("rgb/1.png", "seg/1.png", "better/1.png")))
    options = RecordingDescription(segmentation=named / "better")

    (frame,) = read_source(named, options=options)

    assert frame.segmentation == named / "better/1.png"


def test_carlasimu_finds_its_folder_with_a_backslash_from_both_folders(tmp_path):
    names = (r"out\seg/1.png", "out/images/1.png", r"other\seg/1.png")
    write_files(tmp_path, dict.fromkeys(names))
    write_files(tmp_path, {"out/labels/label50/1.txt": YOLO_LINE})

    for folder in (tmp_path, tmp_path / "out"):
        (frame,) = read_source(folder)
        assert frame.segmentation == tmp_path / r"out\seg/1.png"


@pytest.mark.parametrize(
    ("case", "frames"), [("a-cam-kind", 2), ("b-kind-cam", 2), ("c-yolo-cam", 2),
                         ("i-rgb-semantic", 1)],
)  # fmt: skip
def test_cameras_of_a_case_are_told_apart(case, frames):
    recording = read_source(shared(f"cases/18-cameras/{case}"))

    outcomes = list(filter_source(recording, FilterConfig()))
    verdicts = {
        outcome.key: {each["id"]: each["verdict"] for each in outcome.decisions or ()}
        for outcome in outcomes
    }

    assert recording.unmatched == ()
    assert len(verdicts) == frames
    for key, boxes in verdicts.items():
        first = next(iter(boxes.values()))
        assert first == ("rejected" if "left" in key else "kept"), key


NAMES = ("0000", "0001", "0002")


@pytest.mark.parametrize(
    ("picture", "segmentation"),
    [
        ("{}", "{}_gt"),
        ("{}", "gt_{}"),
        ("{}", "{}gt"),
        ("{}", "{}_gtFine_labelIds"),
        ("town_{}_leftImg8bit", "town_{}_gtFine_labelIds"),
        ("{}-pic", "{}-gt"),
        ("pic_front_{}", "gt_front_{}"),
        ("front_pic_{}", "front_gt_{}"),
        ("dog{}x", "dog{}x_gt"),
    ],
)
@pytest.mark.parametrize("encode", [png, jpeg])
def test_names_that_differ_by_an_ending_are_two_streams(
    tmp_path, picture, segmentation, encode
):
    suffix = "png" if encode is png else "jpg"
    pairs = {picture.format(n): f"{segmentation.format(n)}.png" for n in NAMES}
    for key, tags in pairs.items():
        write_files(tmp_path, {f"{key}.{suffix}": encode(photo())})
        write_files(tmp_path, {tags: png(raw_tags())})

    recording = read_source(tmp_path)

    expected = {key: {"segmentation": tags} for key, tags in pairs.items()}
    assert frames_of(recording) == expected
    assert recording.unmatched == ()


def test_pictures_that_differ_by_an_ending_are_all_frames(tmp_path):
    names = [f"{name}{camera}" for name in NAMES for camera in ("_left", "_right", "")]
    write_files(tmp_path, {f"{name}.png": png(photo()) for name in names})

    assert sorted(frames_of(read_source(tmp_path))) == sorted(names)


@pytest.mark.parametrize(("kinds_first"), [True, False])
def test_folders_of_many_scenes_share_their_looks(tmp_path, kinds_first):
    scenes = [f"{a}{b}" for a in "bcdfgh" for b in "klmnp"]
    for scene in scenes:
        for kind, pixels in (("pic", photo()), ("gt", raw_tags())):
            folder = f"{kind}/{scene}" if kinds_first else f"{scene}/{kind}"
            write_files(tmp_path, {f"{folder}/{n}.png": png(pixels) for n in (1, 2)})

    recording = read_source(tmp_path)
    frames = frames_of(recording)

    assert len(frames) == 2 * len(scenes)
    for key, files in frames.items():
        assert files == {"segmentation": f"{key.replace('pic', 'gt')}.png"}
    assert recording.unmatched == ()
    assert "were not looked at" in " ".join(recording.notes())


def test_a_segmentation_that_could_be_of_two_pictures_is_of_none(tmp_path):
    files = {f"{camera}/1.png": png(photo()) for camera in ("front", "left")}
    write_files(tmp_path, {**files, "gt/1.png": png(raw_tags())})

    recording = read_source(tmp_path)

    assert frames_of(recording) == {"front/1": {}, "left/1": {}}
    (left,) = recording.unmatched
    assert left.path == "gt/1.png"
    assert "2 frames are called like it" in left.why


def test_a_folder_whose_images_all_have_other_looks_is_not_read_whole(tmp_path):
    """Beyond a number, names decide, and that is said."""
    picture, tags = png(photo()[:8]), png(raw_tags())
    names = [f"{n:04}" for n in range(400)]
    files = dict.fromkeys(names, picture) | {names[0]: tags}
    write_files(tmp_path, {f"{name}.png": files[name] for name in names})

    recording = read_source(tmp_path)

    assert len(list(recording)) == 399
    (note,) = recording.notes()
    assert note.startswith("144 images, such as ")
    assert "their names alone" in note
    # A grey picture among pictures costs no look at each: all are frames.
    grey = tmp_path / "grey"
    files = {f"images/{n:04}.png": png(photo()[:8]) for n in range(300)}
    write_files(grey, {**files, "images/0150.png": png(photo(grey=True))})

    recording = read_source(grey)

    assert len(list(recording)) == 300
    assert recording.notes() == ()


def _coco(*names):
    images = [
        {"id": number, "file_name": f"{name}.png", "width": 80, "height": 60}
        for number, name in enumerate(names)
    ]
    return json.dumps({"images": images, "annotations": [], "categories": []})


def _cvat(*names):
    images = (f'<image name="{name}.png"/>' for name in names)
    return f"<annotations><version>1.1</version>{''.join(images)}</annotations>"


def _tasks(*names):
    done = [{"result": ()}]
    tasks = ({"data": {"image": f"{name}.png"}, "annotations": done} for name in names)
    return json.dumps([*tasks])


def _both(write, name):
    """The labels of two frames, and those of another one that is a draft."""
    drafts = {name.format("draft"): write("drafts/9")}
    return {name.format("a"): write("front/0", "left/0"), **drafts}


_OF_LAYOUT = {
    "yolo": ("images", {"labels/{}.txt": "", "classes.txt": "car"}),
    "kitti": ("image_2", {"label_2/{}.txt": ""}),
    "voc": ("JPEGImages", {"Annotations/{}.xml": "<annotation></annotation>"}),
    "carlasimu": ("images", {"labels/label50/{}.txt": ""}),
    "coco": ("images", _both(_coco, "annotations/{}.json")),
    "cvat": ("images", _both(_cvat, "{}.xml")),
    "label-studio": ("images", _both(_tasks, "{}.json")),
    "pairs": ("images", {"images/{}.json": '{"boxes": []}'}),
    "table": ("images", {"labels/{}.csv": "class,x1,y1,x2,y2\ncar,1,2,3,4\n"}),
}


def of_each(names, labels):
    """The label files of frames, by names with braces for those of frames."""
    return {
        label.format(name): text for label, text in labels.items() for name in names
    }


@pytest.mark.parametrize("layout", _OF_LAYOUT)
def test_description_says_roles_in_every_layout_whatever_names_say(tmp_path, layout):
    pictures, labels = _OF_LAYOUT[layout]
    names = ("front/0", "left/0", "drafts/9")
    folders = (pictures, "depth")
    images = [f"{folder}/{name}.png" for folder in folders for name in names]
    scans = [f"scans/{name.replace('/', '_')}.ply" for name in names]
    write_files(tmp_path, of_each(names, labels))
    write_files(tmp_path, dict.fromkeys((*images, "semantic/view 0 of front.png")))
    write_files(tmp_path, dict.fromkeys(scans, "ply"))
    keys = [frame.key for frame in read_source(tmp_path, layout)]
    described = """
    files:
      segmentation: "depth/{camera}/{frame}.png"
      depth: "semantic/view {frame} of {camera}.png"
      lidar: "scans/{camera}_{frame}.ply"
      ignore: ["**/drafts/*", "**/draft.*", "scans/drafts_9.ply"]
    """
    (tmp_path / RECORDING_NAME).write_text(described)

    recording = read_source(tmp_path)
    front, left = recording

    assert (recording.layout, recording.unmatched) == (layout, ())
    assert [front.key, left.key] == [key for key in keys if "9" not in key]
    assert front.segmentation == tmp_path / "depth/front/0.png"
    assert left.segmentation == tmp_path / "depth/left/0.png"
    view = tmp_path / "semantic/view 0 of front.png"
    assert front.others == {"depth": view, "lidar": tmp_path / "scans/front_0.ply"}
    assert left.others == {"lidar": tmp_path / "scans/left_0.ply"}
    told = {(each.role, each.images) for each in recording.streams if each.told_by}
    assert {("segmentation", 2), ("depth", 1), ("lidar", 2)} <= told
    assert sum(each.images for each in recording.streams if each.role == "image") == 2


@pytest.mark.parametrize("layout", ["coco", "cvat", "label-studio"])
def test_labels_of_many_frames_must_be_a_file(tmp_path, layout):
    described = f"layout: {layout}\nboxes: {{labels: .}}"
    write_files(tmp_path, {**LAYOUT_FILES[layout], RECORDING_NAME: described})

    with pytest.raises(LayoutError) as refused:
        read_source(tmp_path)

    assert refused.value.detail.startswith("boxes.labels: expected a")
    assert refused.value.detail.endswith(f"found {tmp_path.name}, which is no file")


@pytest.mark.parametrize("layout", ["yolo", "pairs", "table"])
def test_described_pictures_share_what_their_names_in_braces_say(tmp_path, layout):
    """Both cameras have one point file, and numbers may differ in zeros before them."""
    labels = {
        label.replace("images/", ""): text
        for label, text in _OF_LAYOUT[layout][1].items()
    }
    described = """
    files:
      image: "seg/{camera}/{frame}.png"
      segmentation: "rgb/{frame}_{camera}.png"
      lidar: "scan/{frame}.ply"
    """
    files = {RECORDING_NAME: described, "scan/7.ply": "ply", "depth/left/07.png": None}
    pictures = ("seg/front/07.png", "seg/left/07.png")
    tags = ("rgb/7_front.png", "rgb/7_left.png", "rgb/8_left.png")
    write_files(tmp_path, of_each(("seg/front/07", "seg/left/07"), labels))
    write_files(tmp_path, {**files, **dict.fromkeys((*pictures, *tags))})

    recording = read_source(tmp_path, layout)
    front, left = recording

    lidar, depth = tmp_path / "scan/7.ply", tmp_path / "depth/left/07.png"
    assert [each.image for each in recording] == [tmp_path / name for name in pictures]
    assert front.segmentation == tmp_path / "rgb/7_front.png"
    assert left.segmentation == tmp_path / "rgb/7_left.png"
    assert front.others == {"lidar": lidar}
    assert left.others == {"depth": depth, "lidar": lidar}
    assert [file.path for file in recording.unmatched] == ["rgb/8_left.png"]


def test_described_pictures_of_kitti_may_be_in_another_folder(tmp_path):
    described = "files: {image: 'left/{frame}.png', depth: 'seg/d{frame}.png'}"
    names = ("left/7.png", "seg/d7.png", "seg/7.png", "right/7.png")
    write_files(tmp_path, {RECORDING_NAME: described, "label_2/7.txt": ""})
    write_files(tmp_path, dict.fromkeys(names))

    (frame,) = read_source(tmp_path)

    assert frame.image is not None
    assert frame.image.resolve() == tmp_path / "left/7.png"
    assert frame.segmentation == tmp_path / "seg/7.png"
    assert frame.others == {"depth": tmp_path / "seg/d7.png"}


@pytest.mark.parametrize(
    ("files", "patterns"),
    [
        ("seg/1.png seg/2.png rgb/1.jpg", {"seg/{frame}.png", "rgb/{frame}.jpg"}),
        ("1.png 1_semseg.png 2_semseg.png", {"{frame}.png", "{frame}_semseg.png"}),
        ("rgb7.png rgb8.png seg7.png", {"rgb{frame}.png", "seg{frame}.png"}),
        (
            "a/1.png a/1_gt.png a/2.png a/2_gt.png",
            {"a/{frame}.png", "a/{frame}_gt.png"},
        ),
        ("train/images/1.png val/images/2.png", {"{part}/images/{frame}.png"}),
        (
            "front/rgb/1.jpg left/rgb/1.jpg front/seg/1.png left/seg/1.png",
            {"{camera}/rgb/{frame}.jpg", "{camera}/seg/{frame}.png"},
        ),
        (
            "CAM_FRONT/1.jpg CAM_LEFT/1.jpg SEGCAM_FRONT/1.png SEGCAM_LEFT/1.png",
            {"CAM_{camera}/{frame}.jpg", "SEGCAM_{camera}/{frame}.png"},
        ),
        (
            "t1/r1/left/rgb/1.png t2/r1/front/rgb/1.png t2/r1/left/depth/1.png",
            {"{part}/r1/{camera}/rgb/{frame}.png", "t2/r1/left/depth/{frame}.png"},
        ),
        ("x/1.PNG x/2.png", {None}),
        ("a:b/1.png", {None}),
        ("a/rgb/1.png b/2/rgb/1.png", {"a/rgb/{frame}.png", "b/2/rgb/{frame}.png"}),
    ],
)
def test_stream_is_what_its_pattern_matches_unless_another_is_more_specific(
    tmp_path, files, patterns
):
    names = files.split()
    write_files(tmp_path, dict.fromkeys(names, b""))

    streams = Streams(tmp_path).facts

    assert {each.pattern for each in streams} == patterns
    parsed = [FilePattern(each.pattern) for each in streams if each.pattern is not None]
    of_pattern: dict[str, list[str]] = {}
    for name in names:
        matching = [pattern for pattern in parsed if pattern.match(name) is not None]
        for best in sorted(matching, key=lambda pattern: -pattern.fixed)[:1]:
            of_pattern.setdefault(best.text, []).append(name)
    assert {text: (len(all_), all_[0]) for text, all_ in of_pattern.items()} == {
        each.pattern: (each.images, each.example) for each in streams if each.pattern
    }


@pytest.mark.parametrize("above", ["", "record_data/runs1/"])
def test_folder_of_one_side_only_keeps_no_images_apart(tmp_path, above):
    pictures = {f"{above}Camera_Center/{name}.jpg": b"" for name in (1953, 1954)}
    tags = {name.replace("Camera_Center", "Segment_Camera"): b"" for name in pictures}
    write_files(tmp_path, {**pictures, **tags, "README.md": b""})

    recording = read_source(tmp_path)

    segmentations = [frame.segmentation for frame in recording]
    assert segmentations == [tmp_path / name for name in sorted(tags)]
    assert recording.unmatched == ()


def test_a_role_may_have_several_patterns(tmp_path):
    names = ("a/gt/1.png", "a/1.png", "b/c/classes/2.png", "b/c/2.png")
    patterns = ["{run}/gt/{frame}.png", "{run}/c/classes/{frame}.png"]
    text = json.dumps({"files": {"segmentation": patterns, "depth": "d/{frame}.png"}})
    write_files(tmp_path, {RECORDING_NAME: text, **dict.fromkeys(names)})

    frames = {frame.key: frame.segmentation for frame in read_source(tmp_path)}

    assert frames == {"a/1": tmp_path / names[0], "b/c/2": tmp_path / names[2]}
    description = describe(tmp_path)
    assert description.files.document["segmentation"] == patterns
    assert description_text(description, tmp_path).count("{frame}") == 3


@pytest.mark.parametrize(
    ("picture", "segmentation", "belongs"),
    [
        pytest.param("rgb", "run/semantic_id", True, id="the only one of its folder"),
        pytest.param("rgb_7", "run/semantic_8", False, id="numbers differ"),
        pytest.param("rgb_7", "other/semantic_id", False, id="another folder"),
    ],
)
def test_only_images_of_a_folder_belong_together(
    tmp_path, picture, segmentation, belongs
):
    write_files(tmp_path, {f"run/scene_{picture}.png": png(photo())})
    write_files(tmp_path, {f"{segmentation}.png": png(painted(street_tags()))})

    (frame,) = read_source(tmp_path)

    assert (frame.segmentation is not None) == belongs
