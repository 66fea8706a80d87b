# SPDX-License-Identifier: BSD-3-Clause
"""Rendered homes that verdicts are measured on, and that evidence is fitted to."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from epi360_scenes.photographs import photograph_tour
from epi360_scenes.tours import Tour, render_tour


@dataclass(frozen=True)
class OneTour:
    """A rendered home, what it is called, and its number; the camera, if it shows no panoramas."""

    name: str
    kind: str
    home: int
    tour: Tour
    camera: Path | None = None


def rendered_homes(
    folder: Path, seed: int, num_homes: int, width: int, *, photographed: bool = False
) -> Iterator[OneTour]:
    """Homes of this seed and of those after it, the level ones first; from the folder if there."""
    for is_level, home in itertools.product((True, False), range(num_homes)):
        kind = "level" if is_level else "tilted"
        name = f"{kind}_{home}_{width}"
        tour = render_tour(
            folder / name,
            seed + home,
            is_level=is_level,
            width=width,
            progress=lambda picture, of=name: print(f"{of}: {picture}", flush=True),
        )
        if photographed:
            name = f"photographed_{name}"
            tour = photograph_tour(tour, folder / name, seed + home)
        yield OneTour(name, kind, home, tour)
