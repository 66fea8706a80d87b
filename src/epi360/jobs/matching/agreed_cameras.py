# SPDX-License-Identifier: BSD-3-Clause
"""Cameras on which the pairs of a folder agree, where those that were given are wrong.

A lens whose field of view is guessed, panoramas that were cropped or stretched: a pair may doubt
such a camera, and all pairs together say what it is.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from epi360.cameras import Camera, Equirectangular
from epi360.cameras.changed_camera import changed_lens, changed_panorama
from epi360.estimation import estimate_relative_pose
from epi360.estimation.angle_changes import AngleChange
from epi360.estimation.shared_angles import (
    OF_CHANGED,
    OF_GIVEN,
    Limits,
    PosedMatches,
    SharedAngles,
    fit_shared_angles,
)
from epi360.jobs.folder.image_set import ImageSet
from epi360.jobs.matching.match_job import MatchJob
from epi360.jobs.pairs.pair_selection import Pair
from epi360.jobs.records.match_store import Keys, Verdict
from epi360.two_view import IMAGE_OPTIONS, MAX_NOISE_PX, smallest_pixel_deg

_FEWEST_PAIRS, _FEWEST_IMAGES = 5, 4  # accepted, of a camera
_FIRST_PAIRS, _MOST_PAIRS = (
    16,
    60,
)  # that are looked at first, and if they gain half as much as all must
_FIRST_SHARE = 0.5
_MOST_ROUNDS = 3
# Of accepted pairs, some of which were wrong with the wrong cameras, and of their median noise.
_LEAST_LEFT, _MOST_NOISE = 0.75, 1.05
# A panorama to which so little is missing is whole, or reaches the pole.
_FROM_WHOLE_DEG, _FROM_POLE_DEG = 3.6, 1.8
_ANGLES_DEG = (30, 60, 90)  # from the axis of a lens, to say what they are


class CameraSearch:
    """The images of a folder with cameras that suit its pairs better and better.

    ``images`` has those to match with now, and ``given`` those that were given.
    """

    def __init__(self, images: ImageSet, *, keep_cameras: bool) -> None:
        self.given = self.images = images
        self._rounds_left = 0 if keep_cameras else _MOST_ROUNDS
        self._before = images
        self._accepted: list[Verdict] = []  # by these

    def goes_on(
        self, job: MatchJob, pairs: Sequence[Pair], finished: Mapping[Keys, Verdict]
    ) -> bool:
        """Whether the folder shall be matched once more, by other cameras than it was.

        Where far fewer pairs are accepted than by the cameras before, or their matches agree less
        closely, it shall be by these.
        """
        accepted = [each for each in finished.values() if each.accepted]
        if self._accepted and _are_worse(accepted, self._accepted):
            self.images, self._rounds_left, self._accepted = self._before, 0, []
            return True
        if not self._rounds_left:
            return False
        self._rounds_left -= 1
        limits = OF_GIVEN if self.images is self.given else OF_CHANGED
        changed = _agreed_cameras(self.images, job, pairs, finished, limits)
        if not changed:
            return False
        self._before, self._accepted = self.images, accepted
        self.images = replace(self.images, cameras={**self.images.cameras, **changed})
        return True

    def told(self) -> tuple[str, ...]:
        """What each camera is, and is not, that is another one than was given."""
        cameras = self.given.cameras.items()
        pairs = ((name, given, self.images.cameras[name]) for name, given in cameras)
        return tuple(f"{name}: {_told(given, now)}" for name, given, now in pairs if given != now)


def _are_worse(accepted: Sequence[Verdict], before: Sequence[Verdict]) -> bool:
    """Whether far fewer pairs are accepted than before, or their matches agree less closely."""
    if len(accepted) < _LEAST_LEFT * len(before):
        return True
    noise, noise_before = (
        np.median([each.noise_deg for each in some]) for some in (accepted, before)
    )
    return bool(noise > _MOST_NOISE * noise_before)


def _agreed_cameras(
    images: ImageSet,
    job: MatchJob,
    pairs: Sequence[Pair],
    finished: Mapping[Keys, Verdict],
    limits: Limits,
) -> dict[str, Camera]:
    """Other cameras on which accepted pairs agree clearly, by name; none where the given suit."""
    accepted = {
        keys: pair
        for pair in pairs
        if job.is_readable(pair) and finished[keys := job.keys_of(pair)].accepted
    }
    names = _with_enough_pairs(images, accepted.values())
    if not names:
        return {}
    wanted = [
        keys
        for keys, pair in accepted.items()
        if any(images.images[index].camera in names for index in pair)
    ]
    may_change = [camera if name in names else None for name, camera in images.cameras.items()]
    largest_pixel_deg = max(smallest_pixel_deg((each, each)) for each in images.cameras.values())
    estimate = partial(
        estimate_relative_pose,
        max_noise_deg=MAX_NOISE_PX * largest_pixel_deg,
        options=IMAGE_OPTIONS,
        seed=job.work.inputs.seed,
    )

    def fitted(most: int, start: SharedAngles | None = None) -> SharedAngles:
        some = wanted[:: 1 + (len(wanted) - 1) // most]
        matched = _posed(images, job, {keys: accepted[keys] for keys in some}, finished)
        return fit_shared_angles(matched, may_change, estimate, limits, start)

    first = fitted(_FIRST_PAIRS)
    if np.median(first.gains) < _FIRST_SHARE * limits.gain:
        return {}
    shared = fitted(_MOST_PAIRS, first) if len(wanted) > _FIRST_PAIRS else first
    if not shared.are_clear(limits):
        return {}
    found = zip(images.cameras.items(), shared.changes, strict=True)
    changed = {name: _changed(camera, changes, limits) for (name, camera), changes in found}
    return {
        name: camera
        for name, camera in changed.items()
        if camera not in (None, images.cameras[name])
    }


def _with_enough_pairs(images: ImageSet, pairs: Iterable[Pair]) -> set[str]:
    """Names of the cameras that took enough of the pairs, and enough images of them."""
    pairs_of, images_of = defaultdict(set), defaultdict(set)
    for pair in pairs:
        for index in pair:
            name = images.images[index].camera
            pairs_of[name].add(pair)
            images_of[name].add(index)
    return {
        name
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
        )
    return [posed[keys] for keys in some]


def _changed(camera: Camera, changes: Sequence[AngleChange], limits: Limits) -> Camera | None:
    """The camera with its clear changes, or None if it has none or there is no such camera.

    The changes are rounded, so that the last digits of a sum make no other camera.
    """
    if not any(map(limits.is_clear, changes)):
        return None
    if not isinstance(camera, Equirectangular):
        return changed_lens(camera, np.array([round(each.change, 4) for each in changes]))
    sizes = [round(each.change, 4) if limits.is_clear(each) else 0.0 for each in changes]
    found = changed_panorama(camera, np.array(sizes))
    around, middle = found.horizontal_fov_deg, found.center_latitude_deg
    ends = np.array([-0.5, 0.5]) * found.vertical_fov_deg + middle
    lowest, highest = np.where(np.abs(ends) > 90.0 - _FROM_POLE_DEG, [-90.0, 90.0], ends).tolist()
    return replace(
        found,
        horizontal_fov_deg=360.0 if around > 360.0 - _FROM_WHOLE_DEG else around,
        vertical_fov_deg=highest - lowest,
        center_latitude_deg=(highest + lowest) / 2.0,
    )


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
        return ", ".join(words.format(*both) for *both, words in parts if both[0] != both[1])
    taken = np.radians([angle for angle in _ANGLES_DEG])
    rays = np.column_stack([np.sin(taken), np.zeros(len(taken)), np.cos(taken)])
    x, y, z = now.bearings_from_pixels(given.pixels_from_bearings(rays)).T
    seen = np.degrees(np.arctan2(np.hypot(x, y), z))
    shown = [
        (f"{now:.1f}", str(was)) for now, was in zip(seen, _ANGLES_DEG, strict=True) if now > 0
    ]
    are, were = (" and ".join(each) for each in zip(*shown, strict=True))
    return f"{are} degrees from the axis, not {were}"
