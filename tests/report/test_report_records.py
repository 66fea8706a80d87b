# SPDX-License-Identifier: BSD-3-Clause
"""What a program reads about a pair, and files that are whole or absent."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest

from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.estimation import Explanations, SamePlace
from epi360.poses import Pose
from epi360.report.files import check_figure_name, check_writable
from epi360.report.records import pair_record, truth_record, write_json
from epi360.runs.whole_files import write_file

CAMERA = Equirectangular(width=1024, height=512)


def fail_on_constant(name):
    raise AssertionError(f"{name} is not JSON")


def test_records_are_strict_json_and_round_trip(make_result, any_status, tmp_path):
    record = pair_record(make_result(any_status, CAMERA))
    write_json(tmp_path / "pair.json", record)
    text = (tmp_path / "pair.json").read_text(encoding="utf-8")
    assert json.loads(text, parse_constant=fail_on_constant) == record
    assert json.loads(json.dumps(record, allow_nan=False)) == record
    assert record["status"] == any_status
    assert record["success"] is (any_status == "ok")


def test_what_is_not_determined_is_null(make_result):
    record = pair_record(make_result("pure_rotation", CAMERA))
    assert record["cam2_from_cam1"]["translation"] == [None, None, None]
    assert record["E"] == [[None] * 3] * 3
    assert record["covariance"][4] == [0.0, 0.0, 0.0, 0.0, None]
    assert record["translation_sigma_deg"] is None
    assert record["rotation_sigma_deg"] == pytest.approx(np.degrees(np.sqrt(3e-6)), abs=1e-12)
    failed = pair_record(make_result("too_few_inliers", CAMERA))
    assert failed["cam2_from_cam1"] == {
        "rotation": [[None] * 3] * 3,
        "quaternion_wxyz": [None] * 4,
        "translation": [None] * 3,
    }


def test_the_record_names_the_explanations_and_those_unknown_are_null(make_result):
    known = replace(make_result("ok", CAMERA), explanations=Explanations(0.1, 0.0, 0.2, 0.7, 0.0))
    assert pair_record(known)["explanations"] == {
        "nothing": 0.1, "rotation": 0.0, "surface": 0.2, "motion": 0.7, "rival": 0.0,
    }  # fmt: skip
    unknown = replace(known, explanations=Explanations())
    assert set(pair_record(unknown)["explanations"].values()) == {None}


def test_the_record_has_the_cameras_of_the_pose(make_result):
    lens = KannalaBrandt(480, 480, np.float64(150.0), 150.0, 240.0, 240.0)
    record = pair_record(replace(make_result("ok", CAMERA), cameras=(lens, None)))
    assert record["camera1"]["model"] == "KannalaBrandt" and record["camera1"]["fx"] == 150.0
    assert record["camera2"] is None
    json.dumps(record, allow_nan=False)


def test_the_record_says_what_surrounds_the_matches(make_result):
    result = make_result("ok", CAMERA)
    assert pair_record(result)["place"] == {"here": None, "elsewhere": None, "copy": None}
    known = replace(result, place=SamePlace(0.5, 0.2, 0.3))
    assert pair_record(known)["place"] == {"here": 0.5, "elsewhere": 0.2, "copy": 0.3}


def test_the_record_holds_the_numbers_and_the_matches(make_result):
    result = make_result("ok", CAMERA)
    record = pair_record(result)
    np.testing.assert_array_equal(
        record["cam2_from_cam1"]["rotation"], result.cam2_from_cam1.rotation
    )
    np.testing.assert_array_equal(record["E"], result.E)
    np.testing.assert_array_equal(record["inlier_mask"], result.inlier_mask)
    np.testing.assert_array_equal(record["keypoints2"], result.keypoints2)
    assert record["num_inliers"] == sum(record["inlier_mask"]) == 45
    assert record["convention"] == "x2 = R x1 + t, x right, y down, z forward"


def test_alternatives_are_poses(make_result):
    record = pair_record(make_result("planar_ambiguous", CAMERA))
    assert [sorted(pose) for pose in record["alternatives"]] == [
        ["quaternion_wxyz", "rotation", "translation"]
    ]


def test_the_truth_record_has_the_errors():
    forward, right = np.array([0.0, 0.0, 1.0]), np.array([2.0, 0.0, 0.0])
    record = truth_record(Pose(np.eye(3), forward), Pose(np.eye(3), right))
    assert record["rotation_error_deg"] == pytest.approx(0.0, abs=1e-8)
    assert record["translation_error_deg"] == pytest.approx(90.0, abs=1e-8)
    assert truth_record(Pose.nan(), Pose(np.eye(3), right))["rotation_error_deg"] is None


def test_nan_that_slips_through_is_an_error_and_leaves_no_file(tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "a.json", {"noise_deg": float("nan")})
    assert list(tmp_path.iterdir()) == []


def test_a_file_is_replaced_whole_and_no_temporary_stays(tmp_path, monkeypatch):
    path = tmp_path / "out.bin"
    write_file(path, b"first")
    write_file(path, b"second")
    assert path.read_bytes() == b"second"

    def fail(source, target):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        write_file(path, b"third")
    assert path.read_bytes() == b"second"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(not hasattr(os, "symlink") or os.name == "nt", reason="needs symbolic links")
def test_a_link_is_followed_and_a_device_is_not_replaced(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "target")
    write_file(tmp_path / "link", b"data")
    assert (tmp_path / "target").read_bytes() == b"data"
    assert (tmp_path / "link").is_symlink()
    write_file(os.devnull, b"data")
    assert os.path.exists(os.devnull)
    assert not os.path.isfile(os.devnull)


def test_places_that_cannot_be_written_are_named(tmp_path):
    check_writable(tmp_path / "new.json")
    with pytest.raises(ValueError, match="--json must be a file, .* is a folder"):
        check_writable(tmp_path, name="--json")
    with pytest.raises(ValueError, match="--json: folder .*missing does not exist; create it"):
        check_writable(tmp_path / "missing" / "a.json", name="--json")


def test_a_figure_of_an_unknown_format_is_refused_with_those_that_are_known():
    check_figure_name("a.PNG")
    with pytest.raises(ValueError, match=r"--figure must end in one of \.png.*, got 'a\.gif'"):
        check_figure_name("a.gif", name="--figure")


def test_a_file_that_cannot_be_written_is_named_as_it_was_asked_for(tmp_path):
    path = tmp_path / "missing" / "out.bin"
    with pytest.raises(FileNotFoundError) as caught:
        write_file(path, b"data")
    assert caught.value.filename == str(path)
