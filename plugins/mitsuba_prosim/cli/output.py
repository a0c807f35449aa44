"""Where a command writes: checked before the work, and what happens if writing fails all the same."""

import os
import re
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path

import click

from .. import atomic
from .options import InputError

#: Kinds of files that a name may end in. One that is not written is a mistake, not a part of the name.
KNOWN = re.compile(
    r"\.(avi|bmp|csv|exr|gif|hdr|html|jpe?g|json|mov|mp4|npz|pdf|pfm|ply|png|ppm|rgbe|scn|svg|tga|tiff?|txt|web[mp]|xml)"
)

#: What an image may not overwrite, in words.
SOURCES = "what the image is made of"


def stem(output: str | None, default: Path, suffixes: Collection[str], source: Path | None = None) -> Path:
    """Path without suffix of what is written with all of ``suffixes``.

    ``output``: the value of ``-o``, a file with one of them or without, or a folder; None for ``default``. Raises
    BadParameter where it is empty, another kind of file, a device, the ``source`` of what is written, or needs more
    than one new folder.
    """
    if output is None:
        return default
    path = expanded(output)
    if output.endswith(("/", os.sep)) or os.path.isdir(path):
        return _in_new_folder(path / default.name)
    suffix = path.suffix.lower()
    if suffix in suffixes:
        while path.suffix.lower() in suffixes:  # image.exr.png
            path = path.with_suffix("")
        return _in_new_folder(path)
    kinds = " and ".join(suffixes)
    if suffix and source is not None and os.path.exists(path) and path.samefile(source):
        wrong = f"this is the scene itself, and what is written is {kinds}; give their name, or a folder."
    elif KNOWN.fullmatch(suffix):
        wrong = f"what is written is {kinds}, not {suffix}."
    elif output == "-" or (os.path.exists(path) and not path.is_file()):
        wrong = f"what is written is {kinds}, which are files; give their name, or a folder."
    else:
        return _in_new_folder(path.with_name(path.name.rstrip(".") or path.name))  # a name that ends before its suffix
    raise click.BadParameter(f"'{output}': {wrong}", param_hint="-o")


def default_stem(output: str | None, scene: str, suffixes: Collection[str], ending: str = "") -> Path:
    """As :func:`stem`, by default beside the scene, under its name and an ``ending``."""
    path = Path(scene)
    return stem(output, path.with_name(path.stem + ending), suffixes, path)


def expanded(output: str) -> Path:
    """The value of ``-o``, with the user's folder for ``~``, which the shell leaves as it is in quotes and after ``=``.

    Raises BadParameter where it is empty.
    """
    if not output:
        raise click.BadParameter("expected a name or a folder, found nothing.", param_hint="-o")
    return Path(os.path.expanduser(output))


def refuse_folders(folder: Path) -> None:
    """Raises BadParameter where more than the folder would have to be made: most likely its name is mistyped."""
    if not os.path.lexists(folder) and not os.path.lexists(folder.parent):
        raise click.BadParameter(
            f"there is no folder '{folder.parent}'; one new folder is made, in one that is there.", param_hint="-o"
        )


def _in_new_folder(path: Path) -> Path:
    """The path, whose folder may be a new one; raises BadParameter as above."""
    refuse_folders(path.parent)
    return path


def with_suffixes(stem: Path, suffixes: Iterable[str]) -> list[Path]:
    """The paths that are written."""
    return [stem.with_name(stem.name + suffix) for suffix in suffixes]


def check(scene: Path, stem: Path, suffixes: Collection[str], size: int) -> None:
    """Raises InputError if files of ``size`` bytes in all could not be written, or the scene would be overwritten."""
    try:
        atomic.check(with_suffixes(stem, suffixes), size)
    except OSError as error:
        raise InputError(f"the result can't be written: {said(error)}. Choose another place with -o.") from None
    spare([scene], "the scene itself", stem, suffixes)


def spare(needed: Iterable[Path], what: str, stem: Path, suffixes: Collection[str]) -> None:
    """Raises InputError if a file of ``needed`` would be overwritten; ``what`` says what they are."""
    needed = [path for path in needed if path.exists()]
    for path in with_suffixes(stem, suffixes):
        if os.path.exists(path) and any(path.samefile(other) for other in needed):
            raise InputError(f"{path} is {what}; choose another name with -o.")


def save(stem: Path, contents: Mapping[str, atomic.Content]) -> list[Path]:
    """Writes suffix -> content; returns the paths. What can't be written there goes wherever there is room.

    Raises ClickException, which says where that is.
    """
    files = dict(zip(with_suffixes(stem, contents), contents.values()))
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
