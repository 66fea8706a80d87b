# SPDX-License-Identifier: BSD-3-Clause
"""Camera models: pixels to bearings and back, and the calibration files that describe them."""

from epi360.cameras.base import Camera
from epi360.cameras.calibration import KalibrCamera, load_camera, load_cameras, load_kalibr_rig
from epi360.cameras.double_sphere import DoubleSphere
from epi360.cameras.equirectangular import Equirectangular
from epi360.cameras.extended_unified import ExtendedUnified
from epi360.cameras.kannala_brandt import KannalaBrandt
from epi360.cameras.pinhole import Pinhole
from epi360.cameras.rigs import Rig, load_rig
from epi360.cameras.unified import UnifiedCamera

__all__ = [
    "Camera", "DoubleSphere", "Equirectangular", "ExtendedUnified", "KalibrCamera", "KannalaBrandt",
    "Pinhole", "Rig", "UnifiedCamera", "load_camera", "load_cameras", "load_kalibr_rig", "load_rig",
]  # fmt: skip
