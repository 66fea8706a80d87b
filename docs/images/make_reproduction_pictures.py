# SPDX-License-Identifier: BSD-3-Clause
"""Shrink the figures of a run of `epi360 reproduce` for the documentation: give its folder."""

import sys
from pathlib import Path

from PIL import Image

FOLDER = Path(__file__).resolve().parent / "reproduction"
PICTURES, DIAGRAMS = ("fig1", "fig2"), ("fig3", "fig4a", "fig4b", "fig4c")
WIDTH_PX = 1200  # sharp on a page


def main(run: Path) -> None:
    """Write one small PNG for each figure of the run, all of rendered or synthetic scenes."""
    FOLDER.mkdir(exist_ok=True)
    for name in PICTURES + DIAGRAMS:
        with Image.open(run / name / "figure.png") as picture:
            size = (WIDTH_PX, round(picture.height * WIDTH_PX / picture.width))
            small = picture.convert("RGB").resize(size, Image.Resampling.LANCZOS)
        if name in PICTURES:  # rendered rooms are large in full colour
            small = _with_palette(small)
        small.save(FOLDER / f"{name}.png", optimize=True)


def _with_palette(image: Image.Image) -> Image.Image:
    # The default palette follows the grey areas; this one keeps the colours of the dots apart.
    palette = image.quantize(method=Image.Quantize.MAXCOVERAGE, kmeans=5)
    return image.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
