# SPDX-License-Identifier: BSD-3-Clause
"""A process that decodes and estimates: what goes wrong there, or takes too long, ends there."""

import asyncio
import json
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from epi360_demo.limits import Limits, RefusedError

# The folder of the package comes last, so that it shadows nothing; -P keeps the current folder out.
_START = "import sys; sys.path.append(sys.argv[1]); from epi360_demo.worker import main; main()"
_LONGEST_LINE = 2**20


class WorkerProcess:
    """Runs `epi360_demo.worker` and talks with it in lines of JSON, which run nothing here."""

    def __init__(self, limits: Limits) -> None:
        self._max_pixels = limits.max_pixels
        self._process: asyncio.subprocess.Process | None = None

    async def run(
        self, request: dict[str, Any], on_progress: Callable[[str], None]
    ) -> dict[str, Any]:
        """Return the answer to a request; `RefusedError` where there is none."""
        process = self._process
        if process is None or process.returncode is not None:
            process = self._process = await self._started()
        assert process.stdin is not None and process.stdout is not None
        try:
            process.stdin.write(json.dumps(request).encode() + b"\n")
            await process.stdin.drain()
            while line := await process.stdout.readline():
                answer = json.loads(line)
                if "progress" in answer:
                    on_progress(str(answer["progress"]))
                    continue
                if "refusal" in answer:
                    raise RefusedError(str(answer["refusal"]))
                return dict(answer["answer"])
        except (ConnectionError, json.JSONDecodeError):
            pass
        self.kill()
        raise RefusedError(
            "The estimate ended in the middle, perhaps for want of memory; try smaller pictures."
        )

    def kill(self) -> None:
        """End the process if there is one."""
        process, self._process = self._process, None
        if process is not None and process.returncode is None:
            with suppress(ProcessLookupError):
                process.kill()

    async def close(self) -> None:
        """End the process and wait until it is gone."""
        process = self._process
        self.kill()
        if process is not None:
            await process.wait()

    async def _started(self) -> asyncio.subprocess.Process:
        # Read when OpenCV is loaded: its decoders refuse larger pictures of any format.
        environment = os.environ | {"OPENCV_IO_MAX_IMAGE_PIXELS": str(self._max_pixels)}
        return await asyncio.create_subprocess_exec(
            sys.executable, "-P", "-c", _START, str(Path(__file__).parents[1]),
            stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
            env=environment, limit=_LONGEST_LINE,
        )  # fmt: skip
