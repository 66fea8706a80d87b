# SPDX-License-Identifier: BSD-3-Clause
"""Relative pose of two panoramas: python 01_two_images.py [A.jpg B.jpg], by default a demo pair."""

import sys
from pathlib import Path

import epi360
from epi360.report.figure import draw_pair
from epi360.report.text import describe_pair
from epi360_scenes import demo_pair


def main() -> None:
    """Print the pose and draw what it rests on."""
    if len(sys.argv) not in (1, 3):
        sys.exit(__doc__)
    truth = None
    if len(sys.argv) == 3:
        image1, image2 = epi360.read_image(sys.argv[1]), epi360.read_image(sys.argv[2])
    else:
        pair = demo_pair()
        image1, image2, truth = pair.image1, pair.image2, pair.cam2_from_cam1

    result = epi360.relative_pose_of_images(image1, image2)
    print(describe_pair(result, truth))
    if result.success:  # else result.status says why, and numbers that are not known are NaN
        pose = result.cam2_from_cam1  # x2 = R x1 + t with |t| = 1
        print("\nquaternion (w, x, y, z):", pose.quaternion_wxyz.round(4))
        print("centre of camera 2 in camera 1:", pose.inverse().translation.round(4))

    camera1, camera2 = (epi360.Equirectangular(i.shape[1], i.shape[0]) for i in (image1, image2))
    figure = Path("out", "01_two_images.jpg")
    figure.parent.mkdir(exist_ok=True)
    draw_pair(image1, image2, camera1, camera2, result, path=figure)
    print("figure:", figure)


if __name__ == "__main__":
    main()
