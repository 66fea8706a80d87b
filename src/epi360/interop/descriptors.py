# SPDX-License-Identifier: BSD-3-Clause
"""Descriptors as COLMAP keeps them: SIFT in bytes, those of networks as floats in bytes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Descriptors = NDArray[np.float32] | NDArray[np.uint8]
DescriptorsOf = Callable[[str], Descriptors | None]  # by the name of an image

SIFT, UNDEFINED = 0, -1  # COLMAP's FeatureExtractorType
SIFT_LENGTH = 128
# COLMAP multiplies SIFT descriptors of unit length by 512 and rounds them (feature/utils.cc).
SIFT_STEPS = 512.0
_LARGEST_BYTE = 255
_UNIT_TOLERANCE = 0.02  # hloc's half precision, and SIFT's whole numbers, are not quite of length 1


def colmap_descriptors(descriptors: Descriptors) -> tuple[int, NDArray[np.uint8]]:
    """COLMAP's type of descriptors (N, D), and their bytes (N, B).

    RootSIFT of unit length, and the bytes of SIFT, become COLMAP's SIFT: a step of 1/512 and
    nothing above 255. Others become floats of undefined type, which COLMAP keeps and does not
    match.
    """
    if is_sift_bytes(descriptors):
        return SIFT, np.ascontiguousarray(descriptors, np.uint8)
    if _is_root_sift(descriptors):
        steps = np.minimum(np.round(descriptors * SIFT_STEPS), _LARGEST_BYTE)
        return SIFT, np.ascontiguousarray(steps, np.uint8)
    floats = np.ascontiguousarray(descriptors, np.float32)
    return UNDEFINED, floats.view(np.uint8).reshape(len(floats), -1)


def stored_descriptors(kind: int, stored: NDArray[np.uint8]) -> NDArray[np.float32] | None:
    """Descriptors (N, D) of COLMAP's bytes (N, B); None for bytes that are no whole floats."""
    # Tables of an older COLMAP have no type, and hold SIFT.
    if not len(stored) or kind == SIFT or (kind == UNDEFINED and stored.shape[1] == SIFT_LENGTH):
        return stored.astype(np.float32)
    if stored.shape[1] % 4:
        return stored.astype(np.float32) if kind == UNDEFINED else None
    return np.ascontiguousarray(stored).view(np.float32)


def unit_descriptors(descriptors: Descriptors) -> NDArray[np.float32]:
    """Descriptors of unit length, whatever they were multiplied by."""
    values = np.asarray(descriptors, np.float32)
    if not np.isfinite(values).all():
        raise ValueError("descriptors must be finite numbers")
    lengths = np.linalg.norm(values.astype(np.float64), axis=1, keepdims=True)
    return np.asarray(values / np.maximum(lengths, 1e-9), np.float32)


def is_sift_bytes(descriptors: Descriptors) -> bool:
    """Whether these are SIFT descriptors in whole numbers up to 255."""
    if descriptors.ndim != 2 or descriptors.shape[1] != SIFT_LENGTH or not len(descriptors):
        return False
    if descriptors.dtype == np.uint8:
        return True
    in_range = 0 <= descriptors.min() and 1 < descriptors.max() <= _LARGEST_BYTE
    return bool(in_range and (descriptors == np.floor(descriptors)).all())


def _is_root_sift(descriptors: Descriptors) -> bool:
    if descriptors.ndim != 2 or descriptors.shape[1] != SIFT_LENGTH or not len(descriptors):
        return False
    if not (descriptors >= 0).all():
        return False
    lengths = np.linalg.norm(np.asarray(descriptors, np.float64), axis=1)
    return bool((np.abs(lengths[lengths > 0] - 1.0) < _UNIT_TOLERANCE).all())
