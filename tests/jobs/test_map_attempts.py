# SPDX-License-Identifier: BSD-3-Clause
"""What is tried when a mapper leaves images out, what is kept, and what is taken out again."""

from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from mapped_room import room_poses
from test_mapping import aligned_errors

pycolmap = pytest.importorskip("pycolmap")

from epi360.cameras import Equirectangular  # noqa: E402
from epi360.interop import MatchedImage, MatchedPair, MatchGraph, TwoViewGeometry  # noqa: E402
from epi360.interop.colmap_database import write_colmap_database  # noqa: E402
from epi360.jobs.mapping import map_attempts  # noqa: E402
from epi360.jobs.mapping.colmap_mapper import MapperOptions  # noqa: E402
from epi360.jobs.mapping.composed_poses import ComposedPoses, composed_poses  # noqa: E402
from epi360.jobs.mapping.given_poses import model_from_poses  # noqa: E402
from epi360.jobs.mapping.map_attempts import map_by_attempts  # noqa: E402
from epi360.jobs.matching.match_folder import PairVerdict  # noqa: E402
from epi360.poses import Pose, rotation_from_vector  # noqa: E402

CAMERA = Equirectangular(1024, 512)
COUNT = 20  # images of the made-up graph below


def exact_graph(world_from_cam, points, noise_px=0.0):
    """Key points of the same points in all panoramas, with all pairs, and their verdicts."""
    rng = np.random.default_rng(0)
    images, pairs, verdicts = {}, [], []
    rows = np.arange(len(points))
    matches = np.column_stack([rows, rows])
    for name, pose in world_from_cam.items():
        seen = (points - pose.translation) @ pose.rotation
        pixels = CAMERA.pixels_from_bearings(seen / np.linalg.norm(seen, axis=1, keepdims=True))
        pixels = np.clip(pixels + noise_px * rng.normal(size=pixels.shape), 0.01, (1023, 511))
        images[name] = MatchedImage(name, "c", pixels)
    for name1, name2 in combinations(images, 2):
        pose = world_from_cam[name2].inverse() @ world_from_cam[name1]
        unit = Pose(pose.rotation, pose.translation / np.linalg.norm(pose.translation))
        pairs.append(MatchedPair(name1, name2, matches, TwoViewGeometry("ok", unit, matches)))
        verdicts.append(PairVerdict(status="ok", image1=name1, image2=name2, cam2_from_cam1=unit))
    return MatchGraph({"c": CAMERA}, images, tuple(pairs), {}), verdicts


def points_around(count=300, nearest=2.0):
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return directions * rng.uniform(nearest, 4 * nearest, (count, 1))


def grey(graph):
    return {name: np.full((len(i.keypoints), 3), 9, np.uint8) for name, i in graph.images.items()}


def poses_in(model):
    return {
        image.name: Pose.from_matrix(image.cam_from_world().matrix()).inverse()
        for image in model.images.values()
        if image.has_pose
    }


@pytest.fixture(scope="module")
def many():
    """Graph of images that pairs connect; nothing in it is mapped."""
    poses = {
        f"{k:02d}": Pose(np.eye(3), np.array([0.1 * k, 0.0, 0.01 * k**2])) for k in range(COUNT)
    }
    return exact_graph(poses, points_around(20))


def fake(num_images, error_px=0.5):
    return SimpleNamespace(
        num_reg_images=lambda: num_images,
        compute_mean_reprojection_error=lambda: error_px,
    )


def tried(monkeypatch, many, tmp_path, *found, **options):
    """Attempts where each way finds one of the models, or None; the check takes nothing out."""
    left = list(found)

    def run(*_, **__):
        model = left.pop(0)
        return [] if model is None else [model]

    monkeypatch.setattr(map_attempts, "run_mapper", run)
    monkeypatch.setattr(map_attempts, "_without_unconfirmed", lambda *_, **__: [])
    graph, verdicts = many
    return map_by_attempts(
        tmp_path / "none.db", MapperOptions(**options), graph, verdicts, colors=grey(graph)
    )


@pytest.mark.parametrize("placed", [COUNT, COUNT - 1])
def test_a_mapper_that_places_nearly_all_images_is_the_only_one(
    monkeypatch, many, tmp_path, placed
):
    model = fake(placed)
    mapped = tried(monkeypatch, many, tmp_path, model)
    assert mapped.models == [model]
    assert [(a.how, a.num_registered, a.kept) for a in mapped.attempts] == [
        ("incremental mapper", placed, True)
    ]


def test_the_way_that_places_most_images_is_kept(monkeypatch, many, tmp_path):
    models = fake(COUNT - 2), fake(COUNT - 3), fake(COUNT)
    mapped = tried(monkeypatch, many, tmp_path, *models)
    assert mapped.models == [models[2]]
    assert [(a.how, a.num_registered, a.kept) for a in mapped.attempts] == [
        ("incremental mapper", COUNT - 2, False),
        ("global mapper", COUNT - 3, False),
        ("incremental mapper with small angles", COUNT, True),
    ]


