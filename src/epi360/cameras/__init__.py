# SPDX-License-Identifier: BSD-3-Clause
"""Camera models: pixels to bearings and back, and the calibration files that describe them."""

from epi360.cameras.base import Camera
from epi360.cameras.calibration import load_camera, load_cameras
from epi360.cameras.equirectangular import Equirectangular
from epi360.cameras.kannala_brandt import KannalaBrandt
from epi360.cameras.pinhole import Pinhole

__all__ = [
    "Camera",
    "Equirectangular",
    "KannalaBrandt",
    "Pinhole",
    "load_camera",
    "load_cameras",
]
