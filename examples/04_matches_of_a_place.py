# SPDX-License-Identifier: BSD-3-Clause
"""Matches of many panoramas of one place, by any feature: python 04_matches_of_a_place.py [FOLDER].

Put your own feature (LightGlue, XFeat, ...) in place of `found_by_opencv` and `matched_by_opencv`.
Without a folder of panoramas this renders six, of two bedrooms that are copies of each other: the
matches do not tell them apart, but what the pictures show around the matches does.
"""

import sys
import tempfile
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np

import epi360
from epi360.interop import MatchedImage, MatchedPair, MatchGraph
from epi360.jobs.matching.verify_pairs import verify_pairs
from epi360.report.match_table import describe_verified
from epi360_scenes.home import twin_home

RATIO = 0.8  # of the distances to the best and to the second best descriptor
# Where the cameras stand in each room: x and z in metres, and the heading.
PLACES = {
    "a": [(-0.9, -0.2, 0.3), (-0.3, 0.6, 1.4), (0.2, -0.3, -0.8)],
    "b": [(-0.8, 0.1, 1.0), (0.1, 0.5, -0.4), (0.3, -0.4, 2.2)],
}


def main() -> None:
    """Match the panoramas of a folder, and print which pairs have a pose."""
    if len(sys.argv) > 2:
        raise SystemExit("usage: python 04_matches_of_a_place.py [FOLDER]")
    if len(sys.argv) == 2:
        judge(Path(sys.argv[1]))
        return
    with tempfile.TemporaryDirectory() as folder:
        render_twin_rooms(Path(folder))
        judge(Path(folder))


def judge(folder: Path) -> None:
    """Match all pairs, verify them, and let them judge each other."""
    images, descriptors, cameras = {}, {}, {}
    for path in sorted(folder.iterdir()):
        image = epi360.read_image(path)
        height, width = image.shape[:2]
        size = f"{width}x{height}"
        cameras[size] = epi360.Equirectangular(width, height)
        keypoints, descriptors[path.name] = found_by_opencv(image)
        images[path.name] = MatchedImage(path.name, size, keypoints)
    pairs = tuple(
        MatchedPair(name1, name2, matched_by_opencv(descriptors[name1], descriptors[name2]))
        for name1, name2 in combinations(images, 2)
    )
    judged = verify_pairs(MatchGraph(cameras, images, pairs), pictures=folder)
    for verdict in judged.verdicts:
        told = "accepted" if verdict.accepted else verdict.refused or verdict.status
        print(f"{verdict.image1} {verdict.image2}: {told} (probability {verdict.probability:.3f})")
    print(describe_verified(judged))


def found_by_opencv(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Key points (N, 2) and descriptors; the centre of the first pixel is (0.5, 0.5)."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    found, descriptors = cv2.SIFT_create(4000).detectAndCompute(grey, None)
    return np.array([point.pt for point in found]) + 0.5, descriptors


def matched_by_opencv(descriptors1: np.ndarray, descriptors2: np.ndarray) -> np.ndarray:
    """Rows (M, 2) of the key points of both images that match, each at most once."""
    there, back = (
        {
            best.queryIdx: best.trainIdx
            for best, second in cv2.BFMatcher().knnMatch(first, second, 2)
            if best.distance < RATIO * second.distance
        }
        for first, second in ((descriptors1, descriptors2), (descriptors2, descriptors1))
    )
    mutual = [(one, other) for one, other in there.items() if back.get(other) == one]
    return np.array(mutual, dtype=np.int64).reshape(-1, 2)


def render_twin_rooms(folder: Path) -> None:
    """Three panoramas of each of two bedrooms that differ in little."""
    home, camera = twin_home(0), epi360.Equirectangular(768, 384)
    twins = [room for room in home.rooms if (room.kind, room.side) == ("bedroom", 1)][:2]
    for letter, room in zip("ab", twins, strict=True):
        for number, (x, z, heading) in enumerate(PLACES[letter]):
            place = np.array(room.place.to_world((x, -1.5, z)))
            turn, _ = cv2.Rodrigues(np.array([0.0, heading + room.place.yaw, 0.0]))
            picture = home.seen_from(place).render(camera, epi360.Pose(turn, place)).image
            cv2.imwrite(str(folder / f"{letter}{number}.png"), picture[..., ::-1])


if __name__ == "__main__":
    main()
