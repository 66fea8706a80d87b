# SPDX-License-Identifier: BSD-3-Clause
"""The report of a pair: one HTML file with its verdict, pictures and what is behind the pose."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.cameras.resizing import smallest_pixel_deg
from epi360.epipolar import triangulate
from epi360.estimation.result import ImagePairResult
from epi360.report.charts import residual_histogram, residuals_by_latitude
from epi360.report.curves import cameras_of_pose, shown_residuals_deg
from epi360.report.html_page import Page, camera_record, escaped, packed, picture_address
from epi360.report.pair_words import evidence_of, verdict_headline, verdict_sentences
from epi360.report.sk_section import search_of_pair
from epi360.report.webgl import MISSING, WebGLLibrary, find_webgl_library
from epi360.runs.whole_files import PathLike, write_file

Array = NDArray[np.float64]

PAIR_SCRIPTS = (
    "geometry.js", "sphere.js", "pair_view.js", "ball.js", "scene.js", "surface.js", "pair.js",
)  # fmt: skip
# Both pictures together stay below this, so that the page stays below 3 MB.
_PICTURE_BYTES = 1_500_000
_PICTURE_SIZES = ((2048, 82), (1800, 80), (1600, 78), (1400, 74), (1200, 70), (1000, 60))
_MAX_MATCHES = 6000  # more only cover each other on the screen
_MAX_BALL_RAYS = 1500
_FARTHEST = 30.0  # points farther than this many distances between the cameras are left out


@dataclass(frozen=True)
class _Shown:
    """A pair with what is worked out for its page."""

    names: tuple[str, str]
    images: tuple[NDArray[np.uint8], NDArray[np.uint8]]
    cameras: tuple[Camera, Camera]
    result: ImagePairResult
    bearings: tuple[Array, Array]
    residuals_deg: Array


def write_pair_report(
    path: PathLike,
    names: tuple[str, str],
    images: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    cameras: tuple[Camera, Camera],
    result: ImagePairResult,
) -> None:
    """Write the report of a pair; the result may have any status."""
    write_file(path, pair_page(names, images, cameras, result).encode())


def pair_page(
    names: tuple[str, str],
    images: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    cameras: tuple[Camera, Camera],
    result: ImagePairResult,
) -> Page:
    """Return the page of a pair."""
    cameras = cameras_of_pose(result, cameras)
    bearings = (
        cameras[0].bearings_from_pixels(result.keypoints1),
        cameras[1].bearings_from_pixels(result.keypoints2),
    )
    residuals_deg = shown_residuals_deg(result)
    shown = _Shown(names, images, cameras, result, bearings, residuals_deg)
    webgl = find_webgl_library()
    points = _triangulated(shown)
    rays = [packed(_thin(each[_usable(shown)], _MAX_BALL_RAYS)) for each in bearings]
    search = search_of_pair(*(each[_usable(shown)] for each in bearings))
    data = {
        "pair": _pair_record(shown),
        "inlier_rays": rays,
        "scene": points and points.record,
        "surface": search and search.record(),
    }
    sections = [
        _verdict(shown),
        _pictures(shown),
        _charts(shown),
        _balls(shown),
        _scene(points, webgl),
        search.html() if search else "",
    ]
    title = f"Relative pose of {names[0]} and {names[1]}"
    webgl = webgl if points or search else None
    return Page(title, "\n".join(filter(None, sections)), data, PAIR_SCRIPTS, webgl)


def pictures_html(names: tuple[str, str], hint: str) -> str:
    """Return both pictures with their switches, as `PairView` of the scripts expects them."""
    figures = "".join(
        f'<figure><figcaption>View {number}: {escaped(name)}</figcaption><div class="picture">'
        f'<img alt="View {number}"><canvas class="globe"></canvas><canvas class="overlay"></canvas>'
        "</div></figure>"
        for number, name in enumerate(names, start=1)
    )
    return (
        '<div class="pair"><div class="switches">'
        '<label><input type="checkbox" name="matches" checked> matches</label>'
        '<label><input type="checkbox" name="outliers" checked> matches that do not agree</label>'
        '<label><input type="checkbox" name="sphere"> sphere view: drag to turn, wheel to zoom'
        f'</label></div><div class="columns">{figures}</div><p class="says">{hint}</p></div>'
    )


def _pair_record(shown: _Shown) -> dict[str, Any]:
    result = shown.result
    kept = _thin(np.arange(result.num_matches), _MAX_MATCHES)
    pictures = _fitting_pictures(shown.images)
    views = [
        {"picture": picture, "camera": camera_record(camera)}
        for picture, camera in zip(pictures, shown.cameras, strict=True)
    ]
    has_pose = bool(np.isfinite(result.E).all())
    gate = result.inlier_threshold_deg
    return {
        "views": views,
        "pixels": [packed(result.keypoints1[kept]), packed(result.keypoints2[kept])],
        "residuals": packed(shown.residuals_deg[kept]),
        "inliers": "".join("1" if each else "0" for each in result.inlier_mask[kept]),
        "E": result.E.ravel().tolist() if has_pose else None,
        "gate": float(gate) if np.isfinite(gate) else None,
    }


def _fitting_pictures(images: tuple[NDArray[np.uint8], NDArray[np.uint8]]) -> list[str]:
    """Return both pictures as large as the page can hold."""
    pictures: list[str] = []
    for max_width, quality in _PICTURE_SIZES:
        pictures = [picture_address(image, max_width, quality) for image in images]
        if sum(map(len, pictures)) <= _PICTURE_BYTES:
            break
    return pictures


def _verdict(shown: _Shown) -> str:
    result = shown.result
    kind = " ok" if result.success else ""
    sentences = "".join(f"<p>{escaped(text)}</p>" for text in verdict_sentences(result))
    evidence = evidence_of(result, smallest_pixel_deg(shown.cameras))
    columns = "".join(
        f'<div class="{kind_of}"><h3>{heading}</h3><ul>{items or f"<li>{nothing}</li>"}</ul></div>'
        for kind_of, heading, items, nothing in (
            ("for", "What speaks for a pose", _items(evidence, True), "Nothing does."),
            ("against", "What speaks against it", _items(evidence, False), "Nothing was found."),
        )
    )
    return (
        f'<h1>{verdict_headline(result.status)}</h1><p class="names">{escaped(shown.names[0])} '
        f'and {escaped(shown.names[1])}</p><section class="verdict{kind}">{sentences}</section>'
        f'<section class="columns evidence">{columns}</section>'
    )


def _items(evidence: list[Any], speaks_for: bool) -> str:
    chosen = (each.sentence for each in evidence if each.speaks_for == speaks_for)
    return "".join(f"<li>{escaped(sentence)}</li>" for sentence in chosen)


def _pictures(shown: _Shown) -> str:
    result = shown.result
    hint = "Point at a picture to see the match there"
    if np.isfinite(result.E).all():
        hint += ", and where the same point must lie in the other view"
    gate = result.inlier_threshold_deg
    end = f"{gate:.3f}°" if np.isfinite(gate) else "the gate"
    crosses = "crosses are matches that do not agree"
    if np.isfinite(shown.residuals_deg).any():
        scale = f'<p class="scale">residual 0° <i></i> {end}; {crosses}</p>'
    else:
        scale = f'<p class="scale">Dots are matches that agree with each other; {crosses}.</p>'
    thinned = ""
    if result.num_matches > _MAX_MATCHES:
        thinned = f"<p>Of the {result.num_matches} matches, {_MAX_MATCHES} are shown.</p>"
    return f"<h2>The matches</h2>{pictures_html(shown.names, hint + '.')}{scale}{thinned}"


def _charts(shown: _Shown) -> str:
    result, residuals = shown.result, shown.residuals_deg
    histogram = residual_histogram(residuals, result.inlier_mask, result.inlier_threshold_deg)
    if not histogram:
        return ""
    x, y, z = shown.bearings[0].T
    latitudes = np.degrees(np.arctan2(-y, np.hypot(x, z)))
    mask = result.inlier_mask
    by_latitude = residuals_by_latitude(latitudes[mask], residuals[mask])
    return (
        '<h2>The residuals</h2><div class="columns">'
        f"<figure>{histogram}<figcaption>How far the matches miss the pose. Those that agree are "
        "at the bottom of each bar, those that do not are stacked on them."
        f"</figcaption></figure><figure>{by_latitude}<figcaption>Residuals of the matches that "
        "agree, by latitude; a bar is the median of 15 degrees. If it rises towards the poles, the "
        "camera model or the stitching may not fit there.</figcaption></figure></div>"
    )


def _balls(shown: _Shown) -> str:
    if not _usable(shown).any():
        return ""
    figures = "".join(
        f'<figure><canvas class="ball inliers"></canvas><figcaption>View {number}</figcaption>'
        "</figure>"
        for number in (1, 2)
    )
    return (
        "<h2>Where the matches that agree lie on the sphere</h2><p>The axis x points to the right, "
        "y down and z ahead. Drag a ball to turn it.</p>"
        f'<div class="columns">{figures}</div>'
    )


@dataclass(frozen=True)
class _Points:
    """Triangulated points for the 3D view, and how many there are without the far ones."""

    record: dict[str, Any]
    num_shown: int
    num_far: int


def _triangulated(shown: _Shown) -> _Points | None:
    result = shown.result
    if not np.isfinite(result.E).all():
        return None
    pose = result.cam2_from_cam1
    chosen = np.flatnonzero(_usable(shown))
    bearings1, bearings2 = (each[chosen] for each in shown.bearings)
    points, depths1, _ = triangulate(bearings1, bearings2, pose)
    known = np.isfinite(points).all(axis=1) & (depths1 > 0)
    near = known & (depths1 <= _FARTHEST)
    if not near.any():
        return None
    center2 = -pose.rotation.T @ pose.translation
    reach = float(np.clip(1.5 * np.median(depths1[near]), 2.0, _FARTHEST))
    cameras = [
        {"name": "camera 1", "centre": [0.0, 0.0, 0.0], "rotation": np.eye(3).ravel().tolist()},
        {
            "name": "camera 2", "centre": center2.tolist(),
            "rotation": pose.rotation.ravel().tolist(),
        },
    ]  # fmt: skip
    record = {
        "points": packed(points[near]),
        "colours": packed(_colours(shown, chosen[near])),
        "cameras": cameras,
        "middle": (center2 / 2.0).tolist(),
        "reach": reach,
        "mark": 0.5,
    }
    return _Points(record, int(near.sum()), int((known & ~near).sum()))


def _colours(shown: _Shown, chosen: NDArray[np.intp]) -> Array:
    """Return the colours of the picture at the key points of view 1, from 0 to 1."""
    image = shown.images[0]
    columns, rows = np.floor(shown.result.keypoints1[chosen]).astype(int).T
    rows = np.clip(rows, 0, image.shape[0] - 1)
    colours = image[rows, np.clip(columns, 0, image.shape[1] - 1)]
    return np.asarray(colours / 255.0)


def _scene(points: _Points | None, webgl: WebGLLibrary | None) -> str:
    if points is None:
        return ""
    heading = "<h2>The points and both cameras</h2>"
    if webgl is None:
        return f"{heading}<p>{escaped(MISSING)}</p>"
    far = ""
    if points.num_far:
        far = (
            f" {points.num_far} more are farther away than {_FARTHEST:.0f} times the distance "
            "between the cameras and are left out."
        )
    return (
        f"{heading}<p>Drag to turn, scroll to zoom. The {points.num_shown} points are matches that "
        f"agree, triangulated.{far} Each camera has its axes: x in red, y in green, z in blue.</p>"
        '<div class="scene"></div>'
    )


def _usable(shown: _Shown) -> NDArray[np.bool_]:
    """Return which matches agree with the pose and have a ray in both views."""
    finite = [np.isfinite(each).all(axis=1) for each in shown.bearings]
    return shown.result.inlier_mask & finite[0] & finite[1]


def _thin(values: NDArray[Any], count: int) -> NDArray[Any]:
    return values[:: max(1, -(-len(values) // count))]
