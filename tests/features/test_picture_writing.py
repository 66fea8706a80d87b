# SPDX-License-Identifier: BSD-3-Clause
"""Pictures are written without a loss, and in every order of importing pycolmap and OpenCV.

With pycolmap 4.2 first, whatever compresses with zlib ends the process: PNG files of OpenCV and
Pillow, PDF files and SVG files with pictures of matplotlib.
"""

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from epi360.features.picture_writing import encode_figure, encode_picture

RGB = np.random.default_rng(0).integers(0, 256, (40, 60, 3), dtype=np.uint8)
ORDERS = ["import pycolmap, cv2", "import cv2, pycolmap", "import epi360, pycolmap, cv2"]
WRITERS = {
    "picture": """
import numpy as np
from epi360.features.picture_writing import encode_picture
rgb = np.random.default_rng(0).integers(0, 256, (40, 60, 3), dtype=np.uint8)
for suffix in (".png", ".jpg", ".webp", ".tiff"):
    (out / f"a{suffix}").write_bytes(encode_picture(rgb, suffix))
assert (cv2.imread(str(out / "a.png"))[..., ::-1] == rgb).all()
""",
    "figure": """
import matplotlib.figure
from epi360.features.picture_writing import encode_figure
figure = matplotlib.figure.Figure((1, 1))
figure.subplots().imshow([[0, 1], [2, 3]])
for suffix in ("png", "jpg", "webp", "pdf", "svg"):
    (out / f"a.{suffix}").write_bytes(encode_figure(figure, suffix))
assert cv2.imread(str(out / "a.png")).shape == (100, 100, 3)
""",
    "figure of a pair": """
import numpy as np
from epi360 import Equirectangular, relative_pose_of_images
from epi360.report.figure import draw_pair
rng, camera = np.random.default_rng(0), Equirectangular(256, 128)
noise = [rng.integers(0, 256, (128, 256, 3), dtype=np.uint8) for _ in range(2)]
draw_pair(*noise, camera, camera, relative_pose_of_images(*noise), path=out / "a.png")
assert cv2.imread(str(out / "a.png")).shape[1] == 1400
""",
    "render": """
from epi360.cli import main
words = ["--num-frames", "1", "--scene", "studio", "--width", "64"]
assert main(["render", str(out / "r"), *words]) == 0
assert cv2.imread(str(out / "r/rgb/1.png")).shape == (32, 64, 3)
assert cv2.imread(str(out / "r/depth/tiff/1.tiff"), cv2.IMREAD_UNCHANGED).max() > 0.5
""",
    "cube faces and masks": """
import numpy as np
from epi360 import Equirectangular, Pose
from epi360.features.picture_writing import encode_picture
from epi360.interop.reconstruction import PosedImage, Reconstruction
from epi360.jobs.cubes.cubemap import CubemapOptions, export_cubemap
(out / "in").mkdir()
names = ("a.png", "b.jpg")
for name in names:
    panorama = np.full((32, 64, 3), 90, np.uint8)
    (out / "in" / name).write_bytes(encode_picture(panorama, name[1:]))
images = tuple(PosedImage(name, "pano", Pose(np.eye(3), np.zeros(3))) for name in names)
scene = Reconstruction({"pano": Equirectangular(64, 32)}, images)
export_cubemap(out / "in", scene, out / "cube", mask_nadir_deg=20)
pictures = [cv2.imread(str(path)) for path in (out / "cube").rglob("*.*g")]
assert len(pictures) > 12 and all(picture is not None for picture in pictures)
""",
    "experiment": """
from epi360_paper.plots import new_figure, png_of
(out / "a.png").write_bytes(png_of(new_figure(3, 2)))
assert cv2.imread(str(out / "a.png")) is not None
""",
}


@pytest.mark.parametrize("order", ORDERS)
def test_pictures_are_written_in_every_order_of_imports(tmp_path, order):
    pytest.importorskip("pycolmap")
    lines = [order, "import cv2", "from pathlib import Path"]
    for name, code in WRITERS.items():
        (tmp_path / name).mkdir()
        lines += [f"out = Path({str(tmp_path / name)!r})", code]
    # With a fault handler an abort names the line that it came from.
    command = [sys.executable, "-X", "faulthandler", "-c", "\n".join(lines)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.parametrize(
    "picture", [RGB, RGB[..., 0], RGB[..., 0] > 99], ids=["rgb", "grey", "mask"]
)
def test_a_png_holds_the_very_pixels(picture):
    read = cv2.imdecode(np.frombuffer(encode_picture(picture, ".png"), np.uint8), -1)
    read = read[..., ::-1] if read.ndim == 3 else read
    np.testing.assert_array_equal(read, picture * 255 if picture.dtype == bool else picture)


def test_a_depth_is_written_as_the_very_floats():
    depth = np.random.default_rng(0).uniform(0, 9, (40, 60)).astype(np.float32)
    read = cv2.imdecode(np.frombuffer(encode_picture(depth, ".tiff"), np.uint8), -1)
    np.testing.assert_array_equal(read, depth)


def test_the_quality_of_a_jpeg_is_that_of_opencv():
    for quality in (60, 95):
        expected = cv2.imencode(".jpg", RGB[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        ours = np.frombuffer(encode_picture(RGB, ".jpg", jpeg_quality=quality), np.uint8)
        difference = cv2.absdiff(cv2.imdecode(expected, 1), cv2.imdecode(ours, 1))
        assert difference.max() <= 1
    assert encode_picture(RGB, ".jpg") == encode_picture(RGB, ".jpg", jpeg_quality=95)


def test_what_another_process_says_of_its_failure_is_told(monkeypatch):
    monkeypatch.setattr("epi360.features.picture_writing._zlib_is_broken", lambda: True)
    with pytest.raises(RuntimeError, match="compresses a png file failed: AttributeError"):
        encode_figure("no figure", "png")


def test_nothing_else_writes_pictures():
    source = Path(__file__).parents[2] / "src"
    writers = ("imencode", "imwrite", ".savefig(", ".save(buffer")
    for path in source.rglob("*.py"):
        if path.name != "picture_writing.py":
            text = path.read_text(encoding="utf-8")
            assert not [word for word in writers if word in text], path
