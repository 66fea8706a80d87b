# SPDX-License-Identifier: BSD-3-Clause
"""Panoramas of a rendered room from a tripod, level or tilted, rendered once."""

from dataclasses import replace
from functools import cache

import numpy as np
from rendered_views import write_png

from epi360.cameras import Equirectangular
from epi360.jobs.folder.image_set import find_images
from epi360.jobs.matching.pair_work import PairWork
from epi360.poses import Pose, rotation_from_vector
from epi360_scenes import furnished_room

CAMERA = Equirectangular(512, 256)
NAMES = [f"{number}.png" for number in range(4)]
PLACES = [(0.1, -1.5, -0.35), (0.45, -1.5, -0.2), (-0.2, -1.5, 0.1), (0.2, -1.5, 0.15)]
YAWS = [0.3, 1.4, -0.8, 2.5]
TILTS = [(0.15, 0.0), (0.0, 0.2), (-0.2, 0.1), (0.1, -0.15)]  # about x and z


def world_from_cam(index, is_level):
    upright = rotation_from_vector([0.0, YAWS[index], 0.0])
    x, z = (0.0, 0.0) if is_level else TILTS[index]
    return Pose(upright @ rotation_from_vector([x, 0.0, z]), np.array(PLACES[index]))


@cache
def pictures(is_level):
    room = furnished_room(1)
    return [room.render(CAMERA, world_from_cam(k, is_level)).image for k in range(len(PLACES))]


def write_tour(folder, is_level=True):
    for name, picture in zip(NAMES, pictures(is_level), strict=True):
        write_png(folder / name, picture)
    return find_images(folder)


def judge_otherwise(monkeypatch, changed):
    """From now on pairs are what ``changed(verified, pair, prior)`` makes of them."""
    estimated = PairWork.estimated

    def changed_ones(work, matched, prior, **known):
        found = estimated(work, matched, prior, **known)
        return {pair: changed(verified, pair, prior) for pair, verified in found.items()}

    monkeypatch.setattr(PairWork, "estimated", changed_ones)


def doubted(verified):
    """A pair whose pose is not accepted, since its inliers lie close together."""
    pose, status = verified.verdict.cam2_from_cam1, "concentrated_inliers"
    verdict = replace(verified.verdict, status=status, doubted=pose, cam2_from_cam1=Pose.nan())
    return replace(verified, verdict=verdict)


def truth(index1, index2, is_level=True):
    return world_from_cam(index2, is_level).inverse() @ world_from_cam(index1, is_level)
