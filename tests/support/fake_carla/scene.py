"""Box-shaped solids of the fake world, and a ray caster that finds what is visible."""

from dataclasses import dataclass

import carla
import numpy as np

FAR_M = 1000.0
SKY, ROAD = 11, 1


@dataclass(frozen=True)
class Solid:
    """A box-shaped thing in the world: its pose, centre in it and half sizes."""

    pose: carla.Transform
    centre: tuple[float, float, float]
    half: tuple[float, float, float]
    tag: int
    owner: int


def rays(width, height, fov):
    """(H, W, 3) ray directions in the camera's axes, each one metre long forwards."""
    focal = width / (2 * np.tan(np.radians(fov) / 2))
    v, u = np.mgrid[0:height, 0:width]
    right = (u + 0.5 - width / 2) / focal
    up = (height / 2 - v - 0.5) / focal
    return np.stack([np.ones_like(right), right, up], axis=-1)


def cast(solids, pose, directions):
    """Distance (in lengths of `directions`), tag and owner of each ray's first hit."""
    to_world = np.array(pose.get_matrix())
    flat = directions.reshape(-1, 3)
    world = flat @ to_world[:3, :3].T
    start = to_world[:3, 3]
    reach = np.full(len(flat), FAR_M)
    tag = np.full(len(flat), SKY)
    owner = np.zeros(len(flat), dtype=np.int64)
    with np.errstate(divide="ignore", invalid="ignore"):
        ground = -start[2] / world[:, 2]
    on_road = (ground > 0) & (ground < reach)
    reach[on_road], tag[on_road] = ground[on_road], ROAD
    for solid in solids:
        hit = _distance(solid, start, world)
        nearer = hit < reach
        reach[nearer] = hit[nearer]
        tag[nearer], owner[nearer] = solid.tag, solid.owner
    shape = directions.shape[:-1]
    return reach.reshape(shape), tag.reshape(shape), owner.reshape(shape)


def _distance(solid, start, world):
    """Distances at which rays enter a solid; infinite for a miss or a start in it."""
    inverse = np.array(solid.pose.get_inverse_matrix())
    origin = inverse[:3, :3] @ start + inverse[:3, 3] - solid.centre
    local = world @ inverse[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        low = (-np.array(solid.half) - origin) / local
        high = (np.array(solid.half) - origin) / local
    enter = np.minimum(low, high).max(axis=1)
    leave = np.maximum(low, high).min(axis=1)
    return np.where((enter <= leave) & (enter > 0), enter, np.inf)
