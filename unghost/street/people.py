"""People: walking, standing, and sitting on two wheels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from filter_core.arrays import FloatArray
from unghost.street.mesh import Mesh, Point, ball, join, loft, tube
from unghost.street.paint import BLACK, RGB, Paint, Tag

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
class Clothes:
    """The colours of what one person wears."""

    shirt: RGB
    trousers: RGB
    skin: RGB
    hair: RGB
    coat: bool = False

    @classmethod
    def random(cls, rng: np.random.Generator) -> Clothes:
        """Clothes whose colours are drawn at random."""
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
class BodyPose:
    """Where the joints of a person are: right side first, then left."""

    hips: Point
    shoulders: Point
    head: Point
    knees: tuple[Point, Point]
    feet: tuple[Point, Point]
    elbows: tuple[Point, Point]
    hands: tuple[Point, Point]


def walker(
    clothes: Clothes, phase: int, scale: float = 1.0, *, fine: bool = True
) -> Mesh:
    """Someone walking along x; `phase` is one of `WALK_PHASES` moments of a step."""
    figure = clothes.on(
        _undyed_walker(phase % WALK_PHASES, coat=clothes.coat, fine=fine)
    )
    return Mesh(figure.corners * scale, figure.normals, figure.surface, figure.tag)


@lru_cache(maxsize=4 * WALK_PHASES)
def _undyed_walker(phase: int, *, coat: bool, fine: bool) -> Mesh:
    figure = Figure(walking_pose(phase), Tag.PEDESTRIAN, 8 if fine else 4).mesh()
    if not coat:
        return figure
    # It hangs over the hips, down to the knees.
    angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    hem = [(0.50, 0.200, 0.215), (0.80, 0.165, 0.190), (1.12, 0.120, 0.160)]
    rings = [
        np.column_stack([circle * (deep, wide), np.full(12, z)])
        for z, deep, wide in hem
    ]
    skirt = loft(np.array(rings), [[Paint.dye(_SHIRT)]], Tag.PEDESTRIAN)
    return join([figure, skirt])


def walking_pose(phase: int) -> BodyPose:
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
    return BodyPose(
        hips=(0.0, 0.0, 0.95), shoulders=(0.01, 0.0, 1.43), head=(0.04, 0.0, 1.65),
        knees=(right, left), feet=(right_foot, left_foot),
        elbows=(right_elbow, left_elbow), hands=(right_hand, left_hand),
    )  # fmt: skip


@dataclass(frozen=True)
class Figure:
    """A person in a pose, built part by part: limbs, trunk, head and clothes.

    `sides` are those of its round parts; fewer from afar.
    """

    pose: BodyPose
    tag: int
    sides: int = 8

    def mesh(self) -> Mesh:
        """All parts in one mesh."""
        limbs = [limb(side) for side in (0, 1) for limb in (self._leg, self._arm)]
        return join([self._trunk(), self._head(), *limbs])

    def _ball(
        self, centre: FloatArray, radii: ArrayLike, dye: int, extra: int = 0
    ) -> Mesh:
        paint = Paint.dye(dye) if dye else BLACK
        return ball(centre, radii, (paint, self.tag), self.sides + extra)

    def _limb(
        self, joints: tuple[FloatArray, ...], radii: tuple[float, ...], dye: int
    ) -> Mesh:
        look = (Paint.dye(dye), self.tag)
        (first, middle, last), (thick, bend, thin) = joints, radii
        return join(
            [
                tube(first, middle, (thick, bend), look, self.sides),
                tube(middle, last, (bend, thin), look, self.sides),
                ball(middle, bend, look, self.sides),
            ]
        )

    def _trunk(self) -> Mesh:
        hips, shoulders = np.array(self.pose.hips), np.array(self.pose.shoulders)
        spine = shoulders - hips
        yoke = shoulders - np.array([0, 0, 0.03])
        return join(
            [
                self._ball(hips, (0.12, 0.155, 0.13), _TROUSERS, 2),
                self._ball(hips + 0.35 * spine, (0.12, 0.155, 0.20), _SHIRT, 2),
                self._ball(hips + 0.72 * spine, (0.135, 0.185, 0.21), _SHIRT, 2),
                self._ball(yoke, (0.095, 0.20, 0.075), _SHIRT, 2),
            ]
        )

    def _head(self) -> Mesh:
        head, shoulders = np.array(self.pose.head), np.array(self.pose.shoulders)
        crown = head + np.array([-0.022, 0, 0.03])
        return join(
            [
                tube(shoulders, head, 0.055, (Paint.dye(_SKIN), self.tag), self.sides),
                self._ball(head, (0.095, 0.08, 0.12), _SKIN, 4),
                self._ball(crown, (0.092, 0.088, 0.105), _HAIR, 4),
            ]
        )

    def _leg(self, side: int) -> Mesh:
        hip = np.array(self.pose.hips) + np.array([0, 0.09 * (1 - 2 * side), -0.03])
        knee, foot = np.array(self.pose.knees[side]), np.array(self.pose.feet[side])
        toes = foot + np.array([0.06, 0, -0.035])
        leg = self._limb((hip, knee, foot), (0.100, 0.072, 0.052), _TROUSERS)
        return join([leg, self._ball(toes, (0.135, 0.05, 0.052), 0)])

    def _arm(self, side: int) -> Mesh:
        sign = 1 - 2 * side
        shoulder = np.array(self.pose.shoulders) + np.array([0, 0.185 * sign, -0.035])
        elbow, hand = np.array(self.pose.elbows[side]), np.array(self.pose.hands[side])
        arm = self._limb((shoulder, elbow, hand), (0.060, 0.048, 0.036), _SHIRT)
        return join([arm, self._ball(hand, (0.045, 0.04, 0.055), _SKIN)])
