"""Parses, changes and loads a scene file in XML, or in the thesis's scene language, which is translated to XML."""

from __future__ import annotations

import hashlib
import os
import re
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import OpenEXR
import prosim_scene

from .. import compat, registry
from . import overrides, session
from .confinement import INSTALLED, Confinement, elements
from .errors import check_images

#: Arguments of :func:`prosim_scene.translate`: the arguments that only the scene language has, and all arguments.
LANGUAGE = ("light_units", "tolerance")
TRANSLATION = (*LANGUAGE, "allow_outside", "cache")

COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)


class SceneFile:
    """A parsed scene file, which is read only once; each call of :meth:`load` makes a new scene."""

    def __init__(
        self,
        path: str | Path,
        folder: Path,
        definitions: Mapping[str, str] | None = None,
        resolution: tuple[int, int] | None = None,
        crop: tuple[int, int, int, int] | None = None,
        integrator: Mapping[str, Any] | None = None,
        sensor: int = 0,
        confined: bool = False,
        **translation: Any,
    ) -> None:
        """Reads the scene file ``path``, which is XML if its suffix is .xml, else a text in the thesis's scene
        language.

        ``folder``
            Folder in which the translator of the scene language writes its files, unused for XML; the folder must exist
            until the last call of :meth:`load`.
        ``definitions``
            Values that replace the ``$name`` constants in the text of the scene.
        ``resolution``, ``crop``, ``sensor``
            New size (width, height) of the image of the ``sensor`` with this index, and new crop window (x, y, width,
            height), in pixels; None: as in the file.
        ``integrator``
            New values for parameters of the scene's integrator, such as ``samples``; see :func:`.overrides.apply`.
        ``confined``
            Whether the scene may use only files in the folder of the scene file, see :class:`.confinement.Confinement`.
        ``translation``
            Further arguments for :func:`prosim_scene.translate`, with the names in :data:`TRANSLATION`. For XML, the
            arguments in :data:`LANGUAGE` are errors, and the others have no effect.

        Raises :class:`prosim_scene.SceneError` for a mistake in the scene language, ValueError if the changes do not
        suit the scene, TypeError for an unknown name in ``translation``, OutsideError if a ``confined`` scene uses a
        file outside its folder, OSError for a device or a pipe, and the errors of Mitsuba's parser. Warns if
        ``resolution`` has another aspect ratio than the WINDOW of a scene in the scene language, which distorts the
        image.
        """
        if unknown := sorted(translation.keys() - {*TRANSLATION}):
            raise TypeError(f"no such argument: {', '.join(unknown)}; integrator={{...}} takes samples and the like")
        self.path = self.xml = Path(path)
        prosim_scene.refuse_special(self.path)  # to read a pipe might wait forever
        #: The parsed text in the scene language; None for XML.
        self.document: prosim_scene.Document | None = None
        parameters = dict(integrator or {})
        if self.path.suffix.lower() != ".xml":
            self.document = prosim_scene.document(self.path, dict(definitions or {}))
            self.xml = prosim_scene.translate(
                self.document, Path(folder), resolution=resolution, samples=parameters.get("samples"), **translation
            )
            left, bottom, right, top = self.document.scene.view.window
            if resolution and (wrong := prosim_scene.distortion_message(*resolution, (right - left) / (top - bottom))):
                warnings.warn(prosim_scene.SceneWarning(f"{self.path}: {wrong}"), stacklevel=2)
            definitions = resolution = None  # the translated file already contains both
        elif unfit := overrides.option_names(name for name in LANGUAGE if translation.get(name)):
            raise ValueError(f"{unfit}: only for scenes in the thesis's language; {self.path} is XML")
        #: Arguments with which :class:`SceneFile` reads the same scene from :attr:`xml`, on a worker for example.
        self.changes: dict[str, Any] = {
            "definitions": dict(definitions or {}),
            "resolution": resolution,
            "crop": crop,
            "integrator": parameters,
            "sensor": sensor,
        }
        folders = [self.xml.parent, self.path.parent]
        # A confinement begins with the scene's folder; the search path begins with the folder of the XML file.
        confinement = Confinement(reversed(folders)) if confined else None
        # A file of a confined scene cannot replace a file of Mitsuba, because the folder of Mitsuba is first.
        with session.search_path([INSTALLED, *folders] if confined else folders) as resolver:
            #: The search path, to which elements <path> then add folders.
            self.folders = [str(folder) for folder in resolver]
            if confinement and self.xml is self.path:
                confinement.check_text(self.xml)
            self._unread: list[str] = []  # what :meth:`_spectrum_files` cannot read
            self._spectra = {*self._spectrum_files(self.xml, self.folders, dict(definitions or {}))}
            self.state = parse(self.xml, definitions or {})
            for place in self._unread:
                why = f"{place}; Mitsuba accepts this, but its spectrum files are neither watched nor sent to a cluster"
                warnings.warn(prosim_scene.SceneWarning(why), stacklevel=2)
            #: Mitsuba's search path of the scene's files.
            self.resolver = mi.file_resolver()
            if confinement:
                confinement.check_state(self.state)
            self._unchanged = mi.parser.ParserState(self.state)  # for digest()
        self._materials = sorted({*self._material_files()})
        try:
            #: What became of the scene's integrator, such as "path within prosim_adaptive"; None if it is kept.
            self.wrapped = overrides.apply(self.state, resolution, crop, parameters, sensor)
        except ValueError as error:
            raise ValueError(f"{self.path}: {error}") from None
        except TypeError:  # of a parameter: Mitsuba tells its name and its line
            self.state = self._unchanged
            self.load()
            raise

    def digest(self) -> str:
        """Returns a SHA-256 digest of the scene's content, with the values of its ``$name`` constants, and of the files
        that it uses.

        The digest does not depend on comments, names of files and formats of numbers, nor on ``resolution``, ``crop``
        and ``integrator``, except for ``resolution`` and the number of samples that the translator of the scene
        language writes.
        """
        state = mi.parser.ParserState(self._unchanged)
        for props, name, path in self._file_parameters(state):
            props[name] = hashlib.sha256(path.read_bytes()).hexdigest()
        versions = " ".join(map(str, state.versions))
        versions += "".join(hashlib.sha256(path.read_bytes()).hexdigest() for _, path in self._materials)
        return hashlib.sha256(f"{versions}\n{mi.parser.write_string(state)}".encode()).hexdigest()

    def named_files(self) -> list[tuple[str, Path]]:
        """Returns ``(name, path)`` for each XML file of the scene, and then for each other file that the scene uses.

        ``name`` is the name in the scene's text, with the values of its ``$name`` constants; that of an XML file has no
        folder.
        """
        texts = [(path.name, path) for path in map(Path, map(str, self.state.files))]
        files = [(props[name], path) for props, name, path in self._file_parameters(self.state)]
        return [*texts, *files, *sorted(self._spectra), *self._materials]

    def _spectrum_files(
        self, text: Path, folders: list[str], values: dict[str, str], *within: Path
    ) -> Iterator[tuple[str, Path]]:
        """Yields ``(name, path)`` for each spectrum file that the XML file ``text`` or a file included in it uses.

        Mitsuba's parser replaces the names of spectrum files by their content, so this method searches the text, and,
        like the parser, the search path ``folders``. It adds the values of the elements ``default`` to the ``values``
        of the ``$key`` parameters. ``within`` are the files that include ``text``. Raises RecursionError for elements
        that are too deep for the parser.
        """
        if text in within or not text.is_file():  # the parser refuses both, but a pipe
            return
        folders = [*folders]
        try:
            # Mitsuba accepts "--" within a comment.
            found = elements(COMMENT.sub(b"", text.read_bytes()), strict=False)
        except RecursionError as error:
            raise RecursionError(f"At {text} {error}; Mitsuba's parser would lack memory; make them flatter") from None
        except ValueError as error:
            self._unread.append(f"At {text} {error}")
            return
        for tag, attributes, _, _ in found:
            for key in sorted(values, key=len, reverse=True):  # $key may be the beginning of a longer name
                attributes = {name: value.replace(f"${key}", values[key]) for name, value in attributes.items()}
            name = attributes.get("filename", attributes.get("value", ""))
            if tag == "default":
                values.setdefault(attributes.get("name", ""), name)
                continue
            search = [str(text.parent), *folders] if tag == "include" else folders
            place = next(filter(os.path.exists, (os.path.join(folder, name) for folder in search)), "")
            if tag == "path" and place:
                folders.insert(0, place)
            elif tag == "spectrum" and os.path.isfile(place):
                yield name, Path(place)
            elif tag == "include" and os.path.isfile(place):
                yield from self._spectrum_files(Path(place), search, values, text, *within)

    def _material_files(self) -> Iterator[tuple[str, Path]]:
        """Yields ``(name, path)`` for the files of each conductor's ``material`` that is not one of Mitsuba's."""
        for value in (node.props.get("material") for node in self.state.nodes):
            for name in (file.format(value) for file in compat.MATERIAL_FILES):
                path = Path(str(self.resolver.resolve(name)))
                if os.path.isfile(path) and not path.resolve().is_relative_to(Path(INSTALLED).resolve()):
                    yield name, path

    def sources(self) -> list[Path]:
        """Returns the paths of the files that the scene uses, except for a file in the scene language itself, and for
        the files that the translator wrote.
        """
        if self.document is None:
            return [path for _, path in self.named_files()]
        names = [*(name for name, _ in prosim_scene.images(self.document)), *prosim_scene.meshes(self.document)]
        return [prosim_scene.located(self.path.parent, name) for name in names]

    def _file_parameters(self, state: mi.parser.ParserState) -> Iterator[tuple[mi.Properties, str, Path]]:
        """Yields ``(properties, name, path)`` for each parameter ``name`` whose value names an existing file."""
        for props in (node.props for node in state.nodes):
            for name in [name for name in props if props.type(name) == mi.Properties.Type.String and props[name]]:
                path = Path(str(self.resolver.resolve(props[name])))
                if os.path.isfile(path):  # pathlib raises an error for a list of numbers that is too long for a name
                    yield props, name, path

    def load(self, sampler: str | None = None) -> mi.Scene:
        """Makes a scene from the parsed file; ``sampler`` is the name of a plugin that replaces its samplers, see
        :func:`.overrides.set_sampler`.

        Raises Mitsuba's errors, and :class:`prosim_scene.SceneError` for a damaged image of a scene in the scene
        language.
        """
        state = mi.parser.ParserState(self.state)
        if sampler:
            overrides.set_sampler(state, sampler)
        reads_exr = any(OpenEXR.isOpenExrFile(str(path)) for _, _, path in self._file_parameters(self.state))
        threads = max(dr.thread_count(), compat.EXR_THREADS) if reads_exr else None
        try:
            with session.search_path([*self.resolver]), session.threads(threads):
                return instantiate(state)
        except RuntimeError:
            if self.document is not None:
                check_images(self.document)
            raise


