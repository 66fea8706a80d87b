# SPDX-License-Identifier: BSD-3-Clause
"""Names and pictures of an OpenSfM project.

OpenSfM calls an image by the name of its file alone, whatever folder that is in (``dataset.py`` of
mapillary/OpenSfM): with a sub-folder in the name of a shot, ``bundle`` does not find its metadata
and ``undistort`` leaves it out. The folders stand in image_list.txt, a path a line.
"""

import shutil
from collections import Counter
from collections.abc import Mapping
from filecmp import cmp
from pathlib import Path, PurePosixPath

from epi360.runs.input_files import read_text
from epi360.runs.inside import inside
from epi360.runs.whole_files import PathLike

IMAGE_LIST, IMAGES = "image_list.txt", "images/"


def paths_of_pictures(names: list[str]) -> dict[str, str]:
    """Paths of images below images/, whose last parts are the names of the shots.

    They are the names, or have "_" for each slash where two images of different folders have one
    name.
    """
    if not loses_folders(names):
        return {name: name for name in names}
    flat = {name: "_".join(PurePosixPath(name).parts) for name in names}
    if loses_folders(list(flat.values())):
        raise ValueError("OpenSfM has no folders in names, and without them two images are equal")
    return flat


def loses_folders(names: list[str]) -> bool:
    """Whether OpenSfM can tell images apart only if their names are made flat."""
    shots = Counter(shot_name(name).casefold() for name in names)
    return max(shots.values(), default=1) > 1


def shot_name(path: str) -> str:
    """Name of the shot of a path."""
    return PurePosixPath(path).name


def find_pictures(folder: PathLike, names: list[str]) -> dict[str, Path]:
    """Return the picture of each image; ``FileNotFoundError`` if one is not there."""
    pictures = {name: inside(Path(folder), name) for name in names}
    for picture in pictures.values():
        if not picture.is_file():
            raise FileNotFoundError(f"image {picture} does not exist")
    return pictures


def missing_links(project: Path, pictures: Mapping[str, Path]) -> dict[Path, Path]:
    """Return the links of ``images/`` that are not there yet, with the picture of each.

    ``pictures`` has them by path below ``images/``. A picture that lies there already stays, and
    ``FileExistsError`` is raised where another one does.
    """
    links = {project / IMAGES / path: picture for path, picture in pictures.items()}
    missing = {link: picture for link, picture in links.items() if not _is_there(link, picture)}
    for link, picture in missing.items():
        if link.exists() and not link.is_symlink():
            raise FileExistsError(
                f"{link} is another picture than {picture}, and is not replaced; remove it, or "
                "write into another folder"
            )
    return missing


def link_picture(link: Path, picture: Path) -> None:
    """Make a link in place of an earlier one, or a copy where the file system has no links."""
    link.parent.mkdir(parents=True, exist_ok=True)
    link.unlink(missing_ok=True)
    try:
        link.symlink_to(picture.resolve())
    except OSError:
        shutil.copyfile(picture, link)


def image_list_of(paths: list[str]) -> bytes:
    """Return the content of image_list.txt; OpenSplat too looks for the pictures there."""
    return "".join(f"{IMAGES}{path}\n" for path in paths).encode()


def names_in_list(project: Path) -> dict[str, str]:
    """Names of images by those of their shots, if the project's image_list.txt has folders."""
    if not (project / IMAGE_LIST).is_file():
        return {}
    lines = read_text(project / IMAGE_LIST).splitlines()
    names = [line.removeprefix(IMAGES) for line in lines if line.startswith(IMAGES)]
    return {} if loses_folders(names) else {shot_name(name): name for name in names}


def _is_there(link: Path, picture: Path) -> bool:
    """Whether the link leads to the picture already, or is a copy of it."""
    if not link.exists():
        return False
    return link.samefile(picture) or (not link.is_symlink() and cmp(link, picture, shallow=False))
