"""What names of files and folders mean: roles of images, labels, cameras, bands.

Every reader tells by these words what is what; layouts add the names that their format
itself fixes, such as KITTI's ``label_2``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Final, Literal, NamedTuple, TypeAlias

Role: TypeAlias = Literal[
    "image",
    "segmentation",
    "instances",
    "depth",
    "mask",
    "ignore_mask",
    "other",
    "lidar",
    "radar",
]
"""What the files of a stream are. ``mask``: either classes or whatever else a mask
marks; ``other``: what no frame has, such as optical flow. ``lidar`` and ``radar`` are
point files, which only a description or a manifest names."""

ROLE_WORDS: Final[Mapping[Role, str]] = {
    "other": "optical|opticalflow|optflow|flow|normals|disparity|dvs|lidar|radar|"
    "panoptic|heatmap",
    "ignore_mask": "ignore|ignored",
    "instances": "instances|instance|inst|ist",
    "depth": "depths|depth|dpt",
    "segmentation": "segmentations|segmentation|segments|segment|segs|segm|seg|"
    "semantics|semantic|sem",
    "mask": "masks|mask|segmentationclass|segmentationobject",
    "image": "images|image|img|jpegimages|imgs|rgba|rgb|cameras|camera|cam|"
    "photos|photo|colour|color",
}
"""Words in names, the deciding ones first: an instance segmentation has instances."""

FOLDER_WORDS: Final = frozenset(
    {"images", "image", "img", "jpegimages", "labels", "label", "annotations"}
)
"""Names of folders that describe the kind of files, and are not part of a key."""

YAML_LISTS: Final = ("data.yaml", "data.yml", "dataset.yaml")
"""YOLO's description of a dataset: its classes and its parts."""

TEXT_LISTS: Final = ("classes.txt", "labels.txt", "obj.names")
"""Names of lists of classes with one name in each line."""

_TEXTS_AT_THE_TOP: Final = frozenset(
    {
        "labelmap.txt",
        "readme.txt",
        "requirements.txt",
        "train.txt",
        "val.txt",
        "test.txt",
    }
)
"""Lists of files and notes in a dataset's top folder; in sub-folders such a file is a
frame's."""


def holds_boxes(name: str) -> bool:
    """Whether a label file, relative to its dataset, holds boxes, by its name.

    Lists of classes, lists of files and notes hold none.
    """
    folder, _, base = name.lower().rpartition("/")
    if folder.split("/")[0] == "imagesets":
        return False
    return base not in TEXT_LISTS and (folder or base) not in _TEXTS_AT_THE_TOP


_MAP: Final = re.compile(
    r"(?<![a-z])(?:town(?P<number>\d\d)(?P<hd>hd)?|(?P<mine>mine_01))(?P<opt>_opt)?(?!\d)",
    re.IGNORECASE,
)
"""CARLA's maps, https://carla.readthedocs.io/en/latest/core_map/#carla-maps."""


@lru_cache(4096)
def map_in(path: str) -> str | None:
    """The map of CARLA that a path names, the last one if there are several.

    ``runs/Town10HD_Opt_rain/7.png`` names ``Town10HD_Opt``.
    """
    names = [*_MAP.finditer(path)]
    if not names:
        return None
    name = names[-1]
    town = f"Town{name['number']}{'HD' if name['hd'] else ''}"
    return f"{'Mine_01' if name['mine'] else town}{'_Opt' if name['opt'] else ''}"


_VIEWS: Final = (
    *("back", "cam", "center", "centre", "front"),
    *("left", "rear", "right", "side", "top"),
)

VIEW_WORD: Final = re.compile("|".join(_VIEWS), re.IGNORECASE)
"""In the name of a folder of one of several cameras."""

_CAMERA_WORDS: Final = frozenset(
    (*_VIEWS, "backward", "bev", "camera", "forward", "image", "rgb", "view")
)

_LETTERS: Final = re.compile(r"[A-Za-z]+")


def is_camera(folder: str) -> bool:
    """Whether the name of a folder says nothing but which camera its files are of."""
    words = {word.lower() for word in _LETTERS.findall(folder)}
    return bool(words) and words <= _CAMERA_WORDS


_BAND: Final = re.compile(r"label\d+", re.IGNORECASE)


def is_band(folder: str) -> bool:
    """Whether a folder of this name has the labels of one distance band."""
    return _BAND.fullmatch(folder) is not None


def is_label_folder(name: str) -> bool:
    """Whether a folder is called like one of labels, beside which bands may be."""
    return is_band(name) or name.lower() in ("labels", "label_2", "annotations")


_ALL_WORDS: Final = "|".join(ROLE_WORDS.values())
_CONSISTS_OF_WORDS: Final = re.compile(rf"(?:{_ALL_WORDS})+")
_ANY_WORD: Final = re.compile(_ALL_WORDS)
_ONE_OF: Final = {role: re.compile(words) for role, words in ROLE_WORDS.items()}
_TOKEN: Final = re.compile(r"[A-Za-z]+|[^A-Za-z]+")
_SEPARATORS: Final = " _-."


class Part(NamedTuple):
    """One name of a path, and what its words say.

    It `is_pure` if it consists of words of roles alone; `picture` is it without the
    words of auxiliary roles, `frame` without those of all.
    """

    role: Role | None
    is_pure: bool
    picture: str
    frame: str


def part_of(name: str) -> Part:
    """What one name of a path says."""
    if not _ANY_WORD.search(name.lower()):
        return Part(None, False, name, name)
    roles: set[Role] = set()
    picture, frame = [], []
    for token in _TOKEN.findall(name):
        token_roles = _roles_of(token.lower())
        roles |= token_roles
        picture.append("" if token_roles - {"image"} else token)
        frame.append("" if token_roles else token)
    role = next((candidate for candidate in ROLE_WORDS if candidate in roles), None)
    if role is None:
        return Part(None, False, name, name)
    texts = (name if role == "image" else _joined(picture), _joined(frame))
    return Part(role, not texts[1], *texts)


@lru_cache(4096)
def _roles_of(token: str) -> frozenset[Role]:
    """The roles that a token of letters names, if it consists of nothing else."""
    if not _CONSISTS_OF_WORDS.fullmatch(token):
        return frozenset()
    return frozenset(role for role, words in _ONE_OF.items() if words.search(token))


_SEVERAL_SEPARATORS: Final = re.compile(r"([ _.-])[ _.-]+")


def _joined(tokens: Iterable[str]) -> str:
    """Tokens without the separators around those that are left out."""
    return _SEVERAL_SEPARATORS.sub(r"\1", "".join(tokens)).strip(_SEPARATORS)
