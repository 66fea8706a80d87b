# SPDX-License-Identifier: BSD-3-Clause
"""Other programs read what epi360 writes: `pip install '.[clients]'`, and see client_readers.py.

What is not installed is skipped; `benchmarks/clients.py` also takes programs from their source.
"""

import re

import pytest
from client_files import write_scene
from client_readers import READERS, NotInstalledError, differences

pytest.importorskip("h5py")

SINGLE_PRECISION = 1e-5  # of degrees and of a scene about ten units wide; three times what is seen


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("clients"))


@pytest.fixture
def loaded(scene):
    def loaded(client):
        try:
            return READERS[client](scene, {})
        except NotInstalledError as error:
            pytest.skip(f"{client}: {error}")

    return loaded


@pytest.mark.parametrize("client", READERS)
def test_a_program_finds_every_pose_and_point_where_it_is(client, loaded, scene):
    found = differences(loaded(client), scene)
    assert all(not difference > SINGLE_PRECISION for difference in found)  # NaN: not read


def test_colmap_finds_one_rig_with_a_frame_a_panorama(loaded):
    assert loaded("pycolmap, cube faces").remarks == ("1 rig, 9 frames",)


@pytest.mark.parametrize("client", [name for name in READERS if name.startswith("nerfstudio")])
def test_nerfstudio_leaves_up_where_it_is_and_finds_the_masks(client, loaded):
    up, *masks = loaded(client).remarks
    assert float(re.fullmatch(r"up is z to (\S+) deg", up)[1]) < SINGLE_PRECISION
    assert masks == (["45 of 45 masks"] if "faces" in client else [])


@pytest.mark.parametrize("client", ["Open3D, points", "trimesh, points"])
def test_points_keep_their_colors(client, loaded):
    assert loaded(client).remarks == ("colors equal",)


def test_evo_finds_a_row_for_each_image_in_the_order_of_their_names(loaded):
    assert loaded("evo, trajectory").remarks == ("0 to 4 s",)
