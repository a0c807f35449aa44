"""What only shows when the tree is evaluated."""

import faulthandler
import json
import os
import sys
import tempfile
import warnings
from dataclasses import asdict
from pathlib import Path

from ..assembling import assemble
from ..language.document import Document
from ..language.judging import judge
from ..language.messages import Said, SceneError, SceneWarning, what_is_said
from ..language.reading import Reading
from ..options import Options


def evaluate(document: Document, folder: Path | None) -> list[Said]:
    """What ``prosim_scene.check`` says of a document when it evaluates the tree; ``folder`` has its images."""
    with warnings.catch_warnings(record=True) as warned, tempfile.TemporaryDirectory() as nowhere:
        warnings.simplefilter("always", SceneWarning)
        failed = []
        try:
            assemble(document, folder or Path(nowhere), Options(), lambda name, _: name, str)
        except SceneError as error:
            failed.append(what_is_said(error))
    return [*failed, *(what_is_said(w.message) for w in warned if isinstance(w.message, SceneWarning))]


def main() -> None:
    """Evaluates the scene that comes by standard input, and tells by standard output; see :mod:`.apart`. Ends the
    process with 1 after as many seconds as that says.
    """
    scene = json.load(sys.stdin)
    path = Path(scene["path"]) if scene["path"] else None
    with open(os.devnull, "w") as nowhere:
        # No signal, nor a thread of Python's: an operation on solids may let neither in.
        faulthandler.dump_traceback_later(scene["seconds"], exit=True, file=nowhere)
        _, document = judge(Reading(scene["text"], str(path or "<string>")))
        found = evaluate(document, path and path.parent) if document is not None else []
        faulthandler.cancel_dump_traceback_later()
    print(json.dumps([asdict(one) for one in found]))
