# SPDX-License-Identifier: BSD-3-Clause
"""Tours of homes with twin rooms: panoramas on a tripod, with poses and what pairs share."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Equirectangular
from epi360.features.picture_writing import encode_picture
from epi360.poses import Pose
from epi360.runs.whole_files import write_file
from epi360.synthetic.landmarks import rotation_from_heading
from epi360_scenes.home import Home, HomeView, sphere_directions, twin_home
from epi360_scenes.home_painting import home_atlas
from epi360_scenes.home_plan import PlannedRoom
from epi360_scenes.rendering import RayCaster, Rays

Floats = NDArray[np.float32]

# Raised whenever pictures change, so that cached ones are made again.
VERSION = 1
# Panoramas in each kind of room; a home has two rows of four rooms and a corridor.
PANORAMAS = {"bedroom": 3, "study": 3, "living": 2, "kitchen": 2, "bath": 1, "corridor": 4}
CLEARANCE_M, APART_M, TOGETHER_M = 0.4, 0.6, 2.0
NUM_TRIED, LEG_HEIGHTS_M = 1000, (0.5, 0.75, 1.0)
MAX_LEAN_DEG, MAX_TILT_DEG = 0.5, 20.0
# The badge at the nadir, and the legs that stick out from under it.
BADGE_DEG, LEGS_DEG, LEG_WIDTH = 10.0, 19.0, 0.04
# Number that edges of the badge and the legs are found by: no face of a home has it.
TRIPOD_SURFACE = 1 << 30
NUM_SHARED_RAYS = 4000
# A point counts as seen if nothing is nearer by more than this share of its range and margin.
SEEN_SHARE, SEEN_MARGIN_M = 0.02, 0.03


@dataclass(frozen=True)
class Panorama:
    """One picture of a tour.

    Attributes
    ----------
    name : str
        File name.
    room : str
        Name of the room it was taken in.
    twins : str
        Equal for rooms that are twins of each other.
    world_from_cam : Pose
    """

    name: str
    room: str
    twins: str
    world_from_cam: Pose


@dataclass(frozen=True)
class Tour:
    """Panoramas of one home.

    Attributes
    ----------
    folder : Path
        Where the pictures lie.
    is_level : bool
    panoramas : tuple of Panorama
    overlaps : dict of (str, str) to float
        For each pair of names in order: the smaller of the shares of either sphere of view
        whose surface points the other camera sees too.
    """

    folder: Path
    is_level: bool
    panoramas: tuple[Panorama, ...]
    overlaps: dict[tuple[str, str], float]

    def cam2_from_cam1(self, name1: str, name2: str) -> Pose:
        """Metric pose of a pair."""
        world_from_cam = {one.name: one.world_from_cam for one in self.panoramas}
        return world_from_cam[name2].inverse() @ world_from_cam[name1]

    def digest(self) -> str:
        """What the pictures of the tour are known by."""
        digest = hashlib.sha256()
        for panorama in self.panoramas:
            digest.update((self.folder / panorama.name).read_bytes())
        return digest.hexdigest()

    def relation(self, name1: str, name2: str) -> str:
        """How the rooms of two panoramas are related: "one room", "twins", "mirrored", "other"."""
        of = {one.name: one for one in self.panoramas}
        first, second = of[name1], of[name2]
        if first.room == second.room:
            return "one room"
        if first.twins == second.twins:
            return "twins"
        return "mirrored" if first.twins[:-2] == second.twins[:-2] else "other"


@dataclass(frozen=True)
class _OnTripod(RayCaster):
    """A home with the tripod in front of it that every picture of a tour shows."""

    view: HomeView
    cam_from_world: NDArray[np.float64]
    badge: Floats

    def cast(self, rays: Rays) -> tuple[Floats, Floats, NDArray[np.intp]]:
        colors, ranges, surfaces = self.view.cast(rays)
        x, y, z = self.cam_from_world @ rays.directions.T
        angle = np.degrees(np.arctan2(np.hypot(x, z), y))
        legs = angle < LEGS_DEG
        third = (np.arctan2(z, x) / (2 * np.pi) * 3 + 0.5) % 1.0 - 0.5
        legs &= np.abs(third) * 2 * np.pi / 3 * np.sin(np.radians(angle)) < LEG_WIDTH / 2
        badge = angle < BADGE_DEG
        colors[legs] = 0.06 + 0.2 * np.abs(third[legs, None])
        side = len(self.badge)
        # The badge is a picture pasted over the nadir, as tour makers do: no light falls on it.
        scale = np.float64(side / 2 / BADGE_DEG) * angle / np.maximum(np.hypot(x, z), 1e-9)
        column, row = (np.clip(side / 2 + scale * a, 0, side - 1).astype(int) for a in (x, z))
        colors[badge] = self.badge[row[badge], column[badge]]
        surfaces = np.where(legs, TRIPOD_SURFACE, surfaces)
        return colors, ranges, np.where(badge, TRIPOD_SURFACE + 1, surfaces)


def render_tour(
    folder: Path,
    seed: int,
    *,
    is_level: bool,
    width: int = 1024,
    progress: Callable[[str], None] = lambda _: None,
) -> Tour:
    """Panoramas of the home of a seed; pictures that the folder already holds are used.

    Parameters
    ----------
    folder : Path
        Gets one JPEG file for each panorama and ``tour.json``.
    seed : int
        Of home, places and pictures.
    is_level : bool
        Upright within half a degree and of one height, as on a tripod; else tilted by up to 20
        degrees about both axes and 1.1 to 1.9 m high.
    width : int
        Width of the panoramas in pixels.
    progress : callable
        Gets the name of each panorama when it is done.

    Returns
    -------
    tour : Tour

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    key = {"version": VERSION, "seed": seed, "is_level": is_level, "width": width}
    record = folder / "tour.json"
    if record.is_file():
        document = json.loads(record.read_text(encoding="utf-8"))
        if document["key"] == key:
            return _read_tour(folder, document)
    folder.mkdir(parents=True, exist_ok=True)
    home = twin_home(seed)
    rng = np.random.Generator(np.random.PCG64([seed, 3, int(is_level)]))
    panoramas = _panoramas(home, rng, is_level=is_level)
    badge = _developed_badge(seed)
    camera = Equirectangular(width=width, height=width // 2)
    ranges = []
    for panorama in panoramas:
        view = home.seen_from(panorama.world_from_cam.translation)
        scene = _OnTripod(view, panorama.world_from_cam.rotation.T, badge)
        rendering = scene.render(camera, panorama.world_from_cam)
        _write(folder / panorama.name, rendering.image, rng)
        ranges.append(rendering.depth)
        progress(panorama.name)
    overlaps = _overlaps(panoramas, ranges, camera)
    tour = Tour(folder, is_level, tuple(panoramas), overlaps)
    write_file(record, json.dumps({"key": key, **_document(tour)}).encode())
    return tour


def _panoramas(home: Home, rng: np.random.Generator, *, is_level: bool) -> list[Panorama]:
    """Free places in all rooms: the first of each room looks through its door."""
    height = rng.uniform(1.4, 1.65)
    panoramas = []
    for room in home.rooms:
        taken: list[NDArray[np.float64]] = []
        for number in range(PANORAMAS[room.kind]):
            this_height = height if is_level else rng.uniform(1.1, 1.9)
            taken.append(_free_place(home, room, taken, this_height, rng, at_door=number == 0))
            lean = MAX_LEAN_DEG * np.sqrt(0.5) if is_level else MAX_TILT_DEG
            pitch, roll = np.radians(rng.uniform(-lean, lean, 2))
            rotation = rotation_from_heading(np.array([pitch, rng.uniform(-np.pi, np.pi), roll]))
            name, twins = f"{room.name}_{number + 1}.jpg", f"{room.kind}{room.side:+d}"
            panoramas.append(Panorama(name, room.name, twins, Pose(rotation, taken[-1])))
    return panoramas


def _free_place(
    home: Home,
    room: PlannedRoom,
    taken: list[NDArray[np.float64]],
    height: float,
    rng: np.random.Generator,
    *,
    at_door: bool,
) -> NDArray[np.float64]:
    """Place of a tripod whose legs and head touch nothing, not far from those taken."""
    shape = room.shape
    reach = np.array([shape.half_width_m, shape.half_depth_m]) - CLEARANCE_M
    tried = rng.uniform(-reach, reach, (NUM_TRIED, 2))
    if at_door and room.kind != "corridor":
        steps = np.array(_door_steps(room))
        near = steps[rng.integers(len(steps), size=NUM_TRIED)] + rng.uniform(-0.3, 0.3, tried.shape)
        tried = np.concatenate([np.clip(near, -reach, reach), tried])
    places = np.array([room.place.to_world((x, -height, z)) for x, z in tried])
    columns = np.repeat(places, len(LEG_HEIGHTS_M) + 1, axis=0).reshape(len(places), -1, 3)
    columns[:, 1:, 1] = -np.array(LEG_HEIGHTS_M)
    solids = home.solids_of(room)
    free = solids.distances(columns.reshape(-1, 3)).reshape(columns.shape[:2]).min(axis=1)
    gaps = np.full((1, len(places)), APART_M)
    for one in taken:
        gaps = np.append(gaps, np.hypot(*(places - one)[:, [0, 2]].T)[None], axis=0)
    near = gaps.max(axis=0) <= TOGETHER_M
    for apart in (APART_M, APART_M / 2):
        (good,) = np.nonzero(near & (free >= CLEARANCE_M) & (gaps.min(axis=0) >= apart))
        if len(good):
            return np.asarray(places[good[0]])
    raise ValueError(f"{room.name} has no place for a tripod")


def _door_steps(room: PlannedRoom) -> list[NDArray[np.float64]]:
    """Points (x, z) half a metre inside each door of a room."""
    steps = []
    for wall, doors in room.shape.openings.items():
        for door in doors:
            x, _, z = room.shape.wall(wall).to_world((door, 0.0, 0.5))
            steps.append(np.array([x, z]))
    return steps


def _developed_badge(seed: int) -> Floats:
    texels = home_atlas(seed, ["logo"])
    side = int(texels.sizes[0, 1])
    start = int(texels.starts[0, 1])
    badge = texels.texels[start : start + side * side].reshape(side, side, 3)
    return np.asarray(badge ** np.float32(1 / 2.2), np.float32)


def _write(path: Path, image: NDArray[np.uint8], rng: np.random.Generator) -> None:
    """JPEG file with the noise and the exposure of a camera of its own mind."""
    picture = image * rng.uniform(0.85, 1.1) + rng.normal(0.0, 1.5, image.shape)
    pixels = np.clip(np.round(picture), 0, 255).astype(np.uint8)
    write_file(path, encode_picture(pixels, ".jpg", jpeg_quality=94))


def _overlaps(
    panoramas: list[Panorama], ranges: list[Floats], camera: Equirectangular
) -> dict[tuple[str, str], float]:
    """Smaller share of either view that the other sees, for every pair."""
    directions = sphere_directions(NUM_SHARED_RAYS)
    rows, columns = _pixels(camera, directions)
    shares = np.zeros((len(panoramas), len(panoramas)))
    for i, first in enumerate(panoramas):
        points = ranges[i][rows, columns, None] * directions
        for j, second in enumerate(panoramas):
            if i != j:
                pose = second.world_from_cam.inverse() @ first.world_from_cam
                seen = points @ pose.rotation.T + pose.translation
                distance = np.linalg.norm(seen, axis=1)
                at = _pixels(camera, seen / distance[:, None])
                allowed = ranges[j][at] * (1 + SEEN_SHARE) + SEEN_MARGIN_M
                shares[i, j] = np.mean(distance <= allowed)
    return {
        (panoramas[i].name, panoramas[j].name): float(min(shares[i, j], shares[j, i]))
        for i, j in combinations(range(len(panoramas)), 2)
    }


def _pixels(
    camera: Equirectangular, directions: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Row and column of the pixels that directions fall into."""
    u, v = camera.pixels_from_bearings(directions).T
    rows = np.clip(v.astype(np.intp), 0, camera.height - 1)
    return rows, u.astype(np.intp) % camera.width


def _document(tour: Tour) -> dict[str, object]:
    panoramas = [
        {
            **{k: v for k, v in asdict(one).items() if k != "world_from_cam"},
            "rotation": one.world_from_cam.rotation.tolist(),
            "position_m": one.world_from_cam.translation.tolist(),
        }
        for one in tour.panoramas
    ]
    overlaps = [[*names, share] for names, share in tour.overlaps.items()]
    return {"panoramas": panoramas, "overlaps": overlaps}


def _read_tour(folder: Path, document: dict) -> Tour:  # type: ignore[type-arg]
    panoramas = tuple(
        Panorama(
            entry["name"],
            entry["room"],
            entry["twins"],
            Pose(np.array(entry["rotation"]), np.array(entry["position_m"])),
        )
        for entry in document["panoramas"]
    )
    overlaps = {(name1, name2): share for name1, name2, share in document["overlaps"]}
    return Tour(folder, bool(document["key"]["is_level"]), panoramas, overlaps)
