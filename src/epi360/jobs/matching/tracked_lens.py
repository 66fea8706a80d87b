# SPDX-License-Identifier: BSD-3-Clause
"""The lens on which the tracks of a sequence agree, where the given one is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from epi360.cameras import Camera, Equirectangular
from epi360.interop.match_graph import MatchedImage, MatchedPair, MatchGraph
from epi360.jobs.matching.agreed_cameras import CameraSearch
from epi360.jobs.matching.graph_folder import GraphFolder
from epi360.jobs.threads import num_cores
from epi360.odometry.frame_result import shared_rows
from epi360.odometry.key_frames import KeyFrame
from epi360.progress import no_progress

_CAMERA = "camera"
# Key frames that follow one and share so many tracks are its partners; so many pairs are looked at.
_FOLLOWING, _FEWEST_SHARED, _MOST_PAIRS = 12, 60, 60


@dataclass(frozen=True)
class AgreedCamera:
    """Another camera, and in words what it is and is not."""

    camera: Camera
    said: str


def agreed_camera(
    key_frames: Sequence[KeyFrame], camera: Camera, seed: int, num_threads: int | None = None
) -> AgreedCamera | None:
    """Lens on which the key frames of a sequence agree clearly; None if that is the given one.

    Two key frames are a pair of images whose matches are the tracks that both see. Pairs are
    verified as those of a folder are, and their cameras sought as there, see `CameraSearch`.
    Panoramas stay as they are given.
    """
    if isinstance(camera, Equirectangular):
        return None
    graph = _graph_of(key_frames, camera)
    search = CameraSearch(graph.cameras, [_CAMERA] * len(graph.images), seed=seed)
    while True:
        folder = GraphFolder(graph, None, seed, num_threads or num_cores(), no_progress)
        if not search.goes_on(folder, folder.pairs, folder.verify()):
            break
        graph = replace(graph, cameras=search.cameras)
    told = search.told()
    if not told:
        return None
    return AgreedCamera(search.cameras[_CAMERA], told[0].removeprefix(f"{_CAMERA}: "))


def _graph_of(key_frames: Sequence[KeyFrame], camera: Camera) -> MatchGraph:
    """Key frames as images, and those pairs that share many tracks, evenly spaced if too many.

    Neighbours come first, so that what is left has pairs of all distances.
    """
    images = {
        str(frame.index): MatchedImage(
            str(frame.index), _CAMERA, camera.pixels_from_bearings(frame.bearings)
        )
        for frame in key_frames
    }
    pairs = []
    for apart in range(1, _FOLLOWING + 1):
        for first, second in zip(key_frames, key_frames[apart:], strict=False):
            rows = shared_rows(first.ids, second.ids)
            if len(rows[0]) >= _FEWEST_SHARED:
                names = str(first.index), str(second.index)
                pairs.append(MatchedPair(*names, np.column_stack(rows)))
    step = max(1, -(-len(pairs) // _MOST_PAIRS))
    return MatchGraph({_CAMERA: camera}, images, tuple(pairs[::step]))
