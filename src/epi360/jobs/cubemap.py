# SPDX-License-Identifier: BSD-3-Clause
"""Posed panoramas to posed pinhole images: a folder for tools that know no other camera."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.features.images import nadir_mask, read_image, read_mask
from epi360.files import write_file
from epi360.interop.colmap_model import write_colmap_model
from epi360.interop.nerfstudio import write_nerfstudio
from epi360.interop.reconstruction import Reconstruction
from epi360.jobs.cube_faces import (
    CubemapOptions,
    FaceName,
    FaceSampler,
    cubemap_reconstruction,
    face_camera,
    face_image_names,
    visible_faces,
)
from epi360.progress import Progress, no_progress

RECORD_FILE = "cubemap.json"
_STAGE = "cutting cube faces"


@dataclass(frozen=True, eq=False)
class Cubemap:
    """Folder of an exported cubemap.

    Attributes
    ----------
    reconstruction : Reconstruction
        The faces as posed images, with the points.
    num_written, num_kept : int
        Panoramas cut now, and those whose faces were there already.
    """

    reconstruction: Reconstruction
    num_written: int
    num_kept: int


def export_cubemap(
    folder: str | os.PathLike[str],
    reconstruction: Reconstruction,
    output: str | os.PathLike[str],
    options: CubemapOptions | None = None,
    *,
    masks: Mapping[str, Path | None] | None = None,
    mask_nadir_deg: float = 0.0,
    progress: Progress = no_progress,
) -> Cubemap:
    """Write posed panoramas as posed pinhole images, for tools that know no other camera.

    Parameters
    ----------
    folder : path
        That the names of the images start from.
    reconstruction : Reconstruction
        Poses and cameras of the images, and their points; any camera with a wide view.
    output : path
        Gets ``images/``, ``sparse/0`` (a COLMAP model), ``transforms.json`` (nerfstudio) and,
        where there is a mask, ``masks/NAME.jpg.png`` for each ``images/NAME.jpg``.
    options : CubemapOptions, optional
    masks : mapping of str to path, optional
        Mask by the name of the image; white = use.
    mask_nadir_deg : float
        Masks this angle around straight down of the panorama as well.
    progress : Progress
        Told after each panorama.

    Returns
    -------
    Cubemap

    Raises
    ------
    FileNotFoundError
        If an image or a mask is not there.
    ValueError
        If an image has another size than its camera, ``output`` lies in ``folder`` or holds a
        cubemap with other options, or there is no image.

    Notes
    -----
    A panorama is not cut again while its faces are newer than itself and its mask.
    """
    options = options or CubemapOptions()
    folder, output = Path(folder), Path(output)
    cube = cubemap_reconstruction(reconstruction, options)
    if not cube.images:
        raise ValueError("there is no posed image to cut into faces")
    cutter = _Cutter(folder, output, options, dict(masks or {}), mask_nadir_deg)
    names = face_image_names([image.name for image in reconstruction.images], options)
    cutter.prepare(reconstruction, names)
    kept = done = 0
    progress(_STAGE, 0, len(reconstruction.images))
    with ThreadPoolExecutor(min(8, os.cpu_count() or 1)) as pool:
        for camera, panoramas in _by_camera(reconstruction):
            samplers: dict[FaceName, FaceSampler] = {}
            for panorama in panoramas:
                wanted = {face: names[panorama, face] for face in visible_faces(camera, options)}
                if cutter.is_cut(panorama, wanted.values()):
                    kept += 1
                else:
                    samplers = samplers or _samplers(camera, options)
                    cutter.cut(panorama, camera, samplers, wanted, pool)
                done += 1
                progress(_STAGE, done, len(reconstruction.images))
    write_colmap_model(output / "sparse" / "0", cube)
    write_nerfstudio(output / "transforms.json", cube, images="images")
    return Cubemap(cube, done - kept, kept)


def _by_camera(reconstruction: Reconstruction) -> list[tuple[Camera, list[str]]]:
    """Images of each camera: the maps of one camera at a time are kept in memory."""
    groups: dict[Camera, list[str]] = {}
    for image in reconstruction.images:
        groups.setdefault(reconstruction.cameras[str(image.camera)], []).append(image.name)
    return list(groups.items())


def _samplers(camera: Camera, options: CubemapOptions) -> dict[FaceName, FaceSampler]:
    pinhole = face_camera(camera, options)
    return {face: FaceSampler(camera, pinhole, face) for face in visible_faces(camera, options)}


@dataclass(frozen=True)
class _Cutter:
    """Reads panoramas and writes their faces."""

    folder: Path
    output: Path
    options: CubemapOptions
    masks: dict[str, Path | None]
    mask_nadir_deg: float

    def prepare(
        self, reconstruction: Reconstruction, names: Mapping[tuple[str, FaceName], str]
    ) -> None:
        """Make the output folder, or check it and remove faces that have another camera or mask."""
        if self.output.resolve() == self.folder.resolve():
            raise ValueError(f"the cubemap cannot be written into the images' folder {self.folder}")
        self.output.mkdir(parents=True, exist_ok=True)
        record = {
            "options": {**dataclasses.asdict(self.options), "mask_nadir_deg": self.mask_nadir_deg},
            "made_from": {
                image.name: f"{reconstruction.cameras[str(image.camera)]}, "
                f"mask {self.masks.get(image.name)}"
                for image in reconstruction.images
            },
        }
        record = json.loads(json.dumps(record))  # tuples become lists, as in the file
        path = self.output / RECORD_FILE
        before = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        if before and before["options"] != record["options"]:
            raise ValueError(
                f"{self.output} holds a cubemap with other options; delete it or name another"
            )
        if not before and any(self.output.iterdir()):
            raise ValueError(f"{self.output} holds other files; name a new or empty folder")
        for (panorama, _), face in names.items():
            if before and before["made_from"].get(panorama) != record["made_from"][panorama]:
                (self.output / "images" / face).unlink(missing_ok=True)
                self._mask_file(face).unlink(missing_ok=True)
        write_file(path, json.dumps(record, indent=1, ensure_ascii=False).encode())

    def is_cut(self, panorama: str, faces: Iterable[str]) -> bool:
        """Whether the faces of a panorama are there and newer than what they are made from."""
        mask = self.masks.get(panorama)
        source = self.folder / panorama
        if not source.exists() or (mask is not None and not mask.exists()):
            return False  # cut() says so
        newest = max(path.stat().st_mtime_ns for path in (source, mask) if path is not None)
        needs_mask = mask is not None or self.mask_nadir_deg > 0
        files = [self.output / "images" / face for face in faces]
        if needs_mask:
            files += [self._mask_file(face) for face in faces]
        return all(path.exists() and path.stat().st_mtime_ns >= newest for path in files)

    def cut(
        self,
        panorama: str,
        camera: Camera,
        samplers: Mapping[FaceName, FaceSampler],
        faces: Mapping[FaceName, str],
        pool: ThreadPoolExecutor,
    ) -> None:
        """Write the faces of one panorama, and their masks where something is masked."""
        image = read_image(self.folder / panorama, name="image")
        if image.shape[:2] != (camera.height, camera.width):
            raise ValueError(
                f"image {panorama} is {image.shape[1]}x{image.shape[0]} but its camera is "
                f"{camera.width}x{camera.height}"
            )
        bgr = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2BGR), dtype=np.uint8)
        mask = self._mask(panorama, camera)

        def write(face: FaceName) -> None:
            sampler = samplers[face]
            if mask is not None or not sampler.visible.all():
                white = sampler.mask(mask).astype(np.uint8) * np.uint8(255)
                _write_picture(self._mask_file(faces[face]), white, [])
            quality = [cv2.IMWRITE_JPEG_QUALITY, self.options.jpeg_quality]
            _write_picture(self.output / "images" / faces[face], sampler.picture(bgr), quality)

        list(pool.map(write, faces))

    def _mask(self, panorama: str, camera: Camera) -> NDArray[np.bool_] | None:
        file = self.masks.get(panorama)
        shape = (camera.height, camera.width)
        mask = None if file is None else read_mask(file, shape, name=f"mask of {panorama}")
        if self.mask_nadir_deg > 0:
            above = nadir_mask(camera, self.mask_nadir_deg)
            mask = above if mask is None else mask & above
        return mask

    def _mask_file(self, face: str) -> Path:
        return self.output / "masks" / f"{face}.png"


def _write_picture(path: Path, picture: NDArray[np.uint8], parameters: list[int]) -> None:
    """Write a picture; OpenCV's own writer fails on non-ASCII paths."""
    path.parent.mkdir(parents=True, exist_ok=True)
    encoded = cv2.imencode(path.suffix, picture, parameters if path.suffix == ".jpg" else [])[1]
    write_file(path, encoded.tobytes())
