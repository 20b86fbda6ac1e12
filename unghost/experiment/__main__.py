"""Trains a detector of torchvision from scratch, and writes what it detects.

    python -m unghost.experiment DATA SEED OUTPUT [--steps 2000] [--width 640]

The only module that needs torch and torchvision (`pip install 'unghost[train]'`). It
imports nothing else of Unghost, so it also runs in an environment of its own. The
default is FCOS [1]_ on a small backbone, for machines without a GPU; `--model` names a
builder of ``torchvision.models.detection`` instead. No weights are pretrained, and the
number of steps does not depend on the labels.

References
----------
.. [1] Z. Tian, C. Shen, H. Chen, T. He, "FCOS: Fully Convolutional One-Stage Object
   Detection", ICCV 2019.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import sys
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torchvision.models import detection
from torchvision.models.detection.anchor_utils import AnchorGenerator
from torchvision.models.detection.fcos import (
    FCOS,
    FCOSClassificationHead,
    FCOSHead,
    FCOSRegressionHead,
)
from torchvision.ops import FeaturePyramidNetwork

if TYPE_CHECKING:
    from unghost.experiment.datasets import ImageObject

_STRIDES: Final = (4, 8, 16, 32)

_CHANNELS: Final = 32
"""Of the small backbone's features."""

_LEAST_SCORE: Final = 0.001
"""Of the detections that are written, as usual for COCO's scores."""


def main() -> None:
    """Train on the labels of one arm, and detect in its part ``val``."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="the folder of an arm")
    parser.add_argument("seed", type=int)
    parser.add_argument("output", type=Path)
    parser.add_argument("--model", default="small")
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--width", type=int, default=640, help="of images, px")
    parser.add_argument("--rate", type=float, default=2e-3, help="the learning rate")
    options = parser.parse_args()
    torch.manual_seed(options.seed)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    train = _Part(options.data, "train", options.width)
    model = _model(options.model, len(train.classes), train.hw).to(device)
    _train(model, train, options, device)
    val = _Part(options.data, "val", options.width)
    detections = list(_detections(model, val, options.batch, device))
    draft = options.output / "predictions.part"
    draft.write_text(json.dumps(detections), "utf-8")
    draft.replace(options.output / "predictions.json")


class _Part:
    """The images of a part of a data set in one size, and their labels."""

    def __init__(self, data: Path, part: str, width: int) -> None:
        path = data / "annotations" / f"instances_{part}.json"
        coco = json.loads(path.read_text("utf-8"))
        self.images: list[ImageObject] = coco["images"]
        self.classes = [category["name"] for category in coco["categories"]]
        first = self.images[0]
        height = width * first["height"] / first["width"]
        self.hw = (max(round(height / 32), 1) * 32, width)
        self.pixels = self._pixels(data, part)
        boxes: dict[int, list[list[float]]] = {image["id"]: [] for image in self.images}
        for annotation in coco["annotations"]:
            boxes[annotation["image_id"]].append(
                [*annotation["bbox"], annotation["category_id"]]
            )
        self._boxes = boxes

    def _pixels(self, data: Path, part: str) -> NDArray[np.uint8]:
        """(N, H, W, 3) RGB, read once for all arms, which have the same images."""
        height, width = self.hw
        shape = (len(self.images), height, width, 3)
        file = data.parent / f".{part}-{width}x{height}.rgb"
        if not file.exists():
            draft = file.with_name(f"{file.name}.{os.getpid()}")
            with draft.open("wb") as out:
                for entry in self.images:
                    image = cv2.imread(str(data / "images" / part / entry["file_name"]))
                    if image is None:
                        raise SystemExit(f"{entry['file_name']}: cannot be read")
                    small = cv2.resize(
                        image, (width, height), interpolation=cv2.INTER_AREA
                    )
                    out.write(small[..., ::-1].tobytes())
            draft.replace(file)
        return np.memmap(file, np.uint8, "r", shape=shape)

    def scale(self, row: int) -> NDArray[np.float32]:
        """(2,): from pixels of the file to those of the image as it is here."""
        image, (height, width) = self.images[row], self.hw
        return np.array([width / image["width"], height / image["height"]], np.float32)

    def image(self, row: int, device: torch.device) -> Tensor:
        """(3, H, W), 0..1."""
        rgb = torch.from_numpy(np.array(self.pixels[row])).to(device)
        return rgb.permute(2, 0, 1).float().div_(255)

    def target(
        self, row: int, device: torch.device, *, mirrored: bool
    ) -> dict[str, Tensor]:
        """Boxes (M, 4) as corners and labels (M,), which count from 0."""
        rows = np.array(self._boxes[self.images[row]["id"]], np.float32).reshape(-1, 5)
        boxes = rows[:, :4] * np.tile(self.scale(row), 2)
        boxes[:, 2:] += boxes[:, :2]
        if mirrored:
            boxes[:, [0, 2]] = self.hw[1] - boxes[:, [2, 0]]
        # torchvision refuses boxes without extent.
        there = (boxes[:, 2:] - boxes[:, :2] > 0.1).all(axis=1)
        return {
            "boxes": torch.from_numpy(boxes[there]).to(device),
            "labels": torch.from_numpy(rows[there, 4].astype(np.int64)).to(device),
        }


class _Backbone(nn.Module):
    """Features at four strides, joined by a feature pyramid."""

    def __init__(self, channels: Sequence[int], out_channels: int) -> None:
        super().__init__()
        self.out_channels = out_channels
        self.stem = _convolution(3, channels[0], stride=2)
        pairs = pairwise(channels)
        self.stages = nn.ModuleList(
            nn.Sequential(_convolution(into, out, stride=2), _Residual(out))
            for into, out in pairs
        )
        self.pyramid = FeaturePyramidNetwork(list(channels[1:]), out_channels)

    def forward(self, images: Tensor) -> dict[str, Tensor]:
        features = OrderedDict[str, Tensor]()
        there = self.stem(images)
        for number, stage in enumerate(self.stages):
            there = features[str(number)] = stage(there)
        joined: dict[str, Tensor] = self.pyramid(features)
        return joined


def _convolution(into: int, out: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(into, out, 3, stride, 1, bias=False), nn.BatchNorm2d(out), nn.ReLU()
    )


class _Residual(nn.Module):
    """Two convolutions whose result is added to what they were given."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            _convolution(channels, channels), _convolution(channels, channels)
        )

    def forward(self, features: Tensor) -> Tensor:
        return features + self.layers(features)


