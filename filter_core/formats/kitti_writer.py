"""KITTI's object layout: training/label_2 with 15 columns, calib and ImageSets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Final

import numpy as np

from filter_core.formats.export_boxes import OutBox, Traits, clipped
from filter_core.formats.kitti_box3d import to_kitti_box
from filter_core.formats.writing import PARTS, Desk, OutFrame
from filter_core.geometry.camera import Camera

DONT_CARE: Final = "DontCare"

_NO_BOX: Final = (-1.0, -1.0, -1.0, -1000.0, -1000.0, -1000.0, -10.0)
"""KITTI's own numbers for a 3D box that is not known."""

_NO_ALPHA: Final = -10.0

_UNKNOWN_OCCLUSION: Final = 3

_VELODYNE_AXES: Final = (0, -1, 0, 0, 0, 0, -1, 0, 1, 0, 0, 0)

_IDENTITY: Final = (1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0)


class KittiWriter:
    """Writes ``training/label_2/NNNNNN.txt`` and what belongs to it.

    Frames are numbered in the order of the export, ``frames.jsonl`` says which is
    which. Boxes to ignore are ``DontCare``. What a KITTI file said of truncation,
    occlusion, alpha and the 3D box is given back; else truncation is the share beyond
    the image, occlusion is what depth says of it, 3 (unknown) without, and the 3D
    columns come from the 3D box and the camera, or are KITTI's numbers for unknown.

    References
    ----------
    .. [1] Geiger, Lenz and Urtasun, KITTI object development kit, readme.txt,
       https://www.cvlibs.net/datasets/kitti/eval_object.php
    """

    traits: ClassVar[Traits] = Traits("kitti", keys=True)

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._types = kitti_types(desk.head.classes)
        self._parts = {part: desk.spool() for part in PARTS}
        changed = {name: word for name, word in self._types.items() if name != word}
        if changed:
            desk.facts["kitti_types"] = changed

    def image(self, out: OutFrame) -> str:
        """The name of a frame's image in the export."""
        return f"training/image_2/{out.number:06}{out.suffix}"

    def labels(self, band: str, out: OutFrame) -> None:
        """One label file; with the first, calibration and part too."""
        name = f"{out.number:06}.txt"
        lines = [self._line(one, out.frame.camera) for one in out.boxes]
        lines += [_ignored(xyxy) for xyxy in _regions(out)]
        text = "".join(f"{line}\n" for line in lines)
        self._desk.sink(f"training/{band or 'label_2'}/{name}", [text.encode()])
        if band:
            return
        self._parts[out.part].write(f"{out.number:06}\n".encode())
        if out.frame.camera is not None:
            calibration = _calibration(out.frame.camera)
            self._desk.sink(f"training/calib/{name}", [calibration.encode()])

    def finish(self) -> None:
        """Which frames are for training."""
        for part, spool in self._parts.items():
            self._desk.sink(f"ImageSets/{part}.txt", spool.pieces())

    def _line(self, out: OutBox, camera: Camera | None) -> str:
        if out.ignored:
            return _ignored(out.xyxy)
        given = out.box.given.get("kitti")
        given = given if isinstance(given, Mapping) else {}
        alpha, solid = _solid(out, camera, given)
        columns = (alpha, *out.xyxy, *solid)
        first = (
            self._types[out.box.class_name],
            number_text(_truncated(out, given)),
            str(_occluded(out, given)),
        )
        return " ".join([*first, *map(number_text, columns)])


def kitti_types(classes: Sequence[str]) -> dict[str, str]:
    """A word without a space for every class, different for each."""
    words: dict[str, str] = {}
    taken = {DONT_CARE.lower()}
    for name in classes:
        stem = "_".join(name.split()) or "_"
        word, number = stem, 2
        while word.lower() in taken:
            word, number = f"{stem}_{number}", number + 1
        taken.add(word.lower())
        words[name] = word
    return words


def number_text(value: float) -> str:
    """At least two decimals, as KITTI has, and up to four where they say more."""
    # Adding zero takes the sign from a zero that was rounded.
    text = f"{round(value, 4) + 0.0:.4f}"
    return text[:-2] if text.endswith("00") else text.removesuffix("0")


def _solid(
    out: OutBox, camera: Camera | None, given: Mapping[str, Any]
) -> tuple[float, Sequence[float]]:
    """Alpha and the seven 3D columns."""
    if out.box.vertices is not None and camera is not None:
        box = to_kitti_box(out.box.vertices, camera)
        return box.alpha, (*box.dimensions, *box.location, box.rotation_y)
    numbers = [*_list(given, "dimensions", 3), *_list(given, "location", 3)]
    rotation = given.get("rotation_y")
    alpha = float(given.get("alpha", _NO_ALPHA))
    if len(numbers) == 6 and isinstance(rotation, (int, float)):
        return alpha, (*numbers, float(rotation))
    return alpha, _NO_BOX


def _list(given: Mapping[str, Any], key: str, length: int) -> list[float]:
    value = given.get(key)
    if not isinstance(value, list) or len(value) != length:
        return []
    return [float(one) for one in value if isinstance(one, (int, float))]


def _truncated(out: OutBox, given: Mapping[str, Any]) -> float:
    value = given.get("truncated")
    return float(value) if isinstance(value, (int, float)) else out.cut


def _occluded(out: OutBox, given: Mapping[str, Any]) -> int:
    said = (given.get("occluded"), out.box.given.get("occluded"))
    for value in (*said, out.box.decision.get("occluded")):
        if isinstance(value, int) and 0 <= value <= _UNKNOWN_OCCLUSION:
            return int(value)
    return _UNKNOWN_OCCLUSION


def _ignored(xyxy: Sequence[float]) -> str:
    columns = (*xyxy, *_NO_BOX)
    first = f"{DONT_CARE} -1 -1 {number_text(_NO_ALPHA)}"
    return " ".join([first, *map(number_text, columns)])


def _regions(out: OutFrame) -> list[Sequence[float]]:
    """Regions to ignore that came with the frame."""
    given = out.frame.annotation.get("dontcare")
    rows = given if isinstance(given, list) else []
    usable = [row for row in rows if isinstance(row, list) and len(row) == 4]
    return [clipped(row, out.frame.wh) for row in usable]


def _calibration(camera: Camera) -> str:
    projection = np.hstack([camera.intrinsic, np.zeros((3, 1))]).ravel().tolist()
    rows = {
        **{f"P{number}": projection for number in range(4)},
        "R0_rect": np.eye(3).ravel().tolist(),
        "Tr_velo_to_cam": _VELODYNE_AXES,
        "Tr_imu_to_velo": _IDENTITY,
    }
    return "".join(
        f"{name}: {' '.join(f'{float(v):.12e}' for v in row)}\n"
        for name, row in rows.items()
    )
