# SPDX-License-Identifier: BSD-3-Clause
"""Posed panoramas to posed pinhole images: a folder for tools that know no other camera."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular
from epi360.features.images import nadir_mask, read_image, read_mask
from epi360.features.picture_writing import encode_picture
from epi360.files import write_file
from epi360.interop.colmap_model import write_colmap_model
from epi360.interop.nerfstudio import write_nerfstudio
from epi360.interop.reconstruction import Reconstruction
from epi360.jobs.cube_faces import (
    CubemapOptions,
    FaceName,
    cubemap_reconstruction,
    face_camera,
    face_image_names,
    visible_faces,
)
from epi360.jobs.face_sampler import FaceSampler
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
        Gets ``images/``, ``sparse/0`` (a COLMAP model) and ``transforms.json`` (nerfstudio). Where
        something is masked or a camera does not see all around, there is a mask for every face,
        ``masks/NAME.jpg.png`` for ``images/NAME.jpg``, and ``transforms.json`` names them.
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
        If ``mask_nadir_deg`` is not in [0, 180), an image has another size than its camera,
        ``output`` is ``folder`` or holds a cubemap with other options, or there is no image.

    Notes
    -----
    A panorama is not cut again while its faces are newer than itself and its mask.
    """
    options = options or CubemapOptions()
    if not 0 <= mask_nadir_deg < 180:
        raise ValueError(f"mask_nadir_deg must be in [0, 180), got {mask_nadir_deg}")
    folder, output = Path(folder), Path(output)
    cube = cubemap_reconstruction(reconstruction, options)
    if not cube.images:
        raise ValueError("there is no posed image to cut into faces")
    masked = mask_nadir_deg > 0 or any((masks or {}).values()) or not _see_all(reconstruction)
    cutter = _Cutter(folder, output, options, dict(masks or {}), mask_nadir_deg, masked)
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
    mask_of = {face: f"masks/{face}.png" for face in names.values()} if cutter.masked else None
    write_nerfstudio(output / "transforms.json", cube, images="images", masks=mask_of)
    return Cubemap(cube, done - kept, kept)


def check_cubemap_folder(
    output: Path, options: CubemapOptions, mask_nadir_deg: float
) -> dict[str, Any]:
    """Raise where a cubemap could not be written into a folder, before hours of work.

    Parameters
    ----------
    output, options, mask_nadir_deg
        As `export_cubemap` takes them.

    Returns
    -------
    record : dict
        Of the cubemap that is there; empty where there is none.

    Raises
    ------
    ValueError
        If the folder holds other files, or a cubemap with other options.
    """
    if not output.is_dir():
        return {}
    before = _record_before(output / RECORD_FILE)
    if before and before["options"] != _options_record(options, mask_nadir_deg):
        raise ValueError(f"{output} holds a cubemap with other options; delete it or name another")
    if not before and any(output.iterdir()):
        raise ValueError(f"{output} holds other files; name a new or empty folder")
    return before


def _options_record(options: CubemapOptions, mask_nadir_deg: float) -> dict[str, Any]:
    """Options as they come back from the record: lists for tuples."""
    values = {**dataclasses.asdict(options), "mask_nadir_deg": mask_nadir_deg}
    return dict(json.loads(json.dumps(values)))


def _by_camera(reconstruction: Reconstruction) -> list[tuple[Camera, list[str]]]:
    """Images of each camera: the maps of one camera at a time are kept in memory."""
    groups: dict[Camera, list[str]] = {}
    for image in reconstruction.images:
        groups.setdefault(reconstruction.cameras[str(image.camera)], []).append(image.name)
    return list(groups.items())


def _see_all(reconstruction: Reconstruction) -> bool:
    """Whether every camera sees all around."""
    used = {str(image.camera) for image in reconstruction.images}
    cameras = [reconstruction.cameras[name] for name in used]
    return all(camera == Equirectangular(camera.width, camera.height) for camera in cameras)


def _samplers(camera: Camera, options: CubemapOptions) -> dict[FaceName, FaceSampler]:
    pinhole = face_camera(camera, options)
    return {face: FaceSampler(camera, pinhole, face) for face in visible_faces(camera, options)}


