"""The plugins that there are, by name, and which of them is meant by a name that is none's."""

from __future__ import annotations

import difflib
import re
from pathlib import Path

import mitsuba as mi

from .. import registry
from .confinement import LIBRARIES

#: How Mitsuba says that it knows no such plugin: the tag in XML, and the name.
NOT_FOUND = re.compile(r'failed to instantiate (\w+) plugin of type "([^"\n]+)": [^\n]*not found!')
#: The kinds whose tag in XML is not their name.
KINDS = {"rfilter": "reconstructionfilter", "phase": "phasefunction"}


def nearest(name: str, kind: str) -> str | None:
    """The plugin of this kind, in lower case, whose name is most like ``name``; None where none is like it."""
    names = [path.stem for path in Path(mi.__file__).parent.glob("plugins/*") if path.suffix in LIBRARIES]
    near = difflib.get_close_matches(name, {*names, *registry.PLUGINS}, n=9)
    kind_of = mi.PluginManager.instance().plugin_type
    return next((one for one in near if kind_of(one).name.lower() == KINDS.get(kind, kind)), None)


def with_nearest(words: str) -> str:
    """Mitsuba's ``words``, and the plugin that may be meant where they say that there is none of that name."""

    def meant(found: re.Match[str]) -> str:
        near = nearest(found[2], found[1])
        return found[0] + (f" Did you mean {near}?" if near else "")

    return NOT_FOUND.sub(meant, words)
