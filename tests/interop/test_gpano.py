# SPDX-License-Identifier: BSD-3-Clause
"""GPano metadata: which part of a panorama an image is, and where its gravity points."""

import io
import json

import cv2
import numpy as np
import pytest

from epi360.cameras import Equirectangular
from epi360.cli import main
from epi360.features import extract_features, read_image, track_features
from epi360.features.image_cameras import find_camera
from epi360.features.image_headers import parse_image_header
from epi360.features.picture_writing import encode_picture
from epi360.interop.gpano import (
    GPano,
    PanoramaPart,
    gpano_packet,
    parse_gpano,
    read_gpano,
    with_gpano,
)
from epi360.poses import rotation_error_deg, translation_error_deg
from epi360.two_view import relative_pose_of_images
from epi360_scenes import demo_pair

# As a camera writes it: properties as elements, here with numbers of our own.
ELEMENTS = """<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>
<x:xmpmeta xmlns:x="adobe:ns:meta/">
  <rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
    <rdf:Description rdf:about="" xmlns:GPano="http://ns.google.com/photos/1.0/panorama/">
      <GPano:ProjectionType>equirectangular</GPano:ProjectionType>
      <GPano:CroppedAreaImageWidthPixels>600</GPano:CroppedAreaImageWidthPixels>
      <GPano:CroppedAreaImageHeightPixels>300</GPano:CroppedAreaImageHeightPixels>
      <GPano:FullPanoWidthPixels>1000</GPano:FullPanoWidthPixels>
      <GPano:FullPanoHeightPixels>500</GPano:FullPanoHeightPixels>
      <GPano:CroppedAreaLeftPixels>100</GPano:CroppedAreaLeftPixels>
      <GPano:CroppedAreaTopPixels>50</GPano:CroppedAreaTopPixels>
      <GPano:PoseHeadingDegrees>135.0</GPano:PoseHeadingDegrees>
      <GPano:PosePitchDegrees>-0.2</GPano:PosePitchDegrees>
      <GPano:PoseRollDegrees>-3.9</GPano:PoseRollDegrees>
    </rdf:Description>
  </rdf:RDF>
</x:xmpmeta>
<?xpacket end="r"?>   """
PART = PanoramaPart(width=600, height=300, left=100, top=50, full_width=1000, full_height=500)


def attributes(**properties):
    written = " ".join(f"GPano:{name}='{value}'" for name, value in properties.items())
    return (
        "<x:xmpmeta xmlns:x='adobe:ns:meta/'><rdf:RDF xmlns:rdf="
        "'http://www.w3.org/1999/02/22-rdf-syntax-ns#'><rdf:Description "
        f"xmlns:GPano='http://ns.google.com/photos/1.0/panorama/' {written}/></rdf:RDF></x:xmpmeta>"
    ).encode()


def picture(extension, width=60, height=30):
    image = np.random.default_rng(0).integers(0, 255, (height, width, 3), dtype=np.uint8)
    return cv2.imencode(extension, image)[1].tobytes()


def test_properties_may_be_elements():
    expected = GPano("equirectangular", PART, heading_deg=135.0, pitch_deg=-0.2, roll_deg=-3.9)
    assert parse_gpano(ELEMENTS.encode()) == expected
    assert parse_gpano(ELEMENTS.encode() + b"\0") == expected


def test_properties_may_be_attributes():
    packet = attributes(ProjectionType="equirectangular", PosePitchDegrees="7.5")
    assert parse_gpano(packet) == GPano(pitch_deg=7.5)


def test_a_part_looks_where_the_same_pixels_of_the_whole_look():
    part, whole = GPano(part=PART).camera(600, 300), Equirectangular(1000, 500)
    pixels = np.array([[0.5, 0.5], [300.0, 150.0], [599.5, 20.0], [600.0, 300.0]])
    expected = whole.bearings_from_pixels(pixels + (100, 50))
    np.testing.assert_allclose(part.bearings_from_pixels(pixels), expected, atol=1e-12)


def test_the_camera_of_a_part_by_hand():
    # Columns 500 to 1000 of 1000 are longitudes 0 to 180, rows 0 to 250 of 500 the upper half.
    camera = GPano(part=PanoramaPart(500, 250, 500, 0, 1000, 500)).camera(500, 250)
    np.testing.assert_allclose(
        camera.bearings_from_pixels([[0.0, 250.0], [250.0, 250.0], [250.0, 125.0]]),
        [[0, 0, 1], [1, 0, 0], [0.5**0.5, -(0.5**0.5), 0]],
        atol=1e-12,
    )


def test_a_resized_part_shows_the_same_directions():
    large, small = GPano(part=PART).camera(600, 300), GPano(part=PART).camera(150, 75)
    np.testing.assert_allclose(
        small.bearings_from_pixels([[30.0, 20.0]]),
        large.bearings_from_pixels([[120.0, 80.0]]),
        atol=1e-12,
    )


