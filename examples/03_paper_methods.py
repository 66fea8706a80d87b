# SPDX-License-Identifier: BSD-3-Clause
"""Every estimator of Robust 360-8PA on the same problems: python 03_paper_methods.py [PROBLEMS]."""

import sys
import time

import numpy as np

import epi360
from epi360.estimation import PAPER_METHODS
from epi360.synthetic import two_view_scene


def main() -> None:
    """Print median errors and times; none of these estimators rejects outliers."""
    if len(sys.argv) > 2 or not all(word.isdigit() and int(word) for word in sys.argv[1:]):
        sys.exit(__doc__)
    num_problems = int(sys.argv[1]) if len(sys.argv) == 2 else 20
    # Section 5.1: 200 landmarks, von Mises-Fisher noise of 3.2 deg in view 2, 20 % outliers.
    scenes = [two_view_scene(seed, kappa=500.0, outlier_ratio=0.2) for seed in range(num_problems)]

    print(f"median of {num_problems} problems      rotation    translation     time")
    for method in PAPER_METHODS:
        began = time.perf_counter()
        poses = [epi360.paper_pose(s.bearings1, s.bearings2, method=method) for s in scenes]
        milliseconds = 1e3 * (time.perf_counter() - began) / num_problems
        pairs = [(pose, scene.cam2_from_cam1) for pose, scene in zip(poses, scenes, strict=True)]
        rotation = np.median([epi360.rotation_error_deg(*pair) for pair in pairs])
        translation = np.median([epi360.translation_error_deg(*pair) for pair in pairs])
        print(f"{method:29} {rotation:6.2f} deg {translation:8.2f} deg {milliseconds:8.2f} ms")


if __name__ == "__main__":
    main()
