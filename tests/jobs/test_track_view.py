# SPDX-License-Identifier: BSD-3-Clause
from collections import Counter

import pytest
from walked_room import CAMERA, frames

from epi360 import Odometry
from epi360.cli import main
from epi360.jobs.tracking import track_view
from epi360.jobs.tracking.track_view import TrackView

rerun = pytest.importorskip("rerun")


@pytest.fixture
def viewer(tmp_path, monkeypatch):
    """A viewer without a window: what is sent to it lies in a file."""
    received = tmp_path / "viewer.rrd"
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(rerun.RecordingStream, "spawn", lambda *_, **__: None)
    monkeypatch.setattr(rerun, "GrpcSink", lambda url: rerun.FileSink(str(received)))
    monkeypatch.setattr(track_view, "_is_listening", lambda: True)
    return received


def watch(view, images):
    odometry = Odometry(CAMERA)
    for image in images:
        view(odometry, odometry.add_frame(image), image)
    view.close(odometry)


def rows_of(recording):
    """Number of rows of each entity of a recording."""
    chunk = pytest.importorskip("rerun.chunk")
    rows = Counter()
    for each in chunk.RrdReader(recording).stream():
        rows[each.entity_path] += each.num_rows
    return rows


def test_window_gets_what_the_recording_gets(viewer, tmp_path):
    recording = tmp_path / "walk.rrd"
    watch(TrackView(window=True, recording=recording), frames()[:8])
    rows = rows_of(viewer)
    assert rows == rows_of(recording)
    assert rows["/camera/picture"] == rows["/status"] == 8
    assert rows["/world/points"] == rows["/world/path"] > 0
    assert rows["/world/camera"] > 0


def test_window_alone_gets_the_same_as_a_recording_alone(viewer, tmp_path):
    recording = tmp_path / "walk.rrd"
    watch(TrackView(window=True, recording=None), frames()[:8])
    watch(TrackView(window=False, recording=recording), frames()[:8])
    assert rows_of(viewer) == rows_of(recording)


def test_window_that_was_closed_does_not_end_the_run(viewer, monkeypatch):
    def closed(*_, **__):
        raise RuntimeError("gRPC has been unable to connect for 7s")

    view = TrackView(window=True, recording=None)
    monkeypatch.setattr(rerun.RecordingStream, "flush", closed)
    watch(view, frames()[:2])


def view_error(tmp_path, capsys):
    images = tmp_path / "frames"
    images.mkdir()
    assert main(["track", str(images), "--out", str(tmp_path / "out"), "--view"]) == 2
    assert not (tmp_path / "out").exists()
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    return said


def test_window_without_a_display_is_refused_in_one_sentence(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(track_view.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    said = view_error(tmp_path, capsys)
    assert "--view opens a window, and there is no display here" in said
    assert "--recording FILE.rrd" in said


def test_viewer_that_is_not_installed_is_named_in_one_sentence(
    viewer, tmp_path, monkeypatch, capsys
):
    def missing(*_, **__):
        raise RuntimeError("Failed to find Rerun Viewer executable in PATH.")

    monkeypatch.setattr(rerun.RecordingStream, "spawn", missing)
    said = view_error(tmp_path, capsys)
    assert "--view cannot open Rerun's viewer: Failed to find" in said


def test_viewer_that_ends_at_once_is_said_in_one_sentence(viewer, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(track_view, "_is_listening", lambda: False)
    assert "viewer did not open a window" in view_error(tmp_path, capsys)
