# SPDX-License-Identifier: BSD-3-Clause
"""Training programs on a rendered walk that epi360 maps: does it train, and as well as with truth.

Every command is one of the how-to, with fewer iterations and on the processor.
"""

from __future__ import annotations

import dataclasses
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
from _client_commands import Row, run
from _left_out import poses_in_world
from PIL import Image

from epi360.interop import read_colmap_model, read_tum_trajectory, write_colmap_model

WALK = "--num-frames 12 --step-m 0.2 --max-turn-deg 6 --width 384".split()
HELD_OUT = "6_right.jpg"  # a face; the five others of its panorama are trained on
SPLATS = "--num-downscales 0 --warmup-length 50 --refine-every 50 --val".split()


def opensplat_rows(program: Path, scratch: Path, iterations: int) -> list[Row]:
    """OpenSplat on the cube faces of the map, and on the same with the true poses."""
    _map_a_walk(scratch)
    rows = []
    for folder, poses in (("map/cubemap", "poses of the map"), ("true_cubemap", "true poses")):
        views, splats = scratch / f"{folder}_views", scratch / f"{folder}_splats" / "splat.ply"
        splats.parent.mkdir()
        words = [program, scratch / folder, "-n", str(iterations), *SPLATS, "--cpu", "-o", splats]
        log = scratch / f"{splats.parent.name}.log"
        took, error = run([*words, "--val-image", HELD_OUT, "--val-render", views], log=log)
        result = error or _judged(log, views / f"{iterations}.png", scratch / folder / "images")
        rows.append(Row(f"opensplat -n {iterations}, {poses}", f"{took:.0f}", result))
    return rows


def nerfstudio_rows(program: Path, scratch: Path, iterations: int) -> list[Row]:
    """Train the nerfacto of nerfstudio on the panoramas as they are."""
    if not (scratch / "map").is_dir():
        _map_a_walk(scratch)
    words = "nerfacto --machine.device-type cpu --pipeline.model.implementation torch".split()
    words += "--vis tensorboard --pipeline.datamanager.train-num-rays-per-batch 512".split()
    more = ["--max-num-iterations", str(iterations), "--output-dir", scratch / "nerf"]
    log = scratch / "nerf.log"
    took, error = run([program, *words, *more, "--data", scratch / "map"], log=log)
    found = list((scratch / "nerf").rglob("*.ckpt"))
    result = error or (f"wrote {found[0].name}" if found else "no checkpoint")
    return [Row(f"ns-train nerfacto, {iterations} steps, panoramas", f"{took:.0f}", result)]


def _map_a_walk(scratch: Path) -> None:
    """Render a walk, map it, and make the same cube faces with its true poses."""
    for words in (
        ["render", "walk", *WALK],
        ["map", "walk/rgb", "--output", "map", "--cubemap"],
    ):
        command = [sys.executable, "-m", "epi360", *words]
        subprocess.run(command, cwd=scratch, check=True, capture_output=True)
    model = read_colmap_model(scratch / "map" / "sparse" / "0")
    rows = read_tum_trajectory(scratch / "walk" / "frm_ref.txt").images
    truth = {f"{row}.png": image.cam_from_world for row, image in enumerate(rows, start=1)}
    true, _ = poses_in_world(truth, model, ())
    images = tuple(dataclasses.replace(i, cam_from_world=true[i.name]) for i in model.images)
    write_colmap_model(scratch / "true_model", dataclasses.replace(model, images=images))
    words = ["cubemap", "true_model", "walk/rgb", "true_cubemap", "--keep-world"]
    command = [sys.executable, "-m", "epi360", *words]
    subprocess.run(command, cwd=scratch, check=True, capture_output=True)


def _judged(log: Path, rendered: Path, images: Path) -> str:
    """Mean loss of the first and of the last tenth of the steps, and the held-out view in dB."""
    losses = np.array([float(each) for each in re.findall(r"Step \d+: ([\d.]+)", log.read_text())])
    tenth = max(len(losses) // 10, 1)
    with Image.open(rendered) as one, Image.open(images / HELD_OUT) as other:
        error = np.asarray(one.convert("RGB"), float) - np.asarray(other.convert("RGB"), float)
    psnr = 10 * np.log10(255**2 / np.mean(error**2))
    first, last = losses[:tenth].mean(), losses[-tenth:].mean()
    return f"loss {first:.3f} to {last:.3f}; held-out view {psnr:.1f} dB"
