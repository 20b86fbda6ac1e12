"""A small data set in the tables of nuScenes: two cameras, two boxes, one moment.

Only the tables that are read; nuScenes has others, such as `scene`.
"""

import json

FRONT = "samples/CAM_FRONT/n008__CAM_FRONT__1532402927612460.jpg"
BACK = "samples/CAM_BACK/n008__CAM_BACK__1532402927637525.jpg"
_SECONDS = {"timestamp": 1532402927612460}
_CAMERAS = {
    "front": (FRONT, [0.5, -0.5, 0.5, -0.5], [1.7, 0.02, 1.5]),
    "back": (BACK, [0.5, -0.5, -0.5, 0.5], [0.03, 0.0, 1.55]),
}
_BOXES = {
    "car": ([392.5, 1151.25, 0.9], [1.9, 4.5, 1.6], [0.9238795, 0, 0, 0.3826834]),
    "walker": ([371.0, 1149.5, 1.0], [0.7, 0.8, 1.8], [0.7071068, 0, 0, 0.7071068]),
}
_CATEGORIES = {"car": "vehicle.car", "walker": "human.pedestrian.adult"}
_ENDS = {"next": "", "prev": ""}


def _tables(cameras):
    intrinsic = [[1266.4, 0.0, 816.3], [0.0, 1266.4, 491.5], [0.0, 0.0, 1.0]]
    yield (
        "category",
        [
            {"token": f"{name} category", "name": word, "description": "", "index": 1}
            for name, word in _CATEGORIES.items()
        ],
    )
    yield "instance", [
        {"token": f"{name} 1", "category_token": f"{name} category",
         "nbr_annotations": 1, "first_annotation_token": name,
         "last_annotation_token": name}
        for name in _BOXES
    ]  # fmt: skip
    yield "sensor", [
        {"token": f"{name} sensor", "channel": f"CAM_{name.upper()}",
         "modality": "camera"}
        for name in cameras
    ]  # fmt: skip
    yield "calibrated_sensor", [
        {"token": f"{name} mount", "sensor_token": f"{name} sensor",
         "translation": translation, "rotation": rotation,
         "camera_intrinsic": intrinsic}
        for name, (_, rotation, translation) in cameras.items()
    ]  # fmt: skip
    yield "ego_pose", [
        {"token": "pose", "translation": [381.0, 1151.0, 0.0],
         "rotation": [0.9961947, 0.0, 0.0, 0.0871557], **_SECONDS}
    ]  # fmt: skip
    yield "sample_data", [
        {"token": f"{name} data", "sample_token": "now", "ego_pose_token": "pose",
         "calibrated_sensor_token": f"{name} mount", "filename": file,
         "fileformat": "jpg", "width": 1600, "height": 900, "is_key_frame": True,
         **_SECONDS, **_ENDS}
        for name, (file, _, _) in cameras.items()
    ]  # fmt: skip
    yield "sample_annotation", [
        {"token": name, "sample_token": "now", "instance_token": f"{name} 1",
         "attribute_tokens": [], "visibility_token": "4", "translation": translation,
         "size": size, "rotation": rotation, "num_lidar_pts": 5, "num_radar_pts": 0,
         **_ENDS}
        for name, (translation, size, rotation) in _BOXES.items()
    ]  # fmt: skip


def nuscenes_files(*names):
    """Tables and images, by path, of the cameras of these names."""
    cameras = {name: _CAMERAS[name] for name in names}
    tables = {
        f"v1.0-mini/{name}.json": json.dumps(rows).encode()
        for name, rows in _tables(cameras)
    }
    return {**tables, **{file: b"" for file, _, _ in cameras.values()}}
