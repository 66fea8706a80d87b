# SPDX-License-Identifier: BSD-3-Clause
"""Small folders in the layouts of the data sets, written by formulas of their own."""

from pathlib import Path

import cv2
import numpy as np

SECOND_NS = 10**9
START_NS = 1520530308199447626  # nineteen digits: a float of nanoseconds would lose the last two
SIZE, FOCAL, CENTER = 96, 30.0, 47.0  # CENTER in OpenCV's convention, as Kalibr writes it

# Nothing in this rig is its own inverse: 90 degrees about y, and a lever arm along all axes.
CAM_FROM_IMU = np.array([[0, 0, 1, 0.1], [0, 1, 0, -0.2], [-1, 0, 0, 0.3], [0, 0, 0, 1.0]])


def rotation_about_z(degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def write_png(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(".png", image)[1].tobytes())


def textured(height, width, seed=0):
    noise = np.random.default_rng(seed).uniform(0, 255, (height, width, 3))
    return cv2.GaussianBlur(noise, (0, 0), 1.5).astype(np.uint8)


def write_mp3d_vo(scene: Path, degrees, *, depth=True) -> None:
    """Camera i stands at (i, 2 i, -i) and is turned about z."""
    rows = []
    for index, angle in enumerate(degrees):
        write_png(scene / "rgb" / f"{index + 1}.png", textured(32, 64, index))
        if depth:
            (scene / "depth" / "tiff").mkdir(parents=True, exist_ok=True)
            ranges = np.full((32, 64), 1.5 + index, np.float32)
            encoded = cv2.imencode(".tiff", ranges)[1].tobytes()
            (scene / "depth" / "tiff" / f"{index + 1}.tiff").write_bytes(encoded)
        half = np.radians(angle) / 2
        rows.append(f"{index} {index} {2 * index} {-index} 0 0 {np.sin(half)} {np.cos(half)}")
    (scene / "frm_ref.txt").write_text("\n".join(rows) + "\n")


def imu_row(nanoseconds, degrees, position) -> str:
    half = np.radians(degrees) / 2
    numbers = [*position, np.cos(half), 0.0, 0.0, np.sin(half)]
    return ",".join([str(nanoseconds), *(f"{number:.9f}" for number in numbers)])


def camchain(cam_from_imu=CAM_FROM_IMU) -> str:
    rows = "\n".join(f"  - {row.tolist()}" for row in cam_from_imu)
    return (
        f"cam0:\n  T_cam_imu:\n{rows}\n  camera_model: pinhole\n"
        f"  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]\n  distortion_model: equidistant\n"
        f"  intrinsics: [{FOCAL}, {FOCAL}, {CENTER}, {CENTER}]\n  resolution: [{SIZE}, {SIZE}]\n"
    )


def fisheye_image(value=20000, radius=44, seed=0):
    """16-bit texture in a lit circle about the principal point, black outside."""
    texture = textured(SIZE, SIZE, seed)[:, :, 0] / 255.0
    rows, columns = np.mgrid[:SIZE, :SIZE]
    lit = np.hypot(rows - CENTER, columns - CENTER) <= radius
    return np.where(lit, value * (0.5 + texture), 0).astype(np.uint16)


def write_tum_vi(scene: Path, num_frames=4, *, frames_per_s=20, poses="dso/gt_imu.csv") -> None:
    """The IMU moves with 1 m/s along x and turns about z with 10 deg/s; poses at 100 Hz."""
    step = SECOND_NS // frames_per_s
    times = [START_NS + index * step for index in range(num_frames)]
    for index, time in enumerate(times):
        write_png(scene / "mav0" / "cam0" / "data" / f"{time}.png", fisheye_image(seed=index))
    images = "".join(f"{time},{time}.png\n" for time in times)
    (scene / "mav0" / "cam0" / "data.csv").write_text(f"#timestamp [ns],filename\n{images}")
    (scene / "dso").mkdir(exist_ok=True)
    (scene / "dso" / "camchain.yaml").write_text(camchain())
    first, last = times[0] - SECOND_NS // 200, times[-1] + SECOND_NS // 100
    seconds = [((time - times[0]) / SECOND_NS, time) for time in range(first, last, 10**7)]
    rows = [imu_row(time, 10 * t, (t, 0.5, 0.25)) for t, time in seconds]
    header = "# timestamp[ns],tx,ty,tz,qw,qx,qy,qz"
    (scene / poses).parent.mkdir(parents=True, exist_ok=True)
    (scene / poses).write_text("\n".join([header, *rows]) + "\n")
