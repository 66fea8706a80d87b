# SPDX-License-Identifier: BSD-3-Clause
"""Real image pairs with known poses: reads the folders described by a ``pairs.json``."""

from __future__ import annotations

import csv
import json
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular, KannalaBrandt
from epi360.poses import Pose, pose_from_quaternion

DEFAULT_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
OPENCV_TO_CONTINUOUS = 0.5  # OpenCV puts the centre of the top-left pixel at (0, 0)
FLOW_MAGIC = 202021.25  # first four bytes of a Middlebury .flo file
MIN_REFINED_INLIERS = 60  # above it zind_tour's README prefers image_refined to the annotation
KINDS = ("photo", "render")  # words of the "kind" of a pair that requirements go by


@dataclass(frozen=True)
class Requirement:
    """What a set has to reach: errors within both bounds on all but a few of its pairs."""

    rotation_deg: float
    translation_deg: float = math.inf
    allowed_failures: int = 0
    kind: str = ""  # only pairs of this kind; empty: all

    def __str__(self) -> str:
        """Bounds and kind, as in ``0.7/2 photo``."""
        direction = "-" if math.isinf(self.translation_deg) else f"{self.translation_deg:g}"
        return f"{self.rotation_deg:g}/{direction} {self.kind}".strip()


REQUIREMENTS: dict[str, tuple[Requirement, ...]] = {
    "replica_flow_pair": (Requirement(0.7, 2),),
    "stereo360_vertical": (Requirement(0.3, 1, kind="render"), Requirement(0.7, 3, kind="photo")),
    "theta_flat": (Requirement(0.7, 2), Requirement(0.3, 1, allowed_failures=1)),
    "campus_pair": (Requirement(0.5, 1.5),),
    "fisheye_rig": (Requirement(0.7, 2, allowed_failures=1),),
    "zind_tour": (Requirement(3, 5, allowed_failures=2),),
}
FLOW_REQUIREMENTS = (Requirement(0.01),)
POOLED_REQUIREMENTS = (Requirement(0.4, 1),)


@dataclass(frozen=True)
class ImagePair:
    """Two images, their cameras and the pose that is held to be true."""

    id: str
    folder: Path
    image1: str  # relative to the folder
    image2: str
    cam2_from_cam1: Pose
    reference: str  # where the pose comes from
    kind: str = ""
    camera1: Camera | None = None  # None: a full panorama of the image's size
    camera2: Camera | None = None
    flow: str | None = None  # file of exact optical flow from image 1 to image 2

    @property
    def path1(self) -> Path:
        """File of image 1."""
        return self.folder / self.image1

    @property
    def path2(self) -> Path:
        """File of image 2."""
        return self.folder / self.image2


@dataclass(frozen=True)
class Matches:
    """Matched pixels of two cameras: row i of both, (M, 2), continuous, is match i."""

    camera1: Camera
    camera2: Camera
    keypoints1: NDArray[np.float64]
    keypoints2: NDArray[np.float64]


@dataclass(frozen=True)
class PairSet:
    """All pairs of one folder and what is asked of them."""

    name: str
    pairs: tuple[ImagePair, ...]
    requirements: tuple[Requirement, ...]
    num_available: int  # pairs in the folder; more than len(pairs) if only some were taken

    @property
    def rig_cameras(self) -> tuple[Camera, Camera] | None:
        """Cameras of a rigid rig, where one pose holds for all pairs and matches can be pooled."""
        first = self.pairs[0]
        if first.camera1 is None or first.camera2 is None:
            return None
        return first.camera1, first.camera2


def data_folder(given: str | None) -> Path:
    """Folder of the sets: the given one, ``$EPI360_DATA`` or ``../shared/data``."""
    folder = Path(given or os.environ.get("EPI360_DATA") or DEFAULT_DATA)
    if not folder.is_dir():
        raise ValueError(f"real image pairs are not at {folder}; give --data or set EPI360_DATA")
    return folder.resolve()


