# SPDX-License-Identifier: BSD-3-Clause
"""The command `epi360`: parse, one library call, report.

Exit codes: 0 success, 1 honest failure (the result's status says why), 2 wrong use (one line on
stderr), 130 interrupted. Heavy imports are inside the functions: the help appears at once.
"""

from __future__ import annotations

import os
import re
import sys
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from epi360.cli.exit_codes import FAILURE, INTERRUPTED, SUCCESS, WRONG_USE

# What OpenCV would print about a damaged picture, we say in one sentence.
os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
# What an interrupt leaves, by command; the others leave nothing.
GOES_ON = "what was finished is kept, and the same command goes on from there"
LEFT_BY = dict.fromkeys(
    ("batch", "cubemap", "frames", "map", "match", "render", "reproduce"), GOES_ON
)
LEFT_BY["track"] = "what was tracked so far is written, and the same command begins again"
TRACEBACK = "EPI360_TRACEBACK"  # set, an error shows where it comes from
LONGEST_MESSAGE = 1000  # characters: two paths as long as they may be on most disks, and a sentence
try:
    from cyclopts import CycloptsError, UnknownOptionError, UnusedCliTokensError

    # Importing the module of a command registers it.
    from epi360.cli import batch as _batch  # noqa: F401
    from epi360.cli import completion as _completion  # noqa: F401
    from epi360.cli import convert as _convert  # noqa: F401
    from epi360.cli import demo as _demo  # noqa: F401
    from epi360.cli import evaluate as _evaluate  # noqa: F401
    from epi360.cli import frames as _frames  # noqa: F401
    from epi360.cli import localize as _localize  # noqa: F401
    from epi360.cli import map as _map  # noqa: F401
    from epi360.cli import match as _match  # noqa: F401
    from epi360.cli import pair as _pair  # noqa: F401
    from epi360.cli import render as _render  # noqa: F401
    from epi360.cli import reproduce as _reproduce  # noqa: F401
    from epi360.cli import track as _track  # noqa: F401
    from epi360.cli.command import app, check_numbers
except KeyboardInterrupt:  # half a second in which a user may think again
    print("epi360: interrupted", file=sys.stderr)
    raise SystemExit(INTERRUPTED) from None

_KEYWORD = re.compile(r'\b(\w+)="([^"]*)"')  # as in pairs="near"

__all__ = ["FAILURE", "INTERRUPTED", "SUCCESS", "WRONG_USE", "app", "main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code of the command, after it has run.

    Parameters
    ----------
    arguments : sequence of str, optional
        Words after the program's name; those of the process by default.

    Returns
    -------
    code : int
        0 success, 1 honest failure, 2 wrong use, 130 interrupted.

    Notes
    -----
    An error is one line on stderr; with ``EPI360_TRACEBACK=1`` in the environment it is raised.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        _, given, _ = app.parse_args(words, exit_on_error=False, print_error=False)
        check_numbers(given.arguments)
        with warnings.catch_warnings():
            warnings.showwarning = partial(_show_warning, warnings.showwarning)
            code = app(words, exit_on_error=False, print_error=False, result_action="return_value")
    except BrokenPipeError:  # the reader of our output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return SUCCESS
    except (CycloptsError, ImportError, OSError, ValueError) as error:
        if os.environ.get(TRACEBACK):
            raise
        print(f"epi360: error: {_as_typed(_one_line(error), words)}", file=sys.stderr)
        return WRONG_USE
    except MemoryError as error:
        print(f"epi360: error: not enough memory: {_one_line(error)}", file=sys.stderr)
        return WRONG_USE
    except KeyboardInterrupt:
        left = LEFT_BY.get(words[0]) if words else None
        print("epi360: interrupted" + (f"; {left}" if left else ""), file=sys.stderr)
        return INTERRUPTED
    return code if isinstance(code, int) else SUCCESS


def _show_warning(
    shown_else: Callable[..., None], message: Warning | str, category: type[Warning], *more: Any
) -> None:
    """Show a warning to users as one line; those to programmers as they are."""
    if category is UserWarning:
        print(f"epi360: {message}", file=sys.stderr)
    else:
        shown_else(message, category, *more)


def _one_line(error: Exception) -> str:
    """Error message without its number and line breaks, cut in the middle where it is long."""
    text = str(error)
    if isinstance(error, OSError) and error.strerror is not None:
        text = error.strerror if error.filename is None else f"{error.filename}: {error.strerror}"
    elif isinstance(error, FileNotFoundError) and " " not in text:  # fsspec only names the file
        text = f"{text} does not exist"
    elif isinstance(error, UnusedCliTokensError | UnknownOptionError):
        text = _not_understood(error)
    text = " ".join(text.split()) or type(error).__name__
    if len(text) > LONGEST_MESSAGE:  # it quotes a name or a value as long as a file
        half = (LONGEST_MESSAGE - 5) // 2
        text = f"{text[:half]} ... {text[-half:]}"
    return text


def _as_typed(text: str, words: Sequence[str]) -> str:
    """Error message that names the options of the command, where it names parameters of Python."""
    options = _options_of(words)
    given = {word.partition("=")[0] for word in words}

    def option(name: str) -> str | None:
        typed = f"--{name.replace('_', '-')}"
        if typed not in given and typed[:-1] in given & options:  # --mask is mask1 and mask2
            return typed[:-1]
        return typed if typed in options else None

    name, must, rest = text.partition(" must ")
    if must and (typed := option(name)):
        text = f"{typed} must {rest}"
    return _KEYWORD.sub(
        lambda found: f"{typed} {found[2]}" if (typed := option(found[1])) else found[0], text
    )


def _options_of(words: Sequence[str]) -> set[str]:
    """Names of what the command of these words takes; empty if there is no such command."""
    if not words or words[0].startswith("-") or words[0] not in app:
        return set()
    taken = app[words[0]].assemble_argument_collection(parse_docstring=False)
    return {name for argument in taken for name in argument.names}


def _not_understood(error: UnusedCliTokensError | UnknownOptionError) -> str:
    """What words a command does not know, and where it says which ones it does."""
    command = " ".join(["epi360", *(error.command_chain or ())])
    look = f"'{command} --help' lists what it takes"
    if isinstance(error, UnknownOptionError):
        return f"{error} {look}"
    words = ", ".join(repr(word) for word in error.unused_tokens or ())
    return f"'{command}' takes no further {words}: outputs and settings have names, and {look}"
