# SPDX-License-Identifier: BSD-3-Clause
"""What is wrong with the pictures of a sequence: blank, frozen, of another size."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera

PictureVerdict = Literal["good", "blank", "frozen"]
_SMALL = (128, 64)  # width and height at which pictures are compared: 0.1 ms a picture
_BLANK = 2.5  # grey levels; a lens cap or a faded-out video spreads less, fog and night more
_FROZEN = 0.02  # mean difference in grey levels; sensor noise alone leaves 0.2


class PictureWatch:
    """Looks at each picture of a sequence before it is tracked."""

    def __init__(self, camera: Camera, working: Camera, mask: NDArray[np.bool_] | None) -> None:
        self._given = (camera.width, camera.height)
        self._size = (working.width, working.height)
        usable = np.ones((working.height, working.width), np.uint8)
        if mask is not None:
            usable = mask.astype(np.uint8)
        self._usable = cv2.resize(usable, _SMALL, interpolation=cv2.INTER_NEAREST) > 0
        if not self._usable.any():
            self._usable[:] = True
        self._before: NDArray[np.float32] | None = None

    def fitted(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.uint8] | None, str]:
        """Picture in the working size, None if it has another shape, and a sentence."""
        height, width = image.shape[:2]
        said, wanted = "", f"{self._given[0]}x{self._given[1]}"
        if (width, height) != self._given:
            if abs(width * self._given[1] - height * self._given[0]) > 0.01 * width * height:
                return None, f"is {width}x{height}, not {wanted} as the camera"
            said = f"is {width}x{height}, not {wanted}, and was resized"
        if (width, height) == self._size:
            return image, said
        resized = cv2.resize(image, self._size, interpolation=cv2.INTER_AREA)
        return np.asarray(resized, np.uint8), said

    def verdict(self, gray: NDArray[np.uint8]) -> PictureVerdict:
        """Whether a picture shows something, and something new."""
        small = cv2.resize(gray, _SMALL, interpolation=cv2.INTER_AREA).astype(np.float32)
        if float(small[self._usable].std()) < _BLANK:
            return "blank"
        # Compared with the last one that was new: slow changes add up.
        if self._before is not None and float(np.abs(small - self._before).mean()) < _FROZEN:
            return "frozen"
        self._before = small
        return "good"


def mask_for(camera: Camera, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mask in the size of a camera's pictures."""
    size = (camera.width, camera.height)
    if mask.shape == size[::-1]:
        return mask
    resized = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    return np.asarray(resized > 0)


def joint_mask(camera: Camera, *masks: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
    """What all masks leave, in the size of a camera's pictures; None where there is none."""
    given = [mask_for(camera, mask) for mask in masks if mask is not None]
    return np.logical_and.reduce(given) if given else None