def load_set(folder: Path, *, max_pairs: int | None = None) -> PairSet:
    """Set of one folder, or ``max_pairs`` of its pairs evenly spaced over the list.

    Raises
    ------
    ValueError
        If the folder has no ``pairs.json`` or nothing is asked of a set of its name.
    """
    if folder.name not in REQUIREMENTS or not (folder / "pairs.json").is_file():
        raise ValueError(f"{folder} is no set; known sets: {', '.join(REQUIREMENTS)}")
    document = json.loads((folder / "pairs.json").read_text(encoding="utf-8"))
    cameras = _rig_cameras(folder / "calib.json")
    pairs = [
        _pair_from_entry(folder, {**document, **entry}, cameras) for entry in document["pairs"]
    ]
    count = len(pairs) if max_pairs is None else min(max_pairs, len(pairs))
    chosen = np.unique(np.linspace(0, len(pairs) - 1, count).round().astype(int))
    requirements = REQUIREMENTS[folder.name]
    return PairSet(folder.name, tuple(pairs[i] for i in chosen), requirements, len(pairs))


def read_poses(path: Path) -> dict[str, Pose]:
    """Pose world_from_cam of each image, by its file name."""
    poses = {}
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            wxyz = np.array([float(row[name]) for name in ("qw", "qx", "qy", "qz")])
            unit = "_m" if "cx_m" in row else ""  # that of a sequence by odometry is its own
            centre = np.array([float(row[f"c{axis}{unit}"]) for axis in "xyz"])
            poses[Path(row["image"]).name] = pose_from_quaternion(
                centre, wxyz / np.linalg.norm(wxyz)
            )
    return poses


def _pair_from_entry(
    folder: Path, entry: dict[str, Any], cameras: tuple[Camera | None, Camera | None]
) -> ImagePair:
    refined = entry.get("image_refined", {})
    use_refined = refined.get("inliers_0p4deg", 0) > MIN_REFINED_INLIERS
    truth = refined if use_refined else entry
    return ImagePair(
        id=entry["id"],
        folder=folder,
        image1=entry["image1"],
        image2=entry["image2"],
        cam2_from_cam1=_pose(truth["R"], truth["t_dir"]),
        reference="image_refined" if use_refined else "R, t_dir",
        kind=next((kind for kind in KINDS if kind in entry.get("kind", "")), ""),
        camera1=cameras[0],
        camera2=cameras[1],
        flow=entry.get("flow"),
    )


def _pose(rotation: list[list[float]], direction: list[float]) -> Pose:
    """Pose of a rotation printed with eight digits: the nearest orthonormal matrix."""
    U, _, Vt = np.linalg.svd(np.array(rotation, dtype=np.float64))
    t = np.array(direction, dtype=np.float64)
    return Pose(U @ Vt, t / np.linalg.norm(t))


def _rig_cameras(path: Path) -> tuple[Camera | None, Camera | None]:
    """Left and right camera of a calibration, or two times None where there is no file."""
    if not path.is_file():
        return None, None
    calibration = json.loads(path.read_text(encoding="utf-8"))
    return _fisheye(calibration["left"]), _fisheye(calibration["right"])


def _fisheye(entry: dict[str, Any]) -> KannalaBrandt:
    """Camera up to the angle that its four coefficients were fitted to."""
    names = ("width", "height", "fx", "fy")
    return KannalaBrandt(
        **{name: entry[name] for name in names},
        cx=entry["cx"] + OPENCV_TO_CONTINUOUS,
        cy=entry["cy"] + OPENCV_TO_CONTINUOUS,
        **{f"k{i}": k for i, k in enumerate(entry["k"], start=1)},
        max_angle_deg=entry["calibrated_to_deg_off_axis"],
    )


def flow_matches(path: Path, *, step: int = 4) -> Matches:
    """Exact matches of two panoramas from a Middlebury ``.flo`` file.

    One pixel in ``step`` of every ``step``-th row.

    Raises
    ------
    ValueError
        If the file is of another format.
    """
    data = path.read_bytes()
    if np.frombuffer(data, "<f4", 1)[0] != np.float32(FLOW_MAGIC):
        raise ValueError(f"{path} is not a Middlebury .flo file")
    width, height = (int(size) for size in np.frombuffer(data, "<i4", 2, offset=4))
    flow = np.frombuffer(data, "<f4", offset=12).reshape(height, width, 2).astype(np.float64)
    v, u = np.mgrid[step // 2 : height : step, step // 2 : width : step]
    pixels1 = np.column_stack([u.ravel(), v.ravel()]) + 0.5
    pixels2 = pixels1 + flow[v.ravel(), u.ravel()]
    pixels2[:, 0] %= width
    camera = Equirectangular(width, height)
    return Matches(camera, camera, pixels1, pixels2)
