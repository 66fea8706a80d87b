# SPDX-License-Identifier: BSD-3-Clause
"""Cameras on which the pairs of a folder agree, where those that were given are wrong.

A lens whose field of view is guessed, panoramas that were cropped or stretched: a pair may doubt
such a camera, and all pairs together say what it is.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from epi360.cameras import Camera, Equirectangular
from epi360.cameras.changed_angles import AngleModel, Direction
from epi360.cameras.changed_camera import changed_lens, changed_panorama, what_changed
from epi360.cameras.resizing import smallest_pixel_deg
from epi360.estimation import estimate_relative_pose
from epi360.estimation.angle_changes import AngleChange
from epi360.estimation.calibration_doubt import CALIBRATION_QUESTION
from epi360.estimation.image_matches import IMAGE_OPTIONS, MAX_NOISE_PX
from epi360.estimation.shared_angles import (
    OF_CHANGED,
    OF_GIVEN,
    Limits,
    SharedAngles,
    fit_shared_angles,
)
from epi360.estimation.shared_angles_fit import PosedMatches
from epi360.jobs.matching.verified_folder import VerifiedFolder
from epi360.jobs.pairs.pair_selection import Pair
from epi360.jobs.records.match_store import Keys, Verdict

_FEWEST_PAIRS, FEWEST_IMAGES = 5, 4  # accepted, of a camera
# So many pairs are looked at first, and more if those of a camera gain half as much as all must.
_FIRST_PAIRS, _MOST_PAIRS, _FIRST_SHARE = 16, 60, 0.5
# Where so many pairs doubt their cameras, lenses whose angles are so much smaller and larger are
# tried as well.
_MANY_DOUBTS, _FAR = 0.1, (-0.2, 0.2)
MOST_ROUNDS = 3
# Of pairs that were accepted before, some of which were wrong with the wrong cameras, and of the
# median noise of those that still are.
_LEAST_LEFT, _MOST_NOISE = 0.75, 1.05
# A panorama to which so little is missing is whole, or reaches the pole.
_FROM_WHOLE_DEG, _FROM_POLE_DEG = 3.6, 1.8


class CameraSearch:
    """Cameras that suit the pairs of a folder better and better.

    ``cameras`` are those to use now, by their names, and ``given`` those that were given.
    ``of_images`` has the name of the camera of each image, None where it has none. Panoramas stay
    as they are if ``keep_panoramas``.
    """

    def __init__(
        self,
        cameras: Mapping[str, Camera],
        of_images: Sequence[str | None],
        *,
        seed: int,
        most_rounds: int = MOST_ROUNDS,
        keep_panoramas: bool = False,
    ) -> None:
        self.given = self.cameras = dict(cameras)
        self._of_images, self._seed = of_images, seed
        self._rounds_left = most_rounds
        self._keep_panoramas = keep_panoramas
        self._before: tuple[dict[str, Camera], dict[Pair, float]] | None = None

    def goes_on(
        self, folder: VerifiedFolder, pairs: Sequence[Pair], finished: Mapping[Keys, Verdict]
    ) -> bool:
        """Whether the pairs shall be verified once more, by other cameras than they were.

        Where far fewer of the same pairs are accepted than by the cameras before, or their matches
        agree less closely, it shall be by these.
        """
        noises = _noises_px(folder, pairs, finished)
        if self._before is not None and _are_worse(noises, self._before[1]):
            self.cameras, self._rounds_left, self._before = self._before[0], 0, None
            return True
        if not self._rounds_left:
            return False
        self._rounds_left -= 1
        changed = self._agreed(folder, pairs, finished)
        if not changed:
            return False
        self._before = self.cameras, noises
        self.cameras = {**self.cameras, **changed}
        return True

    def told(self) -> tuple[str, ...]:
        """What each camera is, and is not, that is another one than was given."""
        return said_of_cameras(self.given, self.cameras)

    def _agreed(
        self, folder: VerifiedFolder, pairs: Sequence[Pair], finished: Mapping[Keys, Verdict]
    ) -> dict[str, Camera]:
        """Other cameras on which accepted pairs agree clearly, by name."""
        cameras = self.cameras
        accepted = {
            keys: pair
            for pair in pairs
            if folder.is_readable(pair) and finished[keys := folder.keys_of(pair)].accepted
        }
        pairs_of = self._pairs_by_camera(accepted)
        names = [
            name
            for name, camera in cameras.items()
            if name in pairs_of
            and not (self._keep_panoramas and isinstance(camera, Equirectangular))
        ]
        if not names:
            return {}
        may_change = [camera if name in names else None for name, camera in cameras.items()]
        limits = {
            name: OF_GIVEN if cameras[name] == self.given[name] else OF_CHANGED for name in names
        }
        numbers = {name: number for number, name in enumerate(cameras)}
        estimate = partial(estimate_relative_pose, options=IMAGE_OPTIONS, seed=self._seed)

        def fitted(most: int, start: Mapping[Direction, float] | None) -> SharedAngles:
            some: dict[Keys, Pair] = {}
            for name in names:
                own = pairs_of[name]
                step = 1 + (len(own) - 1) // max(most // len(names), _FEWEST_PAIRS)
                some |= {keys: accepted[keys] for keys in own[::step]}
            matched = self._posed(folder, some, finished)
            least = min(limits.values(), key=lambda each: each.gain)
            return fit_shared_angles(matched, may_change, estimate, least, start)

        def gain(shared: SharedAngles) -> float:
            return max(shared.gain_of(numbers[name]) / limits[name].gain for name in names)

        first = fitted(_FIRST_PAIRS, None)
        if _are_doubted(finished):
            starts = (_all_larger(may_change, change) for change in _FAR)
            first = max([first, *(fitted(_FIRST_PAIRS, each) for each in starts if each)], key=gain)
        if gain(first) < _FIRST_SHARE:
            return {}
        shared = fitted(_MOST_PAIRS, first.sizes)
        changed = {}
        for name in names:
            number, camera = numbers[name], cameras[name]
            if shared.is_clear(number, limits[name]):
                changed[name] = _changed(camera, shared.changes[number], limits[name])
        return {
            name: camera for name, camera in changed.items() if camera not in (None, cameras[name])
        }

    def _pairs_by_camera(self, accepted: Mapping[Keys, Pair]) -> dict[str, list[Keys]]:
        """Pairs of each camera that took enough of them, and enough images of them."""
        pairs_of: dict[str, dict[Keys, Pair]] = defaultdict(dict)
        images_of: dict[str, set[int]] = defaultdict(set)
        for keys, pair in accepted.items():
            for index in pair:
                name = self._name_of_camera(index)
                pairs_of[name][keys] = pair
                images_of[name].add(index)
        return {
            name: list(found)
            for name, found in pairs_of.items()
            if len(found) >= _FEWEST_PAIRS and len(images_of[name]) >= FEWEST_IMAGES
        }

    def _posed(
        self, folder: VerifiedFolder, some: Mapping[Keys, Pair], finished: Mapping[Keys, Verdict]
    ) -> list[PosedMatches]:
        """Matches and poses of some pairs, in their order."""
        numbers = {name: number for number, name in enumerate(self.cameras)}
        posed = {}
        for each in folder.settled_pairs(some, finished, None):
            first, second = some[each.keys]
            rows1, rows2 = each.matches.T
            posed[each.keys] = PosedMatches(
                (numbers[self._name_of_camera(first)], numbers[self._name_of_camera(second)]),
                (folder.bearings_of(first)[rows1], folder.bearings_of(second)[rows2]),
                each.verdict.cam2_from_cam1,
                each.verdict.noise_deg,
                MAX_NOISE_PX
                * smallest_pixel_deg((folder.camera_of(first), folder.camera_of(second))),
            )
        return [posed[keys] for keys in some]

    def _name_of_camera(self, index: int) -> str:
        name = self._of_images[index]
        assert name is not None  # the image is in a pair that was verified
        return name


def said_of_cameras(given: Mapping[str, Camera], now: Mapping[str, Camera]) -> tuple[str, ...]:
    """What each camera is, and is not, that is another one than was given."""
    pairs = ((name, before, now[name]) for name, before in given.items())
    return tuple(f"{name}: {what_changed(*both)}" for name, *both in pairs if both[0] != both[1])


def _noises_px(
    folder: VerifiedFolder, pairs: Sequence[Pair], finished: Mapping[Keys, Verdict]
) -> dict[Pair, float]:
    """Noise of the pairs in pixels, NaN of those that are not accepted."""
    noises = {}
    for pair in pairs:
        if folder.is_readable(pair):
            verdict = finished[folder.keys_of(pair)]
            pixel_deg = smallest_pixel_deg((folder.camera_of(pair[0]), folder.camera_of(pair[1])))
            noises[pair] = verdict.noise_deg / pixel_deg if verdict.accepted else np.nan
    return noises


def _are_worse(noises: Mapping[Pair, float], before: Mapping[Pair, float]) -> bool:
    """Whether far fewer of the same pairs are accepted than before, or they are noisier."""
    both = [(noises[pair], before[pair]) for pair in noises if pair in before]
    now, then = np.array(both).reshape(-1, 2).T
    num_before = np.isfinite(then).sum()
    if np.isfinite(now).sum() < _LEAST_LEFT * num_before:
        return True
    still = np.isfinite(now) & np.isfinite(then)
    return bool(still.any() and np.median(now[still]) > _MOST_NOISE * np.median(then[still]))


def _are_doubted(finished: Mapping[Keys, Verdict]) -> bool:
    """Whether many accepted pairs doubt their cameras."""
    accepted = [each for each in finished.values() if each.accepted]
    doubted = sum(
        any(CALIBRATION_QUESTION in warning for warning in each.warnings) for each in accepted
    )
    return doubted > _MANY_DOUBTS * len(accepted)


def _all_larger(cameras: Sequence[Camera | None], change: float) -> dict[Direction, float]:
    """The angles of all lenses larger by so much."""
    return {
        (number, AngleModel.of(camera).directions[0]): change
        for number, camera in enumerate(cameras)
        if camera is not None and not isinstance(camera, Equirectangular)
    }


def _changed(camera: Camera, changes: Sequence[AngleChange], limits: Limits) -> Camera | None:
    """The camera with its clear changes; None if there is no such camera.

    The changes are rounded, so that the last digits of a sum make no other camera.
    """
    if not isinstance(camera, Equirectangular):
        return changed_lens(camera, np.array([round(each.change, 4) for each in changes]))
    sizes = {
        each.direction: round(each.change, 4) if limits.is_clear(each) else 0.0 for each in changes
    }
    found = changed_panorama(camera, np.array(list(sizes.values())))
    if sizes["horizontal"] and found.horizontal_fov_deg > 360.0 - _FROM_WHOLE_DEG:
        found = replace(found, horizontal_fov_deg=360.0)
    ends = np.array([-0.5, 0.5]) * found.vertical_fov_deg + found.center_latitude_deg
    reached = np.abs(ends) > 90.0 - _FROM_POLE_DEG
    if (sizes["vertical"] or sizes["middle"]) and reached.any():
        lowest, highest = np.where(reached, [-90.0, 90.0], ends).tolist()
        middle = (highest + lowest) / 2.0
        found = replace(found, vertical_fov_deg=highest - lowest, center_latitude_deg=middle)
    return found
