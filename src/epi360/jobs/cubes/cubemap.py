# SPDX-License-Identifier: BSD-3-Clause
"""Posed panoramas to posed pinhole images: a folder for tools that know no other camera."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular, Pinhole
from epi360.features.image_headers import read_image_header
from epi360.features.images import nadir_mask, read_image, read_mask, read_transparent_image
from epi360.features.picture_writing import encode_picture
from epi360.features.sphere_pictures import lit_part
from epi360.interop.colmap_model import write_colmap_model
from epi360.interop.nerfstudio import write_nerfstudio
from epi360.interop.reconstruction import Reconstruction
from epi360.interop.upright_world import made_upright
from epi360.jobs.cubes.cube_faces import (
    CubemapOptions,
    FaceName,
    cubemap_reconstruction,
    face_camera,
    face_image_names,
    visible_faces,
)
from epi360.jobs.cubes.face_sampler import FaceSampler
from epi360.jobs.threads import num_cores, on_threads
from epi360.poses import Pose, vector_from_rotation
from epi360.progress import Progress, no_progress
from epi360.runs.file_digests import FileDigests
from epi360.runs.inside import inside
from epi360.runs.made_from import first_difference, read_record, write_record
from epi360.runs.whole_files import whole_file

RECORD_FILE, DIGESTS_FILE = "cubemap.json", "digests.json"
_STAGE = "cutting cube faces"
_MOST_LOOKED_AT = 8  # pictures of a lens that say where it ends
# Of the radius from which on nothing is lit, so much more may a circle be off its centre; and of
# what is lit, the share beyond that.
_WIDER, _STRAY = 1.1, 0.02
_FaceMask = tuple[NDArray[np.bool_], bytes]  # white = use, and the content of its file


@dataclass(frozen=True, eq=False)
class Cubemap:
    """The faces as posed images, with the points; how many panoramas were cut and how many kept.

    ``upright_from_world`` says how their world was turned from the given one: the identity if that
    was kept.
    """

    reconstruction: Reconstruction
    num_written: int
    num_kept: int
    upright_from_world: Pose

    @property
    def turned_deg(self) -> float:
        """Angle by which the world was turned."""
        return math.degrees(np.linalg.norm(vector_from_rotation(self.upright_from_world.rotation)))


def export_cubemap(
    folder: str | os.PathLike[str],
    reconstruction: Reconstruction,
    output: str | os.PathLike[str],
    options: CubemapOptions | None = None,
    *,
    masks: Mapping[str, Path | None] | None = None,
    mask_nadir_deg: float = 0.0,
    keep_world: bool = False,
    progress: Progress = no_progress,
) -> Cubemap:
    """Write posed panoramas as posed pinhole images, for tools that know no other camera.

    The names of the images start from ``folder``. ``output`` gets ``images/``, ``sparse/0`` (a
    COLMAP model in which the faces of a panorama are a frame of a rig) and ``transforms.json``
    (nerfstudio). Both are in the world of ``reconstruction``, turned so that the mean of its
    cameras' y axes is down: y in COLMAP's model, -z in nerfstudio's file. With ``keep_world``, or
    if the cameras do not agree on a vertical, the model keeps the world. ``cubemap.json`` says how
    it was turned (``upright_from_world``). Where something is masked or transparent, or a
    camera does not see all around, every face has a mask, which ``transforms.json`` names: for
    ``images/NAME.jpg`` it is ``masks/NAME.jpg.png``, COLMAP's name, and the same again as
    ``masks/NAME.png``, where nerfstudio's reader of COLMAP models looks. ``masks`` are those of the
    images by name, white = use; ``mask_nadir_deg`` around straight down is masked as well. A
    panorama is not cut again while its content, its camera and its mask are the same.

    Raises
    ------
    FileNotFoundError
        If an image or a mask is not there.
    ValueError
        If ``mask_nadir_deg`` is not in [0, 180), an image has another size than its camera,
        ``output`` is ``folder`` or holds a cubemap with other options, there is no image, or the
        name of one leads out of ``output``.
    """
    options = options or CubemapOptions()
    if not 0 <= mask_nadir_deg < 180:
        raise ValueError(f"mask_nadir_deg must be in [0, 180), got {mask_nadir_deg}")
    folder, output = Path(folder), Path(output)
    turn = Pose(np.eye(3), np.zeros(3))
    if not keep_world:
        reconstruction, turn = made_upright(reconstruction)
    cube = cubemap_reconstruction(reconstruction, options)
    if not cube.images:
        raise ValueError("there is no posed image to cut into faces")
    masked = mask_nadir_deg > 0 or any((masks or {}).values()) or not _see_all(reconstruction)
    masked = masked or any(_is_transparent(folder / image.name) for image in reconstruction.images)
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
                if cutter.is_cut(wanted.values()):
                    kept += 1
                else:
                    if not samplers:
                        samplers = _samplers(camera, options)
                        cutter.lit = _lit_part(folder, panoramas, camera)
                    cutter.cut(panorama, camera, samplers, wanted, pool)
                done += 1
                progress(_STAGE, done, len(reconstruction.images))
    write_colmap_model(output / "sparse" / "0", cube)
    mask_of = {face: f"masks/{face}.png" for face in names.values()} if cutter.masked else None
    write_nerfstudio(output / "transforms.json", cube, images="images", masks=mask_of)
    cutter.finish(turn)
    return Cubemap(cube, done - kept, kept, turn)


def check_cubemap_folder(
    output: Path,
    options: CubemapOptions,
    mask_nadir_deg: float,
    *,
    remedy: str = "delete it or name another",
) -> dict[str, Any]:
    """Record of the cubemap in a folder; ValueError where none could be written there.

    Asked before hours of work: the folder may hold other files, or a cubemap with other options,
    and then the message says the ``remedy``.
    """
    if not output.is_dir():
        return {}
    before = _record_before(output / RECORD_FILE)
    # Records of earlier versions lack newer options.
    made_with = {**_options(CubemapOptions(), 0.0), **before.get("options", {})}
    different = first_difference(made_with, _options(options, mask_nadir_deg))
    if before and different:
        option = f"--{different.name.replace('_', '-')}"
        raise ValueError(f"{output} holds a cubemap with other options ({option}); {remedy}")
    if not before and any(output.iterdir()):
        raise ValueError(f"{output} holds other files; move them, or name a new or empty folder")
    return before


def _options(options: CubemapOptions, mask_nadir_deg: float) -> dict[str, Any]:
    return {**dataclasses.asdict(options), "mask_nadir_deg": mask_nadir_deg}


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


def _lit_part(folder: Path, names: Sequence[str], camera: Camera) -> NDArray[np.bool_] | None:
    """What a fisheye lens lights of its pictures, by some of them; None where nothing says so.

    Few calibration files say where the lens ends. What is dark in one picture is lit in another,
    and what no lens lights begins on a circle, as no dark sky does.
    """
    if isinstance(camera, Equirectangular | Pinhole):
        return None
    lit = np.zeros((camera.height, camera.width), dtype=bool)
    step = max(1, len(names) // _MOST_LOOKED_AT)
    for name in names[::step][:_MOST_LOOKED_AT]:
        grey = cv2.cvtColor(read_image(folder / name), cv2.COLOR_RGB2GRAY)
        if grey.shape == lit.shape:  # otherwise the work on it says so
            lit |= lit_part(np.asarray(grey, np.uint8))
    if lit.all() or not lit.any():
        return None
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    radii = np.hypot(u - getattr(camera, "cx", np.nan), v - getattr(camera, "cy", np.nan))
    begins = float(np.percentile(radii[~lit], 2))
    if not np.mean(radii[lit] > _WIDER * begins) < _STRAY:
        return None
    inner = cv2.erode(lit.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1)
    return np.asarray(inner > 0)


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
    lit: NDArray[np.bool_] | None = None  # of the camera whose pictures are cut, see `_lit_part`
    _face_masks: tuple[Camera, Path | None, dict[FaceName, _FaceMask]] | None = None
    _record: dict[str, Any] = field(default_factory=dict)
    _left: set[str] = field(default_factory=set)  # faces of panoramas that left the model

    def prepare(
        self, reconstruction: Reconstruction, names: Mapping[tuple[str, FaceName], str]
    ) -> None:
        """Make the output folder, or check it and remove faces that have another camera or mask.

        Nothing is written or removed before all names have been looked at, and the images and masks
        of all faces that have to be cut.
        """
        if self.output.resolve() == self.folder.resolve():
            raise ValueError(f"the cubemap cannot be written into the images' folder {self.folder}")
        digests = FileDigests(self.output / DIGESTS_FILE)
        record = self._record = self._made_from(reconstruction, digests)
        before = check_cubemap_folder(self.output, self.options, self.mask_nadir_deg)
        made_before = before.get("made_from", {})
        names_before = face_image_names(list(made_before), self.options)
        for face in dict.fromkeys((*names.values(), *names_before.values())):
            self._face_file(face)
            self._mask_files(face)
        changed = {
            (panorama, face)
            for (panorama, _), face in names.items()
            if made_before.get(panorama) != record["made_from"][panorama]
        }
        of_changed = {panorama for panorama, _ in changed}
        for image in reconstruction.images:
            if image.name in of_changed:
                self._check_sizes(image.name, reconstruction.cameras[str(image.camera)])
        self.output.mkdir(parents=True, exist_ok=True)
        self._remove(face for _, face in changed)
        # Panoramas that left the model stay in the record until their faces are removed.
        self._left = set(names_before.values()) - set(names.values())
        both = {**record, "made_from": {**made_before, **record["made_from"]}}
        write_record(self.output / RECORD_FILE, both)
        digests.save()

    def finish(self, upright_from_world: Pose) -> None:
        """Remove the faces of panoramas that left the model, and note the world of the new ones."""
        self._remove(self._left)
        world = {"upright_from_world": upright_from_world.matrix()[:3].tolist()}
        write_record(self.output / RECORD_FILE, {**self._record, **world})

    def _made_from(self, reconstruction: Reconstruction, digests: FileDigests) -> dict[str, Any]:
        """The record of this cubemap: its options, and what the faces of each panorama show."""

        def content_of(file: Path) -> str:
            # Of a file that is not there, the work on it says so.
            return digests.digest_of(file).hex()[:32] if file.is_file() else "none"

        masks = [self.masks.get(image.name) for image in reconstruction.images if self.masked]
        files = {
            *(self.folder / image.name for image in reconstruction.images),
            *filter(None, masks),
        }
        contents = dict(on_threads(content_of, sorted(files), num_cores()))
        made_from = {}
        for image in reconstruction.images:
            camera = reconstruction.cameras[str(image.camera)]
            mask = self.masks.get(image.name)
            masked = ("none" if mask is None else contents[mask]) if self.masked else "not written"
            made_from[image.name] = (
                f"{camera}, content {contents[self.folder / image.name]}, mask {masked}"
            )
        return {"options": _options(self.options, self.mask_nadir_deg), "made_from": made_from}

    def _remove(self, faces: Iterable[str]) -> None:
        for face in faces:
            for file in (self._face_file(face), *self._mask_files(face)):
                file.unlink(missing_ok=True)

    def _check_sizes(self, panorama: str, camera: Camera) -> None:
        """Raise where an image or its mask is missing or, by its header, has another size."""
        _check_size(f"image {panorama}", self.folder / panorama, camera)
        mask = self.masks.get(panorama)
        if mask is not None:
            _check_size(f"mask of {panorama}", mask, camera)

    def is_cut(self, faces: Iterable[str]) -> bool:
        """Whether these faces are there; `prepare` has removed those of another panorama."""
        files = [self._face_file(face) for face in faces]
        if self.masked:
            files += [file for face in faces for file in self._mask_files(face)]
        return all(path.exists() for path in files)

    def cut(
        self,
        panorama: str,
        camera: Camera,
        samplers: Mapping[FaceName, FaceSampler],
        faces: Mapping[FaceName, str],
        pool: ThreadPoolExecutor,
    ) -> None:
        """Write the faces of one panorama, and their masks where something is masked."""
        image, hidden = read_transparent_image(self.folder / panorama)
        if image.shape[:2] != (camera.height, camera.width):
            raise ValueError(
                f"image {panorama} is {image.shape[1]}x{image.shape[0]} but its camera is "
                f"{camera.width}x{camera.height}"
            )
        masks = self._masks_of_faces(panorama, camera, samplers, hidden) if self.masked else {}

        def write(face: FaceName) -> None:
            picture = samplers[face].picture(image)
            if face in masks:
                mask, png = masks[face]
                for file in self._mask_files(faces[face]):
                    _write(file, png)
                if self.options.alpha:
                    picture = _with_alpha(picture, mask)
            file = self._face_file(faces[face])
            quality = self.options.jpeg_quality
            _write(file, encode_picture(picture, file.suffix, jpeg_quality=quality))

        list(pool.map(write, faces))

    def _masks_of_faces(
        self,
        panorama: str,
        camera: Camera,
        samplers: Mapping[FaceName, FaceSampler],
        hidden: NDArray[np.bool_] | None,
    ) -> dict[FaceName, _FaceMask]:
        """Masks and their files; one mask of all panoramas is cut once: 8 s if 11008 wide."""
        file = self.masks.get(panorama)
        if hidden is not None:
            mask = self._mask(panorama, camera)
            return _cut_masks(samplers, ~hidden if mask is None else mask & ~hidden)
        if self._face_masks is None or self._face_masks[:2] != (camera, file):
            cut = _cut_masks(samplers, self._mask(panorama, camera))
            self._face_masks = camera, file, cut
        return self._face_masks[2]

    def _mask(self, panorama: str, camera: Camera) -> NDArray[np.bool_] | None:
        file = self.masks.get(panorama)
        shape = (camera.height, camera.width)
        mask = None if file is None else read_mask(file, shape, name=f"mask of {panorama}")
        if self.mask_nadir_deg > 0:
            above = _nadir_mask(camera, self.mask_nadir_deg)
            mask = above if mask is None else mask & above
        if self.lit is not None:
            mask = self.lit if mask is None else mask & self.lit
        return mask

    def _face_file(self, face: str) -> Path:
        return inside(self.output / "images", face)

    def _mask_files(self, face: str) -> tuple[Path, Path]:
        """Where COLMAP looks for the mask of a face, and nerfstudio's reader of COLMAP models."""
        names = f"{face}.png", str(PurePosixPath(face).with_suffix(".png"))
        first, second = (inside(self.output / "masks", name) for name in names)
        return first, second


