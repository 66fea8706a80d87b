# SPDX-License-Identifier: BSD-3-Clause
"""Images and matched pairs of a COLMAP database, read one at a time."""

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular
from epi360.cameras.calibration.colmap import camera_of_model, model_of_number
from epi360.interop.colmap_tables import Blob, ColmapTables
from epi360.runs.whole_files import PathLike

LARGEST_IMAGE_ID = 2147483647  # a pair's id is this times the smaller image id, plus the larger
CACHED_IMAGES = 64  # consecutive pairs share images, so that few images are in use at a time


class ColmapPairs(ColmapTables):
    """COLMAP database whose key points and matches are read when asked for, without pycolmap."""

    def __init__(self, path: PathLike) -> None:
        super().__init__(path)
        try:
            # Camera keys are ids as text; images have their camera's key by name, in order of ids.
            # Image 1 of a pair has the smaller id.
            self.cameras = {str(number): camera for number, camera in self._read_cameras()}
            self._name_of_id: dict[int, str] = {}
            self.images = dict(self._read_images())
            self._id_of_name = {name: number for number, name in self._name_of_id.items()}
            self._num_keypoints = dict(self.rows("SELECT image_id, rows FROM keypoints"))
            query = "SELECT pair_id FROM matches ORDER BY pair_id"
            self._pair_ids = [pair_id for (pair_id,) in self.rows(query)]
            self.names = [self.names_of(pair_id) for pair_id in self._pair_ids]
        except BaseException:
            self.close()
            raise
        # Key points of an image in continuous pixels, shape (N, 2), read-only.
        self.keypoints = lru_cache(CACHED_IMAGES)(self._read_keypoints)

    def camera(self, name: str) -> Camera:
        """Return the camera of an image."""
        return self.cameras[self.images[name]]

    def check_panoramas(self) -> None:
        """Raise ``ValueError`` where pycolmap has made up the camera of a panorama in a pair.

        It makes perspective cameras of a guessed focal length where nobody tells it of another one.
        """
        guessed = self._guessed_panorama()
        if guessed is not None:
            camera = self.camera(guessed)
            raise self.error(
                f"{guessed} has the shape of a panorama, {camera.width}x{camera.height}, and a "
                "perspective camera with a focal length that nobody knows, as pycolmap makes one "
                "up; give the true camera by --camera FILE, or set it in the database (or its "
                "prior_focal_length to 1)"
            )

    def _guessed_panorama(self) -> str | None:
        """Name of an image of 2:1, in a pair, whose camera is perspective and guessed, or None."""
        if not self.has_columns("cameras", "prior_focal_length"):
            return None
        query = "SELECT camera_id FROM cameras WHERE prior_focal_length = 0"
        cameras = {str(key): self.cameras[str(key)] for (key,) in self.rows(query)}
        guessed = {
            key
            for key, camera in cameras.items()
            if camera.width == 2 * camera.height and not isinstance(camera, Equirectangular)
        }
        if not guessed:
            return None
        names = (name for pair in self.names for name in pair)
        return next((name for name in names if self.images[name] in guessed), None)

    def _read_keypoints(self, name: str) -> NDArray[np.float64]:
        query = "SELECT rows, cols, data FROM keypoints WHERE image_id = ?"
        what = f"key points of {name}"
        blobs = list(self.rows(query, self._id_of_name[name])) or [(0, 0, None)]
        array = self.array(blobs[0], np.float32, what)
        if array.shape[1] < 2:
            raise self.error(f"{what} must have 2, 4 or 6 columns, got {array.shape[1]}")
        if not np.isfinite(array[:, :2]).all():
            raise self.error(f"{what} must be finite")
        keypoints = array[:, :2].astype(np.float64)
        keypoints.flags.writeable = False
        return keypoints

    def matches(self, index: int) -> NDArray[np.int64]:
        """Return the matches of a pair, shape (M, 2): key points in image 1 and in image 2."""
        query = "SELECT rows, cols, data FROM matches WHERE pair_id = ?"
        (blob,) = self.rows(query, self._pair_ids[index])
        return self.checked_matches(blob, self.names[index])

    def names_of(self, pair_id: int) -> tuple[str, str]:
        """Return the names of the two images of a pair."""
        id1, id2 = divmod(pair_id, LARGEST_IMAGE_ID)
        if not id1 < id2:
            raise self.error(f"pair {pair_id} must name two images, the smaller id first")
        for number in (id1, id2):
            if number not in self._name_of_id:
                raise self.error(f"pair {pair_id} has image {number}, which is not there")
        return self._name_of_id[id1], self._name_of_id[id2]

    def checked_matches(self, blob: Blob, names: tuple[str, str]) -> NDArray[np.int64]:
        """Return the matches in (rows, cols, data), shape (M, 2); their key points exist."""
        pair = f"pair {names[0]} {names[1]}"
        matches = self.array(blob, np.uint32, f"matches of {pair}").astype(np.int64)
        if matches.shape[1] != 2:
            raise self.error(f"matches of {pair} must have 2 columns, got {matches.shape[1]}")
        for name, largest in zip(names, matches.max(axis=0, initial=-1), strict=True):
            count = self._num_keypoints.get(self._id_of_name[name], 0)
            if largest >= count:
                raise self.error(
                    f"{pair} has matches up to key point {largest} of {name}, "
                    f"which has {count} key points"
                )
        return matches

    def _read_cameras(self) -> Iterator[tuple[int, Camera]]:
        query = "SELECT camera_id, model, width, height, params FROM cameras ORDER BY camera_id"
        for camera_id, number, width, height, data in self.rows(query):
            model = model_of_number(number)
            what = f"camera {camera_id}"
            parameters = self.array((1, len(data or b"") // 8, data), np.float64, what)
            try:
                yield camera_id, camera_of_model(model, width, height, parameters[0].tolist())
            except ValueError as error:
                raise self.error(f"{what}: {error}") from None

    def _read_images(self) -> Iterator[tuple[str, str]]:
        query = "SELECT image_id, name, camera_id FROM images ORDER BY image_id"
        for image_id, name, camera_id in self.rows(query):
            if str(camera_id) not in self.cameras:
                raise self.error(f"image {name} has camera {camera_id}, which is not there")
            self._name_of_id[image_id] = name
            yield name, str(camera_id)
