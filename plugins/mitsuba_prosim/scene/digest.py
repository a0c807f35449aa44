"""A scene by its content."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

import mitsuba as mi

from .references import UnreadableError, references


def digest(state: mi.parser.ParserState) -> str:
    """SHA-256 of a parsed scene, in which the name of a file stands for its content. Comments, the names of files and
    how numbers are written make no difference. To be called with the search path that parsing has left.
    """
    state = mi.parser.ParserState(state)
    for props, name, path in strings(state):
        props[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    versions = " ".join(map(str, state.versions))
    return hashlib.sha256(f"{versions}\n{mi.parser.write_string(state)}".encode()).hexdigest()


def named_files(
    state: mi.parser.ParserState, definitions: Mapping[str, str], begin: mi.FileResolver
) -> Iterator[tuple[str, Path]]:
    """``(name, path)`` of each file that a scene names, but for XML files. ``begin``: the search path with which
    parsing began; to be called with the one that parsing has left.
    """
    for props, name, path in strings(state):
        yield props[name], path
    # The parser itself reads the files of spectra.
    with suppress(UnreadableError):
        for reference in references(str(state.files[0]), definitions, begin):
            if reference.tag == "spectrum" and reference.path.is_file():
                yield reference.name, reference.path


def strings(state: mi.parser.ParserState) -> Iterator[tuple[mi.Properties, str, Path]]:
    """The parameters of a parsed scene that name a file, and its path."""
    resolver = mi.file_resolver()
    for props in (node.props for node in state.nodes):
        for name in [name for name in props if props.type(name) == mi.Properties.Type.String and props[name]]:
            path = Path(str(resolver.resolve(props[name])))
            if path.is_file():
                yield props, name, path
