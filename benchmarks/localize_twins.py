# SPDX-License-Identifier: BSD-3-Clause
"""New images in maps of homes with twin rooms: how often the wrong room is taken for the right one.

Each panorama of a rendered home is left out and localized twice: in a map of all others, and in one
without its room, which may hold a copy of it. The map has the true poses, and points from matches
that fit them.

    python benchmarks/localize_twins.py --work scratch
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from _left_out import triangulated
from numpy.typing import NDArray

import epi360
from epi360.cameras import Camera, Equirectangular
from epi360.features import Features
from epi360.interop.reconstruction import Observations, PosedImage, Reconstruction
from epi360.jobs.localization import LocalizationOptions
from epi360.jobs.localization.feature_sources import ExtractionSettings, ImageFolder
from epi360.jobs.localization.localize import localize_features
from epi360.jobs.localization.map_views import LocalizationMap
from epi360.poses import Pose
from epi360_scenes.tours import Tour, render_tour

RIGHT_M, FITS_RAD, LEAST_OVERLAP = 0.3, 0.004, 0.05
AMBIGUOUS, NO_POSE = "ambiguous", "no pose"
ANSWERS = (
    "right, silent", "right, with a warning", "wrong, with a warning", "wrong, silent", AMBIGUOUS,
    NO_POSE,
)  # fmt: skip
Matches = Mapping[tuple[str, str], NDArray[np.int64]]


@dataclass(frozen=True)
class Known:
    """Features of all images by name."""

    features: Mapping[str, Features]
    are_of_the_points = True

    def of_map(self, name: str, camera: Camera) -> Features | None:
        """Features of an image of the map."""
        return self.features[name]


def right_matches(tour: Tour, features: Mapping[str, Features], camera: Camera) -> Matches:
    """Matches of each pair with a view in common that lie in the planes of the true pose."""
    found = {}
    for (name1, name2), share in tour.overlaps.items():
        if share < LEAST_OVERLAP:
            continue
        matches = epi360.match_features(features[name1], features[name2])
        sides = [(features[name1], matches[:, 0]), (features[name2], matches[:, 1])]
        b1, b2 = (camera.bearings_from_pixels(f.keypoints[rows]) for f, rows in sides)
        pose = tour.cam2_from_cam1(name1, name2)
        normals = np.cross(pose.translation, b1 @ pose.rotation.T)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        off = np.arcsin(np.clip(np.einsum("ni,ni->n", normals, b2), -1.0, 1.0))
        found[name1, name2] = matches[np.abs(off) < FITS_RAD]
    return found


def tracks_of(names: list[str], matches: Matches) -> dict[tuple[int, int], int]:
    """Track of each key point (image, row) that has one: those that matches connect."""
    number = {name: k for k, name in enumerate(names)}
    parent: dict[tuple[int, int], tuple[int, int]] = {}

    def root(node: tuple[int, int]) -> tuple[int, int]:
        while parent.setdefault(node, node) != node:
            parent[node] = node = parent[parent[node]]
        return node

    for (name1, name2), rows in matches.items():
        if name1 in number and name2 in number:
            for row1, row2 in rows.tolist():
                parent[root((number[name1], row1))] = root((number[name2], row2))
    numbers: dict[tuple[int, int], int] = {}
    return {node: numbers.setdefault(root(node), len(numbers)) for node in sorted(parent)}


def map_of(
    names: list[str], tour: Tour, features: Mapping[str, Features], camera: Camera, matches: Matches
) -> LocalizationMap | None:
    """Map of these images with their true poses; None if they share no points."""
    poses = {each.name: each.world_from_cam.inverse() for each in tour.panoramas}
    tracks = tracks_of(names, matches)
    if not tracks:
        return None
    nodes = np.array(list(tracks))
    pixels = np.array([features[names[image]].keypoints[row] for image, row in nodes])
    model = Reconstruction(
        {"panorama": camera},
        tuple(PosedImage(name, "panorama", poses[name]) for name in names),
        observations=Observations(np.array(list(tracks.values())), nodes[:, 0], pixels),
    )
    model = triangulated(model, max(tracks.values()) + 1)
    return LocalizationMap(model, Known(features)) if len(model.points) else None


def answers(tour: Tour, width: int) -> Iterator[tuple[str, str]]:
    """Kind of map, and what became of each panorama in it."""
    camera = Equirectangular(width, width // 2)
    source = ImageFolder(ExtractionSettings(), tour.folder)
    features = {each.name: source.of_map(each.name, camera) for each in tour.panoramas}
    matches = right_matches(tour, features, camera)
    for new in tour.panoramas:
        others = [each for each in tour.panoramas if each.name != new.name]
        kinds = {
            "with its room": others,
            "without its room": [each for each in others if each.room != new.room],
        }
        for kind, images in kinds.items():
            names = [each.name for each in images]
            world = map_of(names, tour, features, camera, matches)
            if world is not None:
                truth = new.world_from_cam
                yield kind, _answer(world, features[new.name], camera, truth)


def _answer(world: LocalizationMap, seen: Features, camera: Camera, world_from_cam: Pose) -> str:
    result = localize_features(seen, camera, world, frozenset(), LocalizationOptions())
    if not result.success:
        return AMBIGUOUS if result.status == "ambiguous" else NO_POSE
    away = result.cam_from_world.inverse().translation - world_from_cam.translation
    is_right = float(np.linalg.norm(away)) < RIGHT_M
    return (
        f"{'right' if is_right else 'wrong'}, {'with a warning' if result.warnings else 'silent'}"
    )


def table(counts: Mapping[str, Counter[str]]) -> None:
    """Print how many panoramas got which answer in either kind of map."""
    print(f"| map | asked | {' | '.join(ANSWERS)} |")
    print("| --- " * (2 + len(ANSWERS)) + "|")
    for kind, found in counts.items():
        cells = " | ".join(str(found[answer]) for answer in ANSWERS)
        print(f"| {kind} | {found.total()} | {cells} |", flush=True)


def main() -> None:
    """Localize the panoramas of each tour and print the table of all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", type=Path, required=True, help="keeps the pictures")
    parser.add_argument(
        "--tours", nargs="+", default=["tilted_0", "level_1"],
        help="level or tilted, and the number of the home (tilted_0 level_1)",
    )  # fmt: skip
    parser.add_argument("--width", type=int, default=1024, help="of the panoramas (1024)")
    given = parser.parse_args()
    counts: dict[str, Counter[str]] = {}
    for name in given.tours:
        begun = time.process_time()
        kind, _, home = name.partition("_")
        folder = given.work / f"{name}_{given.width}"
        tour = render_tour(folder, int(home), is_level=kind == "level", width=given.width)
        rendered = time.process_time()
        for map_kind, answer in answers(tour, given.width):
            counts.setdefault(map_kind, Counter())[answer] += 1
        done = time.process_time()
        print(
            f"{name}: {rendered - begun:.0f} CPU s for pictures, {done - rendered:.0f} for the rest"
        )
    table(counts)


if __name__ == "__main__":
    main()
