# SPDX-License-Identifier: BSD-3-Clause
"""TUM-VI: fisheye images of a hand-held rig with poses of its IMU (Schubert et al., IROS 2018)."""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, load_kalibr_rig
from epi360.image_folders import existing_folder
from epi360.interop.text_tables import Table, read_table
from epi360.poses import Pose, pose_from_quaternion
from epi360.runs.whole_files import PathLike
from epi360_paper.datasets.intensities import intensity_levels, lens_circle_mask
from epi360_paper.datasets.sequence import ImageSequence
from epi360_paper.datasets.trajectories import poses_at_times

IMAGE_COLUMNS = ("timestamp", "filename")
POSE_COLUMNS = ("t", "x", "y", "z", "qw", "qx", "qy", "qz")
POSE_FILES = ("dso/gt_imu.csv", "mav0/mocap0/data.csv")  # both hold the same numbers
CALIBRATION_FILES = ("../omni_calib.yaml", "dso/camchain.yaml")
ROOM_NAME = re.compile(r"(?:dataset-)?room([1-6])(?:_\w+)?")
MAX_GAP_S = 0.05  # motion capture has 120 Hz: six lost samples


def load_tum_vi(
    scene: PathLike, calibration: PathLike | None = None, *, max_gap_s: float = MAX_GAP_S
) -> ImageSequence:
    """Sequence of camera 0 of a scene in the layout of TUM-VI; the mask leaves out the black rim.

    The folder has ``mav0/cam0/data.csv`` (nanoseconds, file in ``mav0/cam0/data``) and poses of the
    IMU in ``dso/gt_imu.csv`` or ``mav0/mocap0/data.csv`` (``t,x,y,z,qw,qx,qy,qz``, nanoseconds). By
    default the calibration, a Kalibr file with ``T_cam_imu``, is the paper's ``omni_calib.yaml``
    (unified model) if the folder above holds it, else ``dso/camchain.yaml`` (equidistant model). An
    image between two motion-capture poses further than ``max_gap_s`` apart has no pose.

    Raises
    ------
    FileNotFoundError
        If a part is missing.
    ValueError
        If a table or the calibration is bad, or the times of images and poses do not overlap.

    Notes
    -----
    world_from_cam = world_from_imu @ cam_from_imu^-1 with Kalibr's ``T_cam_imu`` as cam_from_imu.
    The authors' own code multiplies with ``T_cam_imu`` itself where its inverse belongs.
    """
    scene = existing_folder(scene, "TUM-VI scene")
    table = read_table(_part(scene, "mav0/cam0/data.csv"), IMAGE_COLUMNS, ",")
    images = _image_paths(scene, table)
    times_ns = _times(table)
    camera, cam_from_imu = _calibration(scene, calibration)
    world_from_imu = _poses_at_images(scene, times_ns, round(max_gap_s * 1e9))
    imu_from_cam = cam_from_imu.inverse()
    return ImageSequence(
        name=scene.resolve().name,
        camera=camera,
        image_paths=images,
        timestamps_s=times_ns.astype(np.float64) * 1e-9,
        world_from_cam=tuple(pose and pose @ imu_from_cam for pose in world_from_imu),
        mask=lens_circle_mask(images, camera),
        levels=intensity_levels(images),
    )


def find_tum_vi_rooms(folder: PathLike) -> list[Path]:
    """Scenes room1 to room6 in a folder by their numbers, or the folder itself if it is a scene.

    Folders are called ``dataset-room1_512_16`` and so on, or ``room1``. Only the rooms have poses
    throughout (paper section 5.3); other scenes are left out. ``FileNotFoundError`` if the folder
    does not exist or there is no room in it.
    """
    folder = existing_folder(folder, "TUM-VI folder")
    if (folder / "mav0").is_dir():
        return [folder]
    rooms = sorted(path for path in folder.iterdir() if ROOM_NAME.fullmatch(path.name))
    if not rooms:
        raise FileNotFoundError(
            f"TUM-VI folder {folder} has no rooms; it must hold dataset-room1_512_16 or the like"
        )
    return rooms


def _part(scene: Path, *names: str) -> Path:
    for name in names:
        if (scene / name).is_file():
            return scene / name
    raise FileNotFoundError(f"TUM-VI scene {scene} has no {' and no '.join(names)}")


def _image_paths(scene: Path, table: Table) -> tuple[Path, ...]:
    folder = existing_folder(scene / "mav0/cam0/data", "folder of images")
    paths = tuple(folder / row[1] for row in table.cells)
    for path, line in zip(paths, table.lines, strict=True):
        if not path.is_file():
            raise FileNotFoundError(
                f"image {path} does not exist but row {line} of {table.path} names it"
            )
    return paths


def _times(table: Table) -> NDArray[np.int64]:
    times_ns = table.integers(0)
    late = np.flatnonzero(np.diff(times_ns) <= 0)
    if len(late):
        raise table.error(int(late[0]) + 1, "a later time than the row before")
    return times_ns


def _poses_at_images(
    scene: Path, times_ns: NDArray[np.int64], max_gap_ns: int
) -> list[Pose | None]:
    table = read_table(_part(scene, *POSE_FILES), POSE_COLUMNS, ",")
    _check_header(table)
    known_ns = _times(table)
    if known_ns[-1] < times_ns[0] or known_ns[0] > times_ns[-1]:
        raise ValueError(
            f"the poses of {table.path} must overlap the images in time, got {known_ns[0]} to "
            f"{known_ns[-1]} ns for {times_ns[0]} to {times_ns[-1]} ns; take both from one scene"
        )
    world_from_imu = list(map(pose_from_quaternion, table.floats(1, 4), table.quaternions(4)))
    return poses_at_times(known_ns, world_from_imu, times_ns, max_gap_ns)


def _check_header(table: Table) -> None:
    """Refuse a table that says that its quaternion starts with x."""
    names = table.header.lstrip("# ").lower().split(",")
    if table.header and (len(names) != len(POSE_COLUMNS) or "w" not in names[4]):
        wanted = ",".join(POSE_COLUMNS)
        raise ValueError(f"the header of {table.path} must name {wanted}, got {table.header!r}")


def _calibration(scene: Path, calibration: PathLike | None) -> tuple[Camera, Pose]:
    """Camera 0 of a calibration and its pose cam_from_imu."""
    path = Path(calibration) if calibration is not None else _part(scene, *CALIBRATION_FILES)
    rig = load_kalibr_rig(path)
    if "cam0" not in rig or rig["cam0"].cam_from_imu is None:
        raise ValueError(f"calibration file {path} must give T_cam_imu of cam0; Kalibr writes it")
    return rig["cam0"].camera, rig["cam0"].cam_from_imu
