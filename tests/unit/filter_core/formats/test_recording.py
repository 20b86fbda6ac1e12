"""The description of a recording: from its file and from options, into readers."""

import pytest

from filter_core.annotation.parsing import parse_annotation
from filter_core.config.declaration import declared_keys
from filter_core.config.file import load_config
from filter_core.errors import ConfigError, LayoutError
from filter_core.formats.reading import RECORDING_NAME
from filter_core.formats.recording import LAYOUTS, RecordingDescription, describe
from filter_core.formats.registry import FORMATS, read_source
from tests.support.folders import write_files

WHOLE = """
layout: yolo
split: folders
segmentation:
  folder: tags
  palette: carla-0.9.14
  encoding: raw
  channel_order: bgr
  lossy: nearest
  tags: {40: pedestrian, "#0A00FF": Car, [220, 20, 60]: Rider}
  scale: 2
depth: {encoding: carla-bgr}
boxes:
  labels: boxes
  classes: [van, car]
  default_class: van
  unit: percent
  corners: xyxy
classes:
  sign: {accept: [TrafficSign]}
companions: {velodyne: 2}
map: Town04
"""
OF_TABLES = ("files", "key", "fields", "cameras")


def test_every_key_of_a_description_reaches_reader_or_configuration(tmp_path):
    files = {"rgb/1.png": None, "tags/1.png": None, "boxes/1.txt": "1 20 30 40 50"}
    write_files(tmp_path, {**files, RECORDING_NAME: WHOLE})

    description = describe(tmp_path)
    (frame,) = read_source(tmp_path)

    assert {*description.changed, "origin", *OF_TABLES} == {
        *declared_keys(RecordingDescription)
    }
    assert frame.segmentation == tmp_path / "tags/1.png"
    annotation = parse_annotation(frame.annotation or {})
    (box,) = annotation.boxes
    assert (box.class_name, box.form, annotation.map) == ("car", "xyxyn", "Town04")
    assert box.values == pytest.approx([0.2, 0.3, 0.4, 0.5])
    settings = {"palette": "carla-0.9.14", "encoding": "raw", "channel_order": "bgr"}
    settings["lossy_segmentation"] = "nearest"
    assert description.segmentation_settings() == settings
    assert description.config_keys() == {
        **settings,
        "tags": {"40": "Pedestrian", "#0a00ff": "Car", "#dc143c": "Rider"},
        "tag_scale": 2,
        "depth_encoding": "carla-bgr",
        "classes": {"sign": {"accept": ["TrafficSign"]}},
    }


def test_description_lies_beside_the_file_too_or_anywhere_if_it_is_named(tmp_path):
    beside = "boxes: {classes: [car]}"
    write_files(tmp_path, {RECORDING_NAME: beside, "x.json": "", "o/other.yaml": ""})

    assert describe(tmp_path / "x.json").classes == ("car",)
    assert describe(tmp_path, tmp_path / "o/other.yaml") == RecordingDescription()
    write_files(tmp_path, {"town/1.png": None, "tags/1.png": None})
    file = tmp_path / "described.yaml"
    file.write_text("segmentation: {folder: ../tags}")

    named = describe(tmp_path / "town", file)

    assert named.segmentation is not None
    assert named.segmentation.samefile(tmp_path / "tags")


