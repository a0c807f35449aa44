"""Evaluates the CSG tree of a scene in a separate process, and returns the errors and warnings that an editor shows."""

import asyncio
import faulthandler
import os
import pickle
import subprocess
import sys
import warnings
from pathlib import Path

from ..language import document_of
from ..language.diagnostics import Problem, SceneError, SceneWarning
from ..translator import check

#: The time limit of an evaluation in seconds.
TIME_LIMIT = 60.0
#: The folder that contains this package. The process starts here, so it never imports modules from a scene's folder.
PACKAGES = Path(__file__).parents[2]


def evaluate(text: str, filename: str) -> list[Problem]:
    """Returns the errors, followed by the warnings, that :func:`prosim_scene.check` finds in the text of a scene.

    ``filename`` is the path of the scene file: messages contain it, and the file names in the text are relative to its
    folder.
    """
    errors: list[Problem] = []
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always", SceneWarning)
        try:
            check(document_of(text, filename))
        except SceneError as error:
            errors = [error, *error.others]
    return errors + [warning.message for warning in warned if isinstance(warning.message, SceneWarning)]


async def evaluate_in_process(text: str, filename: str) -> list[Problem] | None:
    """Runs :func:`evaluate` in a new process, which ends with this coroutine; returns None if it fails or reaches the
    :data:`TIME_LIMIT`.
    """
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-c", "from prosim_scene.editor.evaluation import main; main()"),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        cwd=PACKAGES,
        creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
    )
    try:
        result, _ = await process.communicate(pickle.dumps((text, filename, TIME_LIMIT)))
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    return pickle.loads(result) if process.returncode == 0 else None


def main() -> None:
    """Writes the pickled problems of the pickled ``(text, filename, seconds)`` from standard input; after ``seconds``,
    writes nothing and ends with exit code 1.
    """
    text, filename, seconds = pickle.load(sys.stdin.buffer)
    with open(os.devnull, "w") as nowhere:
        # This timer works during an operation on solids; a Python signal handler or thread would run only after the
        # operation ends.
        faulthandler.dump_traceback_later(seconds, exit=True, file=nowhere)
        problems = evaluate(text, filename)
        faulthandler.cancel_dump_traceback_later()
    pickle.dump(problems, sys.stdout.buffer)
