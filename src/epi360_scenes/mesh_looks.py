# SPDX-License-Identifier: BSD-3-Clause
"""Colours of meshes: textures with mip maps, colours of vertices and faces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360_scenes.textures import GAMMA, TextureAtlas, atlas_of_images

Floats = NDArray[np.float32]

# Larger textures are shrunk to this side: at 0.1 deg a pixel it is hardly seen, and a scan may
# have dozens of textures.
MAX_TEXTURE_SIDE = 2048
GREY = 0.6


@dataclass(frozen=True)
class MeshLooks:
    """Colours of the faces of a mesh."""

    atlas: TextureAtlas  # textures, in display values
    textures: NDArray[np.intp]  # (F,): texture of each face, -1 for none
    # (F, 3, 2): texture positions of the corners, in turns; row 0 of the texture is v = 0.
    uv: Floats
    scales: Floats  # (F,): turns per metre
    corners: Floats  # (F, 3, 3): RGB in [0, 1] of the corners; multiplies the texture

    def colors(
        self, face: NDArray[np.intp], weights: NDArray[np.float64], widths: NDArray[np.float64]
    ) -> Floats:
        """Display colours of points on faces."""
        shares = weights.astype(np.float32)
        rgb: Floats = np.einsum("nk,nkc->nc", shares, self.corners[face])
        textured = self.textures[face] >= 0
        if textured.any():
            some = face[textured]
            uv = np.einsum("nk,nkc->cn", shares[textured], self.uv[some])
            footprint = widths[textured].astype(np.float32) * self.scales[some]
            rgb[textured] *= self.atlas.sample(self.textures[some], uv, footprint)
        return rgb


def looks_of_parts(parts: list[Any]) -> MeshLooks:
    """Colours of the faces of several meshes, one after the other."""
    images: list[Floats] = []
    textures, uvs, corners = [], [], []
    for part in parts:
        uv, image = _texture(part)
        textures.append(np.full(len(part.faces), -1 if image is None else len(images)))
        uvs.append(uv)
        corners.append(_corner_colors(part, textured=image is not None))
        if image is not None:
            images.append(image)
    uv = np.concatenate(uvs).astype(np.float32)
    areas = np.concatenate([part.area_faces for part in parts])
    (a, b), (c, d) = (uv[:, 1] - uv[:, 0]).T, (uv[:, 2] - uv[:, 0]).T
    scales = np.sqrt(0.5 * np.abs(a * d - b * c) / np.maximum(areas, 1e-12))
    return MeshLooks(
        atlas_of_images({str(number): image for number, image in enumerate(images)}),
        np.concatenate(textures),
        uv,
        scales.astype(np.float32),
        np.concatenate(corners).astype(np.float32),
    )


def _texture(part: Any) -> tuple[NDArray[Any], Floats | None]:
    """Texture positions (F, 3, 2) and a square texture, or zeros and None."""
    uv = getattr(part.visual, "uv", None)
    material = getattr(part.visual, "material", None)
    picture = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if uv is None or picture is None:
        return np.zeros((len(part.faces), 3, 2)), None
    positions = np.asarray(uv, dtype=np.float64) * (1.0, -1.0) + (0.0, 1.0)  # v upwards in trimesh
    # Whole turns are taken off: far from 0, single precision would blur the texture.
    corners = positions[part.faces]
    corners = corners - np.floor(corners.min(axis=1, keepdims=True))
    rgb = np.asarray(picture.convert("RGB"), dtype=np.uint8)
    side = min(MAX_TEXTURE_SIDE, 1 << int(np.ceil(np.log2(max(rgb.shape[:2])))))
    shrinks = side < max(rgb.shape[:2])
    square = cv2.resize(
        rgb, (side, side), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    )
    return corners, np.asarray(square, dtype=np.float32) / np.float32(255)


def _corner_colors(part: Any, *, textured: bool) -> NDArray[np.float64]:
    """RGB (F, 3, 3) of the corners of the faces."""
    num = len(part.faces)
    material = getattr(part.visual, "material", None)
    if material is not None:
        return np.broadcast_to(_plain_color(material, textured=textured), (num, 3, 3))
    colors = np.full((num, 3, 3), GREY)
    if part.visual.kind == "face":
        colors[:] = _unit_range(part.visual.face_colors)[:, None, :3]
    elif part.visual.kind == "vertex":
        colors[:] = _unit_range(part.visual.vertex_colors)[part.faces][:, :, :3]
    return colors


def _plain_color(material: Any, *, textured: bool) -> NDArray[np.float64]:
    """RGB that a material has everywhere, or that its texture is multiplied with."""
    factor = getattr(material, "baseColorFactor", None)
    if factor is not None:  # linear light in glTF
        display: NDArray[np.float64] = _unit_range(factor)[:3] ** (1 / GAMMA)
        return display
    diffuse = None if textured else getattr(material, "diffuse", None)
    if diffuse is not None:
        return _unit_range(diffuse)[:3]
    return np.full(3, 1.0 if textured else GREY)


def _unit_range(color: Any) -> NDArray[np.float64]:
    """Colours in [0, 1] of bytes; factors are in [0, 1] already."""
    values = np.asarray(color)
    scale = 255.0 if values.dtype == np.uint8 else 1.0
    return values.astype(np.float64) / scale
