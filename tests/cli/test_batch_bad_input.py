# SPDX-License-Identifier: BSD-3-Clause
"""Wrong input of `epi360 batch`: one sentence that names the row, exit code 2, work kept."""

import math
import os

import numpy as np
import pytest
from batch_inputs import columns_of, write_matches

from epi360 import cli
from epi360.runs.lock import only_run

pyarrow = pytest.importorskip("pyarrow")

YAML = '{"model": "Equirectangular", "width": 1024, "height": 512}'


def complaint(capsys, *words) -> str:
    """What `epi360 batch` says on its one line of errors; exit code 2."""
    assert cli.main(["batch", *map(str, words)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = [line for line in captured.err.splitlines() if line.startswith("epi360: error: ")]
    assert len(lines) == 1 and "Traceback" not in captured.err
    return lines[0].removeprefix("epi360: error: ")


def complaint_about(capsys, tmp_path, columns, *words, schema=None) -> str:
    path = write_matches(tmp_path / "in.parquet", columns, schema=schema)
    said = complaint(capsys, path, "--output", tmp_path / "out.parquet", *words)
    assert not (tmp_path / "out.parquet").exists()
    return said


@pytest.mark.parametrize("content", [b"", b"PAR1", b"no such thing", b"SQLite format 3\0"])
def test_a_file_of_another_kind(tmp_path, capsys, content):
    (tmp_path / "in").write_bytes(content)
    said = complaint(capsys, tmp_path / "in", "--output", tmp_path / "out.parquet")
    assert str(tmp_path / "in") in said
    assert os.listdir(tmp_path) == ["in"]


@pytest.mark.parametrize("share", [0.3, 0.999])
def test_a_truncated_file(tmp_path, capsys, share):
    path = write_matches(tmp_path / "in.parquet", columns_of(3))
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    said = complaint(capsys, path, "--output", tmp_path / "out.parquet")
    assert f"{path} is no Parquet file, or truncated or damaged" in said


def test_a_page_that_is_damaged(tmp_path, capsys):
    path = write_matches(tmp_path / "in.parquet", columns_of(3))
    content = bytearray(path.read_bytes())
    content[len(content) // 2 : len(content) // 2 + 8000] = b"\xff" * 8000
    path.write_bytes(content)
    said = complaint(capsys, path, "--output", tmp_path / "out.parquet")
    assert str(path) in said


def test_no_such_file(tmp_path, capsys):
    said = complaint(capsys, tmp_path / "none.parquet", "--output", tmp_path / "out.parquet")
    assert said == f"{tmp_path / 'none.parquet'}: No such file or directory"


def test_missing_columns_are_named(tmp_path, capsys):
    columns = columns_of(2)
    del columns["image1"], columns["bearings2"]
    said = complaint_about(capsys, tmp_path, columns)
    assert "must have the columns image1, image2, bearings1, bearings2; it lacks " in said
    assert said.endswith("it lacks image1, bearings2")


def test_a_name_of_another_format_is_refused_before_the_work(tmp_path, capsys):
    path = write_matches(tmp_path / "in.parquet", columns_of(2))
    said = complaint(capsys, path, "--output", tmp_path / "poses.CSV")
    assert "poses.CSV: poses are written as a Parquet table, name it *.parquet" in said
    assert os.listdir(tmp_path) == ["in.parquet"]


def test_pixels_need_their_cameras(tmp_path, capsys):
    columns = columns_of(2)
    columns = {name.replace("bearings", "pixels"): column for name, column in columns.items()}
    assert "--camera FILE" in complaint_about(capsys, tmp_path, columns)


@pytest.mark.parametrize(
    ("name", "values", "fragment"),
    [
        ("image1", [1, 2], "image1 must be text, got int64"),
        ("bearings2", ["a", "b"], "bearings2 must be lists of numbers, got string"),
        ("bearings2", [1.0, 2.0], "bearings2 must be lists of numbers, got double"),
        ("bearings1", [["a"], ["b"]], "bearings1 must be lists of numbers, got list"),
    ],
)
def test_wrong_types_are_named(tmp_path, capsys, name, values, fragment):
    assert fragment in complaint_about(capsys, tmp_path, {**columns_of(2), name: values})


def x_before_y(row):
    return np.reshape(row, (-1, 3)).T.ravel().tolist()


def spoilt(name, row, change):
    columns = columns_of(3)
    columns[name][row] = change(columns[name][row])
    return columns


@pytest.mark.parametrize(
    ("columns", "fragment"),
    [
        (spoilt("bearings2", 1, lambda row: row[:-3]), "(a/1.jpg b/ä 1.jpg) must have as many"),
        (spoilt("bearings1", 1, lambda row: row[:-1]), "3 numbers a match, row 1 has 299"),
        (spoilt("bearings1", 2, lambda row: [math.inf, *row[1:]]), "row 2 (a/2.jpg b/ä 2.jpg)"),
        (spoilt("bearings2", 0, lambda row: [*row[:-3], 0, 0, 0]), "match 99 is zero in image 2"),
        (spoilt("bearings2", 1, lambda row: [9 * x for x in row]), "row 1 have lengths of 9 to 9"),
        (spoilt("bearings1", 2, x_before_y), "x, y, z of one match after the other"),
        (spoilt("bearings2", 0, lambda row: None), "bearings2 must be a list, row 0 is null"),
        (spoilt("image1", 1, lambda row: None), "image1 must be a name, row 1 is null"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("size", [1, 1000])
def test_a_row_that_cannot_be_used_is_named(tmp_path, capsys, columns, fragment, size):
    assert fragment in complaint_about(capsys, tmp_path, columns, "--pairs-per-part", size)


def test_nested_lists_of_another_length_are_named(tmp_path, capsys):
    columns = columns_of(3)
    for name in ("bearings1", "bearings2"):
        columns[name] = [[row[k : k + 3] for k in range(0, len(row), 3)] for row in columns[name]]
    columns["bearings2"][1][5] = [1.0, 2.0]
    said = complaint_about(capsys, tmp_path, columns)
    assert "bearings2 must be lists of 3 numbers, row 1 has one of 2" in said
    columns["bearings2"][1][5] = None
    assert "row 1" in complaint_about(capsys, tmp_path, columns)


def test_a_pair_that_is_there_twice_is_found_before_any_work(tmp_path, capsys):
    columns = columns_of(4)
    columns["image1"][3], columns["image2"][3] = columns["image1"][1], columns["image2"][1]
    said = complaint_about(capsys, tmp_path, columns, "--pairs-per-part", 1)
    assert "the pair a/1.jpg b/ä 1.jpg is there twice, in rows 1 and 3" in said
    assert not (tmp_path / "out.parquet.parts").exists()


def test_no_pairs(tmp_path, capsys):
    table = pyarrow.table(columns_of(2))
    columns = {name: [] for name in table.column_names}
    assert "has no pairs" in complaint_about(capsys, tmp_path, columns, schema=table.schema)


def test_a_bad_row_is_found_before_any_work(tmp_path, capsys):
    # The corrected file is another input: parts that were finished would be lost.
    columns = columns_of(4)
    columns["bearings1"][3][4] = -math.inf
    said = complaint_about(capsys, tmp_path, columns, "--pairs-per-part", 1)
    assert "row 3" in said
    assert os.listdir(tmp_path) == ["in.parquet"]


def test_an_image_without_camera_is_named(tmp_path, capsys):
    columns = columns_of(2)
    columns = {name.replace("bearings", "pixels"): column for name, column in columns.items()}
    columns["pixels1"] = columns["pixels2"] = [[1.0, 2.0], [3.0, 4.0]]
    (tmp_path / "two.yaml").write_text(f"cameras: {{a: {YAML}, c: {YAML}}}")
    said = complaint_about(capsys, tmp_path, columns, "--camera", tmp_path / "two.yaml")
    assert "b/ä 0.jpg has no camera" in said


def test_infinite_pixels_are_named(tmp_path, capsys):
    columns = columns_of(2)
    columns = {name.replace("bearings", "pixels"): column for name, column in columns.items()}
    columns["pixels1"], columns["pixels2"] = [[1, 2], [3, 4]], [[1.0, 2.0], [math.inf, 4.0]]
    (tmp_path / "one.yaml").write_text(YAML)
    said = complaint_about(capsys, tmp_path, columns, "--camera", tmp_path / "one.yaml")
    assert "row 1 (a/1.jpg b/ä 1.jpg) must be finite" in said


@pytest.mark.parametrize(
    ("words", "fragment"),
    [
        (["--engine", "spark"], "spark"),
        (["--seed", "one"], "seed"),
        (["--pairs-per-part", "0"], "--pairs-per-part must be 1 or more, got 0"),
        (["--num-threads", "0"], "must be 1 or more, got 0"),
        (["--threads", "0"], "must be 1 or more, got 0"),
        (["--address", "auto"], "--address goes with --engine ray"),
        (["--engine", "ray", "--num-threads", "2"], "--num-threads goes with --engine local"),
        (["--features", "f.h5"], "--features and --pairs go with hloc's matches"),
        (["--write-database", "out.db"], "only from a COLMAP database"),
        (["--camera", "none.yaml"], "none.yaml does not exist"),
        (["--nope"], "--nope"),
    ],
)
def test_wrong_words_are_one_line_and_nothing_is_written(tmp_path, capsys, words, fragment):
    path = write_matches(tmp_path / "in.parquet", columns_of(2))
    said = complaint(capsys, path, "--output", tmp_path / "out.parquet", *words)
    assert fragment in said
    assert os.listdir(tmp_path) == ["in.parquet"]


@pytest.mark.skipif(os.name != "posix", reason="Windows lets nobody read a locked file")
def test_an_output_that_another_run_is_writing(tmp_path, capsys):
    path, output = write_matches(tmp_path / "in.parquet", columns_of(2)), tmp_path / "out.parquet"
    with only_run(str(output)):
        said = complaint(capsys, path, "--output", output)
    assert said.startswith(f"another run (process {os.getpid()} on ")
    assert said.endswith(f" is writing {output}; wait for it or stop it")
    assert os.listdir(tmp_path) == ["in.parquet"]
    assert cli.main(["batch", str(path), "--output", str(output)]) == 0


def test_an_output_that_cannot_be_written(tmp_path, capsys):
    path = write_matches(tmp_path / "in.parquet", columns_of(2))
    (tmp_path / "file").touch()
    said = complaint(capsys, path, "--output", tmp_path / "file" / "out.parquet")
    assert str(tmp_path / "file") in said


def test_upright_images_that_are_no_panoramas(tmp_path, capsys):
    fisheye = "model: KannalaBrandt\nwidth: 640\nheight: 480\nfx: 200\nfy: 200\ncx: 320\ncy: 240\n"
    (tmp_path / "camera.yaml").write_text(fisheye, encoding="utf-8")
    pixels = [[100.0, 200.0] * 9]
    columns = {"image1": ["a.jpg"], "image2": ["b.jpg"], "pixels1": pixels, "pixels2": pixels}
    words = ["--camera", tmp_path / "camera.yaml", "--upright", "1"]
    said = complaint_about(capsys, tmp_path, columns, *words)
    assert said.startswith("--upright needs panoramas")
    assert "a.jpg" in said and "KannalaBrandt" in said


def test_no_camera_is_upright_to_no_degrees(tmp_path, capsys):
    said = complaint_about(capsys, tmp_path, columns_of(2), "--upright", "0")
    assert said == "--upright must be in (0, 45] degrees, got 0.0"
