# SPDX-License-Identifier: BSD-3-Clause
"""Videos that the tests write, and what is done to their bytes."""

import struct

import numpy as np

PARENTS = (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsd", b"avc1")
OWN_BYTES = {b"stsd": 8, b"avc1": 78}


def noise_frames(count, size=(128, 256), seed=0):
    """A picture of blobs that moves to the right by 4 pixels a frame."""
    rng = np.random.default_rng(seed)
    small = rng.integers(0, 255, (size[0] // 8, size[1] // 8, 3), dtype=np.uint8)
    picture = np.kron(small, np.ones((8, 8, 1), np.uint8))
    return [np.roll(picture, 4 * index, axis=1) for index in range(count)]


def write_video(path, frames, *, rate=25, options=None, times=None, codec_options=None):
    """Write RGB frames with H.264, at a rate or at given times in milliseconds."""
    import av

    with av.open(str(path), "w", options=options or {}) as container:
        stream = container.add_stream(
            "libx264", rate=rate, options=codec_options or {"bf": "2", "g": "12"}
        )
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        if times is not None:
            from fractions import Fraction

            stream.codec_context.time_base = Fraction(1, 1000)
        for index, picture in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            if times is not None:
                frame.pts, frame.time_base = times[index], Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def box(kind, content):
    return struct.pack(">I4s", 8 + len(content), kind) + content


def with_box(data, parent, new):
    """Bytes of an MP4 file, its index at the end, with a box added at the end of another."""
    data, ways = bytearray(data), []
    start, end = 0, len(data)
    for kind in PARENTS[: PARENTS.index(parent) + 1]:
        start, end = _find(data, kind, start, end)
        ways.append(start)
        start += 8 + OWN_BYTES.get(kind, 0)
    data[end:end] = new
    for way in ways:
        size = struct.unpack_from(">I", data, way)[0]
        struct.pack_into(">I", data, way, size + len(new))
    return bytes(data)


def _find(data, wanted, start, end):
    while start < end:
        size, kind = struct.unpack_from(">I4s", data, start)
        if kind == wanted:
            return start, start + size
        start += size
    raise AssertionError(f"no box {wanted}")
