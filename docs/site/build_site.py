# SPDX-License-Identifier: BSD-3-Clause
"""Build the site into a folder and check it: what `make docs` runs."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from check_site import mistakes
from public_names import SOURCES, public_names
from stage_pages import stage

HERE = Path(__file__).resolve().parent


def build(target: Path) -> None:
    """Write the site into a folder, which is replaced.

    Raises
    ------
    SystemExit
        If a page has a mistake; the message names them.
    """
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(scratch).resolve()
        stage(work / "docs")
        (work / "mkdocs.yml").write_text(configuration(), encoding="utf-8")
        environment = {**os.environ, "NO_COLOR": "1", "PYTHONUTF8": "1"}
        command = [sys.executable, "-m", "zensical", "build", "--clean", "--strict"]
        if subprocess.run(command, cwd=work, env=environment).returncode:
            raise SystemExit("The site was not built: see the warnings above.")
        if found := sorted(set(mistakes(work / "site"))):
            raise SystemExit("\n".join([*found, f"{len(found)} mistakes in the site"]))
        shutil.rmtree(target, ignore_errors=True)
        shutil.move(work / "site", target)


def configuration() -> str:
    """The settings of the generator, with this machine's paths and the pages of the API."""
    pages = "".join(f"\n      - {name}: api/{name}.md" for name in public_names())
    return (
        (HERE / "mkdocs.yml")
        .read_text(encoding="utf-8")
        .replace("API_PAGES", "\n      - Overview: api/index.md" + pages)
        .replace("[SOURCES]", f'["{SOURCES.as_posix()}"]')
        .replace("[DOCSTRINGS]", f'["{(HERE / "docstrings.py").as_posix()}"]')
    )


if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "site").resolve()
    build(folder)
    print(f"{folder / 'index.html'} opens in a browser")
