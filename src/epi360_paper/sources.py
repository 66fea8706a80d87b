# SPDX-License-Identifier: BSD-3-Clause
"""Where the pairs of a trial of Tables 1 to 3 come from: landmarks, or folders of a data set."""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal, Protocol

from epi360_paper.datasets import (
    ImageSequence,
    SkipRule,
    find_mp3d_vo_scenes,
    find_tum_vi_rooms,
    load_mp3d_vo,
    load_tum_vi,
    steady_segments,
)
from epi360_paper.options import ProtocolName
from epi360_paper.protocols import PROTOCOLS, draw_scene
from epi360_paper.tracks import BearingPair, PairRule, cached_pairs, pairs_of_frames, sequence_key
from epi360_paper.trials import Trial

DatasetName = Literal["mp3d_vo", "tum_vi"]

# The setting of section 5.1.
NUM_POINTS, KAPPA, OUTLIER_RATIO = 200, 500.0, 0.2
BLOCKS_PER_SCENE = 20  # of a room of TUM-VI a block has 140 frames, a minute of tracking


class PairSource(Protocol):
    """What gives the pairs of a trial."""

    def pairs(self, trial: Trial) -> list[BearingPair]:
        """Pairs of a trial; there may be none."""


@dataclass(frozen=True)
class LandmarkPairs:
    """Synthetic landmarks: one pair a trial, 200 points with noise and 20 % outliers."""

    protocol: ProtocolName  # how the problems are made

    def pairs(self, trial: Trial) -> list[BearingPair]:
        """Pair of a trial."""
        protocol = PROTOCOLS[self.protocol]
        rngs = trial.scene_rng(), trial.rng()
        scene = draw_scene(protocol, NUM_POINTS, KAPPA, OUTLIER_RATIO, *rngs)
        return [BearingPair(0, 1, scene.bearings1, scene.bearings2, scene.cam2_from_cam1)]


@dataclass(frozen=True)
class FolderTracks:
    """Tracks in one scene of a data set, a block of first frames a trial."""

    dataset: DatasetName  # its layout
    name: str  # name of the scene
    rule: PairRule  # what makes a pair
    scene: Path = field(repr=False)  # folder of the scene
    cache: Path = field(repr=False)  # folder of the tracks

    def pairs(self, trial: Trial) -> list[BearingPair]:
        """Pairs whose first frames lie in a block of the scene, tracked unless they are kept."""
        sequence = load_scene(self.dataset, self.scene)
        first, stop = (
            len(sequence) * block // BLOCKS_PER_SCENE for block in (trial.index, trial.index + 1)
        )
        key = f"{self!r} {first} {stop} {SkipRule()} {sequence_key(sequence)}"
        return cached_pairs(self.cache, key, lambda: self._track(sequence, range(first, stop)))

    def _track(self, sequence: ImageSequence, first_frames: range) -> list[BearingPair]:
        return pairs_of_frames(
            sequence.image,
            sequence.world_from_cam,
            sequence.camera,
            self.rule,
            mask=sequence.mask,
            segments=_segments(self.dataset, self.scene),
            first_frames=first_frames,
        )


def pair_rule(protocol: ProtocolName) -> PairRule:
    """Rule of a protocol; "corrected" also drops tracks that do not lead back to their start."""
    return PairRule(forward_backward_px=0.5) if protocol == "corrected" else PairRule()


def dataset_sources(
    dataset: DatasetName, folder: Path, rule: PairRule, num_pairs: int, cache: Path
) -> dict[str, FolderTracks]:
    """Source of each scene of a data set by a short name."""
    # First frames are so far apart that all scenes together give the wanted number of pairs.
    scenes = find_mp3d_vo_scenes(folder) if dataset == "mp3d_vo" else find_tum_vi_rooms(folder)
    num_frames = sum(len(load_scene(dataset, scene)) for scene in scenes)
    rule = replace(rule, stride=max(1, -(-num_frames // num_pairs)))
    sources = {}
    for number, scene in enumerate(scenes):
        name = scene.resolve().relative_to(folder.resolve().parent).as_posix()
        sources[f"{dataset}-{number:03d}"] = FolderTracks(dataset, name, rule, scene, cache)
    return sources


@lru_cache(maxsize=16)
def load_scene(dataset: DatasetName, scene: Path) -> ImageSequence:
    """Sequence of a scene of a data set, read once per process."""
    return load_mp3d_vo(scene) if dataset == "mp3d_vo" else load_tum_vi(scene)


@lru_cache(maxsize=16)
def _segments(dataset: DatasetName, scene: Path) -> list[range]:
    """Runs of frames that can be tracked; only TUM-VI has violent motion and changes of light."""
    rule = SkipRule() if dataset == "tum_vi" else None
    return steady_segments(load_scene(dataset, scene), rule)
