# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import astuple, replace

import cv2
import numpy as np
import papered_rooms
import pytest
from twin_rooms import exposed_and_visited, rooms, truth

import epi360
from epi360.estimation.result import LEAST_PROBABILITY, SamePlace
from epi360.features.warped_patches import WIDTH, Panorama
from epi360.places.own_evidence import OwnEvidence, grow_both, shown_by
from epi360.places.same_place import (
    DOUBT,
    ONE_WALL,
    SURE,
    can_be_compared,
    look_around,
    same_place,
    same_place_in_doubt,
)
from epi360.places.shared_points import PosedPair
from epi360.poses import rotation_error_deg, rotation_from_vector, translation_error_deg
from epi360_scenes.lenses import Lens

LENS = Lens.of(200.0, 768, np.eye(3)).camera


def picture(name):
    return rooms()[f"{name}.png"][1]


def pose_of(name1, name2, **options):
    return epi360.relative_pose_of_images(picture(name1), picture(name2), **options)


def panorama_camera():
    height, width = picture("a0").shape[:2]
    return epi360.Equirectangular(width, height)


def error_deg(pose, name1, name2):
    expected = truth(f"{name1}.png", f"{name2}.png")
    return max(rotation_error_deg(pose, expected), translation_error_deg(pose, expected))


def test_without_evidence_the_prior_remains():
    np.testing.assert_allclose(astuple(same_place(OwnEvidence())), (0.882, 0.1, 0.018))
    np.testing.assert_allclose(astuple(same_place_in_doubt(OwnEvidence())), (0.25, 0.5, 0.25))
    assert same_place(OwnEvidence(inliers_on_floor=True)).elsewhere == pytest.approx(0.5)


def test_evidence_moves_probability_between_the_three_explanations():
    for others, copies in np.random.default_rng(0).uniform(-12, 12, (50, 2)):
        place = same_place(OwnEvidence(others, copies))
        assert sum(astuple(place)) == pytest.approx(1.0)
        assert min(astuple(place)) > 0.0
        assert same_place(OwnEvidence(others + 1, copies)).here >= place.here
        assert same_place(OwnEvidence(others, copies + 1)).copy <= place.copy
        assert same_place(OwnEvidence(others, copies, inliers_on_floor=True)).here < place.here


def test_no_more_than_the_limit_speaks_for_a_part_of_the_sphere():
    whole, part, much = (
        same_place(OwnEvidence(each, each, is_partial=is_partial))
        for each, is_partial in ((9.0, False), (9.0, True), (3.0, False))
    )
    assert part == much
    assert LEAST_PROBABILITY < part.here < whole.here


def test_on_one_wall_no_more_than_the_limit_speaks_for_a_pair():
    assert same_place(OwnEvidence(on_one_wall=True)).here == pytest.approx(0.25)
    much, more = (same_place(OwnEvidence(each, each, on_one_wall=True)) for each in (3.0, 9.0))
    assert much == more
    assert LEAST_PROBABILITY < more.here < 0.9
    assert same_place(OwnEvidence(9.0, 1.5, on_one_wall=True)).here < LEAST_PROBABILITY


def test_what_looks_like_a_copy_is_refused_and_yet_possible():
    assert 0.2 < same_place(OwnEvidence(8.0, -50.0)).here < LEAST_PROBABILITY
    assert same_place(OwnEvidence(-50.0, 8.0)).here < 1e-3


def test_in_the_open_there_are_few_copies():
    street = same_place(OwnEvidence(3.0, -50.0, in_the_open=True))
    assert same_place(OwnEvidence(3.0, -50.0)).here < LEAST_PROBABILITY < street.here < 0.95


@pytest.mark.parametrize("names", [("a0", "a1"), ("a1", "a2"), ("b0", "b2"), ("b2", "b0")])
def test_two_views_of_one_room_are_of_one_place(names):
    result = pose_of(*names)
    assert result.status == "ok"
    assert result.place.here > 0.99
    assert error_deg(result.cam2_from_cam1, *names) < 0.5
    assert not any("both cameras must see" in each for each in result.warnings)


@pytest.mark.parametrize(
    ("views", "status"), [((("b", 0), ("b", 1)), "ok"), ((("a", 0), ("b", 1)), "another_place")]
)
def test_on_one_wall_alone_rooms_may_have_the_same_paper(views, status):
    pictures = [papered_rooms.picture(*view, own_patterns=False) for view in views]
    result = epi360.relative_pose_of_images(*pictures)
    assert result.status == status
    assert result.place.here < 0.9
    assert ONE_WALL in result.warnings


