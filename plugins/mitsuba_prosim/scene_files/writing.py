"""Files that are complete or not there."""

import os
from collections.abc import Mapping
from pathlib import Path


def write(contents: Mapping[Path, bytes]) -> list[Path]:
    """Writes files, and makes their folders; returns their paths. They take the old ones' places when all are complete.

    Raises OSError; then none of them is written, unless the last step, the renaming, fails between two.
    """
    parts = {}
    try:
        for path, content in contents.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            part = path.with_name(f".{path.name}.{os.getpid()}")
            parts[part] = path
            part.write_bytes(content)
        for part, path in parts.items():
            os.replace(part, path)
    finally:
        for part in parts:
            part.unlink(missing_ok=True)
    return list(parts.values())