def _model(name: str, classes: int, hw: tuple[int, int]) -> nn.Module:
    size = {"min_size": min(hw), "max_size": max(hw)}
    if name != "small":
        build = getattr(detection, name, None)
        if build is None:
            raise SystemExit(f"--model: torchvision.models.detection has no {name!r}")
        # Class 0 is the background in most of them.
        made: nn.Module = build(
            weights=None, weights_backbone=None, num_classes=classes + 1, **size
        )
        return made
    backbone = _Backbone((16, 24, 32, 48, 64), _CHANNELS)
    # FCOS looks for objects of 4 to 8 times these sizes in each level.
    anchors = AnchorGenerator(tuple((stride,) for stride in _STRIDES), ((1.0,),) * 4)
    norm = partial(nn.GroupNorm, 8)
    # Its own heads have four layers each, and a group for each of 32 channels.
    head = FCOSHead(_CHANNELS, 1, classes + 1, num_convs=1)
    head.classification_head = FCOSClassificationHead(
        _CHANNELS, 1, classes + 1, num_convs=1, norm_layer=norm
    )
    head.regression_head = FCOSRegressionHead(
        _CHANNELS, 1, num_convs=1, norm_layer=norm
    )
    return FCOS(
        backbone,
        classes + 1,
        anchor_generator=anchors,
        head=head,
        score_thresh=_LEAST_SCORE,
        **size,
    )


def _train(
    model: nn.Module, train: _Part, options: argparse.Namespace, device: torch.device
) -> None:
    model.train()
    optimizer = torch.optim.AdamW(model.parameters(), options.rate, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, options.rate, total_steps=options.steps, pct_start=0.1
    )
    rng = np.random.default_rng(options.seed)
    count = len(train.images)
    # Every row once in each round, in random order
    rounds = (rng.permutation(count).tolist() for _ in itertools.repeat(None))
    rows = itertools.chain.from_iterable(rounds)
    for step in range(options.steps):
        images, targets = [], []
        for _ in range(options.batch):
            row, mirrored = next(rows), bool(rng.random() < 0.5)
            image = train.image(row, device)
            images.append(image.flip(2) if mirrored else image)
            targets.append(train.target(row, device, mirrored=mirrored))
        loss = sum(model(images, targets).values())
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(model.parameters(), 5.0)
        optimizer.step()
        schedule.step()
        if step % 50 == 0 or step == options.steps - 1:
            sys.stdout.write(f"step {step}: loss {float(loss.detach()):.3f}\n")
            sys.stdout.flush()


@torch.no_grad()
def _detections(
    model: nn.Module, val: _Part, batch: int, device: torch.device
) -> Iterator[dict[str, object]]:
    """The results as COCO has them, in pixels of the images' files."""
    model.eval()
    count = len(val.images)
    for start in range(0, count, batch):
        rows = range(start, min(start + batch, count))
        outputs = model([val.image(row, device) for row in rows])
        for row, output in zip(rows, outputs, strict=True):
            boxes = output["boxes"].cpu().numpy() / np.tile(val.scale(row), 2)
            boxes[:, 2:] -= boxes[:, :2]
            for box, label, score in zip(
                boxes.round(2).tolist(),
                output["labels"].tolist(),
                output["scores"].tolist(),
                strict=True,
            ):
                yield {
                    "image_id": val.images[row]["id"],
                    "category_id": label,
                    "bbox": [round(value, 2) for value in box],
                    "score": round(score, 5),
                }


if __name__ == "__main__":
    main()