@pytest.mark.parametrize("letter", "ab")
def test_where_more_than_a_wall_has_patterns_one_room_is_told_from_two(letter):
    pictures = [papered_rooms.picture(letter, number) for number in (0, 1)]
    result = epi360.relative_pose_of_images(*pictures)
    camera1, camera2 = papered_rooms.poses()
    expected = camera2.inverse() @ camera1
    assert result.success and result.place.here > 0.99
    assert rotation_error_deg(result.cam2_from_cam1, expected) < 0.2
    assert translation_error_deg(result.cam2_from_cam1, expected) < 0.5
    other = papered_rooms.picture("b" if letter == "a" else "a", 1)
    assert not epi360.relative_pose_of_images(pictures[0], other).success


@pytest.mark.parametrize("names", [("a0", "b1"), ("a1", "b0"), ("a2", "b1"), ("b1", "a2")])
def test_two_views_of_twin_rooms_are_of_another_place(names):
    result = pose_of(*names)
    assert (result.status, result.success) == ("another_place", False)
    assert result.place.here < LEAST_PROBABILITY
    assert result.probability <= result.place.here
    pose = result.cam2_from_cam1
    for values in (pose.rotation, pose.translation, result.E, result.covariance):
        assert np.isnan(values).all()
    assert np.isnan(result.translation_basis).all()
    assert error_deg(result.alternatives[0], *names) > 10.0
    assert result.num_inliers > 50


def test_the_probability_is_that_of_matches_and_place():
    result = pose_of("a0", "b1")
    explained = result.explanations.motion + result.explanations.surface
    assert result.probability == pytest.approx(explained * result.place.here)


@pytest.mark.parametrize(
    ("by_matches", "by_place", "status"),
    [
        (0.99, 0.9, "ok"),
        (0.9, 0.96, "ok"),
        (0.95, 0.87, "another_place"),
        (0.87, 0.96, "too_few_inliers"),
    ],
)
def test_an_accepted_pose_is_right_with_that_probability_of_all(
    monkeypatch, by_matches, by_place, status
):
    place = SamePlace(by_place, 0.5 * (1.0 - by_place), 0.5 * (1.0 - by_place))
    monkeypatch.setattr("epi360.places.same_place.same_place", lambda own: place)
    found = replace(pose_of("a0", "a1"), warnings=(), probability=by_matches)
    first, second = (Panorama.of(picture(name)) for name in ("a0", "a1"))
    told = look_around(found, (panorama_camera(), panorama_camera()), (first, second))
    assert told.status == status
    assert told.probability == pytest.approx(by_matches * by_place)
    assert (DOUBT in told.warnings) == (by_place < 0.95)


def test_exposures_and_people_do_not_make_it_another_place():
    pictures = [
        exposed_and_visited(number, picture(name)) for number, name in enumerate(("b0", "b2"))
    ]
    result = epi360.relative_pose_of_images(*pictures)
    assert result.status == "ok"
    assert result.place.here > 0.95


def test_a_mask_takes_out_what_differs():
    changed = picture("b1").copy()
    mask = np.ones(changed.shape[:2], dtype=bool)
    for box in np.s_[150:300, 60:260], np.s_[120:330, 450:640]:
        noise = np.random.default_rng(0).uniform(0, 255, changed[box].shape[:2])
        changed[box] = cv2.GaussianBlur(noise, (0, 0), 2.0)[:, :, None]
        mask[box] = False
    seen = epi360.relative_pose_of_images(picture("b0"), changed)
    masked = epi360.relative_pose_of_images(picture("b0"), changed, mask2=mask)
    assert masked.place.here > max(seen.place.here, 0.99)
    assert masked.status == "ok"


def lens_frame(name, heading):
    """What a lens shows that looks along a heading of the room, and where it is in its panorama."""
    pose, panorama = rooms()[f"{name}.png"]
    lens = Lens(LENS, pose.rotation.T @ rotation_from_vector([0.0, heading, 0.0]))
    return lens.picture(panorama), lens.pose


def pose_of_frames(name1, name2, heading1, heading2):
    (picture1, lens1), (picture2, lens2) = lens_frame(name1, heading1), lens_frame(name2, heading2)
    result = epi360.relative_pose_of_images(picture1, picture2, camera1=LENS, camera2=LENS)
    return result, lens2 @ result.cam2_from_cam1 @ lens1.inverse()


@pytest.mark.parametrize("heading", [0.5, 2.6])
def test_fisheye_frames_of_one_room_are_of_one_place(heading):
    result, pose = pose_of_frames("a0", "a1", heading, heading)
    assert result.status == "ok"
    assert result.place.here > LEAST_PROBABILITY
    assert error_deg(pose, "a0", "a1") < 3.0


def test_a_panorama_and_a_fisheye_frame_are_compared():
    frame, lens = lens_frame("a1", 0.5)
    result = epi360.relative_pose_of_images(picture("a0"), frame, camera2=LENS)
    assert result.status == "ok"
    assert result.place.here > LEAST_PROBABILITY
    assert error_deg(lens @ result.cam2_from_cam1, "a0", "a1") < 3.0


