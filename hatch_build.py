"""The README as a package index shows it: relative links lead nowhere there."""

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface


def absolute(text: str, source: str | None) -> str:
    """The README ``text`` with links to the repository ``source``; without a repository, with neither relative links
    nor pictures.
    """
    picture, link = r"!\[([^]]*)\]\((?!https?:)([^)]+)\)", r"(?<!!)\[([^]]*)\]\((?!https?:)([^)]+)\)"
    if source:
        text = re.sub(picture, rf"![\1]({source}/raw/HEAD/\2)", text)
        return re.sub(link, rf"[\1]({source}/blob/HEAD/\2)", text)
    return re.sub(link, r"\1", re.sub(picture + r"\n+(\*[^*]+\*\n+)?", "", text))


class ReadmeHook(MetadataHookInterface):
    """Sets the description of the package."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Adds the field ``readme``; the repository is ``Source`` in ``[project.urls]``."""
        text = Path(self.root, "README.md").read_text(encoding="utf-8")
        source = metadata["urls"].get("Source")
        metadata["readme"] = {"content-type": "text/markdown", "text": absolute(text, source)}
