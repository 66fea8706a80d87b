# SPDX-License-Identifier: BSD-3-Clause
"""Results of images are kept, and made again where anything changed that they depend on."""

import dataclasses

import numpy as np
import pytest
from written_map import CAMERA, write_map

import epi360
from epi360.cameras import KannalaBrandt
from epi360.features.picture_writing import encode_picture
from epi360.jobs.localization import localize_files as module
from epi360.jobs.localization.kept_results import read_result, write_result
from epi360.jobs.localization.localize_files import localize_files

pytest.importorskip("h5py")


@pytest.fixture
def folder(tmp_path):
    write_map(tmp_path)
    return tmp_path


@pytest.fixture
def made(monkeypatch):
    """Images that were localized and not taken from the folder of results."""
    names = []

    def counted(path, **options):
        names.append(path.name)
        return epi360.localize_image(path, **options)

    monkeypatch.setattr(module, "localize_image", counted)
    return names


def run(folder, **given):
    world = epi360.load_map(folder, features=folder / "features.h5")
    files = {"new.png": folder / "new" / "new.png"}
    return localize_files(files, world, keep=folder / "kept", **given)


def assert_same(result, other):
    for field in dataclasses.fields(result):
        value, kept = getattr(result, field.name), getattr(other, field.name)
        if isinstance(value, epi360.Pose):
            value, kept = value.matrix(), kept.matrix()
        elif field.name == "alternatives":
            value, kept = ([pose.matrix() for pose in poses] for poses in (value, kept))
        elif field.name in ("camera", "status", "warnings", "map_images"):
            assert value == kept
            continue
        np.testing.assert_array_equal(value, kept, err_msg=field.name)


def test_what_is_done_is_not_done_again(folder, made):
    first = run(folder)
    again = run(folder)
    assert made == ["new.png"] and (first.num_kept, again.num_kept) == (0, 1)
    assert first.results["new.png"].success
    assert_same(first.results["new.png"], again.results["new.png"])


def test_a_picture_that_is_gone_costs_itself_alone(folder):
    world = epi360.load_map(folder, features=folder / "features.h5")
    there = folder / "new" / "new.png"
    files = {"gone.png": folder / "new" / "gone.png", "new.png": there}
    found = localize_files(files, world, keep=folder / "kept")
    assert found.reasons["gone.png"].endswith("cannot be opened: No such file or directory")
    assert found.results["new.png"].success


@pytest.mark.parametrize(
    "given",
    [
        {"options": epi360.LocalizationOptions(seed=1)},
        {"options": epi360.LocalizationOptions(known_place=True)},
        {"camera": CAMERA},
    ],
)
def test_other_options_make_other_results(given, folder, made):
    run(folder)
    assert run(folder, **given).num_kept == 0
    assert run(folder).num_kept == 1 and len(made) == 2


def test_another_picture_mask_or_map_is_localized_again(folder, made):
    run(folder)
    black = np.full((CAMERA.height, CAMERA.width, 3), 255, np.uint8)
    (folder / "mask.png").write_bytes(encode_picture(black, ".png"))
    assert run(folder, mask=folder / "mask.png").num_kept == 0
    (folder / "new" / "new.png").write_bytes(encode_picture(black - 1, ".png"))
    assert run(folder).num_kept == 0
    points = folder / "sparse" / "0" / "points3D.bin"
    data = bytearray(points.read_bytes())
    data[23] ^= 1  # the sign, exponent or first digits of a coordinate
    points.write_bytes(bytes(data))
    assert run(folder).num_kept == 0
    assert len(made) == 4


def test_a_damaged_result_is_made_again(folder, made):
    before = run(folder).results["new.png"]
    (file,) = (folder / "kept").glob("result-*.npz")
    content = file.read_bytes()
    for damaged in (b"", content[:-30]):
        file.write_bytes(damaged)
        found = run(folder)
        assert found.num_kept == 0
        np.testing.assert_array_equal(found.results["new.png"].points, before.points)
    assert len(made) == 3


def test_a_result_without_pose_and_any_camera_is_kept_whole(folder, tmp_path):
    result = run(folder).results["new.png"]
    camera = KannalaBrandt(
        360, 360, 103.0, 103.0, 180.0, 180.0, 0.0, 0.0, 0.0, 0.0, max_angle_deg=100
    )
    poses = result.cam_from_world, result.cam_from_world.inverse()
    nowhere = dataclasses.replace(
        result, camera=camera, cam_from_world=epi360.Pose.nan(), status="too_few_inliers",
        alternatives=poses, seen_share=float("nan"), warnings=("a", "b"),
    )  # fmt: skip
    write_result(tmp_path / "a.npz", nowhere)
    assert_same(nowhere, read_result(tmp_path / "a.npz"))


def test_each_image_may_have_a_camera_of_its_own(folder, made):
    with pytest.raises(ValueError, match=r"but its camera is 64x32"):
        run(folder, camera={"new.png": epi360.Equirectangular(64, 32)})
    found = run(folder, camera={"new.png": CAMERA})
    assert found.results["new.png"].camera == CAMERA
    assert run(folder, camera=CAMERA).num_kept == 1  # the same question
