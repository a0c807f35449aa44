"""Evaluates the tree of a scene in a separate process, for an editor: its errors and warnings."""

import asyncio
import faulthandler
import os
import pickle
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

from .language.analysis import analyse
from .language.diagnostics import SceneError, SceneWarning
from .language.document import Document
from .mitsuba.assemble import assemble
from .translation_options import Options

#: The largest time of an evaluation in seconds.
TIME_LIMIT = 60.0
#: The folder of the package, from which the process imports; never the folder of a scene.
PACKAGES = Path(__file__).parents[1]


def evaluate(document: Document, folder: Path | None) -> list[SceneError | SceneWarning]:
    """The errors and warnings of ``prosim_scene.check`` for a document; ``folder`` has its images."""
    found: list[SceneError | SceneWarning] = []
    with warnings.catch_warnings(record=True) as warned, tempfile.TemporaryDirectory() as empty_folder:
        warnings.simplefilter("always", SceneWarning)
        try:
            assemble(document, folder or Path(empty_folder), Options(), lambda name, _: name, str)
        except SceneError as error:
            found.append(error)
    return found + [one.message for one in warned if isinstance(one.message, SceneWarning)]


async def evaluate_in_process(text: str, path: Path | None) -> list[SceneError | SceneWarning]:
    """The result of :func:`evaluate` for a scene without errors; empty if it takes longer than :data:`TIME_LIMIT`.

    Cancelling the task ends the process.
    """
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-c", "from prosim_scene.evaluation import main; main()"),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        cwd=PACKAGES,
        creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
    )
    try:
        found, _ = await asyncio.wait_for(process.communicate(pickle.dumps((text, path, TIME_LIMIT))), TIME_LIMIT)
    except asyncio.TimeoutError:
        return []
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    return pickle.loads(found) if process.returncode == 0 else []


def main() -> None:
    """Evaluates the scene on standard input, and writes the result to standard output, both pickled.

    Ends the process with exit code 1 after the time limit in the input, also if its parent has ended before.
    """
    text, path, seconds = pickle.load(sys.stdin.buffer)
    with open(os.devnull, "w") as empty_folder:
        # A signal or a thread of Python would wait for the operation on solids; this timer does not.
        faulthandler.dump_traceback_later(seconds, exit=True, file=empty_folder)
        _, _, document = analyse(text, str(path or "<string>"))
        found = evaluate(document, path and path.parent) if document is not None else []
        faulthandler.cancel_dump_traceback_later()
    pickle.dump(found, sys.stdout.buffer)
