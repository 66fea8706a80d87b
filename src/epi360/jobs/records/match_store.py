# SPDX-License-Identifier: BSD-3-Clause
"""The output folder of `epi360 match`: what it was made with, finished pairs, the result.

``epi360-match.json``
    Format and options.
``features/KEY.npz``
    Key points of an image, see `FeatureCache`.
``digests.json``
    Hashes of the image files, see `FileDigests`; only saves time.
``pairs/part-HASH.npz``
    Some verified pairs, known by the keys of their images. Parts appear whole or not at all.
``level-HASH/part-HASH.npz``
    Pairs of a level folder that were estimated again with a prior; the first hash is the prior's.
``some-HASH/part-HASH.npz``
    What some of the matches of a pair say by themselves; the first hash is how they were chosen.
``implied/part-HASH.npz``
    Pairs with a second pose, or one that other pairs imply; the index names the file that counts.
``images.json``, ``cameras.json``
    Images and pairs of the last complete run.
``verdicts.json``
    Verdicts of that run, see `kept_verdicts`; only saves time.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.estimation import Explanations
from epi360.extras import package_version
from epi360.jobs.frames.frame_source import FRAMES_RECORD
from epi360.poses import Pose
from epi360.runs.arrays import Arrays, npz_bytes, read_arrays
from epi360.runs.made_from import fingerprint, first_difference, read_record, write_record
from epi360.runs.remote_path import AnyPath
from epi360.runs.storage import remove_folder
from epi360.runs.whole_files import write_file

FORMAT = 2
MARKER, IMAGES, CAMERAS = "epi360-match.json", "images.json", "cameras.json"
VERDICTS = "verdicts.json"
FEATURES, PAIRS, DIGESTS = "features", "pairs", "digests.json"
LEVEL_PAIRS = "level-"  # and the fingerprint of the prior
SOME_MATCHES = "some-"  # and the fingerprint of how they were chosen
IMPLIED_PAIRS = "implied"
UNREADABLE = "unreadable_image"  # the status of a pair of which an image is of no use
Keys = tuple[str, str]


@dataclass(frozen=True, eq=False, kw_only=True)
class Verdict:
    """What became of a pair, without its matches; most values are those of `RelativePoseResult`."""

    status: str  # also UNREADABLE, and of a folder REFUSED
    warnings: tuple[str, ...] = ()
    num_matches: int = 0
    num_inliers: int = 0
    noise_deg: float = np.nan
    parallax_deg: float = np.nan
    rotation_sigma_deg: float = np.nan  # one-sigma errors to expect, over all axes
    translation_sigma_deg: float = np.nan
    probability: float = np.nan  # that a pose with translation is right; NaN where there is none
    floor_share: float = np.nan  # of the inliers that both images see below the horizon
    explanations: Explanations = Explanations()  # of the matches of this pair alone
    prior: str = ""  # what was known of the pose beforehand, in words
    cam2_from_cam1: Pose = dataclasses.field(default_factory=Pose.nan)
    doubted: Pose = dataclasses.field(
        default_factory=Pose.nan
    )  # a refused pose that others may confirm

    @property
    def accepted(self) -> bool:
        """Whether the pose may be used."""
        return self.status == "ok"


@dataclass(frozen=True, eq=False)
class VerifiedPair:
    """A finished pair: keys of both images, verdict, matches (M, 2) and their inlier mask (M,)."""

    keys: Keys
    verdict: Verdict
    matches: NDArray[np.int64]
    inlier_mask: NDArray[np.bool_]


def open_output(folder: AnyPath, options: Mapping[str, Any], *, restart: bool) -> None:
    """Make the output folder, or check that its pairs were made with these options.

    With ``restart``, pairs that were made with others are thrown away instead of refusing them.
    """
    wanted = {"format": FORMAT, "epi360_version": package_version(), "options": dict(options)}
    found = _marker(folder)
    if restart and found is not None and found != wanted:
        for name in (IMAGES, VERDICTS):
            (folder / name).unlink(missing_ok=True)
        for store in (PAIRS, IMPLIED_PAIRS, f"{LEVEL_PAIRS}*", f"{SOME_MATCHES}*"):
            for pairs in folder.glob(store):
                if pairs.is_dir():
                    remove_folder(str(pairs))
    elif found is not None:
        _check_same(folder, found, wanted)
    folder.mkdir(parents=True, exist_ok=True)
    # The marker comes first: a folder with other files and without it is not ours.
    write_record(folder / MARKER, wanted)
    for part in (FEATURES, PAIRS):
        (folder / part).mkdir(exist_ok=True)


def _is_no_result(path: AnyPath) -> bool:
    return path.name.startswith(".") or (path / FRAMES_RECORD).is_file()


def _marker(folder: AnyPath) -> dict[str, Any] | None:
    """Content of the marker, None where there is nothing but hidden files and a video's frames."""
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"output must be a folder, {folder} is a file")
    if not folder.exists() or all(_is_no_result(path) for path in folder.iterdir()):
        return None
    remedy = "choose another output"
    found = read_record(folder / MARKER, remedy=remedy)
    if found is None:
        raise ValueError(
            f"output {folder} is not empty and was not made by epi360 match; choose another"
        )
    if not isinstance(found.get("options"), dict):
        raise ValueError(f"{folder / MARKER} is damaged; {remedy}")
    return found


