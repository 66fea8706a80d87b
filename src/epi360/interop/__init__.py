# SPDX-License-Identifier: BSD-3-Clause
"""Matches and reconstructions in the files of other tools: COLMAP, hloc, OpenSfM, nerfstudio."""

from epi360.interop.colmap_cameras import camera_from_colmap, colmap_camera
from epi360.interop.colmap_database import read_colmap_database, write_colmap_database
from epi360.interop.colmap_model import read_colmap_model, write_colmap_model
from epi360.interop.gpano import GPano, gpano_packet, read_gpano, with_gpano
from epi360.interop.hloc import read_hloc, write_hloc
from epi360.interop.match_graph import MatchedImage, MatchedPair, MatchGraph, TwoViewGeometry
from epi360.interop.nerfstudio import read_nerfstudio, write_nerfstudio
from epi360.interop.opensfm import read_opensfm, write_opensfm, write_opensfm_folder
from epi360.interop.pairs_file import read_pairs_file, write_pairs_file
from epi360.interop.reconstruction import Observations, PosedImage, Reconstruction
from epi360.interop.tum import read_tum_trajectory, write_tum_trajectory

__all__ = [
    "GPano", "MatchGraph", "MatchedImage", "MatchedPair", "Observations", "PosedImage",
    "Reconstruction", "TwoViewGeometry", "camera_from_colmap", "colmap_camera", "gpano_packet",
    "read_colmap_database", "read_colmap_model", "read_gpano", "read_hloc", "read_nerfstudio",
    "read_opensfm", "read_pairs_file", "read_tum_trajectory", "with_gpano", "write_colmap_database",
    "write_colmap_model", "write_hloc", "write_nerfstudio", "write_opensfm",
    "write_opensfm_folder", "write_pairs_file",
    "write_tum_trajectory",
]  # fmt: skip
