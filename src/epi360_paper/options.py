# SPDX-License-Identifier: BSD-3-Clause
"""Options of a run of an experiment, and what the run has made."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

ProtocolName = Literal["printed", "authors", "corrected"]


@dataclass(frozen=True)
class ReproduceOptions:
    """Options that all experiments share; an experiment ignores those that it has no use for."""

    # Follow the paper's text, the authors' code, or what is right.
    protocol: ProtocolName = "printed"
    trials: int | None = None  # trials a cell; by default the paper's count
    seed: int = 0  # seed of all random numbers
    jobs: int | None = None  # worker processes, by default one a core
    # Folder of the results; each experiment writes into its own folder in it.
    out: Path = Path("out/reproduce")
    # Tables 1 and 2 on synthetic landmarks instead of tracks in rendered images.
    landmarks: bool = False
    mp3d_vo: Path | None = None  # folder of the data set 360-MP3D-VO, for Table 3
    tum_vi: Path | None = None  # folder of the data set TUM-VI, for Table 3
    image_width: int = 1024  # width of rendered panoramas in pixels

    def __post_init__(self) -> None:
        if self.protocol not in get_args(ProtocolName):
            names = ", ".join(get_args(ProtocolName))
            raise ValueError(f"protocol must be one of {names}, got {self.protocol!r}")
        for name, least in (("trials", 1), ("jobs", 1), ("seed", 0), ("image_width", 64)):
            value = getattr(self, name)
            if value is not None and value < least:
                raise ValueError(f"{name} must be {least} or more, got {value}")
        if self.image_width % 2:
            raise ValueError(f"image_width must be even, got {self.image_width}")

    @property
    def num_workers(self) -> int:
        """Worker processes of the run."""
        return self.jobs or os.cpu_count() or 1

    def num_trials(self, papers_count: int) -> int:
        """Trials a cell: the wanted number, or else the paper's."""
        return self.trials or papers_count

    def folder(self, name: str) -> Path:
        """Folder of an experiment's results; its name ends with a protocol other than "printed"."""
        return self.out / (name if self.protocol == "printed" else f"{name}-{self.protocol}")


@dataclass(frozen=True)
class Outcome:
    """What an experiment has made."""

    name: str  # name of the experiment
    files: tuple[Path, ...]  # files written, the raw trials first
    summary: str = ""  # the table in Markdown, *paper | ours*; empty for a figure without numbers