def test_option_wins_over_the_file_and_a_configuration_over_both(tmp_path):
    text = "segmentation: {palette: carla-0.9.10}\nclasses: {person: walker, A: car}"
    write_files(tmp_path, {RECORDING_NAME: text})

    options = {"palette": "carla-0.9.14", "class_map": {"A": "bus"}}
    description = describe(tmp_path, options=options)
    config = "classes: {pedestrian: {min_visible_pixels: 7}, A: {accept: [Car]}}"
    below = description.config_keys()

    assert description.palette == "carla-0.9.14"
    assert description.class_map == {"person": "walker", "A": "bus"}
    # A mapping of one class wins under any of its names, and as a whole.
    own = load_config(config, below=below).config.classes["A"]
    assert own.as_dict() == {"accept": ["Car"]}
    assert load_config("palette: paper-table1", below=below).config.palette == (
        "paper-table1"
    )
    assert load_config("", below=below).config.palette == "carla-0.9.14"
    with pytest.raises(ConfigError, match="origin: expected"):
        RecordingDescription(origin="2")  # type: ignore[arg-type]  # the fault that is tested


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("layot: yolo", "recording.yaml: unknown key 'layot'; the nearest valid key "
         "is 'layout'"),
        ("layout: yollo", "layout: expected one of auto, yolo, coco, kitti, voc, "
         "cvat, label-studio, manifest, decisions-jsonl, "
         'carlasimu, nuscenes, table, pairs, found "yollo"; did you mean \'yolo\'?'),
        ("segmentation: {palete: auto}", "recording.yaml: segmentation: unknown key "
         "'palete'; the nearest valid key is 'palette'"),
        ("depth: {encoding: rgb}", "depth: encoding: expected one of auto, carla"),
        ("segmentation: {tags: {256: Car}}", "segmentation.tags.256: expected a "
         "number from 0 to 255, or a colour such as \"#dc143c\" (in quotes) or "
         "[220, 20, 60], found '256'"),
        ("segmentation: {tags: {40: Persn}}", "40: unknown tag 'Persn'; the nearest "
         "valid name is 'Pedestrian'"),
        ("segmentation: {tags: {'#00008e': Car, [0, 0, 142]: Bus}}", "#00008e is given "
         "twice"),
        ("segmentation: {scale: 0}", "segmentation: scale: expected a whole number "
         "from 1 to 255"),
        ("boxes: {origin: 2}", "recording.yaml: boxes: origin: expected"),
        ("boxes: {classes: []}", "boxes: classes: expected a list of class names"),
        ("boxes: [car]", "boxes: expected a mapping of keys, found a list of 1"),
        ("classes: {car: {acept: [Car]}}", "classes.car: unknown key 'acept'"),
        ("split: random", "recording.yaml: split: expected one of auto, none, lists"),
        ("files: {imag: x}", "recording.yaml: files: unknown key 'imag'; the nearest "
         "valid key is 'image'"),
        ("files: {image: x}", "files: image: expected a pattern with {frame} in it"),
        ("files: {image: '../{frame}.png'}", "image: expected a path below the folder"),
        ("files: {image: '{a}{frame}'}", "expected something between two names"),
        ("files: {image: '{frame}.png', depth: '{cam}/{frame}.png'}",
         'files: depth: expected only names that image has, too, found "{cam}"'),
        ("files: {depth: ['{frame}.png', '{a}/{frame}.png']}", "files: depth: expected "
         "a pattern, or a list of patterns that have the same names in braces"),
        ("files: {labels: ['{frame}.txt']}", "files: labels: expected one pattern"),
        ("key: '{camera}'", "key: expected a text with {frame} in it"),
        ("boxes: {fields: {xmin: a}}", "boxes.fields: unknown key 'xmin'"),
        ("boxes: {fields: {x1: a, y1: b}}", "boxes.fields: expected the fields of one "
         "form of boxes"),
        ("boxes: {fields: {id: 'a[('}}", "fields: id: expected the name of a column or "
         "a path (JMESPath): "),
        ("boxes: {classes: {a: car}}", "classes: expected a list of class names"),
        ("cameras: {fow: 90}", "cameras: unknown key 'fow'; the nearest valid key is "
         "'fov'"),
        ("cameras: {pose: {file: /x.json}}", "pose: expected a path below the folder"),
        ("cameras: {mount: {file: a.json, negated: [a]}}", "negated: expected a list"),
        ("boxes: {unit: share}", "boxes: unit: expected one of auto, pixels"),
        ("classes: {a: {name: 3}}", "name: expected a class name, found 3"),
        ("outside_files: true", "unknown key 'outside_files'"),
        ("segmentation: {folder: nowhere}", "segmentation.folder: expected a folder"),
        ("segmentation: {folder: ..}", "found \"..\"; --recording FILE names"),
        ("a: [", "recording.yaml: line 1"),
    ],
)  # fmt: skip
def test_fault_of_a_description_names_file_and_key(tmp_path, text, words):
    write_files(tmp_path, {RECORDING_NAME: text, "1.png": None})

    with pytest.raises(LayoutError) as caught:
        read_source(tmp_path)

    assert words in str(caught.value)
    assert RECORDING_NAME in str(caught.value)


def test_empty_description_changes_nothing(tmp_path):
    write_files(tmp_path, {RECORDING_NAME: "# nothing\nboxes:\nclasses: {}\n"})

    assert describe(tmp_path) == RecordingDescription()
    assert describe(tmp_path).changed == {}
    formats = [name for name, form in FORMATS.items() if form.read]
    assert list(LAYOUTS) == ["auto", *formats]
