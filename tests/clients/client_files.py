# SPDX-License-Identifier: BSD-3-Clause
"""One exact scene in every file that epi360 writes for other programs."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from epi360.cameras import Equirectangular
from epi360.interop import (
    MatchedImage,
    MatchedPair,
    MatchGraph,
    Observations,
    PosedImage,
    Reconstruction,
    write_colmap_model,
    write_hloc,
    write_nerfstudio,
    write_opensfm_folder,
    write_tum_trajectory,
)
from epi360.interop.ply import write_ply_points
from epi360.interop.upright_world import down_in_world, moved, upright_from_world
from epi360.jobs.cubes.cube_faces import CubemapOptions, cubemap_reconstruction
from epi360.jobs.cubes.cubemap import export_cubemap
from epi360.poses import Pose, rotation_from_vector

CAMERA = Equirectangular(160, 80)
FACES = CubemapOptions(faces=("front", "right", "back", "left", "up"), flat=True, face_size=64)
TILT = rotation_from_vector([0.4, 0.0, 0.3])  # of the world against the vertical


@dataclass(frozen=True)
class Scene:
    """Where the files are, and what they are of: level panoramas in a tilted world, and their
    cube faces in an upright one, as `epi360 map` makes it."""

    folder: Path
    panoramas: Reconstruction
    faces: Reconstruction


def write_scene(folder: Path) -> Scene:
    """Write cube faces, COLMAP models, transforms, a project, a trajectory, points, matches."""
    panoramas = _panoramas()
    upright = moved(panoramas, upright_from_world(down_in_world(panoramas)))
    rng = np.random.default_rng(0)
    for image in panoramas.images:
        picture = rng.integers(0, 256, (CAMERA.height, CAMERA.width, 3), dtype=np.uint8)
        path = folder / "panoramas" / image.name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(picture).save(path)
    export_cubemap(folder / "panoramas", upright, folder / "cube", FACES, mask_nadir_deg=60)
    faces = cubemap_reconstruction(upright, FACES)
    write_colmap_model(folder / "text" / "sparse" / "0", faces, text=True)
    write_colmap_model(folder / "panorama_model", panoramas)
    write_nerfstudio(folder / "transforms.json", panoramas, images="panoramas")
    write_opensfm_folder(folder / "opensfm", panoramas)
    write_tum_trajectory(folder / "trajectory.txt", panoramas, fps=2.0)
    write_ply_points(folder / "points.ply", panoramas.points, panoramas.colors)
    write_hloc(folder / "features.h5", folder / "matches.h5", _graph(panoramas))
    return Scene(folder, panoramas, faces)


def _panoramas() -> Reconstruction:
    rng = np.random.default_rng(1)
    points = rng.normal(size=(60, 3))
    points *= 4 / np.linalg.norm(points, axis=1)[:, None]
    colors = rng.integers(0, 256, (60, 3)).astype(np.uint8)
    images, pixels = [], []
    for number in range(9):
        heading = rotation_from_vector([0.0, 0.7 * number, 0.0])
        position = TILT.T @ [0.3 * number, 0.02 * number, 0.1 * (number % 3)]
        pose = Pose(heading @ TILT, -(heading @ TILT @ position))
        images.append(PosedImage(f"walk/v1.{number}.png", "panorama", pose))
        seen = CAMERA.pixels_from_bearings(points @ pose.rotation.T + pose.translation)
        pixels.append(seen)
    observations = Observations(
        np.tile(np.arange(60), 9), np.repeat(np.arange(9), 60), np.concatenate(pixels)
    )
    return Reconstruction({"panorama": CAMERA}, tuple(images), points, colors, observations)


def _graph(panoramas: Reconstruction) -> MatchGraph:
    """Key points of all points in all images, and matches between neighbours."""
    seen = panoramas.observations
    assert seen is not None
    images = {
        image.name: MatchedImage(image.name, image.camera, seen.pixels[seen.images == index])
        for index, image in enumerate(panoramas.images)
    }
    names = list(images)
    matches = np.repeat(np.arange(60)[:, None], 2, axis=1)
    pairs = tuple(
        MatchedPair(one, other, matches) for one, other in zip(names, names[1:], strict=False)
    )
    return MatchGraph(panoramas.cameras, images, pairs)
