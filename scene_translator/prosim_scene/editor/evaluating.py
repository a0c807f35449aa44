"""What only shows when the tree is evaluated."""

import tempfile
import warnings
from pathlib import Path

from ..assembling import assemble
from ..language.document import Document
from ..language.messages import Said, SceneError, SceneWarning, what_is_said
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
