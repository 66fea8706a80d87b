# SPDX-License-Identifier: BSD-3-Clause
"""Make the pictures of the documentation from the package's own rooms: run it in any folder.

``make_pictures.py pair fig3`` makes two of them; without names it makes all.
"""

import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

from map_picture import draw_map
from PIL import Image
from verdict_pictures import PAIRS

from epi360 import cli

FOLDER = Path(__file__).resolve().parent
WIDTH_PX = 1100  # sharp on a page
FIGURES = ("fig1", "fig2", "fig3", "fig4a", "fig4b", "fig4c")
NUM_TRIALS = 1000  # scenes a cell; the tables of the page come from the paper's 15,000


def draw_pair(drawn: Path) -> None:
    """Draw the demo pair as the command does."""
    cli.main(["pair", "--demo", "--figure", str(drawn)])


def draw_figure(name: str, drawn: Path) -> None:
    """Draw a figure of the paper from a small run."""
    folder = drawn.parent / "reproduced"
    cli.main(["reproduce", name, "--trials", str(NUM_TRIALS), "--out", str(folder)])
    (folder / name / "figure.png").rename(drawn)


def pictures() -> dict[str, Callable[[Path], None]]:
    """How each picture is drawn, by its file name without the extension."""
    return {
        "pair": draw_pair,
        "map": draw_map,
        **{f"reproduction/{name}": partial(draw_figure, name) for name in FIGURES},
        **{f"verdicts/{name}": partial(draw_verdict, name) for name in PAIRS},
    }


def draw_verdict(name: str, drawn: Path) -> None:
    """Draw one of the pairs that show what a verdict means."""
    PAIRS[name]().draw(drawn)


def make(name: str) -> None:
    """Draw a picture and write it, made smaller, into this folder."""
    with tempfile.TemporaryDirectory() as scratch:
        drawn = Path(scratch) / "drawn.png"
        pictures()[name](drawn)
        with Image.open(drawn) as picture:
            size = (WIDTH_PX, round(picture.height * WIDTH_PX / picture.width))
            small = picture.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    target = FOLDER / f"{name}.webp"
    target.parent.mkdir(exist_ok=True)
    small.save(target, quality=75, method=6)


def main() -> None:
    """Make the pictures whose names are given, by default all."""
    names = [full for full in pictures() if not sys.argv[1:] or Path(full).name in sys.argv[1:]]
    if not names:
        sys.exit(f"no such picture; there are {', '.join(Path(name).name for name in pictures())}")
    for name in names:
        make(name)
        print(FOLDER / f"{name}.webp")


if __name__ == "__main__":
    main()
