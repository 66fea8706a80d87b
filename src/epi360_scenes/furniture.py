# SPDX-License-Identifier: BSD-3-Clause
"""Building blocks of a furnished room: placed boxes and ellipsoids with materials, lights."""

from dataclasses import dataclass, field

import numpy as np

# Faces of a box are -x, +x, -y, +y, -z, +z. Pieces face +z, and up is -y.
FRONT, TOP = 5, 2
# Textures whose grain follows the longer side of a board.
GRAINED = ("oak", "walnut")

Span = tuple[float, float]
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Material:
    """A texture that repeats every `width_m`; without that it covers the face once."""

    texture: str
    width_m: float | None = None
    glow: float = 0.0


@dataclass(frozen=True)
class Place:
    """Where a piece of furniture stands: its origin on the floor and its turn."""

    x: float
    z: float
    yaw: float = 0.0

    def to_world(self, point: Triple) -> Triple:
        """World coordinates of a point of the piece."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        x, y, z = point
        return float(self.x + c * x + s * z), y, float(self.z - s * x + c * z)


@dataclass(frozen=True)
class Light:
    """Small flat source: position, direction it faces, RGB strength."""

    position: Triple
    normal: Triple
    rgb: Triple


@dataclass
class Furniture:
    """Growing list of the solids of a scene; only here, heights are positive upwards."""

    boxes: list[tuple[Triple, Triple, float]] = field(default_factory=list)
    box_materials: list[tuple[Material, ...]] = field(default_factory=list)
    box_shadows: list[bool] = field(default_factory=list)
    ellipsoids: list[tuple[Triple, Triple]] = field(default_factory=list)
    ellipsoid_materials: list[Material] = field(default_factory=list)
    lights: list[Light] = field(default_factory=list)

    def textures(self) -> list[str]:
        """Names of the textures that the solids use, sorted."""
        materials = [m for faces in self.box_materials for m in faces] + self.ellipsoid_materials
        return sorted({material.texture for material in materials})

    def box(
        self,
        place: Place,
        across: Span,
        heights: Span,
        depths: Span,
        material: Material,
        *,
        shadow: bool = True,
        faces: dict[int, Material] | None = None,
    ) -> None:
        """Add a box by its spans to the right, above the floor and towards the front."""
        # `faces` gives single faces another material; without `shadow` it shades nothing else.
        spans = np.array([across, (-heights[1], -heights[0]), depths])
        x, y, z = spans.mean(axis=1).tolist()
        a, b, c = (np.diff(spans, axis=1)[:, 0] / 2).tolist()
        self.boxes.append((place.to_world((x, y, z)), (a, b, c), place.yaw))
        self.box_materials.append(tuple((faces or {}).get(face, material) for face in range(6)))
        self.box_shadows.append(shadow)

    def ellipsoid(self, place: Place, center: Triple, radii: Triple, material: Material) -> None:
        """Add an ellipsoid by its centre (right, above the floor, front) and its radii."""
        x, height, z = center
        self.ellipsoids.append((place.to_world((x, -height, z)), radii))
        self.ellipsoid_materials.append(material)
