"""The scenes of docs/walkthrough.md, whose blocks show only the statements that change."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[1] / "walkthrough.md"


def steps():
    """``(scene, picture)`` of each step: its whole text, and the file of its picture."""
    statements = {}
    for block, picture in re.findall(r"```scn\n(.*?)```\n\n!\[.*?\]\((.*?)\)", PAGE.read_text("utf-8"), re.DOTALL):
        for statement in re.split(r"\n(?=\S)", block.rstrip()):
            name = re.match(r"(?:SURFACE|TRANSFORM|TEXTURE) \S+|[\w-]+", statement)[0]
            statements[name] = statement
        end = statements.pop("END")
        yield "\n".join([*statements.values(), end, ""]), picture
        statements["END"] = end
