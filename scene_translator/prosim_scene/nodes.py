"""Represents a Mitsuba scene as nested dictionaries for ``mi.load_dict``, and converts the dictionaries to XML."""

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from html import escape
from typing import Any
from xml.etree import ElementTree

import numpy as np

INDENT = "    "
INVALID_IN_XML = re.compile("[\x00-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")

#: Name of an XML element -> the plugins of this element that the translator uses.
PLUGINS = {
    "integrator": "prosim path volpath",
    "sensor": "perspective prosim_window thinlens",
    "film": "hdrfilm",
    "sampler": "nrook multijitter",
    "rfilter": "box",
    "shape": "ply sphere",
    "medium": "homogeneous",
    "emitter": "prosim_area prosim_point area point spot constant envmap",
    "texture": "bitmap prosim_brick prosim_stripes prosim_fractal prosim_product",
    "bsdf": "prosim_conductor prosim_dielectric prosim_lambertian prosim_composite prosim_phong diffuse conductor "
    "roughconductor dielectric roughdielectric plastic roughplastic blendbsdf",
}
#: Plugin -> the name of its XML element.
TAGS = {plugin: tag for tag, plugins in PLUGINS.items() for plugin in plugins.split()}

#: The dictionary of a plugin: its "type", its parameters, and its nested plugins.
Node = dict[str, Any]


@dataclass(frozen=True)
class Default:
    """A named number in the XML file, which ``-D name=value`` of Mitsuba's command can replace."""

    name: str
    value: int | float


class Comment(str):
    """A comment before the next element of the same dictionary; its key has no effect."""


class Point(list[float]):
    """Coordinates of an XML element ``point``; a plain list of three numbers becomes a ``vector``."""


def rgb(color: Iterable[float]) -> Node:
    """Returns Mitsuba's dictionary (type "rgb") of a colour with the channels r, g and b."""
    return {"type": "rgb", "value": [float(c) for c in color]}


def rgb_clipped(color: Iterable[float]) -> Node:
    """Returns Mitsuba's dictionary (type "rgb") of a reflectance: a colour whose channels are clipped to at most 1."""
    return rgb(min(c, 1.0) for c in color)


def plain(value: Any, transform: Callable[[np.ndarray], Any]) -> Any:
    """Returns a copy of a plugin's dictionary, or of a value in it, for ``mi.load_dict``.

    The copy contains no :class:`Comment`. In the copy, each :class:`Default` is replaced by its value, and each matrix
    by the result of ``transform(matrix)``.
    """
    if isinstance(value, dict):
        return {key: plain(part, transform) for key, part in value.items() if not isinstance(part, Comment)}
    if isinstance(value, Default):
        return value.value
    return transform(value) if isinstance(value, np.ndarray) else value


def values_in(node: Node) -> Iterator[Any]:
    """Yields the values in a plugin's dictionary and in the dictionaries that are nested in it."""
    for value in node.values():
        if isinstance(value, dict):
            yield from values_in(value)
        else:
            yield value


def xml(scene: Node) -> str:
    """Returns a scene as XML text, with an element ``default`` at the beginning for each :class:`Default`."""
    root = ElementTree.Element("scene", version="3.0.0")
    for name, value in {d.name: d.value for d in values_in(scene) if isinstance(d, Default)}.items():
        ElementTree.SubElement(root, "default", name=name, value=xml_number(value))
    for key, value in scene.items():
        if key != "type":
            _append(root, key, value, 1)
    ElementTree.indent(root, INDENT)
    # ElementTree writes "<a />" instead of "<a/>", and "&#10;" for a line end in a matrix.
    text = ElementTree.tostring(root, encoding="unicode").replace(" />", "/>").replace("&#10;", "\n")
    text = text.replace(f"\n{INDENT}<!--", f"\n\n{INDENT}<!--")  # a blank line before each statement
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n'


def is_valid_in_xml(text: str) -> bool:
    """Whether a file name can be written to an XML file: it contains no control characters and no invalid Unicode."""
    return not INVALID_IN_XML.search(text)


def xml_number(value: float) -> str:
    """Formats a number for XML with ten significant digits, which is more than Mitsuba's single precision has."""
    return format(value, ".10g")


def _append(parent: ElementTree.Element, name: str, value: Any, depth: int) -> None:
    if isinstance(value, Comment):
        # A comment in XML must not contain "--".
        text = escape(INVALID_IN_XML.sub("?", value), quote=False).replace("--", "- -")
        parent.append(ElementTree.Comment(f" {text} "))
    elif isinstance(value, dict) and value["type"] == "rgb":
        ElementTree.SubElement(parent, "rgb", name=name, value=", ".join(map(xml_number, value["value"])))
    elif isinstance(value, dict):
        element = ElementTree.SubElement(parent, TAGS[value["type"]], type=value["type"])
        # An object in the scene has an id; a nested texture, BSDF or medium has the name of a parameter.
        if parent.tag == "scene":
            element.set("id", name)
        elif element.tag in ("texture", "bsdf", "medium"):
            element.set("name", name)
        for key, part in value.items():
            if key != "type":
                _append(element, key, part, depth + 1)
    elif isinstance(value, np.ndarray):
        transform = ElementTree.SubElement(parent, "transform", name=name)
        new_row = "\n" + INDENT * (depth + 1) + " " * len('<matrix value="')
        rows = ("  ".join(map(xml_number, row)) for row in value)
        ElementTree.SubElement(transform, "matrix", value=new_row.join(rows))
    elif isinstance(value, list | tuple):
        x, y, z = map(xml_number, value)
        ElementTree.SubElement(parent, "point" if isinstance(value, Point) else "vector", name=name, x=x, y=y, z=z)
    else:
        tag, text = _scalar(value)
        ElementTree.SubElement(parent, tag, name=name, value=text)


def _scalar(value: Any) -> tuple[str, str]:
    """Returns the XML tag and the text of a number, a boolean, a string, or a :class:`Default`; the text of a
    :class:`Default` refers to its name, as in ``$samples``.
    """
    if isinstance(value, Default):
        return _scalar(value.value)[0], f"${value.name}"
    if isinstance(value, bool):
        return "boolean", str(value).lower()
    if isinstance(value, int):
        return "integer", str(value)
    return ("float", xml_number(value)) if isinstance(value, float) else ("string", value.replace("$", "\\$"))
