# SPDX-License-Identifier: BSD-3-Clause
"""What places the frames of a sequence: epi360's odometry and map, pycolmap's two mappers."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from _odometry_data import Clip
from numpy.typing import NDArray

from epi360.features import read_image
from epi360.features.picture_writing import encode_picture
from epi360.interop.colmap_cameras import colmap_camera
from epi360.poses import Pose

MOST_EXHAUSTIVE = 30  # images; more are paired with their neighbours, as in `epi360 map`
OVERLAP = 10


@dataclass(frozen=True)
class Placed:
    """Poses by the frame's name, and the seconds from decoded frames to poses.

    Processor time is that of all threads; both without reading the frames where ``reading_s`` is
    given.
    """

    world_from_cam: dict[str, Pose]
    seconds: float
    cpu_s: float = float("nan")
    reading_s: float = 0.0
    statuses: dict[str, int] = field(default_factory=dict)


def track(clip: Clip, scratch: Path) -> Placed:
    """`epi360.Odometry` on all frames; decoding them is not counted."""
    import epi360

    odometry = epi360.Odometry(clip.camera)
    watch, reading = _Watch(), _Watch()
    for index, path in enumerate(clip.frames):
        with reading:
            image, mask = read_image(path), _mask(clip, path.name)
        with watch:
            odometry.add_frame(image, index / 30, mask=mask)
    with watch:
        odometry.finish()  # as `epi360 track` does
        trajectory = odometry.trajectory()
    poses = {
        clip.frames[index].name: pose.inverse()
        for index, pose in zip(trajectory.indices, trajectory.cam_from_world, strict=True)
    }
    statuses = Counter(result.status for result in odometry.results())
    return Placed(poses, watch.seconds, watch.cpu_s, reading.seconds, dict(statuses))


class _Watch:
    """Adds up the time and the processor time of what is done with it."""

    def __init__(self) -> None:
        self.seconds, self.cpu_s = 0.0, 0.0

    def __enter__(self) -> None:
        self._begun = time.perf_counter(), time.process_time()

    def __exit__(self, *_: object) -> None:
        self.seconds += time.perf_counter() - self._begun[0]
        self.cpu_s += time.process_time() - self._begun[1]


def map_frames(clip: Clip, scratch: Path) -> Placed:
    """`epi360 map` with its defaults and the masks."""
    import yaml

    from epi360.jobs.folder.image_set import find_images
    from epi360.jobs.mapping.map_folder import MapOptions, map_images
    from epi360_scenes.sequence import camera_record

    calibration = scratch / "camera.yaml"
    calibration.write_text(yaml.safe_dump(camera_record(clip.camera)))
    images = find_images(_links(clip, scratch), camera=str(calibration), mask=_masks(clip, scratch))
    begun = time.perf_counter()
    run = map_images(images, scratch / "out", MapOptions())
    seconds = time.perf_counter() - begun
    best = run.models[0].reconstruction.images if run.models else ()
    return Placed({image.name: image.cam_from_world.inverse() for image in best}, seconds)


def pycolmap_incremental(clip: Clip, scratch: Path) -> Placed:
    """COLMAP's own steps with the true camera, the incremental mapper."""
    return _pycolmap(clip, scratch, "incremental_mapping")


def pycolmap_global(clip: Clip, scratch: Path) -> Placed:
    """The same with the global mapper."""
    return _pycolmap(clip, scratch, "global_mapping")


def _pycolmap(clip: Clip, scratch: Path, mapper: str) -> Placed:
    import pycolmap

    pycolmap.logging.minloglevel = pycolmap.logging.FATAL.value
    images, database, output = _links(clip, scratch), scratch / "database.db", scratch / "models"
    output.mkdir()
    camera = colmap_camera(clip.camera)
    reader = pycolmap.ImageReaderOptions(
        camera_model=camera.model.name, camera_params=",".join(map(repr, map(float, camera.params)))
    )
    masks = _masks(clip, scratch)
    if masks is not None:
        reader.mask_path = masks
    begun = time.perf_counter()
    pycolmap.extract_features(
        database,
        images,
        camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=reader,
        device=pycolmap.Device.cpu,
    )
    if len(clip.frames) <= MOST_EXHAUSTIVE:
        pycolmap.match_exhaustive(database, device=pycolmap.Device.cpu)
    else:
        pairing = pycolmap.SequentialPairingOptions(overlap=OVERLAP)
        pycolmap.match_sequential(database, pairing_options=pairing, device=pycolmap.Device.cpu)
    models = getattr(pycolmap, mapper)(database, images, output)
    seconds = time.perf_counter() - begun
    if not models:
        return Placed({}, seconds)
    best = max(models.values(), key=lambda model: model.num_reg_images())
    poses = {
        image.name: Pose.from_matrix(image.cam_from_world().matrix()).inverse()
        for image in best.images.values()
        if image.has_pose and np.isfinite(image.cam_from_world().matrix()).all()
    }
    return Placed(poses, seconds)


def _links(clip: Clip, scratch: Path) -> Path:
    """Folder of links to the frames: some methods write beside the images."""
    folder = scratch / "images"
    folder.mkdir()
    for path in clip.frames:
        (folder / path.name).symlink_to(path.resolve())
    return folder


def _masks(clip: Clip, scratch: Path) -> Path | None:
    """Folder of the masks as COLMAP calls them, a.jpg.png for a.jpg."""
    if not clip.masks:
        return None
    folder = scratch / "masks"
    folder.mkdir()
    for path in clip.frames:
        mask = _mask(clip, path.name)
        if mask is not None:
            (folder / f"{path.name}.png").write_bytes(encode_picture(mask, ".png"))
    return folder


def _mask(clip: Clip, name: str) -> NDArray[np.bool_] | None:
    """Mask of a frame in the size of the frame; those of the clips are larger."""
    if name not in clip.masks:
        return None
    grey = cv2.imread(str(clip.masks[name]), cv2.IMREAD_GRAYSCALE)
    size = (clip.camera.width, clip.camera.height)
    return cv2.resize(grey, size, interpolation=cv2.INTER_NEAREST) > 127


METHODS: dict[str, Callable[[Clip, Path], Placed]] = {
    "track": track,
    "map": map_frames,
    "pycolmap": pycolmap_incremental,
    "pycolmap global": pycolmap_global,
}
