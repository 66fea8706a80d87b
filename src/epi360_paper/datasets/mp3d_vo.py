# SPDX-License-Identifier: BSD-3-Clause
"""360-MP3D-VO: panoramas with depth and poses, rendered from Matterport3D (paper section 5)."""

from pathlib import Path

from epi360.image_folders import existing_folder
from epi360.interop.text_tables import read_table
from epi360.poses import pose_from_quaternion
from epi360.runs.whole_files import PathLike
from epi360_paper.datasets.image_folder import panorama_camera
from epi360_paper.datasets.intensities import intensity_levels
from epi360_paper.datasets.sequence import ImageSequence

COLUMNS = ("t", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
POSES_FILE = "frm_ref.txt"


def load_mp3d_vo(scene: PathLike) -> ImageSequence:
    """Sequence of a scene in the layout of 360-MP3D-VO, which `epi360 render` writes too.

    The folder has ``rgb/1.png``, ``rgb/2.png``, ..., optionally ``depth/tiff/1.tiff``, ... (range
    along the ray, 0 = none), and ``frm_ref.txt``: rows ``t tx ty tz qx qy qz qw`` of
    world_from_cam. The k-th row, from 0, belongs to the files k + 1.

    Raises
    ------
    FileNotFoundError
        If the folder, its images or its poses are missing.
    ValueError
        If a file number is missing, the counts differ, a row is bad or an image is no panorama.
    """
    scene = existing_folder(scene, "MP3D-VO scene")
    images = _numbered_files(existing_folder(scene / "rgb", "folder of images"), ".png")
    table = read_table(scene / POSES_FILE, COLUMNS, None)
    if len(table.cells) != len(images):
        raise ValueError(
            f"MP3D-VO scene {scene} must have one pose per image, got {len(table.cells)} rows in "
            f"{POSES_FILE} and {len(images)} images in rgb"
        )
    translations, quaternions = table.floats(1, 4), table.quaternions(4)[:, [3, 0, 1, 2]]
    return ImageSequence(
        name=scene.resolve().name,
        camera=panorama_camera(images[0]),
        image_paths=images,
        timestamps_s=table.floats(0, 1)[:, 0],
        world_from_cam=tuple(map(pose_from_quaternion, translations, quaternions)),
        depth_paths=_depth_files(scene, len(images)),
        levels=intensity_levels(images),
    )


def find_mp3d_vo_scenes(folder: PathLike) -> list[Path]:
    """Scenes in a folder: itself, or those at any depth that hold ``frm_ref.txt``, sorted.

    ``FileNotFoundError`` if the folder does not exist or there is no scene in it.
    """
    folder = existing_folder(folder, "MP3D-VO folder")
    scenes = sorted(path.parent for path in folder.rglob(POSES_FILE))
    if not scenes:
        raise FileNotFoundError(
            f"MP3D-VO folder {folder} has no scene; a scene holds rgb/ and {POSES_FILE}"
        )
    return scenes


def _depth_files(scene: Path, count: int) -> tuple[Path, ...]:
    folder = scene / "depth" / "tiff"
    if not folder.is_dir():
        return ()
    files = _numbered_files(folder, ".tiff")
    if len(files) != count:
        raise ValueError(
            f"MP3D-VO scene {scene} must have one depth map per image, got {len(files)} in "
            f"depth/tiff and {count} images in rgb"
        )
    return files


def _numbered_files(folder: Path, suffix: str) -> tuple[Path, ...]:
    numbers = {int(path.stem) for path in folder.glob(f"*{suffix}") if path.stem.isdecimal()}
    if not numbers:
        raise FileNotFoundError(f"{folder} has no images 1{suffix}, 2{suffix}, ...")
    missing = sorted(set(range(1, max(numbers) + 1)) - numbers)
    if missing or 0 in numbers:
        what = f"{missing[0]}{suffix} is missing" if missing else f"there is a 0{suffix}"
        raise ValueError(f"{folder} must number its files from 1 to {max(numbers)}, {what}")
    return tuple(folder / f"{number}{suffix}" for number in sorted(numbers))