def test_of_equal_ways_the_one_that_was_asked_for_is_kept_and_else_that_with_less_error(
    monkeypatch, many, tmp_path
):
    models = fake(9, 0.9), fake(9, 0.5), fake(9, 0.1)
    assert tried(monkeypatch, many, tmp_path, *models).models == [models[0]]
    models = fake(8, 0.1), fake(9, 0.5), fake(9, 0.4)
    assert tried(monkeypatch, many, tmp_path, *models).models == [models[2]]


def test_the_global_mapper_is_first_where_it_was_asked_for(monkeypatch, many, tmp_path):
    mapped = tried(monkeypatch, many, tmp_path, None, fake(COUNT), mapper="global")
    assert [(a.how, a.num_registered) for a in mapped.attempts] == [
        ("global mapper", 0),
        ("incremental mapper", COUNT),
    ]


def test_where_nothing_works_all_ways_are_named(monkeypatch, many, tmp_path):
    mapped = tried(monkeypatch, many, tmp_path, None, None, None)
    assert mapped.models == []
    assert [a.num_registered for a in mapped.attempts] == [0, 0, 0]
    assert [a.mean_error_px for a in mapped.attempts] == [None, None, None]


@pytest.mark.parametrize("status", ["pure_rotation", "too_few_inliers", None])
def test_pairs_without_a_translation_start_no_mapper(monkeypatch, many, tmp_path, status):
    graph, verdicts = many
    pairs = [
        replace(pair, geometry=None if status is None else replace(pair.geometry, status=status))
        for pair in graph.pairs
    ]
    still = replace(graph, pairs=tuple(pairs)), verdicts
    mapped = tried(monkeypatch, still, tmp_path)
    assert (mapped.models, mapped.attempts, mapped.unconfirmed) == ([], (), ())
    # One pair with a translation is enough to try; here all three ways find nothing.
    one = replace(graph, pairs=(*pairs[1:], graph.pairs[0])), verdicts
    assert len(tried(monkeypatch, one, tmp_path, None, None, None).attempts) >= 1


def test_a_clip_too_slow_for_the_incremental_mapper_is_mapped_all_the_same(tmp_path):
    truth = {
        f"{k:02d}": Pose(
            rotation_from_vector([0.0, 0.01 * k, 0.0]),
            np.array([0.008 * k, 0.001 * (k % 3), 0.002 * k]),
        )
        for k in range(12)
    }
    graph, verdicts = exact_graph(truth, points_around(), noise_px=0.02)
    write_colmap_database(tmp_path / "database.db", graph)
    mapped = map_by_attempts(
        tmp_path / "database.db", MapperOptions(), graph, verdicts, colors=grey(graph)
    )
    assert mapped.attempts[0].num_registered == 0
    assert mapped.attempts[-1].kept and mapped.attempts[-1].num_registered == 12
    position, degrees = aligned_errors(poses_in(mapped.models[0]), truth)
    assert position < 0.01 and degrees < 0.05  # 0.02 pixels over 88 mm, points at 2 to 8 m


def right_model(folder, count):
    """A graph of so many images with its verdicts, their true poses, and the model of these."""
    truth = {f"{k}": pose for k, pose in enumerate(room_poses(count)[:count])}
    graph, verdicts = exact_graph(truth, points_around())
    write_colmap_database(folder / "database.db", graph)
    cam_from_world = {name: pose.inverse() for name, pose in truth.items()}
    model = model_from_poses(folder / "database.db", cam_from_world, MapperOptions())
    return graph, verdicts, truth, model


def move(model, name, truth):
    """Put an image of a model 3 m off its true place."""
    (image,) = (each for each in model.images.values() if each.name == name)
    pose = truth[name].inverse()
    moved = pycolmap.Rigid3d(pycolmap.Rotation3d(pose.rotation), pose.translation + [0.0, 3.0, 0.0])
    model.frame(image.frame_id).set_cam_from_world(image.camera_id, moved)


def taken_out(models, graph, verdicts, lengths=None, looked_at=None, *, is_trusted=False):
    everyone = frozenset((each.image1, each.image2) for each in verdicts)
    looked_at = everyone if looked_at is None else looked_at
    known = ComposedPoses(lengths=lengths or {}, looked_at=looked_at)
    return map_attempts._without_unconfirmed(
        models, graph, verdicts, lambda: known, MapperOptions(), is_trusted=is_trusted
    )


def test_an_image_at_a_wrong_place_is_taken_out_and_the_others_are_adjusted(tmp_path):
    graph, verdicts, truth, model = right_model(tmp_path, 6)
    move(model, "4", truth)
    models = [model]
    assert taken_out(models, graph, verdicts) == ["4"]
    found = poses_in(models[0])
    assert found.keys() == truth.keys() - {"4"}
    position, degrees = aligned_errors(found, truth)
    assert position < 1e-4 and degrees < 1e-3  # exact key points, in single precision


