# SPDX-License-Identifier: BSD-3-Clause
"""The ways from two images to a relative pose that are compared: epi360, and COLMAP's own."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from _data import ImagePair, Matches
from numpy.typing import NDArray

import epi360
from epi360.cameras import Camera, Equirectangular, KannalaBrandt
from epi360.estimation.result import pose_sigmas_deg
from epi360.features.picture_writing import encode_picture
from epi360.poses import Pose


@dataclass(frozen=True)
class Estimate:
    """What a method says about a pair."""

    cam2_from_cam1: Pose
    accepted: bool  # the method itself stands behind rotation and direction
    status: str
    num_inliers: int
    num_matches: int
    keypoints1: NDArray[np.float64]  # (M, 2) continuous pixels, row i of both is match i
    keypoints2: NDArray[np.float64]
    rotation_sigma_deg: float = np.nan  # one sigma, over all components, where a method states it
    translation_sigma_deg: float = np.nan


class Method(Protocol):
    """From files to a pose, and from given matches to a pose."""

    name: str

    def prepare(self, pairs: Sequence[ImagePair]) -> None:
        """Do once, untimed, what does not depend on the images."""

    def from_images(self, pair: ImagePair, seed: int) -> Estimate:
        """Pose of two image files."""

    def from_matches(self, matches: Matches, seed: int) -> Estimate:
        """Pose from matched pixels."""


class Epi360:
    """The package of this repository, with its defaults."""

    name = "epi360"

    def prepare(self, pairs: Sequence[ImagePair]) -> None:
        """Nothing to prepare: cameras carry their field of view."""

    def from_images(self, pair: ImagePair, seed: int) -> Estimate:
        """`epi360.relative_pose_of_images` on the two files."""
        result = epi360.relative_pose_of_images(
            pair.path1, pair.path2, camera1=pair.camera1, camera2=pair.camera2, seed=seed
        )
        return self._estimate(result, result.keypoints1, result.keypoints2)

    def from_matches(self, matches: Matches, seed: int) -> Estimate:
        """`epi360.estimate_relative_pose` on the bearings of matched pixels."""
        bearings1 = matches.camera1.bearings_from_pixels(matches.keypoints1)
        bearings2 = matches.camera2.bearings_from_pixels(matches.keypoints2)
        result = epi360.estimate_relative_pose(bearings1, bearings2, seed=seed)
        return self._estimate(result, matches.keypoints1, matches.keypoints2)

    @staticmethod
    def _estimate(
        result: epi360.RelativePoseResult,
        keypoints1: NDArray[np.float64],
        keypoints2: NDArray[np.float64],
    ) -> Estimate:
        rotation_sigma_deg, translation_sigma_deg = pose_sigmas_deg(result)
        return Estimate(
            cam2_from_cam1=result.cam2_from_cam1,
            accepted=result.success,
            status=result.status,
            num_inliers=result.num_inliers,
            num_matches=result.num_matches,
            keypoints1=keypoints1,
            keypoints2=keypoints2,
            rotation_sigma_deg=rotation_sigma_deg,
            translation_sigma_deg=translation_sigma_deg,
        )


class Pycolmap:
    """COLMAP with its defaults: SIFT on the CPU, matching and verification through its database.

    Both images are extracted in one call and so in parallel. The extractor and matcher objects
    without a database give the same matches, but were slower: their matcher alone took up to
    55 s where the database's took 2 s (14,500 key points an image).
    """

    name = "pycolmap"

    def __init__(self, scratch: Path, *, max_error_px: float | None = None) -> None:
        """Import pycolmap, which may raise ``ImportError``; masks are kept in ``scratch``."""
        import pycolmap

        pycolmap.logging.minloglevel = pycolmap.logging.ERROR.value
        self._pycolmap: Any = pycolmap
        self._mask_folder = scratch
        self._max_error_px = max_error_px

    def prepare(self, pairs: Sequence[ImagePair]) -> None:
        """Write the field of view of fisheye cameras as the masks that COLMAP reads."""
        for pair in pairs:
            for camera, image in ((pair.camera1, pair.image1), (pair.camera2, pair.image2)):
                if camera is not None:
                    mask = camera.field_of_view_mask().astype(np.uint8) * 255
                    path = self._mask_path(pair) / f"{image}.png"
                    path.parent.mkdir(parents=True, exist_ok=True)
                    path.write_bytes(encode_picture(mask, ".png"))

    def from_images(self, pair: ImagePair, seed: int) -> Estimate:
        """Features, matches and verified geometry of a database that holds this pair only."""
        with tempfile.TemporaryDirectory() as folder:
            database = Path(folder) / "database.db"
            self._extract(pair, database)
            self._pycolmap.match_exhaustive(
                database,
                verification_options=self._geometry_options(seed),
                device=self._pycolmap.Device.cpu,
            )
            return self._read_estimate(pair, database)

    def from_matches(self, matches: Matches, seed: int) -> Estimate:
        """Two-view geometry of matched pixels."""
        rows = np.arange(len(matches.keypoints1), dtype=np.uint32)
        geometry = self._pycolmap.estimate_calibrated_two_view_geometry(
            self._camera(matches.camera1, 1),
            matches.keypoints1,
            self._camera(matches.camera2, 2),
            matches.keypoints2,
            np.column_stack([rows, rows]),
            self._geometry_options(seed),
        )
        return self._estimate(geometry, matches.keypoints1, matches.keypoints2)

    def _mask_path(self, pair: ImagePair) -> Path:
        return self._mask_folder / pair.folder.name

    def _geometry_options(self, seed: int) -> Any:
        options = self._pycolmap.TwoViewGeometryOptions(compute_relative_pose=True)
        options.ransac.random_seed = seed
        if self._max_error_px is not None:
            options.ransac.max_error = self._max_error_px
        return options

    def _extract(self, pair: ImagePair, database: Path) -> None:
        """SIFT of both images in one call, which makes the cameras, and then the rig's cameras."""
        colmap = self._pycolmap
        options = colmap.ImageReaderOptions(camera_model="EQUIRECTANGULAR")
        if pair.camera1 is not None:
            options.camera_model = "OPENCV_FISHEYE"
            options.mask_path = self._mask_path(pair)
        colmap.Database.open(database).close()
        colmap.extract_features(
            database,
            pair.folder,
            [pair.image1, pair.image2],
            camera_mode=colmap.CameraMode.PER_IMAGE,
            reader_options=options,
            device=colmap.Device.cpu,
        )
        if pair.camera1 is not None and pair.camera2 is not None:
            with colmap.Database.open(database) as opened:
                for name, camera in ((pair.image1, pair.camera1), (pair.image2, pair.camera2)):
                    camera_id = opened.read_image_with_name(name).camera_id
                    opened.update_camera(self._camera(camera, camera_id))

    def _read_estimate(self, pair: ImagePair, database: Path) -> Estimate:
        with self._pycolmap.Database.open(database) as opened:
            ids = [
                opened.read_image_with_name(name).image_id for name in (pair.image1, pair.image2)
            ]
            pixels1, pixels2 = (
                opened.read_keypoints(image_id)[:, :2].astype(np.float64) for image_id in ids
            )
            matches = opened.read_matches(*ids)
            geometry = opened.read_two_view_geometry(*ids)
        return self._estimate(geometry, pixels1[matches[:, 0]], pixels2[matches[:, 1]])

    def _camera(self, camera: Camera, camera_id: int) -> Any:
        """COLMAP's camera of one of ours; its pixels are continuous like ours."""
        if isinstance(camera, Equirectangular):
            model, names = "EQUIRECTANGULAR", "width height"
        elif isinstance(camera, KannalaBrandt):
            model, names = "OPENCV_FISHEYE", "fx fy cx cy k1 k2 k3 k4"
        else:
            raise ValueError(f"camera must be Equirectangular or KannalaBrandt, got {camera}")
        return self._pycolmap.Camera(
            camera_id=camera_id,
            model=model,
            width=camera.width,
            height=camera.height,
            params=[getattr(camera, name) for name in names.split()],
            has_prior_focal_length=True,
        )

    def _estimate(
        self, geometry: Any, keypoints1: NDArray[np.float64], keypoints2: NDArray[np.float64]
    ) -> Estimate:
        """Estimate from COLMAP's geometry: it stands behind each that has a translation."""
        found = geometry.cam2_from_cam1
        pose = Pose.nan() if found is None else Pose(found.rotation.matrix(), found.translation)
        return Estimate(
            cam2_from_cam1=pose,
            accepted=bool(np.linalg.norm(pose.translation) > 0),  # NaN is not
            status=self._pycolmap.TwoViewGeometryConfiguration(geometry.config).name.lower(),
            num_inliers=len(geometry.inlier_matches),
            num_matches=len(keypoints1),
            keypoints1=keypoints1,
            keypoints2=keypoints2,
        )
