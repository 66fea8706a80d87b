# SPDX-License-Identifier: BSD-3-Clause
"""Matches of one's own: what cannot be is said, with the image or the pair."""

import numpy as np
import pytest

from epi360.cameras import Equirectangular
from epi360.interop import MatchedImage, MatchedPair, MatchGraph

CAMERAS = {"c": Equirectangular(64, 32)}
MATCHES = np.array([[0, 1], [1, 0]])


def graph(matches=MATCHES, keypoints=None, names=(("a", "b"),)):
    seen = np.full((2, 2), 5.0) if keypoints is None else keypoints
    images = {name: MatchedImage(name, "c", seen) for name in "ab"}
    return MatchGraph(CAMERAS, images, tuple(MatchedPair(*each, matches) for each in names))


def test_rows_of_key_points_are_taken():
    assert len(graph().pairs) == len(graph(np.zeros((0, 2), np.uint32)).pairs) == 1


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"matches": MATCHES.astype(float)}, r"pair a b: matches must be .* float64 \(2, 2\)"),
        ({"matches": MATCHES[:, :1]}, r"pair a b: matches must be .*got int64 \(2, 1\)"),
        ({"matches": MATCHES[0]}, r"pair a b: matches must be .*got int64 \(2,\)"),
        ({"matches": MATCHES + 1}, "pair a b must match key points 0 to 1 of a, got 1 to 2"),
        ({"keypoints": np.eye(3)}, r"image a: key points must be pixels .* \(3, 3\)"),
        ({"names": [("a", "b"), ("b", "a")]}, "pair b a is there twice"),
        ({"names": [("a", "a")]}, "pair a a must name two images"),
        ({"names": [("a", "x")]}, "pair a x: there is no image x"),
    ],
)
def test_what_cannot_be_is_named(given, message):
    with pytest.raises(ValueError, match=message):
        graph(**given)
