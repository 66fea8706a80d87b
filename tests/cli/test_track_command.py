# SPDX-License-Identifier: BSD-3-Clause
import csv
import errno
import json
import os
import signal
import subprocess
import sys
import time

import cv2
import numpy as np
import pytest
from command_line import assert_wrong_use
from mapped_room import write_picture
from walked_room import frames, write_frames

from epi360.cli import main
from epi360.interop import read_colmap_model, read_nerfstudio, read_tum_trajectory
from epi360.interop.ply import read_ply_points
from epi360.jobs.tracking import track_files, track_job


def rows_of(output):
    with (output / "frames.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def stamps_of(output):
    return [image.timestamp_s for image in read_tum_trajectory(output / "trajectory.txt").images]


def log_of(output):
    return json.loads((output / "track.json").read_text())


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    folder = tmp_path_factory.mktemp("walk") / "frames"
    write_frames(folder, 12)
    output = folder.parent / "out"
    report = ["--report", str(folder.parent / "way.html")]
    code = main(["track", str(folder), "--out", str(output), "--refine", *report])
    return folder, output, code


def test_track_writes_all_files(walk):
    _, output, code = walk
    assert code == 0
    model = read_colmap_model(output / "sparse" / "0")
    points, colors = read_ply_points(output / "points.ply")
    log = log_of(output)
    assert len(model.images) == log["num_key_frames"]
    assert len(points) == len(model.points) == len(colors) == log["num_points"]
    assert colors.max() > 50
    assert model.observations is not None and len(model.observations.points) > 2 * len(points)
    assert log["track"] == "done" and log["statuses"] == {"tracked": 12}
    assert any("COLMAP's bundle adjustment" in message for message in log["messages"])


def test_the_report_shows_every_key_frame(walk):
    folder, output, _ = walk
    page = (folder.parent / "way.html").read_text(encoding="utf-8")
    data = json.loads(page.partition('id="data">')[2].partition("</script>")[0])
    assert len(data["keys"]) == len(data["cameras"]) == log_of(output)["num_key_frames"]
    assert [each["frame"] for each in data["pictures"]] == data["keys"]
    assert "The camera was followed through 12 of 12 frames" in page


def test_a_report_that_no_browser_opens_is_refused_before_the_work(walk, tmp_path, capsys):
    folder, _, _ = walk
    words = ["--out", str(tmp_path / "out"), "--report", str(tmp_path / "way.pdf")]
    assert main(["track", str(folder), *words]) == 2
    assert "--report must end in .html" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_tracked_rows_are_those_of_the_trajectory_in_order(walk):
    _, output, _ = walk
    rows = rows_of(output)
    assert list(rows[0]) == ["image", "timestamp_s", "status", "num_inliers", "is_keyframe"]
    assert [row["image"] for row in rows] == [f"{index:03d}.png" for index in range(12)]
    tracked = [float(row["timestamp_s"]) for row in rows if row["status"] == "tracked"]
    assert stamps_of(output) == tracked
    assert all(int(row["num_inliers"]) > 20 for row in rows)


def test_down_is_plus_y_in_every_file(walk):
    """The mean of the tracked cameras' y axes; all files have one world."""
    _, output, _ = walk
    rows = read_tum_trajectory(output / "trajectory.txt").images
    mean = np.mean([row.cam_from_world.rotation[1] for row in rows], axis=0)
    np.testing.assert_allclose(mean / np.linalg.norm(mean), [0, 1, 0], atol=1e-12)
    by_time = {row.timestamp_s: row.cam_from_world.matrix() for row in rows}
    times = {row["image"]: float(row["timestamp_s"]) for row in rows_of(output)}
    model = read_colmap_model(output / "sparse" / "0")
    for image in model.images:
        expected = by_time[times[image.name]]
        np.testing.assert_allclose(image.cam_from_world.matrix(), expected, atol=1e-9)
    points, _ = read_ply_points(output / "points.ply")
    np.testing.assert_allclose(points, model.points, atol=1e-12)


def test_transforms_name_the_images_of_the_folder(walk):
    folder, output, _ = walk
    document = json.loads((output / "transforms.json").read_text())
    for frame in document["frames"]:
        assert (output / frame["file_path"]).resolve().parent == folder.resolve()
        assert (output / frame["file_path"]).is_file()
    poses = {
        image.name: image.cam_from_world for image in read_colmap_model(output / "sparse/0").images
    }
    for image in read_nerfstudio(output / "transforms.json").images:
        name = image.name.rpartition("/")[2]
        np.testing.assert_allclose(image.cam_from_world.matrix(), poses[name].matrix(), atol=1e-9)


def test_camera_that_does_not_move_is_an_honest_failure(tmp_path, capsys):
    write_frames(tmp_path / "frames", 6, same=True)
    assert main(["track", str(tmp_path / "frames"), "--out", str(tmp_path / "out")]) == 1
    assert "the camera does not move" in capsys.readouterr().out
    assert {row["status"] for row in rows_of(tmp_path / "out")[1:]} == {"static"}
    assert not (tmp_path / "out" / "trajectory.txt").exists()


def test_damaged_image_is_named_and_the_run_goes_on(tmp_path, capsys):
    write_frames(tmp_path / "frames", 8)
    path = tmp_path / "frames" / "005.png"
    path.write_bytes(path.read_bytes()[:2000])
    assert main(["track", str(tmp_path / "frames"), "--out", str(tmp_path / "out")]) == 0
    assert "frame 5: cannot be read" in capsys.readouterr().out
    assert [row["status"] for row in rows_of(tmp_path / "out")].count("tracked") == 7


def test_missing_images_are_named_where_names_are_numbered(tmp_path, capsys):
    write_frames(tmp_path / "frames", 9)
    for number in (5, 6):
        (tmp_path / "frames" / f"00{number}.png").unlink()
    assert main(["track", str(tmp_path / "frames"), "--out", str(tmp_path / "out")]) == 0
    said = "frame 5: 2 before it are missing, 004.png is followed by 007.png"
    assert said in capsys.readouterr().out
    assert len(stamps_of(tmp_path / "out")) == 7


def test_video_is_tracked_with_its_own_times_and_its_key_frames_are_written(tmp_path):
    pytest.importorskip("av")
    from written_videos import write_video

    video = write_video(tmp_path / "walk.mp4", frames()[:12])
    output = tmp_path / "out"
    assert main(["track", str(video), "--out", str(output)]) == 0
    stamps = stamps_of(output)
    assert len(stamps) == 12
    np.testing.assert_allclose(np.diff(stamps), 1 / 25, atol=1e-3)
    document = json.loads((output / "transforms.json").read_text())
    assert all((output / frame["file_path"]).is_file() for frame in document["frames"])


def test_full_disk_loses_no_other_file(tmp_path, monkeypatch, capsys):
    write_frames(tmp_path / "frames", 8)

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(track_files, "write_ply_points", full)
    assert main(["track", str(tmp_path / "frames"), "--out", str(tmp_path / "out")]) == 1
    assert "points.ply could not be written: No space left" in capsys.readouterr().out
    assert len(stamps_of(tmp_path / "out")) == 8
    assert (tmp_path / "out" / "sparse" / "0" / "images.bin").is_file()


def test_rows_that_do_not_fit_on_the_disk_do_not_stop_the_run(tmp_path, monkeypatch):
    write_frames(tmp_path / "frames", 8)
    monkeypatch.setattr(track_files.FrameTable, "_write", _full_after_three)
    assert main(["track", str(tmp_path / "frames"), "--out", str(tmp_path / "out")]) == 0
    assert len(rows_of(tmp_path / "out")) == 8  # written whole in the end
    assert any("No space left" in message for message in log_of(tmp_path / "out")["messages"])


def _full_after_three(table, row):
    table.count = getattr(table, "count", 0) + 1
    if table.count > 3:
        table.error = f"{table.path}: {os.strerror(errno.ENOSPC)}"


@pytest.fixture
def interrupt_at(monkeypatch):
    """Call it with the name of a frame: there somebody presses Ctrl-C."""
    add = track_job._Run._add

    def interrupt(name):
        def interrupted(run, frame):
            if frame.name == name:
                raise KeyboardInterrupt
            return add(run, frame)

        monkeypatch.setattr(track_job._Run, "_add", interrupted)

    return interrupt


def test_interrupted_run_writes_what_it_has(tmp_path, interrupt_at):
    write_frames(tmp_path / "frames", 10)
    interrupt_at("007.png")
    assert main(["track", str(tmp_path / "frames"), "--out", str(tmp_path / "out")]) == 130
    assert len(stamps_of(tmp_path / "out")) == 7
    assert len(rows_of(tmp_path / "out")) == 7
    assert log_of(tmp_path / "out")["track"] == "interrupted"


@pytest.mark.skipif(os.name != "posix", reason="needs SIGINT")
def test_ctrl_c_inside_of_a_frame_waits_for_it(tmp_path, monkeypatch):
    write_frames(tmp_path / "frames", 10)
    begin = track_job.Odometry._begun  # a key frame is there, and the frame has no name yet

    def interrupted(*arguments):
        os.kill(os.getpid(), signal.SIGINT)
        return begin(*arguments)

    monkeypatch.setattr(track_job.Odometry, "_begun", interrupted)
    assert main(["track", str(tmp_path / "frames"), "--out", str(tmp_path / "out")]) == 130
    assert log_of(tmp_path / "out")["track"] == "interrupted"
    model = read_colmap_model(tmp_path / "out" / "sparse" / "0")
    assert len(model.images) == log_of(tmp_path / "out")["num_key_frames"] > 0


@pytest.mark.parametrize("name", ["write_trajectory", "write_frames", "key_frame_model"])
def test_ctrl_c_while_files_are_written_writes_them_all(tmp_path, monkeypatch, name):
    write_frames(tmp_path / "frames", 8)
    write, pressed = getattr(track_files, name), []

    def interrupted(*arguments):
        if not pressed and (tmp_path / "out" / "track.json").is_file():
            pressed.append(True)
            raise KeyboardInterrupt
        return write(*arguments)

    monkeypatch.setattr(track_files, name, interrupted)
    out = tmp_path / "out"
    assert main(["track", str(tmp_path / "frames"), "--out", str(out)]) == 130
    assert pressed and log_of(out)["track"] == "interrupted"
    assert len(stamps_of(out)) == len(rows_of(out)) == 8
    assert len(read_nerfstudio(out / "transforms.json").images) == log_of(out)["num_key_frames"]


def test_frames_of_another_size_have_the_camera_of_their_size(tmp_path):
    folder, out = tmp_path / "frames", tmp_path / "out"
    write_frames(folder, 10)
    height, width = frames()[0].shape[:2]
    for path in sorted(folder.iterdir())[::2]:
        picture = cv2.imread(str(path))
        cv2.imwrite(str(path), cv2.resize(picture, (2 * width, 2 * height)))
    camera = tmp_path / "camera.yaml"
    camera.write_text(f"model: Equirectangular\nwidth: {width}\nheight: {height}\n")
    assert main(["track", str(folder), "--out", str(out), "--camera", str(camera)]) == 0
    for path in sorted(folder.iterdir()):
        write_picture(tmp_path / "masks" / path.name, np.full((height, width, 3), 255, np.uint8))
    masked = ["--mask", str(tmp_path / "masks"), "--out", str(tmp_path / "masked")]
    assert main(["track", str(folder), "--camera", str(camera), *masked]) == 0
    assert "mask_path" not in (tmp_path / "masked" / "transforms.json").read_text()
    model = read_colmap_model(out / "sparse" / "0")
    sizes = {name: (each.width, each.height) for name, each in model.cameras.items()}
    for image in model.images:
        stored = cv2.imread(str(folder / image.name)).shape
        assert sizes[image.camera] == (stored[1], stored[0])
    assert len(set(sizes.values())) == 2
    # Points are seen where the cameras of both sizes say.
    seen = model.observations
    for k, image in enumerate(model.images):
        rows = seen.images == k
        points = model.points[seen.points[rows]]
        rays = points @ image.cam_from_world.rotation.T + image.cam_from_world.translation
        expected = model.cameras[image.camera].pixels_from_bearings(rays)
        off = np.linalg.norm(seen.pixels[rows] - expected, axis=1)
        assert np.median(off) < 0.01 * sizes[image.camera][0]
    read = read_nerfstudio(out / "transforms.json")
    assert {(each.width, each.height) for each in read.cameras.values()} == set(sizes.values())


def test_masks_of_all_frames_go_to_nerfstudio(tmp_path, capsys):
    folder, out = tmp_path / "frames", tmp_path / "out"
    write_frames(folder, 8)
    white = np.full(frames()[0].shape, 255, np.uint8)
    for path in sorted(folder.iterdir()):
        write_picture(tmp_path / "masks" / path.name, white)
    words = ["track", str(folder), "--out", str(out), "--mask", str(tmp_path / "masks")]
    assert main(words) == 0
    document = json.loads((out / "transforms.json").read_text())
    for frame in document["frames"]:
        assert (out / frame["mask_path"]).resolve().parent == (tmp_path / "masks").resolve()
    capsys.readouterr()
    (tmp_path / "masks" / "000.png").unlink()
    assert main([*words, "--mask-nadir-deg", "10"]) == 0
    said = capsys.readouterr()
    assert "1 of 8 images have no mask in" in said.err and "they are used whole" in said.err
    assert "transforms.json lacks masks, because some images have none and what --mask" in said.out
    document = json.loads((out / "transforms.json").read_text())
    assert not any("mask_path" in frame for frame in document["frames"])


def test_frames_that_were_chosen_have_no_gaps(tmp_path, capsys):
    write_frames(tmp_path / "frames", 9)
    for number in (5, 6):
        (tmp_path / "frames" / f"00{number}.png").unlink()
    (tmp_path / "frames" / "epi360-frames.json").write_text("{}")
    assert main(["track", str(tmp_path / "frames"), "--out", str(tmp_path / "out")]) == 0
    assert "missing" not in capsys.readouterr().out


@pytest.mark.parametrize("count", [0, 7])
def test_interrupted_run_writes_its_report(tmp_path, interrupt_at, count):
    write_frames(tmp_path / "frames", 10)
    interrupt_at(f"{count:03d}.png")
    page = tmp_path / "way.html"
    words = ["--out", str(tmp_path / "out"), "--report", str(page)]
    assert main(["track", str(tmp_path / "frames"), *words]) == 130
    text = page.read_text(encoding="utf-8")
    assert f"The run was interrupted after {count} frames." in text
    data = json.loads(text.partition('id="data">')[2].partition("</script>")[0])
    assert len(data["names"]) == count
    assert log_of(tmp_path / "out")["track"] == "interrupted"


@pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")
def test_killed_run_leaves_the_rows_of_its_frames(tmp_path):
    write_frames(tmp_path / "frames", 12)
    arguments = ["track", str(tmp_path / "frames"), "--out", str(tmp_path / "out")]
    slow = (
        "import sys, time\nfrom epi360.cli import main\n"
        "from epi360.jobs.tracking import track_job\n"
        "add = track_job._Run._add\n"
        "track_job._Run._add = lambda run, frame: (time.sleep(0.2), add(run, frame))[1]\n"
        "sys.exit(main(sys.argv[1:]))"
    )
    run = subprocess.Popen([sys.executable, "-c", slow, *arguments])
    table = tmp_path / "out" / "frames.csv"
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        if table.exists() and len(table.read_text().splitlines()) > 4:
            break
        time.sleep(0.05)
    run.send_signal(signal.SIGKILL)
    run.wait()
    assert len(rows_of(tmp_path / "out")) >= 3
    assert main(arguments) == 0  # the folder is its own and may be used again
    assert len(stamps_of(tmp_path / "out")) == 12


def test_folder_of_something_else_is_not_touched(tmp_path, capsys):
    write_frames(tmp_path / "frames", 2)
    other = tmp_path / "mine"
    other.mkdir()
    (other / "trajectory.txt").write_text("precious")
    assert main(["track", str(tmp_path / "frames"), "--out", str(other)]) == 2
    assert "choose a new folder" in capsys.readouterr().err
    assert (other / "trajectory.txt").read_text() == "precious"


def test_the_track_of_another_folder_is_not_replaced(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for folder in ("walk/frames", "other/frames"):
        write_frames(tmp_path / folder, 3)
    assert main(["track", "walk/frames", "--out", "out"]) == 0
    before = (tmp_path / "out" / "trajectory.txt").read_bytes()
    capsys.readouterr()
    refused = "out holds the track of another video or folder, ", "choose another folder"
    assert_wrong_use(capsys, ["track", "other/frames", "--out", "out"], *refused)
    assert (tmp_path / "out" / "trajectory.txt").read_bytes() == before
    # The same frames, named in another way and with other options, are tracked again.
    monkeypatch.chdir(tmp_path / "walk")
    assert main(["track", "frames", "--out", "../out", "--seed", "1"]) == 0


@pytest.mark.parametrize(("name", "first"), [("walk.mp4", 3), ("run.mp4", 0)])
def test_the_track_of_another_video_is_not_replaced(tmp_path, capsys, name, first):
    pytest.importorskip("av")
    from written_videos import write_video

    (tmp_path / "other").mkdir()
    walk = write_video(tmp_path / "walk.mp4", frames()[:3])
    other = write_video(tmp_path / "other" / name, frames()[first : first + 3])
    out = ["--out", str(tmp_path / "out")]
    assert main(["track", str(walk), *out]) == 0
    capsys.readouterr()
    said = "the track of another video or folder, walk.mp4; choose another folder"
    assert_wrong_use(capsys, ["track", other, *out], said)
    assert log_of(tmp_path / "out")["made_from"]["video"] == "walk.mp4"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--max-points", "0"], "--max-points must be positive"),
        (["--camera", "missing.yaml"], "missing.yaml"),
        (["--start", "1"], "have no times"),
    ],
)
def test_wrong_use_is_one_line(tmp_path, capsys, words, said):
    write_frames(tmp_path / "frames", 2)
    assert main(["track", str(tmp_path / "frames"), "--out", str(tmp_path / "out"), *words]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "size", "said"),
    [
        ("masks/001.png", (64, 32), "each frame of frames is 512x256 but its mask masks"),
        ("masks/001.png.png", (64, 32), "a mask must have the size of its image"),
        ("masks/1.png", (512, 256), "mask folder masks has no mask for any of the images"),
        ("masks.png", (64, 32), "is 512x256 but its mask masks.png is 64x32"),
    ],
)
def test_masks_that_fit_no_frame_are_refused_before_the_work(
    tmp_path, monkeypatch, capsys, name, size, said
):
    monkeypatch.chdir(tmp_path)
    write_frames(tmp_path / "frames", 2)
    write_picture(tmp_path / name, np.full((size[1], size[0], 3), 255, np.uint8))
    mask = name.partition("/")[0]
    assert_wrong_use(capsys, ["track", "frames", "--out", "out", "--mask", mask], said)
    assert not (tmp_path / "out").exists()


