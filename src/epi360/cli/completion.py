# SPDX-License-Identifier: BSD-3-Clause
"""`epi360 completion`: commands and options at the press of the tab key."""

from __future__ import annotations

from typing import Literal

from epi360.cli.command import app
from epi360.cli.exit_codes import SUCCESS


@app.command
def completion(shell: Literal["bash", "zsh", "fish"], /) -> int:
    """Print the script that completes commands and options in a shell.

    Nothing is installed; write the script to where your shell looks for it:

    bash: ``epi360 completion bash > ~/.local/share/bash-completion/completions/epi360``

    zsh: ``epi360 completion zsh > ~/.zfunc/_epi360`` (a folder of ``$fpath``)

    fish: ``epi360 completion fish > ~/.config/fish/completions/epi360.fish``

    Parameters
    ----------
    shell
        bash, zsh or fish.
    """
    print(app.generate_completion(shell=shell))
    return SUCCESS