def test_what_sees_too_little_is_not_compared():
    assert np.isnan(astuple(pose_of("a0", "b0").place)).all()  # a pure rotation
    wide, narrow, coarse = (
        Lens.of(*each, np.eye(3)).camera for each in ((110.0, 768), (100.0, 768), (200.0, 360))
    )
    assert can_be_compared(LENS) and can_be_compared(wide)
    assert not can_be_compared(narrow) and not can_be_compared(coarse)
    assert can_be_compared(epi360.Equirectangular(512, 255))
    assert not can_be_compared(epi360.Equirectangular(510, 255))
    no_middle = epi360.KannalaBrandt(400, 400, 200.0, 200.0, -400.0, 200.0, max_angle_deg=100.0)
    assert not can_be_compared(no_middle)
    assert can_be_compared(epi360.Equirectangular(2048, 512, 360.0, 90.0))


def test_nothing_is_compared_where_masks_leave_too_little():
    columns = np.arange(768) // 16 % 2 == 0  # no cell is free of stripes
    stripes = np.repeat(columns[None], 384, axis=0)
    result = pose_of("a0", "a1", mask1=stripes, mask2=stripes)
    assert result.status == "ok"
    assert np.isnan(result.place.here)
    half = np.repeat((np.arange(768) < 384)[None], 384, axis=0)
    assert pose_of("a0", "a1", mask1=half, mask2=half).place.here > 0.95


def test_nothing_is_compared_in_tiny_panoramas():
    small = [
        cv2.resize(picture(name), (384, 192), interpolation=cv2.INTER_AREA) for name in ("a0", "a1")
    ]
    result = epi360.relative_pose_of_images(*small)
    assert result.status == "ok"
    assert np.isnan(result.place.here)


def test_a_result_without_pictures_has_no_place():
    assert np.isnan(astuple(SamePlace())).all()


def test_a_masked_panorama_counts_where_the_mask_is_white():
    image = np.full((512, 1024, 3), 90, np.uint8)
    mask = np.ones((512, 1024), dtype=bool)
    mask[:, :512] = False  # behind and to the left
    panorama = Panorama.seen_by(epi360.Equirectangular(1024, 512), image, mask, 30.0)
    directions = np.array([[0.5, 0, 1.0], [1, 0, 0], [-1, 0, 0], [0.1, 1, 0.1], [0.1, -1, 0.1]])
    assert panorama.counts_at(directions).tolist() == [True, True, False, False, True]
    whole = Panorama.seen_by(epi360.Equirectangular(1024, 512), image)
    assert whole.counts_at(directions).all()
    assert panorama.usable.shape == (WIDTH // 2, WIDTH)


@pytest.mark.parametrize("names", [("a0", "a1"), ("b0", "b2"), ("a0", "b1")])
def test_swapped_views_show_the_same(names):
    result = pose_of(*names)
    pose = result.cam2_from_cam1 if result.success else result.alternatives[0]
    views = [Panorama.of(picture(name)) for name in names]
    bearings = [
        panorama_camera().bearings_from_pixels(keypoints[result.inlier_mask])
        for keypoints in (result.keypoints1, result.keypoints2)
    ]
    inliers = np.column_stack([np.arange(result.num_inliers)] * 2)
    pair = PosedPair.of((0, 1), pose, inliers, bearings)
    swapped = PosedPair.of((0, 1), pose.inverse(), inliers, bearings[::-1])
    np.testing.assert_allclose(
        shown_by(pair, grow_both(pair, views)),
        shown_by(swapped, grow_both(swapped, views[::-1])),
        atol=0.02,
    )


@pytest.mark.parametrize("names", [("a0", "a1"), ("b0", "b2"), ("a0", "b1"), ("a1", "b0")])
def test_swapped_views_get_the_same_verdict(names):
    one, other = pose_of(*names), pose_of(*names[::-1])
    assert one.status == other.status
    # Other samples find a pose that differs a little.
    assert log_odds(one.place.here) == pytest.approx(log_odds(other.place.here), abs=1.0)


def log_odds(probability):
    return np.log(probability / (1.0 - probability))


@pytest.mark.parametrize("in_the_open", [False, True])
def test_in_doubt_the_pictures_alone_make_a_place_sure(in_the_open):
    """Where nothing else says where a frame is, a street corner may be one of many."""
    little = OwnEvidence(1.0, -3.0, in_the_open=in_the_open)
    much = OwnEvidence(9.0, 8.0, in_the_open=in_the_open)
    assert same_place_in_doubt(little).here < 0.1
    assert same_place_in_doubt(much).here > SURE
    assert same_place_in_doubt(OwnEvidence(9.0, 0.0, in_the_open=in_the_open)).here < 0.51
