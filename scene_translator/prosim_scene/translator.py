"""Translates a scene file to a Mitsuba scene, either as XML and mesh files on disk or as a dictionary."""

import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .atomic_files import TemporaryFolder
from .geometry import TranslationCache
from .language import document_of
from .language.diagnostics import AnyPath, SceneError
from .language.document import Document
from .mitsuba.assemble import assemble
from .mitsuba.translation_context import Options
from .model import Scene
from .nodes import Comment, Node, is_valid_in_xml, plain, xml
from .text_files import read
from .writer import MARK, TranslationFiles


def document(path: AnyPath, define: Mapping[str, object] | None = None) -> Document:
    """Reads a scene file; returns a document: the scene, and the position of each value in the file's text.

    ``define`` sets values of ``$names``, as for :func:`prosim_scene.parse`. The functions :func:`translate`,
    :func:`load` and :func:`check` accept the returned document instead of a path, so that a scene is read only once.
    Raises :class:`SceneError`.
    """
    return document_of(read(path), path, define)


def _opened(source: AnyPath | Document, define: Mapping[str, object] | None) -> Document:
    if not isinstance(source, Document):
        return document(source, define)
    if define:
        raise SceneError("define has no effect on a document; pass it to prosim_scene.document", source.source.filename)
    return source


def translate(
    source: AnyPath | Document,
    out_dir: AnyPath | None = None,
    *,
    define: Mapping[str, object] | None = None,
    cache: TranslationCache | None = None,
    **options: Any,
) -> Path:
    """Translates a scene file, or a :func:`document`, to ``<out_dir>/<stem>.xml`` and mesh files; returns the path of
    the XML file.

    ``out_dir``
        Folder of the translated files, which is created if it does not exist. Default: the scene's folder.
    ``define``
        Dictionary of values (numbers or words) for the ``$names`` in the scene.
    ``cache``
        A :class:`TranslationCache`, which keeps the surface of the evaluated CSG tree for the next translation.

    The functions :func:`load` and :func:`check` have the following options, too:

    ``target``
        "prosim" for this project's plugins, "stock" for Mitsuba's own plugins only (each kind of approximation causes
        one SceneWarning).
    ``light_units``
        "calibrated", "radiance" or "unattenuated": see :mod:`prosim_scene.mitsuba.lights`.
    ``tolerance``
        Largest chord error of a curved face, in pixels of the image (default 0.1).
    ``resolution``, ``samples``
        Image size (width, height) and number of samples N, which replace RESOLUTION and NSAMPLES of the scene.
    ``allow_outside``
        Whether the scene may use image and mesh files outside the scene's folder.

    Raises :class:`SceneError` for wrong input, and then writes no file. Emits a :class:`SceneWarning` for a probable
    mistake. A translation overwrites and removes only files of earlier translations.
    """
    checked, opened = Options(**options), _opened(source, define)
    source_path = Path(opened.source.filename)
    if not is_valid_in_xml(source_path.stem):
        reason = "this name is not valid in XML; expected one without control characters, in UTF-8"
        raise SceneError(reason, repr(str(source_path)))
    folder = Path(out_dir) if out_dir is not None else source_path.parent
    files = TranslationFiles(folder, source_path.stem)
    tree = {"mark": Comment(MARK), **assemble(opened, checked, files.store, files.image_path, cache)}
    try:
        return files.write(xml(tree))
    except OSError as error:
        raise SceneError(error.strerror or str(error), error.filename or folder) from None


def load(
    source: AnyPath | Document,
    *,
    define: Mapping[str, object] | None = None,
    cache: TranslationCache | None = None,
    **options: Any,
) -> Node:
    """Translates a scene file to a dictionary for ``mi.load_dict``; :func:`translate` describes the options.

    The meshes are in a temporary folder, which exists until the returned dictionary and its copies are deleted, or the
    process ends. A transform is a ``mitsuba.ScalarTransform4f`` of the active variant, or a 4x4 array if Mitsuba has no
    active variant.
    """
    checked, opened = Options(**options), _opened(source, define)
    try:
        tree = assemble(opened, checked, _MeshFolder().store, cache=cache)
    except OSError as error:
        raise SceneError(error.strerror or str(error), error.filename or tempfile.gettempdir()) from None
    mitsuba = sys.modules.get("mitsuba")
    result: Node = plain(tree, mitsuba.ScalarTransform4f if mitsuba and mitsuba.variant() else np.asarray)
    return result


class _MeshFolder(TemporaryFolder):
    """A temporary folder of meshes, which exists as long as a reference to it or to a :class:`_FileName` in it."""

    def store(self, name: str, content: bytes) -> str:
        """Writes the PLY file of a mesh to the temporary folder; returns the file name."""
        file = _FileName(self.path / f"{name}.ply")
        file.folder = self
        Path(file).write_bytes(content)
        return file


class _FileName(str):
    """The name of a file in a temporary folder, which exists as long as a reference to this name."""

    folder: _MeshFolder

    def __deepcopy__(self, _: Any) -> "_FileName":
        return self


def check(source: AnyPath | Document, *, define: Mapping[str, object] | None = None, **options: Any) -> Scene:
    """Analyses a scene file and evaluates its CSG tree, without writing a file; returns the scene.

    Raises a :class:`SceneError` and emits a :class:`SceneWarning` in the same cases as :func:`translate`, for example
    for primitives that are invisible in the evaluated CSG tree. Only errors about the files and file names that
    :func:`translate` writes are not found.
    """
    checked, opened = Options(**options), _opened(source, define)
    assemble(opened, checked, lambda name, _: name)
    return opened.scene