def _check_same(folder: AnyPath, found: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    flat = [{**record, **record["options"]} for record in (found, wanted)]
    del flat[1]["options"]
    different = first_difference(*flat)
    if different is not None:
        raise ValueError(
            f"{folder} was made with {different.name} {different.before}, now it is "
            f"{different.now}: choose another --output, or --restart to match again (features that "
            "still fit are kept)"
        )


def write_part(folder: AnyPath, pairs: Sequence[VerifiedPair], store: str = PAIRS) -> str:
    """Keep finished pairs, at least one, in a file of this sub-folder, whose name is returned."""
    verdicts = [pair.verdict for pair in pairs]
    matches = np.concatenate([pair.matches for pair in pairs])
    arrays = {
        "keys": np.array([pair.keys for pair in pairs]),
        "status": np.array([verdict.status for verdict in verdicts]),
        "warnings": np.array(["\n".join(verdict.warnings) for verdict in verdicts]),
        "prior": np.array([verdict.prior for verdict in verdicts]),
        "numbers": np.array([_numbers(verdict) for verdict in verdicts]),
        "explanations": np.array([dataclasses.astuple(each.explanations) for each in verdicts]),
        "ends": np.cumsum([len(pair.matches) for pair in pairs]),
        "matches": matches.astype(np.min_scalar_type(matches.max(initial=0))),
        "inlier_mask": np.concatenate([pair.inlier_mask for pair in pairs]),
    }
    content = npz_bytes(arrays)
    name = f"part-{fingerprint(content)}.npz"
    (folder / store).mkdir(exist_ok=True)
    write_file(folder / store / name, content)
    return name


def read_parts(folder: AnyPath, store: str = PAIRS) -> Iterable[VerifiedPair]:
    """Pairs that are finished, in no order; one may come twice, the same each time.

    A damaged part counts as not done.
    """
    for arrays in part_arrays(folder, store):
        yield from _pairs_of(arrays)


def read_part(folder: AnyPath, name: str, store: str = PAIRS) -> list[VerifiedPair]:
    """Pairs of the part of this name; none where it is damaged."""
    arrays = read_arrays(folder / store / name)
    return [] if arrays is None else _pairs_of(arrays)


def keys_by_part(folder: AnyPath, store: str = PAIRS) -> Iterator[tuple[str, list[Keys]]]:
    """Name of each whole part, and the keys of its pairs."""
    for name, arrays in _named_parts(folder, store):
        yield name, [(str(key1), str(key2)) for key1, key2 in arrays["keys"]]


def part_arrays(folder: AnyPath, store: str = PAIRS) -> Iterator[Arrays]:
    """Arrays of each whole part, see `write_part`; `pair_of_part` makes its pairs of them."""
    for _, arrays in _named_parts(folder, store):
        yield arrays


def _named_parts(folder: AnyPath, store: str) -> Iterator[tuple[str, Arrays]]:
    for name in sorted(path.name for path in (folder / store).glob("part-*.npz")):
        arrays = read_arrays(folder / store / name)
        if arrays is not None:
            yield name, arrays


def _pairs_of(arrays: Arrays) -> list[VerifiedPair]:
    return [pair_of_part(arrays, row) for row in range(len(arrays["keys"]))]


def _numbers(verdict: Verdict) -> list[float]:
    poses = (verdict.cam2_from_cam1, verdict.doubted)
    return [
        verdict.noise_deg,
        verdict.parallax_deg,
        verdict.rotation_sigma_deg,
        verdict.translation_sigma_deg,
        verdict.probability,
        verdict.floor_share,
        *(value for pose in poses for value in (*pose.rotation.ravel(), *pose.translation)),
    ]


def pair_of_part(arrays: Arrays, row: int) -> VerifiedPair:
    """One of the pairs of a part."""
    matches, mask = matches_of_part(arrays, row)
    *measured, probability, floor_share = arrays["numbers"][row][:6]
    noise, parallax, rotation_sigma, translation_sigma = measured
    cam2_from_cam1, doubted = poses_of_part(arrays, row)
    verdict = Verdict(
        status=str(arrays["status"][row]),
        warnings=tuple(str(arrays["warnings"][row]).splitlines()),
        num_matches=len(matches),
        num_inliers=int(mask.sum()),
        noise_deg=float(noise),
        parallax_deg=float(parallax),
        rotation_sigma_deg=float(rotation_sigma),
        translation_sigma_deg=float(translation_sigma),
        probability=float(probability),
        floor_share=float(floor_share),
        explanations=_explanations_of_part(arrays, row),
        prior=str(arrays["prior"][row]),
        cam2_from_cam1=cam2_from_cam1,
        doubted=doubted,
    )
    key1, key2 = arrays["keys"][row]
    return VerifiedPair((str(key1), str(key2)), verdict, matches, mask)


def _explanations_of_part(arrays: Arrays, row: int) -> Explanations:
    if "explanations" not in arrays:  # older parts do not say
        return Explanations()
    return Explanations(*arrays["explanations"][row].tolist())


def matches_of_part(arrays: Arrays, row: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Matches (M, 2) and inlier mask (M,) of one of the pairs of a part."""
    start, end = arrays["ends"][row - 1] if row else 0, arrays["ends"][row]
    return arrays["matches"][start:end].astype(np.int64), arrays["inlier_mask"][start:end]


def poses_of_part(arrays: Arrays, row: int) -> tuple[Pose, Pose]:
    """Pose and doubted pose of one of the pairs of a part."""
    pose, doubted = np.split(arrays["numbers"][row][6:], 2)
    return _pose(pose), _pose(doubted)


def _pose(numbers: NDArray[np.float64]) -> Pose:
    return Pose(numbers[:9].reshape(3, 3), numbers[9:])