def test_masks_of_another_size_are_refused_for_a_video(tmp_path, capsys):
    pytest.importorskip("av")
    from written_videos import write_video

    video = write_video(tmp_path / "walk.mp4", frames()[:2])
    write_picture(tmp_path / "masks" / "walk_000001.png", np.full((32, 64, 3), 255, np.uint8))
    words = ["track", video, "--out", tmp_path / "out", "--mask", tmp_path / "masks"]
    assert_wrong_use(capsys, words, "is 512x256 but its mask")


def test_a_mask_of_a_frame_that_is_not_there_does_not_matter(tmp_path):
    write_frames(tmp_path / "frames", 3)
    for name, (height, width) in (("001", (256, 512)), ("999", (32, 64))):
        white = np.full((height, width, 3), 255, np.uint8)
        write_picture(tmp_path / "masks" / f"{name}.png", white)
    words = ["--out", str(tmp_path / "out"), "--mask", str(tmp_path / "masks")]
    assert main(["track", str(tmp_path / "frames"), *words]) == 0
    assert not any("mask" in message for message in log_of(tmp_path / "out")["messages"])


def test_recording_is_written(tmp_path):
    pytest.importorskip("rerun")
    write_frames(tmp_path / "frames", 6)
    recording = tmp_path / "walk.rrd"
    arguments = ["track", str(tmp_path / "frames"), "--out", str(tmp_path / "out")]
    assert main([*arguments, "--recording", str(recording)]) == 0
    assert recording.stat().st_size > 10_000