def test_metadata_of_a_whole_panorama_are_the_plain_camera():
    part = PanoramaPart(5376, 2688, 0, 0, 5376, 2688)
    assert GPano(part=part).camera(1920, 960) == Equirectangular(1920, 960)
    assert GPano(roll_deg=3.0).camera(1920, 960) == Equirectangular(1920, 960)


def test_a_panorama_that_was_filled_up_after_it_was_described_is_whole():
    part = PanoramaPart(1000, 300, 0, 100, 1000, 500)
    assert GPano(part=part).camera(1000, 500) == Equirectangular(1000, 500)


@pytest.mark.parametrize(
    ("gpano", "size", "fragment"),
    [
        (GPano(part=PanoramaPart(1200, 300, 0, 0, 1000, 500)), (1200, 300), "inside the panorama"),
        (GPano(part=PanoramaPart(600, 300, 500, 0, 1000, 500)), (600, 300), "inside the panorama"),
        (GPano(part=PanoramaPart(600, 300, 0, -1, 1000, 500)), (600, 300), "inside the panorama"),
        (GPano(part=PanoramaPart(0, 0, 0, 0, 0, 0)), (600, 300), "inside the panorama"),
        (GPano(part=PanoramaPart(600, 300, 0, 0, 1000, 300)), (600, 300), "2:1, got 1000x300"),
        (GPano(part=PART), (600, 400), "600x400 but its GPano metadata say 600x300"),
        (GPano(projection="cylindrical"), (600, 300), "projection equirectangular"),
        (GPano(), (600, 400), "2:1, got 600x400"),
    ],
)
def test_numbers_that_fit_no_panorama_are_refused(gpano, size, fragment):
    with pytest.raises(ValueError, match=fragment):
        gpano.camera(*size)


def test_gravity_of_a_level_camera_is_straight_down():
    np.testing.assert_allclose(GPano(pitch_deg=0.0).down, [0, 1, 0], atol=1e-15)


def test_a_camera_that_looks_up_sees_the_horizon_below_its_centre():
    down = GPano(pitch_deg=10.0).down
    # Straight ahead, the horizon is 10 degrees of 180 below the middle row of 500.
    camera = Equirectangular(1000, 500)
    pixel = [[500.0, 250 + 500 * 10 / 180]]
    assert abs(camera.bearings_from_pixels(pixel)[0] @ down) < 1e-12
    assert down[2] < 0  # the ground is more behind than ahead


def test_roll_turns_the_horizon_counter_clockwise():
    down = GPano(roll_deg=10.0).down
    # Counter-clockwise in the picture: the horizon rises on the right, +x at 3/4 of the width,
    # and falls on the left.
    pixels = [[750.0, 250 - 500 * 10 / 180], [250.0, 250 + 500 * 10 / 180], [500.0, 250.0]]
    horizon = Equirectangular(1000, 500).bearings_from_pixels(pixels)
    np.testing.assert_allclose(horizon @ down, 0, atol=1e-12)


def test_pitch_is_the_height_of_the_centre_whatever_the_roll():
    for roll_deg in (-170.0, -30.0, 0.0, 60.0):
        down = GPano(pitch_deg=25.0, roll_deg=roll_deg).down
        assert np.degrees(np.arcsin(-down[2])) == pytest.approx(25.0)
        assert np.linalg.norm(down) == pytest.approx(1.0)


def test_without_pitch_and_roll_nothing_is_known_of_gravity():
    assert GPano(heading_deg=90.0).down is None
    assert GPano(roll_deg=5.0).down is not None


@pytest.mark.parametrize(
    "packet",
    [
        None,
        b"",
        b"\xff\xfe<",
        b"<x:xmpmeta",
        ELEMENTS.encode()[:700],
        b"<!DOCTYPE a [<!ENTITY b 'c'>]><a>&b;</a>",
        b"<x:xmpmeta xmlns:x='adobe:ns:meta/'/>",
    ],
)
def test_a_packet_that_cannot_be_read_is_none(packet):
    assert parse_gpano(packet) is None


@pytest.mark.parametrize("text", ["", "north", "nan", "inf", "1e999"])
def test_a_property_that_is_no_number_counts_as_missing(text):
    gpano = parse_gpano(attributes(PosePitchDegrees=text, FullPanoWidthPixels=text))
    assert gpano == GPano()


def test_a_part_of_which_a_number_is_missing_is_unknown():
    packet = ELEMENTS.replace("<GPano:CroppedAreaTopPixels>50</GPano:CroppedAreaTopPixels>", "")
    assert parse_gpano(packet.encode()).part is None


