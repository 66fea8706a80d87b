# SPDX-License-Identifier: BSD-3-Clause
"""Images whose places points and pairs confirm, and wrong ones that are left out."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from epi360.jobs.mapping.model_check import (
    PlacedImages,
    confirmed_groups,
    confirmed_images,
    judged_images,
)
from epi360.jobs.matching.match_folder import PairVerdict
from epi360.poses import Pose, rotation_from_vector

NUM_IMAGES, NUM_POINTS = 6, 60


def unit(pose):
    return Pose(pose.rotation, pose.translation / np.linalg.norm(pose.translation))


def walk(step=0.3):
    """Poses of a walk, true pairs between all images, and points that all of them see."""
    rng = np.random.default_rng(0)
    poses = {
        str(k): Pose(
            rotation_from_vector([0.0, 0.3 * k, 0.02 * k]), np.array([step * k, 0.1 * (k % 2), 0.0])
        ).inverse()
        for k in range(NUM_IMAGES)
    }
    points = rng.uniform(-4, 4, (NUM_POINTS, 3))
    point_index = np.tile(np.arange(NUM_POINTS), NUM_IMAGES)
    image_index = np.repeat(np.arange(NUM_IMAGES), NUM_POINTS)
    model = PlacedImages(poses, {name: name for name in poses}, points, point_index, image_index)
    return model, true_pairs(poses)


def true_pairs(poses):
    return [
        PairVerdict(
            status="ok",
            image1=name1,
            image2=name2,
            cam2_from_cam1=unit(poses[name2] @ poses[name1].inverse()),
            rotation_sigma_deg=0.1,
            translation_sigma_deg=0.3,
        )
        for name1, name2 in combinations(poses, 2)
    ]


def moved(model, name, pose):
    return replace(model, cam_from_world={**model.cam_from_world, name: pose})


def only(model, image, count):
    """Model in which an image sees only so many of the points."""
    kept = (model.image_index != image) | (model.point_index < count)
    return replace(model, point_index=model.point_index[kept], image_index=model.image_index[kept])


EVERYONE = {str(k) for k in range(NUM_IMAGES)}


def test_every_image_of_a_right_model_is_confirmed():
    model, pairs = walk()
    assert confirmed_images(model, pairs) == EVERYONE


@pytest.mark.parametrize("seed", range(5))
def test_the_order_of_images_points_and_pairs_does_not_matter(seed):
    model, pairs = walk()
    model = only(model, 5, 14)
    rng = np.random.default_rng(seed)
    names = list(model.cam_from_world)
    order = rng.permutation(NUM_IMAGES)
    shuffled = rng.permutation(len(model.point_index))
    other = PlacedImages(
        {names[k]: model.cam_from_world[names[k]] for k in order},
        model.frames,
        model.points,
        model.point_index[shuffled],
        np.argsort(order)[model.image_index[shuffled]],
    )
    turned = [
        replace(p, image1=p.image2, image2=p.image1, cam2_from_cam1=p.cam2_from_cam1.inverse())
        for p in (pairs[k] for k in rng.permutation(len(pairs)))
    ]
    assert confirmed_images(other, turned) == confirmed_images(model, pairs) == EVERYONE - {"5"}


def test_the_world_and_its_scale_do_not_matter():
    model, pairs = walk()
    other_from_world = Pose(rotation_from_vector([1.0, -0.4, 2.0]), np.array([3.0, 1.0, -2.0]))
    poses = {
        name: Pose(pose.rotation, 7.0 * pose.translation) @ other_from_world.inverse()
        for name, pose in only(model, 5, 14).cam_from_world.items()
    }
    points = 7.0 * model.points @ other_from_world.rotation.T + other_from_world.translation
    turned = replace(only(model, 5, 14), cam_from_world=poses, points=points)
    assert confirmed_images(turned, pairs) == EVERYONE - {"5"}


@pytest.mark.parametrize(("count", "confirmed"), [(14, False), (15, True)])
def test_an_image_needs_fifteen_points_that_others_know(count, confirmed):
    model, pairs = walk()
    assert ("5" in confirmed_images(only(model, 5, count), pairs)) is confirmed


def test_points_that_only_one_other_image_sees_say_nothing_about_the_distance():
    model, pairs = walk()
    # Image 5 has points of its own with image 4, so that it could stand anywhere on a line.
    own = (model.image_index == 5) | (model.image_index == 4)
    more = replace(
        model,
        points=np.concatenate([model.points, model.points + 0.1]),
        point_index=np.where(own & (model.image_index == 5), NUM_POINTS, 0) + model.point_index,
    )
    more = replace(
        more,
        point_index=np.concatenate([more.point_index, NUM_POINTS + np.arange(NUM_POINTS)]),
        image_index=np.concatenate([more.image_index, np.full(NUM_POINTS, 4)]),
    )
    assert confirmed_images(more, pairs) == EVERYONE - {"5"}


def test_points_seen_from_one_place_have_no_depth():
    model, pairs = walk(step=1e-4)
    flat = replace(model, points=1e3 * model.points)
    assert confirmed_images(flat, pairs) == set()


def test_an_image_that_one_pair_alone_holds_is_left_out():
    model, pairs = walk()
    few = [pair for pair in pairs if "5" not in (pair.image1, pair.image2) or pair.image1 == "4"]
    assert len(few) == len(pairs) - 4
    assert confirmed_images(model, few) == EVERYONE - {"5"}


@pytest.mark.parametrize("what", ["turned", "aside"])
def test_an_image_that_its_pairs_contradict_is_left_out(what):
    model, pairs = walk()
    pose = model.cam_from_world["2"]
    turn = rotation_from_vector([0.0, np.radians(8.0), 0.0])
    wrong = {
        "turned": Pose(turn @ pose.rotation, turn @ pose.translation),
        "aside": Pose(pose.rotation, pose.translation + [0.0, 0.0, 0.5]),
    }[what]
    assert confirmed_images(moved(model, "2", wrong), pairs) == EVERYONE - {"2"}


def test_two_wrong_images_do_not_confirm_each_other():
    model, pairs = walk()
    shift = Pose(np.eye(3), np.array([0.0, 5.0, 0.0]))  # 4 and 5 agree with one another only
    for name in ("4", "5"):
        model = moved(model, name, model.cam_from_world[name] @ shift)
    assert confirmed_images(model, pairs) == EVERYONE - {"4", "5"}


def test_uncertain_pairs_may_differ_by_four_sigmas():
    model, pairs = walk()
    pose = model.cam_from_world["2"]
    turn = rotation_from_vector([0.0, np.radians(8.0), 0.0])
    model = moved(model, "2", Pose(turn @ pose.rotation, turn @ pose.translation))
    unsure = [replace(pair, rotation_sigma_deg=2.0, translation_sigma_deg=2.0) for pair in pairs]
    assert "2" in confirmed_images(model, unsure)


def test_pairs_that_are_not_accepted_confirm_nothing():
    model, pairs = walk()
    for wrong in ({"status": "too_few_inliers"}, {"contradicted": True}, {"refused": "alone"}):
        judged = [replace(p, **wrong) if p.image2 == "5" else p for p in pairs]
        assert confirmed_images(model, judged) == EVERYONE - {"5"}


def test_a_pure_rotation_confirms_the_rotation():
    model, pairs = walk()
    judged = [
        replace(
            p,
            status="pure_rotation",
            cam2_from_cam1=Pose(p.cam2_from_cam1.rotation, np.full(3, np.nan)),
        )
        if p.image2 == "5"
        else p
        for p in pairs
    ]
    assert confirmed_images(model, judged) == EVERYONE


def test_images_of_a_moment_of_a_rig_stand_and_fall_together():
    model, pairs = walk()
    rig = replace(model, frames={str(k): str(k // 2) for k in range(NUM_IMAGES)})
    assert confirmed_images(rig, pairs) == EVERYONE
    few = [p for p in pairs if not ({"4", "5"} & {p.image1, p.image2})]
    assert confirmed_images(rig, few) == set()  # two moments have no third


def test_two_images_or_none_are_not_confirmed():
    model, pairs = walk()
    first = {name: model.cam_from_world[name] for name in ("0", "1")}
    kept = model.image_index < 2
    two = PlacedImages(
        first, model.frames, model.points, model.point_index[kept], model.image_index[kept]
    )
    assert confirmed_images(two, pairs) == set()
    empty = np.zeros(0, dtype=np.int64)
    assert confirmed_images(PlacedImages({}, {}, np.zeros((0, 3)), empty, empty), pairs) == set()


def lengths_of(model, pairs, factor=3.0):
    """True lengths of the pairs' translations, in another unit."""
    centers = {name: pose.inverse().translation for name, pose in model.cam_from_world.items()}
    return {
        (p.image1, p.image2): factor * float(np.linalg.norm(centers[p.image1] - centers[p.image2]))
        for p in pairs
    }