def parse(path: str | Path, parameters: Mapping[str, str]) -> mi.parser.ParserState:
    """Returns the state of Mitsuba's parser after an XML scene file.

    ``parameters`` are the values of the ``$key`` constants. Raises ValueError for a name that Mitsuba reserves or
    cannot read, and the errors of :func:`check_parameters` and of the parser.
    """
    if taken := set(compat.RESERVED) & set(parameters):
        raise ValueError(f"-D {taken.pop()}=...: Mitsuba reserves this name; choose another")
    for text in (str(path), *parameters, *parameters.values()):
        if (shown := text.encode("utf-8", "replace").decode()) != text:
            raise ValueError(f"{shown}: Mitsuba reads only names and values in UTF-8; change it")
    config = mi.parser.ParserConfig(mi.variant() or "")
    state = mi.parser.parse_file(config, str(path), **parameters)
    mi.parser.transform_upgrade(config, state)  # old names of parameters, such as maxDepth
    check_parameters(state)
    return state


def check_parameters(state: mi.parser.ParserState) -> None:
    """Raises ValueError for the first plugin of a parsed scene whose parameters would end the process."""
    for node in state.nodes:
        props, plugin, wrong = node.props, node.props.plugin_name(), ""
        if (needed := compat.REQUIRED.get(plugin)) and not any(name in props for name in needed):
            wrong = f"this {plugin} has no {needed[0]}, which it needs"
        elif (
            node.type == mi.ObjectType.Sampler and isinstance(count := props.get("sample_count", 1), int) and count < 1
        ):
            wrong = f"sample_count is {count} in the sampler {plugin}; give 1 or more"  # Mitsuba would divide by it
        if wrong:
            raise ValueError(f"At {mi.parser.file_location(state, node)}: {wrong}")


def instantiate(state: mi.parser.ParserState) -> mi.Scene:
    """Makes the Mitsuba scene that a parser state describes; the parser state cannot be used again."""
    return compat.instantiate(mi.parser.ParserConfig(mi.variant() or ""), state, registry.PLUGINS)


def require_scene(caller: str, scene: object) -> None:
    """Raises TypeError, about ``caller``, if ``scene`` is no loaded scene of the active variant."""
    if isinstance(scene, mi.Scene):
        return
    if type(scene).__name__ == "Scene" and hasattr(scene, "variant_name"):
        raise TypeError(
            f"{caller}: this scene was loaded in the variant {scene.variant_name()}, but {mi.variant()} is active; "
            "load it again, or set its variant."
        )
    raise TypeError(f"{caller}: a scene or the name of its file is needed, not {type(scene).__name__}.")
