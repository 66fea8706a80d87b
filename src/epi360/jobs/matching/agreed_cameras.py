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
from epi360.cameras.changed_camera import changed_lens, changed_panorama
from epi360.estimation import estimate_relative_pose
from epi360.estimation.angle_changes import AngleChange
from epi360.estimation.calibration_doubt import CALIBRATION_QUESTION
from epi360.estimation.shared_angles import (
    OF_CHANGED,
    OF_GIVEN,
    Limits,
    SharedAngles,
    fit_shared_angles,
)
from epi360.estimation.shared_angles_fit import Direction, PosedMatches
from epi360.jobs.folder.image_set import ImageSet
from epi360.jobs.matching.match_job import MatchJob
from epi360.jobs.pairs.pair_selection import Pair
from epi360.jobs.records.match_store import Keys, Verdict
from epi360.two_view import IMAGE_OPTIONS, MAX_NOISE_PX, smallest_pixel_deg

_FEWEST_PAIRS, _FEWEST_IMAGES = 5, 4  # accepted, of a camera
# So many pairs are looked at first, and more if those of a camera gain half as much as all must.
_FIRST_PAIRS, _MOST_PAIRS, _FIRST_SHARE = 16, 60, 0.5
# Where so many pairs doubt their cameras, lenses whose angles are so much smaller and larger are
# tried as well.
_MANY_DOUBTS, _FAR = 0.1, (-0.2, 0.2)
_MOST_ROUNDS = 3
# Of pairs that were accepted before, some of which were wrong with the wrong cameras, and of the
# median noise of those that still are.
_LEAST_LEFT, _MOST_NOISE = 0.75, 1.05
# A panorama to which so little is missing is whole, or reaches the pole.
_FROM_WHOLE_DEG, _FROM_POLE_DEG = 3.6, 1.8
_ANGLES_DEG = (90, 60, 30, 15, 5)  # from the axis of a lens, to say what they are
_SAME_DEG = 1e-9
_GRID = 41  # pixels along each side, of which some are in the circle of a fisheye


class CameraSearch:
    """The images of a folder with cameras that suit its pairs better and better.

    ``images`` has those to match with now, and ``given`` those that were given. Panoramas stay as
    they are if ``keep_panoramas``.
    """

    def __init__(
        self, images: ImageSet, *, keep_cameras: bool = False, keep_panoramas: bool = False
    ) -> None:
        self.given = self.images = images
        self._rounds_left = 0 if keep_cameras else _MOST_ROUNDS
        self._keep_panoramas = keep_panoramas
        self._before: tuple[ImageSet, dict[Pair, float]] | None = None

    def goes_on(
        self, job: MatchJob, pairs: Sequence[Pair], finished: Mapping[Keys, Verdict]
    ) -> bool:
        """Whether the folder shall be matched once more, by other cameras than it was.

        Where far fewer of the same pairs are accepted than by the cameras before, or their matches
        agree less closely, it shall be by these.
        """
        noises = _noises_px(job, pairs, finished)
        if self._before is not None and _are_worse(noises, self._before[1]):
            self.images, self._rounds_left, self._before = self._before[0], 0, None
            return True
        if not self._rounds_left:
            return False
        self._rounds_left -= 1
        changed = self._agreed(job, pairs, finished)
        if not changed:
            return False
        self._before = self.images, noises
        self.images = replace(self.images, cameras={**self.images.cameras, **changed})
        return True

    def told(self) -> tuple[str, ...]:
        """What each camera is, and is not, that is another one than was given."""
        cameras = self.given.cameras.items()
        pairs = ((name, given, self.images.cameras[name]) for name, given in cameras)
        return tuple(f"{name}: {_told(given, now)}" for name, given, now in pairs if given != now)

    def _agreed(
        self, job: MatchJob, pairs: Sequence[Pair], finished: Mapping[Keys, Verdict]
    ) -> dict[str, Camera]:
        """Other cameras on which accepted pairs agree clearly, by name."""
        images = self.images
        accepted = {
            keys: pair
            for pair in pairs
            if job.is_readable(pair) and finished[keys := job.keys_of(pair)].accepted
        }
        pairs_of = _pairs_by_camera(images, accepted)
        names = [
            name
            for name, camera in images.cameras.items()
            if name in pairs_of
            and not (self._keep_panoramas and isinstance(camera, Equirectangular))
        ]
        if not names:
            return {}
        may_change = [camera if name in names else None for name, camera in images.cameras.items()]
        limits = {
            name: OF_GIVEN if images.cameras[name] == self.given.cameras[name] else OF_CHANGED
            for name in names
        }
        numbers = {name: number for number, name in enumerate(images.cameras)}
        estimate = partial(estimate_relative_pose, options=IMAGE_OPTIONS, seed=job.work.inputs.seed)

        def fitted(most: int, start: Mapping[Direction, float] | None) -> SharedAngles:
            some: dict[Keys, Pair] = {}
            for name in names:
                own = pairs_of[name]
                step = 1 + (len(own) - 1) // max(most // len(names), _FEWEST_PAIRS)
                some |= {keys: accepted[keys] for keys in own[::step]}
            matched = _posed(images, job, some, finished)
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
            number, camera = numbers[name], images.cameras[name]
            if shared.is_clear(number, limits[name]):
                changed[name] = _changed(camera, shared.changes[number], limits[name])
        return {
            name: camera
            for name, camera in changed.items()
            if camera not in (None, images.cameras[name])
        }