def hanging(num_points=20):
    """The walk, whose last image hangs on one pair, with points that its neighbour alone sees."""
    model, pairs = walk()
    is_last = model.point_index >= NUM_POINTS - num_points
    kept = np.where(model.image_index < 4, ~is_last, is_last) | (
        (model.image_index == 4) & ~is_last
    )
    few = replace(model, point_index=model.point_index[kept], image_index=model.image_index[kept])
    return few, [pair for pair in pairs if pair.image2 != "5"] + [pairs[-1]]


@pytest.mark.parametrize(("stretched", "confirmed"), [(1.0, True), (1.1, True), (1.5, False)])
def test_one_pair_is_enough_where_its_length_is_known_and_right(stretched, confirmed):
    model, pairs = hanging()
    assert (pairs[-1].image1, pairs[-1].image2) == ("4", "5")
    assert confirmed_images(model, pairs) == EVERYONE - {"5"}
    lengths = lengths_of(model, pairs)
    lengths["4", "5"] *= stretched
    assert ("5" in confirmed_images(model, pairs, lengths)) is confirmed
    assert EVERYONE - {"5"} <= confirmed_images(model, pairs, lengths)


@pytest.mark.parametrize(("num_points", "confirmed"), [(14, False), (15, True)])
def test_an_image_that_hangs_on_one_pair_needs_fifteen_points_too(num_points, confirmed):
    model, pairs = hanging(num_points)
    assert ("5" in confirmed_images(model, pairs, lengths_of(model, pairs))) is confirmed
    assert EVERYONE - {"5"} <= confirmed_images(model, pairs, lengths_of(model, pairs))