def test_recording_that_cannot_be_written_is_one_line(tmp_path, capsys):
    pytest.importorskip("rerun")
    write_frames(tmp_path / "frames", 2)
    arguments = ["track", str(tmp_path / "frames"), "--out", str(tmp_path / "out")]
    assert main([*arguments, "--recording", str(tmp_path / "no" / "walk.rrd")]) == 2
    said = capsys.readouterr().err
    assert "walk.rrd cannot be written" in said and len(said.splitlines()) == 1


def test_upright_frames_are_tracked_with_gravity_and_the_log_says_so(walk, tmp_path, capsys):
    folder, _, _ = walk
    output = tmp_path / "level"
    assert main(["track", str(folder), "--out", str(output), "--upright", "1"]) == 0
    assert log_of(output)["options"]["upright_deg"] == 1.0
    assert log_of(output)["statuses"] == {"tracked": 12}
    assert main(["track", str(folder), "--out", str(tmp_path / "no"), "--upright", "0"]) == 2
    assert "--upright must be in (0, 45] degrees" in capsys.readouterr().err
    assert not (tmp_path / "no").exists()


def test_the_result_of_a_whole_run_stays_until_the_next_one_is_done(tmp_path, interrupt_at):
    write_frames(tmp_path / "frames", 10)
    arguments = ["track", str(tmp_path / "frames"), "--out", str(tmp_path / "out")]
    assert main(arguments) == 0
    whole = (tmp_path / "out" / "trajectory.txt").read_bytes()
    interrupt_at("004.png")
    for _ in range(2):  # an interrupted result does not replace the whole one
        assert main(arguments) == 130
        assert len(rows_of(tmp_path / "out")) == 4
        earlier = tmp_path / "out" / "earlier"
        assert (earlier / "trajectory.txt").read_bytes() == whole
        assert (earlier / "sparse" / "0" / "images.bin").is_file()
        assert log_of(earlier)["track"] == "done"
        assert any("earlier" in remark for remark in log_of(tmp_path / "out")["remarks"])
    interrupt_at("no frame")
    assert main(arguments) == 0
    assert not earlier.exists()
    assert (tmp_path / "out" / "trajectory.txt").read_bytes() == whole
