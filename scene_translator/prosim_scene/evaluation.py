"""What only the evaluation of the tree shows, for an editor that waits for nothing: it runs in a process of its own."""

import asyncio
import faulthandler
import json
import os
import subprocess
import sys
import tempfile
import warnings
from dataclasses import asdict
from pathlib import Path

from .language.analysis import analyse
from .language.diagnostics import Diagnostic, SceneError, SceneWarning, diagnostic
from .language.document import Document
from .mitsuba.assemble import assemble
from .options import Options

#: Seconds after which an evaluation is given up.
PATIENCE = 60.0
#: Where the package lies: what runs there finds it, and nothing that lies beside a scene.
PACKAGES = Path(__file__).parents[1]


def evaluate(document: Document, folder: Path | None) -> list[Diagnostic]:
    """What ``prosim_scene.check`` says of a document when it evaluates the tree; ``folder`` has its images."""
    with warnings.catch_warnings(record=True) as warned, tempfile.TemporaryDirectory() as nowhere:
        warnings.simplefilter("always", SceneWarning)
        failed = []
        try:
            assemble(document, folder or Path(nowhere), Options(), lambda name, _: name, str)
        except SceneError as error:
            failed.append(diagnostic(error))
    return [*failed, *(diagnostic(w.message) for w in warned if isinstance(w.message, SceneWarning))]


async def evaluated(text: str, path: Path | None) -> list[Diagnostic]:
    """What :func:`evaluate` says of a scene that is right; nothing where it takes longer than :data:`PATIENCE`.

    Where this is cancelled the process ends.
    """
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-c", "from prosim_scene.evaluation import main; main()"),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        cwd=PACKAGES,
        creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
    )
    try:
        scene = json.dumps({"text": text, "path": path and str(path), "seconds": PATIENCE})
        found, _ = await asyncio.wait_for(process.communicate(scene.encode()), PATIENCE)
    except asyncio.TimeoutError:
        return []
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    return [Diagnostic(**one) for one in json.loads(found)] if process.returncode == 0 else []


def main() -> None:
    """Evaluates the scene that comes by standard input, and writes what it says to standard output, both in JSON.

    Ends the process with 1 after as many seconds as the input says, also where nobody is left to end it.
    """
    scene = json.load(sys.stdin)
    path = Path(scene["path"]) if scene["path"] else None
    with open(os.devnull, "w") as nowhere:
        # No signal, nor a thread of Python's: an operation on solids may let neither in.
        faulthandler.dump_traceback_later(scene["seconds"], exit=True, file=nowhere)
        _, _, document = analyse(scene["text"], str(path or "<string>"))
        found = evaluate(document, path and path.parent) if document is not None else []
        faulthandler.cancel_dump_traceback_later()
    print(json.dumps([asdict(one) for one in found]))