@dataclass
class _Cutter:
    """Reads panoramas and writes their faces."""

    folder: Path
    output: Path
    options: CubemapOptions
    masks: dict[str, Path | None]
    mask_nadir_deg: float
    masked: bool  # every face gets a mask: nerfstudio takes those of all images or of none
    _face_masks: tuple[Camera, Path | None, dict[FaceName, bytes]] | None = None

    def prepare(
        self, reconstruction: Reconstruction, names: Mapping[tuple[str, FaceName], str]
    ) -> None:
        """Make the output folder, or check it and remove faces that have another camera or mask."""
        if self.output.resolve() == self.folder.resolve():
            raise ValueError(f"the cubemap cannot be written into the images' folder {self.folder}")
        self.output.mkdir(parents=True, exist_ok=True)
        record = {
            "options": _options_record(self.options, self.mask_nadir_deg),
            "made_from": {
                image.name: f"{reconstruction.cameras[str(image.camera)]}, "
                f"{self._mask_words(image.name)}"
                for image in reconstruction.images
            },
        }
        record = json.loads(json.dumps(record))  # tuples become lists, as in the file
        path = self.output / RECORD_FILE
        before = check_cubemap_folder(self.output, self.options, self.mask_nadir_deg)
        for face in self._stale(before.get("made_from", {}), record["made_from"], names):
            (self.output / "images" / face).unlink(missing_ok=True)
            self._mask_file(face).unlink(missing_ok=True)
        write_file(path, json.dumps(record, indent=1, ensure_ascii=False).encode())

    def _stale(
        self,
        before: Mapping[str, str],
        now: Mapping[str, str],
        names: Mapping[tuple[str, FaceName], str],
    ) -> set[str]:
        """Faces made from something else, and those of panoramas that left the model."""
        names_before = face_image_names(list(before), self.options)
        changed = {
            face for (panorama, _), face in names.items() if before.get(panorama) != now[panorama]
        }
        return changed | (set(names_before.values()) - set(names.values()))

    def is_cut(self, panorama: str, faces: Iterable[str]) -> bool:
        """Whether the faces of a panorama are there and newer than what they are made from."""
        mask = self.masks.get(panorama)
        source = self.folder / panorama
        if not source.exists() or (mask is not None and not mask.exists()):
            return False  # cut() says so
        newest = max(path.stat().st_mtime_ns for path in (source, mask) if path is not None)
        files = [self.output / "images" / face for face in faces]
        if self.masked:
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
        masks = self._masks_of_faces(panorama, camera, samplers) if self.masked else {}

        def write(face: FaceName) -> None:
            if face in masks:
                _write(self._mask_file(faces[face]), masks[face])
            file = self.output / "images" / faces[face]
            picture = samplers[face].picture(image)
            quality = self.options.jpeg_quality
            _write(file, encode_picture(picture, file.suffix, jpeg_quality=quality))

        list(pool.map(write, faces))

    def _masks_of_faces(
        self, panorama: str, camera: Camera, samplers: Mapping[FaceName, FaceSampler]
    ) -> dict[FaceName, bytes]:
        """Encoded masks; one mask for all panoramas is cut once: 8 s of a panorama 11008 wide."""
        file = self.masks.get(panorama)
        if self._face_masks is None or self._face_masks[:2] != (camera, file):
            mask = self._mask(panorama, camera)
            cut = {face: sampler.mask(mask) for face, sampler in samplers.items()}
            pngs = {face: encode_picture(cut[face], ".png") for face in cut}
            self._face_masks = camera, file, pngs
        return self._face_masks[2]

    def _mask(self, panorama: str, camera: Camera) -> NDArray[np.bool_] | None:
        file = self.masks.get(panorama)
        shape = (camera.height, camera.width)
        mask = None if file is None else read_mask(file, shape, name=f"mask of {panorama}")
        if self.mask_nadir_deg > 0:
            above = _nadir_mask(camera, self.mask_nadir_deg)
            mask = above if mask is None else mask & above
        return mask

    def _mask_words(self, panorama: str) -> str:
        return f"mask {self.masks.get(panorama)}" if self.masked else "no masks"

    def _mask_file(self, face: str) -> Path:
        return self.output / "masks" / f"{face}.png"


_nadir_mask = lru_cache(maxsize=1)(nadir_mask)  # 5 s of a panorama 11008 wide


def _record_before(path: Path) -> dict[str, Any]:
    """What an earlier run noted; empty where there was none."""
    if not path.exists():
        return {}
    try:
        record: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        record["options"], record["made_from"].get("")
    except (ValueError, TypeError, KeyError, AttributeError):
        raise ValueError(f"{path} is damaged; delete {path.parent}") from None
    return record


def _write(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_file(path, data)