def test_a_trusted_way_is_doubted_only_where_lengths_are_known(tmp_path):
    graph, verdicts, truth, model = right_model(tmp_path, 6)
    lengths = lengths_of(truth, verdicts)
    assert taken_out([model], graph, verdicts, lengths, is_trusted=True) == []
    move(model, "4", truth)
    assert taken_out([model], graph, verdicts, is_trusted=True) == []
    assert model.num_reg_images() == 6
    assert taken_out([model], graph, verdicts, lengths, is_trusted=True) == ["4"]
    assert model.num_reg_images() == 5


def lengths_of(truth, verdicts):
    places = {name: pose.translation for name, pose in truth.items()}
    return {
        (each.image1, each.image2): float(np.linalg.norm(places[each.image1] - places[each.image2]))
        for each in verdicts
    }


def test_of_a_trusted_way_images_that_no_length_could_reach_stay(tmp_path):
    """A length that is not known says nothing where nobody asked for it, or nothing is near."""
    graph, verdicts, truth, model = right_model(tmp_path, 6)
    move(model, "4", truth)
    lengths = lengths_of(truth, verdicts)
    without = {ends: length for ends, length in lengths.items() if "4" not in ends}
    room = {ends: without[ends] for ends in combinations("012", 2)}
    assert taken_out([model], graph, verdicts, room, is_trusted=True) == []
    some = frozenset(lengths) - {("3", "4")}
    assert taken_out([model], graph, verdicts, without, some, is_trusted=True) == []
    assert taken_out([model], graph, verdicts, without, is_trusted=True) == ["4"]


def test_of_a_trusted_way_what_is_beside_a_sound_model_stays(tmp_path):
    (tmp_path / "few").mkdir()
    graph, verdicts, _, model = right_model(tmp_path, 6)
    _, _, _, few = right_model(tmp_path / "few", 2)
    models = [model, few]
    assert taken_out(models, graph, verdicts, {("0", "1"): 1.0}, is_trusted=True) == []
    assert models == [model, few]


def test_a_model_that_nothing_confirms_is_dropped(tmp_path):
    graph, _, truth, model = right_model(tmp_path, 4)
    models = [model]
    assert taken_out(models, graph, []) == sorted(truth)
    assert models == []


def hanging_on_one_pair(truth, num_matches=40):
    """All see the same points, but the last image only some others, with one of them alone."""
    graph, verdicts = exact_graph(truth, points_around(), noise_px=0.1)
    last, beside = list(truth)[-1], list(truth)[-2]
    pairs, told = [], []
    for pair, verdict in zip(graph.pairs, verdicts, strict=True):
        if last not in (pair.image1, pair.image2):
            rows = pair.matches[:-num_matches]
        elif beside in (pair.image1, pair.image2):
            rows = pair.matches[-num_matches - 10 :]
        else:
            continue
        pairs.append(replace(pair, matches=rows, geometry=replace(pair.geometry, inliers=rows)))
        told.append(verdict)
    return replace(graph, pairs=tuple(pairs)), told


def test_an_image_that_hangs_on_one_pair_is_placed_by_the_poses_of_the_pairs(tmp_path):
    """It shares ten points with the others, of which COLMAP's mapper wants fifteen."""
    truth = {f"{k}": pose for k, pose in enumerate(room_poses(6)[:6])}
    graph, verdicts = hanging_on_one_pair(truth)
    write_colmap_database(tmp_path / "database.db", graph)
    composed = composed_poses(graph, verdicts, lambda name: None)
    assert set(composed.cam_from_world) == set(truth)
    for compose, placed in ((ComposedPoses, 5), (lambda: composed, 6)):
        mapped = map_by_attempts(
            tmp_path / "database.db",
            MapperOptions(),
            graph,
            verdicts,
            colors=grey(graph),
            compose=compose,
        )
        assert mapped.models[0].num_reg_images() == placed
    assert [attempt.how for attempt in mapped.attempts] == [
        "incremental mapper", "the poses of the pairs"
    ]  # fmt: skip
    place, rotation = aligned_errors(poses_in(mapped.models[0]), truth)
    assert place < 0.02 and rotation < 0.2


def test_what_was_found_is_counted_after_images_were_taken_out(monkeypatch, many, tmp_path):
    """They may all be in another model, so that none of them is lost."""
    graph, verdicts = many

    def shrink(models, *_, **__):
        models[0].num_reg_images = lambda: 3
        return []

    monkeypatch.setattr(map_attempts, "run_mapper", lambda *_, **__: [fake(6)])
    monkeypatch.setattr(map_attempts, "_without_unconfirmed", shrink)
    mapped = map_by_attempts(
        tmp_path / "none.db", MapperOptions(), graph, verdicts, colors=grey(graph)
    )
    assert mapped.attempts[0].num_registered == 3