def _is_transparent(path: Path) -> bool:
    """Whether some pixels are transparent; a picture whose header leaves that open is decoded."""
    try:
        if not read_image_header(path).may_have_alpha:
            return False
        return read_transparent_image(path)[1] is not None
    except (OSError, ValueError):  # who cuts it says so
        return False


def _cut_masks(
    samplers: Mapping[FaceName, FaceSampler], mask: NDArray[np.bool_] | None
) -> dict[FaceName, _FaceMask]:
    cut = {face: sampler.mask(mask) for face, sampler in samplers.items()}
    return {face: (cut[face], encode_picture(cut[face], ".png")) for face in cut}


def _check_size(what: str, path: Path, camera: Camera) -> None:
    if not path.exists():
        raise FileNotFoundError(f"{what.split()[0]} {path} does not exist")
    try:
        size = read_image_header(path).size
    except OSError as error:
        raise ValueError(f"{what} cannot be read: {error.strerror}") from None
    if size is not None and size != (camera.width, camera.height):
        raise ValueError(
            f"{what} is {size[0]}x{size[1]} but its camera is {camera.width}x{camera.height}"
        )


_nadir_mask = lru_cache(maxsize=1)(nadir_mask)  # takes 5 s for a panorama 11008 wide


def _record_before(path: Path) -> dict[str, Any]:
    """What an earlier run noted; empty where there was none."""
    remedy = f"delete {path.parent}"
    record = read_record(path, remedy=remedy)
    if record is None:
        return {}
    if not all(isinstance(record.get(name), dict) for name in ("options", "made_from")):
        raise ValueError(f"{path} is damaged; {remedy}")
    return record


def _with_alpha(picture: NDArray[np.uint8], mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """RGBA of an RGB picture, transparent where the mask is black."""
    return np.dstack([picture, np.where(mask, np.uint8(255), np.uint8(0))])


def _write(path: Path, data: bytes) -> None:
    with whole_file(path, make_folder=True) as file:
        file.write(data)
