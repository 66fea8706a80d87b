# SPDX-License-Identifier: BSD-3-Clause
"""Panoramas seen through a fisheye lens: what is known of them is known of its pictures too."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.features import read_image
from epi360.features.picture_writing import encode_picture
from epi360.features.resampling import Resampling, pixel_centers
from epi360.poses import Pose
from epi360.runs.whole_files import write_file
from epi360.synthetic.landmarks import rotation_from_heading
from epi360_scenes.tours import Tour

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

MOST_PITCH_DEG = 10.0  # of a lens that is held level
CAMERA, RECORD = "lens.yaml", "lens.txt"


@dataclass(frozen=True, eq=False)
class Lens:
    """An equidistant fisheye lens that looks somewhere in a panorama."""

    camera: KannalaBrandt
    panorama_from_lens: Array

    @classmethod
    def of(cls, lens_deg: float, panorama_width: int, panorama_from_lens: Array) -> Lens:
        """Make one of a field of view, as fine as a panorama is at its horizon."""
        focal = panorama_width / (2 * np.pi)
        size = round(np.radians(lens_deg) * focal)
        middle = size / 2
        camera = KannalaBrandt(size, size, focal, focal, middle, middle, max_angle_deg=lens_deg / 2)
        return cls(camera, panorama_from_lens)

    @classmethod
    def at_random(cls, lens_deg: float, panorama_width: int, rng: np.random.Generator) -> Lens:
        """Make one that looks anywhere along the horizon, and a little up or down."""
        pitch = np.radians(rng.uniform(-MOST_PITCH_DEG, MOST_PITCH_DEG))
        heading = np.array([pitch, rng.uniform(-np.pi, np.pi), 0.0])
        return cls.of(lens_deg, panorama_width, rotation_from_heading(heading))

    def picture(self, panorama: Picture) -> Picture:
        """What the lens shows of a panorama; black where it shows nothing."""
        height, width = panorama.shape[:2]
        centers = pixel_centers(self.camera.width, self.camera.height)
        bearings = self.camera.bearings_from_pixels(centers) @ self.panorama_from_lens.T
        shape = (self.camera.height, self.camera.width)
        return Resampling(Equirectangular(width, height), [bearings], shape).picture(panorama)

    @property
    def pose(self) -> Pose:
        """Where the lens is in its panorama."""
        return Pose(self.panorama_from_lens, np.zeros(3))

    def write_camera(self, path: Path) -> None:
        """Write the calibration file of the lens."""
        names = ("width", "height", "fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4", "max_angle_deg")
        values = (f"{name}: {getattr(self.camera, name)}\n" for name in names)
        path.write_text("model: KannalaBrandt\n" + "".join(values), encoding="utf-8")


def tour_through_lens(tour: Tour, folder: Path, lens_deg: float, seed: int) -> Tour:
    """The same places through a lens that looks elsewhere in each.

    Parameters
    ----------
    tour : Tour
    folder : Path
        Gets the camera, ``lens.yaml``, and ``pictures`` with a PNG file for each panorama; those
        that are there of these panoramas and this lens stay.
    lens_deg : float
        Field of view.
    seed : int
        Of where the lens looks.

    Returns
    -------
    tour : Tour
        With the poses of the lens. What two pictures share is not known: NaN.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    pictures = folder / "pictures"
    pictures.mkdir(parents=True, exist_ok=True)
    key = f"{lens_deg:g} degrees, seed {seed}, of {tour.digest()}"
    record = folder / RECORD
    is_of_these = record.is_file() and record.read_text(encoding="utf-8") == key
    record.unlink(missing_ok=True)
    panoramas = []
    for number, one in enumerate(tour.panoramas):
        rng = np.random.Generator(np.random.PCG64([seed, 5, number]))
        panorama = read_image(tour.folder / one.name)
        lens = Lens.at_random(lens_deg, panorama.shape[1], rng)
        name = _as_png(one.name)
        if not (is_of_these and (pictures / name).is_file()):
            write_file(pictures / name, encode_picture(lens.picture(panorama), ".png"))
        panoramas.append(replace(one, name=name, world_from_cam=one.world_from_cam @ lens.pose))
    lens.write_camera(folder / CAMERA)
    write_file(record, key.encode())
    unknown = {(_as_png(name1), _as_png(name2)): np.nan for name1, name2 in tour.overlaps}
    return replace(tour, folder=pictures, panoramas=tuple(panoramas), overlaps=unknown)


def _as_png(name: str) -> str:
    return str(Path(name).with_suffix(".png"))
