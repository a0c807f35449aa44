"""Evaluates the tree of a scene in a separate process, for an editor: its errors and warnings."""

import asyncio
import faulthandler
import os
import pickle
import subprocess
import sys
import warnings
from pathlib import Path

from .language import document_of
from .language.diagnostics import Problem, SceneError, SceneWarning
from .translator import check

#: The largest time of an evaluation in seconds.
TIME_LIMIT = 60.0
#: The folder of the package, from which the process imports; never the folder of a scene.
PACKAGES = Path(__file__).parents[1]


def evaluate(text: str, filename: str) -> list[Problem]:
    """The errors and warnings of :func:`prosim_scene.check` for the text of a scene."""
    found: list[Problem] = []
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always", SceneWarning)
        try:
            check(document_of(text, filename))
        except SceneError as error:
            found = [error, *error.others]
    return found + [one.message for one in warned if isinstance(one.message, SceneWarning)]


async def evaluate_in_process(text: str, filename: str) -> list[Problem] | None:
    """The result of :func:`evaluate`; None if it takes longer than :data:`TIME_LIMIT`. Cancelling ends the process."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-c", "from prosim_scene.evaluation import main; main()"),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        cwd=PACKAGES,
        creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
    )
    try:
        found, _ = await process.communicate(pickle.dumps((text, filename, TIME_LIMIT)))
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    return pickle.loads(found) if process.returncode == 0 else None


def main() -> None:
    """Evaluates the scene on standard input, and writes the result to standard output, both pickled.

    Ends the process with exit code 1 after the time limit in the input.
    """
    text, filename, seconds = pickle.load(sys.stdin.buffer)
    with open(os.devnull, "w") as nowhere:
        # A signal or a thread of Python would wait for the operation on solids; this timer does not.
        faulthandler.dump_traceback_later(seconds, exit=True, file=nowhere)
        found = evaluate(text, filename)
        faulthandler.cancel_dump_traceback_later()
    pickle.dump(found, sys.stdout.buffer)
