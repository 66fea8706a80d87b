# SPDX-License-Identifier: BSD-3-Clause
"""Images of a rendered room to verified poses, interrupted, changed and damaged on the way."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from rendered_views import NAMES, image_set, pictures, truth, write_png, write_views

from epi360.jobs.folder import feature_cache
from epi360.jobs.matching import match_job, pair_work, verified_matches
from epi360.jobs.matching.match_folder import MatchOptions, load_matches, match_images
from epi360.jobs.records import match_store
from epi360.poses import rotation_error_deg, translation_error_deg
from epi360.report.match_table import describe_match
from epi360.report.pairs_table import pairs_csv

FOR_PLACES = ("places", "rival poses", "second poses")  # stages
PAIRS = [(a, b) for a in range(4) for b in range(a + 1, 4)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_views(tmp_path_factory.mktemp("views"))


@pytest.fixture(scope="module")
def output(tmp_path_factory):
    return tmp_path_factory.mktemp("output") / "matches"


@pytest.fixture(scope="module")
def run(folder, output):
    return match_images(image_set(folder), output)


@pytest.fixture
def views(tmp_path):
    """A folder of its own, to change."""
    return write_views(tmp_path / "views", NAMES[:3])


@pytest.fixture
def extractions(monkeypatch):
    """Files whose key points are searched from now on."""
    searched = []
    extract = feature_cache.FeatureCache.extract

    def counted(cache, key, image, camera):
        searched.append(image.path.name)
        return extract(cache, key, image, camera)

    monkeypatch.setattr(feature_cache.FeatureCache, "extract", counted)
    return searched


@pytest.fixture
def verified(monkeypatch):
    """Number of pairs in each batch that is estimated from now on."""
    counts = []
    estimate = verified_matches.estimate_relative_poses

    def counted(pairs, **options):
        counts.append(len(pairs))
        return estimate(pairs, **options)

    monkeypatch.setattr("epi360.jobs.matching.folder_verdicts.find_rivals", lambda *_: {})
    monkeypatch.setattr(verified_matches, "estimate_relative_poses", counted)
    return counts


def stop_after(num_calls, stage="pairs"):
    calls = []

    def progress(name, done, total):
        calls.append(name)
        if calls.count(stage) > num_calls:
            raise KeyboardInterrupt

    return progress


def test_all_poses_agree_with_the_truth(run):
    assert [(v.image1, v.image2) for v in run.verdicts] == [(NAMES[a], NAMES[b]) for a, b in PAIRS]
    for verdict, pair in zip(run.verdicts, PAIRS, strict=True):
        assert verdict.accepted, verdict
        assert rotation_error_deg(verdict.cam2_from_cam1, truth(*pair)) < 0.5
        assert translation_error_deg(verdict.cam2_from_cam1, truth(*pair)) < 1.5
        assert verdict.num_inliers > 50
        assert 0 < verdict.rotation_sigma_deg < 0.3


def test_the_graph_holds_what_was_found(run, output, folder):
    graph = load_matches(output)
    assert list(graph.images) == NAMES
    assert graph.cameras == image_set(folder).cameras
    assert {image.camera for image in graph.images.values()} == {"512x256", "448x224"}
    for pair, verdict in zip(graph.pairs, run.verdicts, strict=True):
        assert (pair.image1, pair.image2) == (verdict.image1, verdict.image2)
        assert pair.geometry.status == "ok"
        assert len(pair.matches) == verdict.num_matches
        assert len(pair.geometry.inliers) == verdict.num_inliers
        pose = pair.geometry.cam2_from_cam1
        np.testing.assert_array_equal(pose.matrix(), verdict.cam2_from_cam1.matrix())


def test_inliers_of_the_graph_lie_on_the_epipolar_planes_of_the_truth(run, output):
    graph = load_matches(output)
    for pair, indices in zip(graph.pairs, PAIRS, strict=True):
        bearings = []
        for name, rows in zip((pair.image1, pair.image2), pair.geometry.inliers.T, strict=True):
            image = graph.images[name]
            camera = graph.cameras[image.camera]
            bearings.append(camera.bearings_from_pixels(image.keypoints[rows]))
        pose = truth(*indices)
        normals = np.cross(pose.translation, bearings[0] @ pose.rotation.T)
        sines = (bearings[1] * normals).sum(axis=1) / np.linalg.norm(normals, axis=1)
        assert np.median(np.abs(sines)) < np.radians(0.3)  # 0.7 degrees are a pixel


def test_a_second_run_only_reads(run, folder, output, extractions, verified):
    again = match_images(image_set(folder), output)
    assert extractions == []
    assert sum(verified) == 0
    assert again.num_found == len(PAIRS)
    assert pairs_csv(again) == pairs_csv(run)


def test_threads_do_not_show(run, folder, tmp_path):
    other = match_images(image_set(folder), tmp_path, MatchOptions(num_threads=1))
    assert pairs_csv(other) == pairs_csv(run)


def stored(output):
    return {path.relative_to(output): path.read_bytes() for path in output.glob("*/*.npz")}


def test_files_are_the_same_on_any_number_of_threads(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(match_job, "PAIRS_PER_PART", 2)
    for num_threads in (1, 5):  # one part at once, and all three
        output = tmp_path / str(num_threads)
        match_images(image_set(folder), output, MatchOptions(num_threads=num_threads))
    assert len(list((tmp_path / "1" / "pairs").iterdir())) == 3
    assert stored(tmp_path / "1") == stored(tmp_path / "5")


def test_parts_of_another_size_are_used(run, folder, tmp_path, monkeypatch, verified):
    # As a version before has left them: its parts were larger the more threads there were.
    with monkeypatch.context() as patched:
        patched.setattr(match_job, "PAIRS_PER_PART", 4)
        with pytest.raises(KeyboardInterrupt):
            match_images(image_set(folder), tmp_path, progress=stop_after(1))
    verified.clear()
    again = match_images(image_set(folder), tmp_path)
    assert again.num_found == 4
    assert verified[0] == 2
    assert pairs_csv(again) == pairs_csv(run)


@pytest.mark.parametrize("stage", ["features", "pairs"])
def test_an_interrupted_run_goes_on_to_the_same_bytes(
    run, folder, tmp_path, monkeypatch, verified, stage
):
    monkeypatch.setattr(match_job, "PAIRS_PER_PART", 2)
    options = MatchOptions(num_threads=1)
    with pytest.raises(KeyboardInterrupt):
        match_images(image_set(folder), tmp_path, options, progress=stop_after(2, stage))
    before = stored(tmp_path)
    assert before
    with pytest.raises(FileNotFoundError, match="no complete result"):
        load_matches(tmp_path)
    verified.clear()
    done = []
    again = match_images(
        image_set(folder), tmp_path, options, progress=lambda *call: done.append(call)
    )
    assert pairs_csv(again) == pairs_csv(run)
    assert before.items() <= stored(tmp_path).items()
    if stage == "pairs":
        assert next(call for call in done if call[0] == "pairs") == ("pairs", 4, 6)
        assert again.num_found == 4


def test_half_a_part_is_done_again(run, folder, output, tmp_path, verified):
    match_images(image_set(folder), tmp_path)
    (part,) = (tmp_path / "pairs").iterdir()
    part.write_bytes(part.read_bytes()[:-50])
    with pytest.raises(ValueError, match="damaged; run epi360 match"):
        load_matches(tmp_path)
    again = match_images(image_set(folder), tmp_path)
    assert again.num_found == 0
    assert pairs_csv(again) == pairs_csv(run)
    load_matches(tmp_path)


@pytest.mark.parametrize("pairs_are_there", [True, False])
def test_damaged_key_points_are_found_again(views, tmp_path, extractions, pairs_are_there):
    output = tmp_path / "out"
    first = match_images(image_set(views, NAMES[:3]), output)
    for path in (output / "features").iterdir():
        path.write_bytes(b"damaged")
    with pytest.raises(ValueError, match="missing or damaged; run epi360 match"):
        load_matches(output)
    for path in (output / "pairs").iterdir():
        if not pairs_are_there:
            path.unlink()
    extractions.clear()
    again = match_images(image_set(views, NAMES[:3]), output)
    assert set(extractions) == {"küche 1.png", "küche 2.png", "10.png"}
    assert pairs_csv(again) == pairs_csv(first)
    load_matches(output)


def test_only_what_changed_is_done_again(views, tmp_path, extractions, verified):
    output = tmp_path / "out"
    match_images(image_set(views, NAMES[:3]), output)
    moved = [*NAMES[:2], "neu/10 Ω.png"]
    (views / moved[2]).parent.mkdir()
    (views / NAMES[2]).rename(views / moved[2])
    extractions.clear()
    verified.clear()
    match_images(image_set(views, moved), output)
    assert extractions == []
    assert sum(verified) == 0
    assert list(load_matches(output).images) == moved
    write_png(views / NAMES[0], pictures()[3])
    run = match_images(image_set(views, moved), output)
    assert extractions == ["küche 1.png"]
    assert run.num_found == 1
    for verdict, pair in zip(run.verdicts, [(3, 1), (3, 2), (1, 2)], strict=True):
        assert rotation_error_deg(verdict.cam2_from_cam1, truth(*pair)) < 0.5


def test_new_images_are_added(views, tmp_path, extractions):
    output = tmp_path / "out"
    match_images(image_set(views, NAMES[:3]), output)
    write_views(views)
    extractions.clear()
    run = match_images(image_set(views), output)
    assert extractions == ["9.png"]
    assert (run.num_found, len(run.verdicts)) == (3, 6)


@pytest.mark.parametrize("when", ["listed", "hashed"])
@pytest.mark.parametrize("damage", ["vanished", "cut"])
def test_an_image_that_cannot_be_read_costs_only_its_pairs(views, tmp_path, when, damage):
    images = image_set(views, NAMES[:3])
    victim = views / NAMES[1]

    def spoil():
        if damage == "vanished":
            victim.unlink(missing_ok=True)
        else:
            victim.write_bytes(victim.read_bytes()[:1000])

    def progress(stage, done, total):
        if when == "hashed" and stage == "features" and done == 0:
            spoil()

    if when == "listed":
        spoil()
    run = match_images(images, tmp_path / "out", progress=progress)
    assert [verdict.status for verdict in run.verdicts] == [
        "unreadable_image", "ok", "unreadable_image",
    ]  # fmt: skip
    assert list(run.unreadable) == [NAMES[1]]
    assert "küche 2.png" in run.unreadable[NAMES[1]]
    assert run.unreadable[NAMES[1]] in pairs_csv(run).decode()
    assert f"Not used      {NAMES[1]}" in describe_match(run)
    assert list(load_matches(tmp_path / "out").images) == [NAMES[0], NAMES[2]]


def test_masked_parts_have_no_key_points(views, tmp_path):
    mask = np.zeros((256, 512, 3), np.uint8)
    mask[:, 100:400] = 255
    write_png(tmp_path / "mask.png", mask)
    images = image_set(views, NAMES[:2], mask=tmp_path / "mask.png")
    run = match_images(images, tmp_path / "out")
    assert run.verdicts[0].accepted
    for image in load_matches(tmp_path / "out").images.values():
        assert len(image.keypoints) > 100
        assert 100 <= image.keypoints[:, 0].min() <= image.keypoints[:, 0].max() < 400


def test_other_options_are_refused_until_asked(views, tmp_path, extractions, verified):
    output = tmp_path / "out"
    images = image_set(views, NAMES[:2])
    match_images(images, output)
    with pytest.raises(ValueError, match=r"was made with seed 0, now it is 1: .*--restart"):
        match_images(images, output, MatchOptions(seed=1))
    with pytest.raises(ValueError, match="was made with max_width 2048, now it is 300"):
        match_images(images, output, MatchOptions(max_width=300))
    extractions.clear()
    verified.clear()
    run = match_images(images, output, MatchOptions(seed=1), restart=True)
    assert extractions == []
    assert run.num_found == 0
    assert sum(verified) >= 1
    assert match_images(images, output, MatchOptions(seed=1)).num_found == 1


def test_the_result_of_other_images_is_not_replaced_until_asked(views, tmp_path):
    output = tmp_path / "out"
    match_images(image_set(views, NAMES[:2]), output)
    before = (output / "images.json").read_bytes()
    moved = ["moved/1.png", "moved/2.png"]
    write_views(views, moved)
    with pytest.raises(ValueError, match="is the result of 2 other images, such as .*--restart"):
        match_images(image_set(views, moved), output)
    assert (output / "images.json").read_bytes() == before
    match_images(image_set(views, moved), output, restart=True)
    assert set(load_matches(output).images) == set(moved)
    match_images(image_set(views, [NAMES[0], moved[1]]), output)  # one of them is the same
    assert set(load_matches(output).images) == {NAMES[0], moved[1]}


def test_a_damaged_list_of_images_is_written_again(views, tmp_path):
    images = image_set(views, NAMES[:2])
    match_images(images, tmp_path / "out")
    for text in ("{", '{"images": [3]}'):
        (tmp_path / "out" / "images.json").write_text(text)
        assert match_images(images, tmp_path / "out").num_found == 1
        assert set(load_matches(tmp_path / "out").images) == set(NAMES[:2])


def test_other_pairs_need_no_restart(views, tmp_path):
    images = image_set(views, NAMES[:3])
    match_images(images, tmp_path / "out", MatchOptions(pairs="sequential", overlap=1))
    listed = tmp_path / "pairs.txt"
    listed.write_text(f'"{NAMES[0]}" "{NAMES[1]}"\n', encoding="utf-8")
    run = match_images(images, tmp_path / "out", MatchOptions(pairs=listed))
    assert (run.num_found, len(run.verdicts)) == (1, 1)
    assert len(load_matches(tmp_path / "out").pairs) == 1


def test_weak_matches_get_a_second_look_with_all_key_points(views, tmp_path, monkeypatch):
    images = image_set(views, NAMES[:2])
    first = match_images(images, tmp_path / "a").verdicts[0]
    monkeypatch.setattr(pair_work, "CONTRAST_THRESHOLD", 0.9)  # nothing is strong
    second = match_images(images, tmp_path / "b").verdicts[0]
    assert second.accepted
    assert second.num_matches > first.num_matches


def test_the_same_picture_twice_is_a_pure_rotation(views, tmp_path):
    write_png(views / NAMES[1], pictures()[0])
    run = match_images(image_set(views, NAMES[:2]), tmp_path / "out")
    assert run.verdicts[0].status == "pure_rotation"
    (pair,) = load_matches(tmp_path / "out").pairs
    assert np.isnan(pair.geometry.cam2_from_cam1.translation).all()
    row = pairs_csv(run).decode().splitlines()[1].split(",")
    assert row[3] == "no"


def test_equal_pictures_are_searched_once(views, tmp_path, extractions):
    for name in NAMES:
        write_png(views / name, pictures()[0])
    images = image_set(views)
    same = tuple(dataclasses.replace(image, camera="512x256") for image in images.images)
    run = match_images(dataclasses.replace(images, images=same), tmp_path / "out")
    assert len(extractions) == 1
    assert {verdict.status for verdict in run.verdicts} == {"pure_rotation"}


def test_of_equal_pictures_another_is_taken_where_one_vanishes(views, tmp_path):
    write_png(views / NAMES[2], pictures()[1])  # as NAMES[1]
    images = image_set(views, NAMES[:3])
    same = tuple(dataclasses.replace(image, camera="512x256") for image in images.images)
    output = tmp_path / "out"

    def progress(stage, done, total):
        if (stage, done) == ("pairs", 0):
            (views / NAMES[2]).unlink(missing_ok=True)
            for path in (output / "features").iterdir():
                path.write_bytes(b"damaged")  # all have to be found again

    one = MatchOptions(num_threads=1)  # in turn: the picture that is there would come first
    run = match_images(dataclasses.replace(images, images=same), output, one, progress=progress)
    assert [verdict.status for verdict in run.verdicts] == [
        "ok", "unreadable_image", "unreadable_image",
    ]  # fmt: skip
    assert list(run.unreadable) == [NAMES[2]]


def test_a_folder_of_something_else_is_left_alone(views, tmp_path):
    with pytest.raises(ValueError, match="was not made by epi360 match"):
        match_images(image_set(views, NAMES[:2]), views)
    (tmp_path / "file").write_text("x")
    with pytest.raises(ValueError, match="must be a folder"):
        match_images(image_set(views, NAMES[:2]), tmp_path / "file")
    assert sorted(path.name for path in views.iterdir()) == ["Zimmer", "b"]


def test_a_run_that_was_stopped_at_its_very_start_goes_on(views, tmp_path, monkeypatch):
    output = tmp_path / "out"

    def stop(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(match_store, "write_file", stop)
        with pytest.raises(KeyboardInterrupt):  # the folder is there, its marker is not
            match_images(image_set(views, NAMES[:2]), output)
    (output / ".epi360-match.json.1.tmp").write_bytes(b"half")
    (output / ".DS_Store").write_bytes(b"")
    assert match_images(image_set(views, NAMES[:2]), output).verdicts[0].accepted


def test_a_damaged_marker_is_named(views, tmp_path):
    (tmp_path / match_store.MARKER).write_text("{")
    with pytest.raises(ValueError, match="epi360-match.json is damaged"):
        match_images(image_set(views, NAMES[:2]), tmp_path)


def test_frames_and_rig_come_back(views, tmp_path):
    images = image_set(views, NAMES[:2])
    framed = tuple(dataclasses.replace(image, frame="7") for image in images.images)
    rig = {"512x256": truth(0, 1)}
    images = dataclasses.replace(images, images=framed, cam_from_rig=rig)
    match_images(images, tmp_path / "out")
    graph = load_matches(tmp_path / "out")
    assert [image.frame for image in graph.images.values()] == ["7", "7"]
    np.testing.assert_array_equal(graph.cam_from_rig["512x256"].matrix(), rig["512x256"].matrix())


def test_a_damaged_index_is_named(views, tmp_path):
    match_images(image_set(views, NAMES[:2]), tmp_path / "out")
    index = tmp_path / "out" / match_store.IMAGES
    record = json.loads(index.read_text(encoding="utf-8"))
    no_key = [{**record["images"][0], "key": None}, {"name": "b"}]
    for damaged in ({"images": no_key}, {"pairs": [["a", "b"]]}, {"pairs": [["a"]]}):
        index.write_text(json.dumps({**record, **damaged}))
        with pytest.raises(ValueError, match=r"images.json is damaged|key points of .* missing"):
            load_matches(tmp_path / "out")
    index.write_text("{")
    with pytest.raises(ValueError, match="images.json is damaged"):
        load_matches(tmp_path / "out")


@pytest.mark.parametrize("name", ["overlap", "max_features", "num_threads"])
def test_options_out_of_range_are_refused(name):
    with pytest.raises(ValueError, match=f"{name} must be at least 1, got 0"):
        MatchOptions(**{name: 0})


def test_images_that_look_alike_are_paired_and_found_again_by_a_later_run(folder, tmp_path):
    stages = []
    options = MatchOptions(pairs="retrieval", neighbors=1, num_threads=1)
    run = match_images(
        image_set(folder), tmp_path, options, progress=lambda stage, *_: stages.append(stage)
    )
    assert run.how == "retrieval, 1 that look alike"
    assert 2 <= len(run.verdicts) <= 4
    assert {name for each in run.verdicts for name in (each.image1, each.image2)} == set(NAMES)
    # Whether there is a place to check depends on the pairs that look most alike.
    done = [each for each in dict.fromkeys(stages) if each not in FOR_PLACES]
    assert done == ["images", "features", "retrieval", "pairs"]
    again = match_images(image_set(folder), tmp_path, dataclasses.replace(options, num_threads=3))
    assert pairs_csv(again) == pairs_csv(run)
    assert again.num_found == len(run.verdicts)


def test_an_image_that_cannot_be_read_is_no_partner_of_retrieval(views, tmp_path):
    (views / NAMES[1]).write_bytes(b"no picture")
    options = MatchOptions(pairs="retrieval", neighbors=5)
    run = match_images(image_set(views, NAMES[:3]), tmp_path / "out", options)
    assert [(each.image1, each.image2) for each in run.verdicts] == [(NAMES[0], NAMES[2])]
    assert list(run.unreadable) == [NAMES[1]]


def test_images_that_were_taken_near_each_other_are_paired(tmp_path):
    lines = [f"{k} {x} 0 0 0 0 0 1" for k, x in enumerate((0.0, 5.0, 5.4, 0.3))]
    (tmp_path / "poses.txt").write_text("\n".join(lines))
    rows = [f"{name},{k}" for k, name in enumerate(NAMES)]
    pictures_here = write_views(tmp_path / "pictures")
    (pictures_here / "frames.csv").write_text("\n".join(["image,timestamp_s", *rows]))
    options = MatchOptions(pairs="near", positions=tmp_path / "poses.txt", radius=0.5)
    run = match_images(image_set(pictures_here), tmp_path / "out", options)
    assert run.how == f"near, 20 nearest within 0.5 by {tmp_path / 'poses.txt'}"
    paired = [(each.image1, each.image2) for each in run.verdicts]
    assert paired == [(NAMES[0], NAMES[3]), (NAMES[1], NAMES[2])]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"radius": 2.0}, 'radius must come with pairs="near", got pairs="auto"'),
        ({"pairs": "retrieval", "positions": "x.txt"}, 'positions must come with pairs="near"'),
        ({"pairs": "near", "radius": 0.0}, "radius must be above 0, got 0"),
        ({"pairs": "near", "radius": float("nan")}, "radius must be above 0, got nan"),
        ({"neighbors": 0}, "neighbors must be at least 1, got 0"),
        (
            {"pairs": "exhaustive", "overlap": 5},
            'overlap must come with pairs="sequential" or "auto", got pairs="exhaustive"',
        ),
        (
            {"pairs": "sequential", "neighbors": 5},
            'neighbors must come with pairs="retrieval", "near" or "auto", got pairs="sequential"',
        ),
        ({"pairs": "retrieval,near", "overlap": 5}, 'overlap must come with pairs="sequential"'),
        ({"pairs": Path("pairs.txt"), "neighbors": 5}, 'or "auto", got pairs="pairs.txt"'),
    ],
)
def test_options_of_partners_are_checked(changes, said):
    with pytest.raises(ValueError, match=said):
        MatchOptions(**changes)


@pytest.mark.parametrize("pairs", ["auto", "sequential,retrieval", "near,sequential"])
def test_numbers_of_partners_go_with_each_choice_that_uses_them(pairs):
    options = MatchOptions(pairs=pairs, overlap=3, neighbors=4)
    assert options.partners == {"overlap": 3, "neighbors": 4}


def test_few_images_that_are_all_paired_say_that_numbers_of_partners_are_not_used(folder, tmp_path):
    options = MatchOptions(overlap=1, neighbors=1)
    run = match_images(image_set(folder, NAMES[:2]), tmp_path, options)
    assert run.how == "exhaustive; overlap and neighbors not used"
