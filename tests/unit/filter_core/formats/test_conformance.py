"""What `python -m filter_core.formats.conformance` tells the author of a format."""

from dataclasses import replace
from pathlib import Path

import pytest

from filter_core.formats import conformance
from filter_core.formats.format import Format
from filter_core.formats.reading import BoxOrigin, FrameSet, FrameSource
from filter_core.formats.registry import FORMATS
from tests.support.folders import LAYOUT_FILES, write_files
from tests.support.sources import CHECKOUT

# That of the other tests has no box.
EXAMPLES = {
    **LAYOUT_FILES,
    "manifest": {
        **LAYOUT_FILES["manifest"],
        "manifest.jsonl": b'{"key": "a", "image": "rgb/0.png", "boxes": [{"class": '
        b'"car", "xyxy": [1, 2, 3, 4]}]}\n',
    },
}


@pytest.mark.parametrize("name", [name for name, form in FORMATS.items() if form.read])
def test_every_format_that_can_be_read_conforms(name, tmp_path, capsys):
    example = write_files(tmp_path, EXAMPLES[name])
    constant = name.upper().replace("-", "_")
    module = f"{FORMATS[name].read.__module__}:{constant}"

    assert conformance.main([module, "--example", str(example)]) == 0

    assert capsys.readouterr().out == f"{module} conforms.\n"


def test_example_of_the_documentation_conforms(monkeypatch, capsys):
    monkeypatch.syspath_prepend(str(CHECKOUT / "docs" / "plugin"))

    assert conformance.main(["unghost_corners"]) == 0

    assert capsys.readouterr().out == "unghost_corners conforms.\n"


def with_spans(box_spans, origin):
    """A format with one box, and where it says that it is."""
    box = {"class": "car", "xyxy": [1, 2, 3, 4]}
    source = FrameSource("a", {"boxes": [box]}, origin=origin)
    candidate = strict_format(frames=lambda: iter([source]))
    candidate.spans(box_spans)
    return candidate


def faults(candidate, tmp_path):
    example = write_files(tmp_path / "mine", {"a.txt": "a\n", "b.txt": "b\n"})
    return "\n".join(conformance.faults_of(candidate, example))


def strict_format(name="mine", **changes):
    """A format of texts, of which none may be changed; `changes` are of its frames."""
    candidate = Format(name=name, title="Mine", docs_row="mine", recognised_by="a.txt")

    @candidate.recogniser
    def recognise(source):
        return "certain" if (source.path / "a.txt").is_file() else "none"

    @candidate.reader
    def read(root: Path, options):
        frames = [
            FrameSource(key=path.stem, annotation=annotation(path), label=path.name)
            for path in sorted(root.glob("*.txt"))
        ]
        made = FrameSet("mine", lambda: iter(frames), count=len(frames))
        return replace(made, **changes)

    return candidate


def annotation(path):
    corners = {"a": [1, 2, 3, 4], "b": [2, 3, 4, 5]}[path.read_text().strip()]
    return {"boxes": [{"class": "car", "xyxy": corners}]}


def of_frame(annotation, count=1, **more):
    """A format whose reader gives one frame, perhaps again and again."""
    frames = [FrameSource("a", annotation, **more)] * count
    return strict_format(frames=lambda: iter(frames))


ONCE = strict_format(frames=iter([FrameSource("a", {"boxes": []})]).__iter__)
BAD = Format(name="none", title="", docs_row="a|b", read_options=frozenset("x"))
NO_READER = Format(name="none", title="", docs_row="")
TWICE = of_frame({"boxes": []}, 2)
NO_ORIGIN = with_spans(lambda file: [], None)
NO_PLACES = with_spans(lambda file: [], BoxOrigin(Path(__file__)))
OF_FRAME = "Frame 'a' of the example: "


@pytest.mark.parametrize(
    ("candidate", "sentence"),
    [
        (strict_format(), "With a.txt emptied, the reader fails with KeyError: ''; "),
        (strict_format("yolo"), "name: Unghost has a format 'yolo'; choose another"),
        (strict_format("Mine!"), "name: expected 1 to 40 of a-z, 0-9 and dash"),
        (strict_format("other"), "FrameSet.layout: expected 'other', found 'mine'."),
        (strict_format(count=3), "FrameSet.count is 3, but 2 frames are read."),
        (TWICE, "The key 'a' is that of 2 frames; each has its own."),
        (TWICE, "The example has no box, so that reading boxes is not checked."),
        (of_frame({"boxes": 1}), f"{OF_FRAME}its annotation is refused: "),
        (of_frame(None), f"{OF_FRAME}neither an annotation nor a problem."),
        (of_frame({}, image=Path("/no/a.png")), f"{OF_FRAME}/no/a.png is not there."),
        (ONCE, "The example's frames differ when they are read again"),
        (BAD, "title: expected a text of one line"),
        (BAD, "docs_row: expected a text of one line without '|'"),
        (BAD, "read_options: 'x' is no option of readers; these are cameras, class"),
        (NO_ORIGIN, "Frame 'a' of the example has no origin, which spans need."),
        (NO_PLACES, f"{OF_FRAME}box_spans does not have the places of all 1 "),
        (NO_READER, "The format has no function with the decorator `reader`."),
    ],
)
def test_fault_of_a_format_is_a_sentence(candidate, sentence, tmp_path):
    assert sentence in faults(candidate, tmp_path)


def test_option_that_is_used_but_not_declared_is_told(tmp_path):
    candidate = strict_format()
    read = candidate.read
    assert read is not None
    candidate.reader(lambda root, options: options.classes or read(root, options))

    told = "The reader uses the option 'classes'; read_options does not list it."
    assert told in faults(candidate, tmp_path)


@pytest.mark.parametrize(
    ("answer", "sentences"),
    [
        (
            lambda source: "possible",
            [
                "answers 'possible' for an empty folder; expected 'none'",
                "answers 'possible' for a folder of kitti, with training/label_2/",
                "answers 'possible' for a note in a file",
            ],
        ),
        (lambda source: "none", ["answers 'none' for the example"]),
        (lambda source: True, ["answers True for the example; expected one of cert"]),
        (
            lambda source: min(source.path.iterdir()) and "certain",
            ["answers 'with the error ValueError: min() arg is an empty sequence' "],
        ),
    ],
)
def test_wrong_answer_of_a_recogniser_is_a_sentence(answer, sentences, tmp_path):
    candidate = strict_format()
    candidate.recogniser(answer)

    text = faults(candidate, tmp_path)

    for sentence in sentences:
        assert sentence in text


@pytest.mark.parametrize(
    ("module", "sentence"),
    [
        ("no_such_module", "no_such_module declares no format that can be used: Modu"),
        ("filter_core.formats.decisions", "expected one Format, found 3; MODULE:NAME"),
        ("filter_core.errors", "filter_core.errors: expected one Format, found 0"),
        ("filter_core.formats.coco", "There is no example : expected a small recor"),
    ],
)
def test_module_that_cannot_be_checked_is_told_why(module, sentence, capsys):
    assert conformance.main([module]) == 1

    assert sentence in capsys.readouterr().out