def _noises_px(
    job: MatchJob, pairs: Sequence[Pair], finished: Mapping[Keys, Verdict]
) -> dict[Pair, float]:
    """Noise of the pairs in pixels, NaN of those that are not accepted."""
    noises = {}
    for pair in pairs:
        if job.is_readable(pair):
            verdict = finished[job.keys_of(pair)]
            pixel_deg = smallest_pixel_deg((job.camera_of(pair[0]), job.camera_of(pair[1])))
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
        (number, "radial"): change
        for number, camera in enumerate(cameras)
        if camera is not None and not isinstance(camera, Equirectangular)
    }


def _pairs_by_camera(images: ImageSet, accepted: Mapping[Keys, Pair]) -> dict[str, list[Keys]]:
    """Pairs of each camera that took enough of them, and enough images of them."""
    pairs_of: dict[str, dict[Keys, Pair]] = defaultdict(dict)
    images_of: dict[str, set[int]] = defaultdict(set)
    for keys, pair in accepted.items():
        for index in pair:
            name = images.images[index].camera
            pairs_of[name][keys] = pair
            images_of[name].add(index)
    return {
        name: list(found)
        for name, found in pairs_of.items()
        if len(found) >= _FEWEST_PAIRS and len(images_of[name]) >= _FEWEST_IMAGES
    }


def _posed(
    images: ImageSet, job: MatchJob, some: Mapping[Keys, Pair], finished: Mapping[Keys, Verdict]
) -> list[PosedMatches]:
    """Matches and poses of some pairs, in their order."""
    numbers = {name: number for number, name in enumerate(images.cameras)}
    posed = {}
    for each in job.settled_pairs(some, finished, None):
        first, second = some[each.keys]
        rows1, rows2 = each.matches.T
        posed[each.keys] = PosedMatches(
            (numbers[images.images[first].camera], numbers[images.images[second].camera]),
            (job.bearings_of(first)[rows1], job.bearings_of(second)[rows2]),
            each.verdict.cam2_from_cam1,
            each.verdict.noise_deg,
            MAX_NOISE_PX * smallest_pixel_deg((job.camera_of(first), job.camera_of(second))),
        )
    return [posed[keys] for keys in some]


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


def _told(given: Camera, now: Camera) -> str:
    """What a camera is, and not, in words."""
    if isinstance(given, Equirectangular) and isinstance(now, Equirectangular):
        parts = [
            (now.horizontal_fov_deg, given.horizontal_fov_deg, "{:.1f} degrees around, not {:.6g}"),
            (now.vertical_fov_deg, given.vertical_fov_deg, "{:.1f} degrees high, not {:.6g}"),
            (
                now.center_latitude_deg,
                given.center_latitude_deg,
                "its middle row at a latitude of {:.1f} degrees, not {:.6g}",
            ),
        ]
        return ", ".join(
            words.format(*both) for *both, words in parts if abs(both[0] - both[1]) > _SAME_DEG
        )
    across, down = (np.linspace(1.0, size - 1.0, _GRID) for size in (given.width, given.height))
    pixels = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    bearings = given.bearings_from_pixels(pixels)
    widest = bearings[np.nanargmin(bearings[:, 2])]  # towards there most angles are in the picture
    out = np.array([*widest[:2], 0.0]) / np.hypot(*widest[:2])
    taken = np.radians(_ANGLES_DEG)[:, None]
    pixels = given.pixels_from_bearings(np.sin(taken) * out + np.cos(taken) * [0.0, 0.0, 1.0])
    x, y, z = now.bearings_from_pixels(pixels).T
    seen = np.degrees(np.arctan2(np.hypot(x, y), z))
    shown = [each for each in zip(seen, _ANGLES_DEG, strict=True) if np.isfinite(each[0])][1::-1]
    are = " and ".join(f"{angle:.1f}" for angle, _ in shown)
    return f"{are} degrees from the axis, not {' and '.join(str(angle) for _, angle in shown)}"
