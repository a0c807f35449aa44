"""Where a command writes, seen to before the work, and what it does if that fails all the same."""

import os
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path

import click

from ..scene import atomic
from .options import InputError

#: Kinds of files that a name may end in. One that is not written is a mistake, not a part of the name.
KNOWN = {
    ".avi",
    ".bmp",
    ".csv",
    ".exr",
    ".gif",
    ".hdr",
    ".html",
    ".jpeg",
    ".jpg",
    ".json",
    ".mov",
    ".mp4",
    ".pdf",
    ".pfm",
    ".ply",
    ".png",
    ".ppm",
    ".rgbe",
    ".scn",
    ".svg",
    ".tga",
    ".tif",
    ".tiff",
    ".txt",
    ".webm",
    ".webp",
    ".xml",
}

#: What an image may not overwrite, in words.
SOURCES = "what the image is made of"


def stem(output: str | None, default: Path, suffixes: Collection[str], source: Path | None = None) -> Path:
    """Path without suffix of what is written with all of ``suffixes``.

    ``output``: what ``-o`` says, a file with one of them or without, or a folder; None for ``default``. Raises
    BadParameter where it says nothing, another kind of file, a device, the ``source`` of what is written, or more than
    one folder that is not there.
    """
    if output is None:
        return default
    path = Path(expanded(output))
    if output.endswith(("/", os.sep)) or os.path.isdir(path):
        return _in_new_folder(output, path / default.name)
    suffix = path.suffix.lower()
    if suffix in suffixes:
        while path.suffix.lower() in suffixes:  # image.exr.png
            path = path.with_suffix("")
        return _in_new_folder(output, path)
    kinds = " and ".join(suffixes)
    wrong = None
    there = os.path.exists(path)
    if suffix and source is not None and there and path.samefile(source):
        wrong = f"this is the scene itself, and what is written is {kinds}; give their name, or a folder."
    elif suffix in KNOWN:
        wrong = f"what is written is {kinds}, not {suffix}."
    elif output == "-" or (there and not path.is_file()):
        wrong = f"what is written is {kinds}, which are files; give their name, or a folder."
    if wrong is not None:
        raise click.BadParameter(f"'{output}': {wrong}", param_hint="-o")
    if name := path.name.rstrip("."):  # a name that ends before its suffix
        path = path.with_name(name)
    return _in_new_folder(output, path)


def expanded(output: str) -> str:
    """What ``-o`` says, with the user's folder for ``~``, which the shell leaves as it is in quotes and after ``=``.

    Raises BadParameter where it says nothing.
    """
    if not output:
        raise click.BadParameter("expected a name or a folder, found nothing.", param_hint="-o")
    return os.path.expanduser(output)


def refuse_folders(output: str, folder: Path) -> None:
    """Raises BadParameter where more than the folder would have to be made: most likely its name is mistyped."""
    above = folder.parent
    if not os.path.lexists(folder) and not os.path.lexists(above):
        raise click.BadParameter(
            f"'{output}': there is no folder '{above}'; one new folder is made, in one that is there.", param_hint="-o"
        )


def _in_new_folder(output: str, path: Path) -> Path:
    """The path, whose folder may be a new one; raises BadParameter as above."""
    refuse_folders(output, path.parent)
    return path


def check(scene: Path, stem: Path, suffixes: Collection[str], size: int) -> None:
    """Raises InputError if files of ``size`` bytes in all could not be written, or the scene would be overwritten."""
    paths = [stem.with_name(stem.name + suffix) for suffix in suffixes]
    try:
        atomic.check(paths, size)
    except OSError as error:
        raise InputError(f"the result can't be written: {said(error)}. Choose another place with -o.") from None
    spare([scene], "the scene itself", stem, suffixes)


def spare(needed: Iterable[Path], what: str, stem: Path, suffixes: Collection[str]) -> None:
    """Raises InputError if files that are ``needed`` would be overwritten; ``what``: they are, in words."""
    paths = [path for suffix in suffixes if (path := stem.with_name(stem.name + suffix)).exists()]
    for other in needed if paths else ():
        for path in paths:
            if other.exists() and path.samefile(other):
                raise InputError(f"{path} is {what}; choose another name with -o.")


def save(stem: Path, contents: Mapping[str, atomic.Content]) -> list[Path]:
    """Writes suffix -> content; returns the paths. What can't be written there goes wherever there is room.

    Raises ClickException, which says where that is.
    """
    files = {stem.with_name(stem.name + suffix): content for suffix, content in contents.items()}
    try:
        return atomic.write(files)
    except OSError as error:
        failure = f"{' and '.join(map(str, files))} could not be written: {said(error)}"
    try:
        kept = atomic.rescue(files)
    except OSError as error:
        raise click.ClickException(f"{failure}; nor could anything else: {said(error)}") from None
    raise click.ClickException(f"{failure}. The result is in {' and '.join(map(str, kept))}") from None


def said(error: OSError) -> str:
    """What an error of the system says, and of which file."""
    return ": ".join(map(str, filter(None, (error.filename, error.strerror)))) or str(error)
