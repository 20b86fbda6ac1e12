"""People: walking, standing, and sitting on two wheels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from app.demo.mesh import Mesh, join
from app.demo.paint import BLACK, Paint, Tag
from app.demo.solids import ball, loft, tube

Point = tuple[float, float, float]
RGB = tuple[float, float, float]

_SHIRT, _TROUSERS, _SKIN, _HAIR = range(1, 5)

SHIRTS: Final = (
    (142, 52, 48), (214, 210, 200), (52, 68, 98), (84, 106, 82), (178, 144, 80),
    (92, 92, 98), (104, 66, 92), (186, 122, 92), (92, 122, 140), (44, 44, 50),
)  # fmt: skip
TROUSERS: Final = (
    (44, 50, 66), (60, 58, 56), (98, 86, 70), (36, 36, 40), (108, 110, 114),
)  # fmt: skip
SKINS: Final = ((206, 162, 136), (184, 134, 104), (136, 94, 70), (94, 66, 50))
HAIRS: Final = (
    (40, 28, 20),
    (92, 62, 36),
    (20, 18, 18),
    (168, 132, 82),
    (120, 116, 112),
)

WALK_PHASES: Final = 4


@dataclass(frozen=True)
class Dress:
    """What one person wears."""

    shirt: RGB
    trousers: RGB
    skin: RGB
    hair: RGB
    coat: bool = False

    @classmethod
    def random(cls, rng: np.random.Generator) -> Dress:
        """Any of the colours."""
        shirt, trousers, skin, hair = (
            colors[rng.integers(len(colors))]
            for colors in (SHIRTS, TROUSERS, SKINS, HAIRS)
        )
        return cls(shirt, trousers, skin, hair, coat=bool(rng.random() < 0.4))

    def on(self, figure: Mesh) -> Mesh:
        """A figure that wears it."""
        return figure.dyed(
            {
                _SHIRT: self.shirt,
                _TROUSERS: self.trousers,
                _SKIN: self.skin,
                _HAIR: self.hair,
            }
        )


@dataclass(frozen=True)
class Pose:
    """Where the joints of a person are: right side first, then left."""

    hips: Point
    shoulders: Point
    head: Point
    knees: tuple[Point, Point]
    feet: tuple[Point, Point]
    elbows: tuple[Point, Point]
    hands: tuple[Point, Point]


def walker(dress: Dress, phase: int, scale: float = 1.0) -> Mesh:
    """Someone walking along x; `phase` is one of `WALK_PHASES` moments of a step."""
    figure = dress.on(_undyed_walker(phase % WALK_PHASES, coat=dress.coat))
    return Mesh(figure.corners * scale, figure.normals, figure.surface, figure.tag)


@lru_cache(maxsize=2 * WALK_PHASES)
def _undyed_walker(phase: int, *, coat: bool) -> Mesh:
    figure = person(walking_pose(phase), Tag.PEDESTRIAN)
    return join([figure, _coat(Tag.PEDESTRIAN)]) if coat else figure


def _coat(tag: int) -> Mesh:
    """What hangs over the hips, down to the knees."""
    angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    hem = [(0.50, 0.200, 0.215), (0.80, 0.165, 0.190), (1.12, 0.120, 0.160)]
    rings = [
        np.column_stack([circle * (deep, wide), np.full(12, z)])
        for z, deep, wide in hem
    ]
    return loft(np.array(rings), [[Paint.dye(_SHIRT)]], tag)


def walking_pose(phase: int) -> Pose:
    """Legs and arms swing against each other."""
    swing = float(np.sin(2 * np.pi * phase / WALK_PHASES + 0.6))
    reach = 0.21 * swing
    legs = []
    for side, forward in ((1, reach), (-1, -reach)):
        lift = 0.10 * max(0.0, -forward) / 0.21
        legs.append(
            (
                (forward * 0.55 + 0.05, 0.10 * side, 0.50),
                (forward, 0.11 * side, 0.09 + lift),
            )
        )
    arms = []
    for side, forward in ((1, -reach), (-1, reach)):
        arms.append(
            (
                (forward * 0.35 - 0.03, 0.235 * side, 1.16),
                (forward * 0.8 + 0.06, 0.225 * side, 0.92),
            )
        )
    (right, right_foot), (left, left_foot) = legs
    (right_elbow, right_hand), (left_elbow, left_hand) = arms
    return Pose(
        hips=(0.0, 0.0, 0.95), shoulders=(0.01, 0.0, 1.43), head=(0.04, 0.0, 1.65),
        knees=(right, left), feet=(right_foot, left_foot),
        elbows=(right_elbow, left_elbow), hands=(right_hand, left_hand),
    )  # fmt: skip


def person(pose: Pose, tag: int) -> Mesh:
    """A figure of limbs, trunk and head in a given pose, to be dressed."""
    parts = [_trunk(pose, tag), _head(pose, tag)]
    for side in (0, 1):
        parts += [_leg(pose, side, tag), _arm(pose, side, tag)]
    return join(parts)


def _trunk(pose: Pose, tag: int) -> Mesh:
    hips, shoulders = np.array(pose.hips), np.array(pose.shoulders)
    waist = hips + 0.35 * (shoulders - hips)
    chest = hips + 0.72 * (shoulders - hips)
    return join(
        [
            ball(hips, (0.12, 0.155, 0.13), (Paint.dye(_TROUSERS), tag)),
            ball(waist, (0.12, 0.155, 0.20), (Paint.dye(_SHIRT), tag)),
            ball(chest, (0.135, 0.185, 0.21), (Paint.dye(_SHIRT), tag)),
            ball(
                shoulders - np.array([0, 0, 0.03]),
                (0.095, 0.20, 0.075),
                (Paint.dye(_SHIRT), tag),
            ),
        ]
    )


def _head(pose: Pose, tag: int) -> Mesh:
    head = np.array(pose.head)
    neck = tube(np.array(pose.shoulders), head, 0.055, (Paint.dye(_SKIN), tag), 8)
    face = ball(head, (0.095, 0.08, 0.12), (Paint.dye(_SKIN), tag), 12)
    hair = ball(
        head + np.array([-0.022, 0, 0.03]),
        (0.092, 0.088, 0.105),
        (Paint.dye(_HAIR), tag),
        12,
    )
    return join([neck, face, hair])


def _leg(pose: Pose, side: int, tag: int) -> Mesh:
    sign = 1 - 2 * side
    hip = np.array(pose.hips) + np.array([0, 0.09 * sign, -0.03])
    knee, foot = np.array(pose.knees[side]), np.array(pose.feet[side])
    return join(
        [
            tube(hip, knee, (0.100, 0.072), (Paint.dye(_TROUSERS), tag), 8),
            tube(knee, foot, (0.072, 0.052), (Paint.dye(_TROUSERS), tag), 8),
            ball(knee, 0.072, (Paint.dye(_TROUSERS), tag), 8),
            ball(
                foot + np.array([0.06, 0, -0.035]),
                (0.135, 0.05, 0.052),
                (BLACK, tag),
                8,
            ),
        ]
    )


def _arm(pose: Pose, side: int, tag: int) -> Mesh:
    sign = 1 - 2 * side
    shoulder = np.array(pose.shoulders) + np.array([0, 0.185 * sign, -0.035])
    elbow, hand = np.array(pose.elbows[side]), np.array(pose.hands[side])
    return join(
        [
            tube(shoulder, elbow, (0.060, 0.048), (Paint.dye(_SHIRT), tag), 8),
            tube(elbow, hand, (0.048, 0.036), (Paint.dye(_SHIRT), tag), 8),
            ball(elbow, 0.049, (Paint.dye(_SHIRT), tag), 8),
            ball(hand, (0.045, 0.04, 0.055), (Paint.dye(_SKIN), tag), 8),
        ]
    )
