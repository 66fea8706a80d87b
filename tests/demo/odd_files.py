# SPDX-License-Identifier: BSD-3-Clause
"""Files that a visitor may drop: pictures, and things that only look like some."""

import struct
import zlib

import cv2
import numpy as np

TEXT = b"These are my holiday notes.\n"


def jpeg(image):
    return cv2.imencode(".jpg", image[:, :, ::-1])[1].tobytes()


def noise_picture(width=64, height=32):
    rng = np.random.Generator(np.random.PCG64(0))
    return rng.integers(0, 256, (height, width, 3), dtype=np.uint8)


def broken_jpeg():
    whole = jpeg(noise_picture(256, 128))
    return whole[: len(whole) // 2]


def dual_fisheye(width=512):
    """Two discs of texture side by side on black, as a 360 camera records them."""
    half = width // 2
    rows, columns = np.mgrid[:half, :half] + 0.5 - half / 2
    disc = np.hypot(rows, columns) < 0.49 * half
    picture = noise_picture(width, half) // 2 + 100
    return picture * np.tile(disc, (1, 2))[:, :, None].astype(np.uint8)


def png_bomb(width=20000, height=10000):
    """A valid PNG of one bit a pixel: 200 megapixels in 25 kB."""
    rows = zlib.compress(bytes((1 + width // 8) * height), 9)
    header = struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    chunks = [(b"IHDR", header), (b"IDAT", rows), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )


def bmp_header(width=20000, height=-10000):
    return b"BM" + struct.pack("<IIIIiiHHI", 0, 0, 54, 40, width, height, 1, 24, 0) + bytes(20)


def webp_header(kind, width=16000, height=12600):
    size = {
        b"VP8X": bytes(4) + (width - 1).to_bytes(3, "little") + (height - 1).to_bytes(3, "little"),
        b"VP8L": b"\x2f" + (width - 1 | (height - 1) << 14).to_bytes(4, "little"),
        b"VP8 ": bytes(6) + struct.pack("<HH", width, height),
    }[kind]
    return (
        b"RIFF"
        + struct.pack("<I", 1000)
        + b"WEBP"
        + kind
        + struct.pack("<I", 100)
        + size
        + bytes(20)
    )
