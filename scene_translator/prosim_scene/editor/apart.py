"""Evaluates a scene in a process of its own, for that may take long, while an editor waits for nothing."""

import asyncio
import json
import subprocess
import sys
from pathlib import Path

from ..language.messages import Said

#: Seconds after which nothing more is expected of a tree.
PATIENCE = 60.0

#: Where the package lies: what runs there finds it, and nothing that lies beside a scene.
PACKAGES = Path(__file__).parents[2]


async def evaluated(text: str, path: Path | None) -> list[Said]:
    """What :func:`.evaluating.evaluate` says of a scene that is right. Where this is cancelled the process ends.

    Nothing is said where it takes longer than :data:`PATIENCE`; then the process ends, also where nobody is left to end
    it.
    """
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-c", "from prosim_scene.editor.evaluating import main; main()"),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        cwd=PACKAGES,
        creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
    )
    try:
        scene = json.dumps({"text": text, "path": path and str(path), "seconds": PATIENCE})
        said, _ = await asyncio.wait_for(process.communicate(scene.encode()), PATIENCE)
    except asyncio.TimeoutError:
        return []
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    return [Said(**one) for one in json.loads(said)] if process.returncode == 0 else []