@pytest.mark.parametrize("extension", [".jpg", ".png"])
def test_written_metadata_come_back_with_the_picture(tmp_path, extension):
    camera = GPano(part=PART).camera(600, 300)
    packet = gpano_packet(camera, heading_deg=90.0, pitch_deg=-2.5, roll_deg=4)
    plain = picture(extension, 600, 300)
    path = tmp_path / f"a{extension}"
    path.write_bytes(with_gpano(plain, packet))
    expected = GPano("equirectangular", PART, heading_deg=90.0, pitch_deg=-2.5, roll_deg=4.0)
    assert read_gpano(path) == expected
    assert read_gpano(path).camera(600, 300) == camera
    np.testing.assert_array_equal(
        cv2.imread(str(path)), cv2.imdecode(np.frombuffer(plain, np.uint8), cv2.IMREAD_COLOR)
    )


def test_the_file_header_stays_in_front_of_written_metadata():
    jpeg = with_gpano(picture(".jpg"), gpano_packet(Equirectangular(60, 30)))
    assert jpeg[2:4] == b"\xff\xe0"  # JFIF must come first
    assert parse_image_header(io.BytesIO(jpeg)).size == (60, 30)


def test_angles_that_are_not_given_are_not_written():
    assert parse_gpano(gpano_packet(Equirectangular(60, 30))).down is None


def test_a_part_across_the_seam_cannot_be_described():
    camera = Equirectangular(100, 50, 100, 50, center_longitude_deg=170)
    with pytest.raises(ValueError, match="inside the panorama"):
        gpano_packet(camera)


def test_metadata_are_written_once_and_into_pictures_only():
    packet = gpano_packet(Equirectangular(60, 30))
    with pytest.raises(ValueError, match="has one"):
        with_gpano(with_gpano(picture(".png"), packet), packet)
    with pytest.raises(ValueError, match="JPEG or PNG"):
        with_gpano(picture(".bmp"), packet)


def test_a_picture_without_metadata_has_none(tmp_path):
    (tmp_path / "a.jpg").write_bytes(picture(".jpg"))
    assert read_gpano(tmp_path / "a.jpg") is None


@pytest.fixture(scope="module")
def described_pair(tmp_path_factory):
    """Files of the middle of two panoramas of a room: 2:1, but no panoramas themselves."""
    pair = demo_pair()
    part = PanoramaPart(600, 300, 200, 100, 1000, 500)
    camera = GPano(part=part).camera(600, 300)
    folder = tmp_path_factory.mktemp("described")
    paths = [folder / name for name in ("1.png", "2.jpg")]
    for path, image in zip(paths, (pair.image1, pair.image2), strict=True):
        whole = cv2.resize(image, (1000, 500), interpolation=cv2.INTER_AREA)
        content = encode_picture(whole[100:400, 200:800], path.suffix)
        path.write_bytes(with_gpano(content, gpano_packet(camera)))
    return paths, camera, pair.cam2_from_cam1


def test_python_and_the_command_see_the_same_part_of_a_panorama(described_pair, tmp_path):
    paths, camera, truth = described_pair
    result = relative_pose_of_images(*paths)
    assert main(["pair", *map(str, paths), "--json", str(tmp_path / "pose.json")]) == 0
    record = json.loads((tmp_path / "pose.json").read_text())["cam2_from_cam1"]
    pose = result.cam2_from_cam1
    assert record["rotation"] == pose.rotation.tolist()
    assert record["translation"] == pose.translation.tolist()
    given = relative_pose_of_images(*paths, camera1=camera, camera2=camera)
    np.testing.assert_array_equal(given.cam2_from_cam1.matrix(), pose.matrix())
    # A pixel is 0.36 degrees wide. A camera of the whole sphere makes angles 1.7 times as large.
    assert rotation_error_deg(pose, truth) < 1
    assert translation_error_deg(pose, truth) < 3


def test_features_and_tracks_of_a_described_file_are_those_of_its_part(described_pair):
    (path, _), camera, _ = described_pair
    picture = read_image(path)
    np.testing.assert_array_equal(
        extract_features(path).keypoints, extract_features(picture, camera).keypoints
    )
    np.testing.assert_array_equal(
        track_features([path, picture]).keypoints,
        track_features([picture, picture], camera).keypoints,
    )


def test_an_array_and_a_file_without_metadata_are_whole_panoramas(tmp_path):
    picture = cv2.resize(demo_pair().image1, (600, 300), interpolation=cv2.INTER_AREA)
    (tmp_path / "a.png").write_bytes(encode_picture(picture, ".png"))
    for source in (picture, tmp_path / "a.png", str(tmp_path / "a.png")):
        assert find_camera(source, picture, None, "image") == Equirectangular(600, 300)


def test_metadata_that_contradict_a_file_are_told_with_its_name(tmp_path):
    packet = gpano_packet(GPano(part=PART).camera(600, 300))
    (tmp_path / "a.png").write_bytes(with_gpano(picture(".png", 60, 50), packet))
    with pytest.raises(ValueError, match="image1: the image is 60x50 but its GPano metadata say"):
        relative_pose_of_images(tmp_path / "a.png", tmp_path / "a.png")
