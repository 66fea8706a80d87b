# SPDX-License-Identifier: BSD-3-Clause
"""Make the pictures of the documentation from the package's own room: run it in any folder."""

import tempfile
from pathlib import Path

from PIL import Image

from epi360 import cli

FOLDER = Path(__file__).resolve().parent
WIDTH_PX = 1200  # sharp on a page


def main() -> None:
    """Draw the demo pair as the command does, then shrink the file."""
    with tempfile.TemporaryDirectory() as scratch:
        drawn = Path(scratch) / "pair.png"
        cli.main(["pair", "--demo", "--figure", str(drawn)])
        with Image.open(drawn) as picture:
            size = (WIDTH_PX, round(picture.height * WIDTH_PX / picture.width))
            small = picture.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    # The default palette follows the grey areas; this one keeps the colours of the curves apart.
    palette = small.quantize(method=Image.Quantize.MAXCOVERAGE, kmeans=5)
    small.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG).save(
        FOLDER / "pair.png", optimize=True
    )


if __name__ == "__main__":
    main()
