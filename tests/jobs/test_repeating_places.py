# SPDX-License-Identifier: BSD-3-Clause
"""Matches of a place that repeats itself, of which there are no pictures."""

from colmap_graphs import panoramas_of_points, relative_pose

from epi360.jobs.matching.verify_pairs import verify_pairs, without_geometries
from epi360.poses import rotation_error_deg
from epi360.report.match_table import describe_verified


def test_pairs_whose_other_matches_agree_on_another_direction_are_refused():
    poses, graph = panoramas_of_points(4, num_shifted=80)
    found = verify_pairs(without_geometries(graph))
    for pair, verdict in zip(found.graph.pairs, found.verdicts, strict=True):
        assert not verdict.accepted and verdict.probability <= 0.5
        assert verdict.refused.startswith(
            "shows a place that repeats itself, for many of its other"
        )
        truth = relative_pose(poses[pair.image1], poses[pair.image2])
        assert rotation_error_deg(verdict.cam2_from_cam1, truth) < 1.0
    assert "6 shows a place that repeats itself" in " ".join(describe_verified(found).split())


def test_few_of_them_refuse_no_pair():
    _, graph = panoramas_of_points(4, num_shifted=15)
    assert all(verdict.accepted for verdict in verify_pairs(without_geometries(graph)).verdicts)


def test_the_result_is_the_same_on_any_number_of_threads():
    _, graph = panoramas_of_points(5, num_shifted=60)
    one, three = (
        verify_pairs(without_geometries(graph), num_threads=number).verdicts for number in (1, 3)
    )
    assert [each.refused for each in one] == [each.refused for each in three]
    assert [each.probability for each in one] == [each.probability for each in three]
    assert any(each.refused for each in one)
