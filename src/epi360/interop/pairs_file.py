# SPDX-License-Identifier: BSD-3-Clause
"""Pairs files: which images to match, one pair a line, as hloc and COLMAP take them."""

import re
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

from epi360.runs.input_files import read_text
from epi360.runs.whole_files import PathLike, write_file

# A name may hold any character but these two; file names do hold other Unicode white space.
BLANK = re.compile(r"[ \t]+")
PLAIN_NAME = re.compile(r'[^"# \t][^ \t]*')
NAME = rf'"(.+?)"|({PLAIN_NAME.pattern})'
LONGEST_LINE = 2**13  # characters, two of the longest paths; a longer line is no pair
TWO_NAMES = re.compile(rf"(?:{NAME})[ \t]+(?:{NAME})")


def read_pairs_file(
    path: PathLike, *, names: Collection[str] | None = None, both_orders: bool = False
) -> list[tuple[str, str]]:
    """Return the pairs of image names in a file, in its order.

    Parameters
    ----------
    path : path-like
        UTF-8 text. Each line holds two names with blanks between them. If a name has blanks in it,
        it stands in double quotes, or a tab separates the two names. Empty lines and lines that
        begin with # are skipped.
    names : collection of str, optional
        Names of the images. A line that can be split in only one way into two of these names needs
        neither quotes nor a tab. Other names are accepted too.
    both_orders : bool, optional
        Whether a pair may be listed in both orders. It is then returned once, in the first order.
        hloc writes such files, because its retrieval finds most pairs from either image.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ValueError
        If the file is no text, or a line does not hold two names, holds one name twice or repeats a
        pair. The message has the number of the line.
    """
    path = Path(path)
    image_names = None if names is None else frozenset(names)
    pairs: dict[tuple[str, str], int] = {}  # with the line
    for number, line in _lines(path):
        try:
            pair = _two_names(line, image_names)
            if both_orders and pair[::-1] in pairs and pair not in pairs:
                continue
            _check_is_new(pair, pairs)
        except ValueError as error:
            raise ValueError(f"pairs file {path}, line {number}: {error}") from None
        pairs[pair] = number
    if not pairs:
        raise ValueError(f"pairs file {path} has no pairs")
    return list(pairs)


def write_pairs_file(path: PathLike, pairs: Iterable[tuple[str, str]]) -> None:
    """Write pairs of image names, one pair a line; the file appears whole or not at all.

    A file that exists is replaced. Names with blanks are put into double quotes.

    Raises
    ------
    ValueError
        If a name is empty, has a line break, or has both blanks and double quotes.
    OSError
        If the file cannot be written.
    """
    lines = [f"{_written(image1)} {_written(image2)}\n" for image1, image2 in pairs]
    write_file(path, "".join(lines).encode())


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Lines that are neither empty nor comments, with their numbers from 1."""
    try:
        text = read_text(path)
    except FileNotFoundError:
        raise FileNotFoundError(f"pairs file {path} does not exist") from None
    except UnicodeDecodeError:
        raise ValueError(f"pairs file {path} must be UTF-8 text") from None
    except OSError:
        raise ValueError(f"pairs file {path} is a folder or may not be read") from None
    for number, line in enumerate(text.split("\n"), start=1):
        stripped = line.strip(" \t")
        if stripped and not stripped.startswith("#"):
            yield number, stripped


def _two_names(line: str, image_names: frozenset[str] | None) -> tuple[str, str]:
    if len(line) > LONGEST_LINE:
        raise ValueError(f"expected two image names, got {len(line)} characters")
    marked = TWO_NAMES.fullmatch(line)
    if marked:
        return marked[1] or marked[2], marked[3] or marked[4]
    by_tab = [part.strip(" ") for part in line.split("\t")]
    if len(by_tab) == 2 and all(by_tab):
        return by_tab[0], by_tab[1]
    splits = [(line[: blank.start()], line[blank.end() :]) for blank in BLANK.finditer(line)]
    if image_names is not None:
        splits = [split for split in splits if image_names.issuperset(split)]
    if len(splits) == 1:
        return splits[0]
    raise ValueError(
        f"expected two image names, got {line!r}; put names with blanks into double quotes"
    )


def _check_is_new(pair: tuple[str, str], pairs: dict[tuple[str, str], int]) -> None:
    if pair[0] == pair[1]:
        raise ValueError(f"a pair needs two images, got {pair[0]} twice")
    for other in (pair, pair[::-1]):
        if other in pairs:
            order = "" if other == pair else " in the other order"
            raise ValueError(
                f"the pair {' '.join(pair)} is there already{order}, in line {pairs[other]}"
            )


def _written(name: str) -> str:
    is_plain = PLAIN_NAME.fullmatch(name) is not None
    if not name or "\n" in name or "\r" in name or (not is_plain and '"' in name):
        raise ValueError(f"image name {name!r} cannot stand in a pairs file; rename the image")
    return name if is_plain else f'"{name}"'