def test_one_length_alone_has_no_unit_and_takes_nothing_away():
    model, pairs = hanging()
    lengths = lengths_of(model, pairs)
    alone = {("4", "5"): lengths["4", "5"]}
    assert confirmed_images(model, pairs, alone) == EVERYONE - {"5"}
    model, pairs = walk()
    three = [pair for pair in pairs if {pair.image1, pair.image2} <= set("012")]
    assert confirmed_images(model, three) == set("012")
    for name1, name2 in combinations("012", 2):
        assert confirmed_images(model, three, {(name1, name2): 1.0}) == set("012")


def test_lengths_of_which_most_disagree_take_nothing_away():
    model, pairs = walk()
    lengths = lengths_of(model, pairs)
    lengths = {ends: 3.0**k * length for k, (ends, length) in enumerate(lengths.items())}
    assert confirmed_images(model, pairs, lengths) == EVERYONE
    two = dict(list(lengths.items())[:2])
    assert confirmed_images(model, pairs, two) == EVERYONE


def test_each_group_that_confirms_itself_is_found():
    """Two walks that nothing joins, the second of four images."""
    model, pairs = walk()
    apart = [pair for pair in pairs if (pair.image1 in "01") == (pair.image2 in "01")]
    apart = [pair for pair in apart if not {pair.image1, pair.image2} <= set("01")]
    assert confirmed_groups(model, apart) == [set("2345")]
    both = [pair for pair in pairs if (pair.image1 in "012") == (pair.image2 in "012")]
    assert sorted(map(sorted, confirmed_groups(model, both))) == [list("012"), list("345")]


def test_a_length_reaches_what_others_that_began_before_do_not():
    """The pair that is farthest apart has no length, and what it leads to holds other pairs."""
    model, pairs = hanging()
    lengths = {e: n for e, n in lengths_of(model, pairs).items() if e in (("0", "1"), ("4", "5"))}
    assert confirmed_images(model, pairs, lengths) == EVERYONE


def test_lengths_judge_what_they_reach_and_what_is_beside_them_only():
    _, pairs = walk()
    line = [pair for pair in pairs if int(pair.image2) == int(pair.image1) + 1]
    ends = {(pair.image1, pair.image2) for pair in line}
    known = {("0", "1"): 1.0, ("3", "4"): 1.0}
    assert judged_images(EVERYONE, line, known, ends) == EVERYONE
    assert judged_images(EVERYONE, line, known, ends - {("1", "2")}) == EVERYONE - {"2"}
    assert judged_images(EVERYONE, line, {("0", "1"): 1.0}, ends) == set("01")
    assert judged_images(EVERYONE, line, {}, ends) == set()
    assert judged_images(EVERYONE - {"3"}, line, {("0", "1"): 1.0}, ends) == set("012")


def test_a_pair_of_another_direction_is_not_enough_however_long():
    model, pairs = hanging()
    pose = model.cam_from_world["5"]
    elsewhere = moved(model, "5", Pose(pose.rotation, pose.translation + [0.0, 0.4, 0.0]))
    assert "5" not in confirmed_images(elsewhere, pairs, lengths_of(elsewhere, pairs))
