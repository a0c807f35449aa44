"""A scene as nested dictionaries -> XML, or those that ``mi.load_dict`` takes."""

import re
from collections.abc import Callable, Iterator
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..nodes import Comment, Default, Node, Point

INDENT = "    "
UNSPEAKABLE = re.compile("[\x00-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")

#: The element of each plugin that the translator uses.
TAGS = {
    plugin: tag
    for tag, plugins in {
        "integrator": "prosim path volpath",
        "sensor": "perspective prosim_window",
        "film": "hdrfilm",
        "sampler": "nrook multijitter",
        "rfilter": "box",
        "shape": "ply sphere",
        "medium": "homogeneous",
        "emitter": "prosim_area prosim_point area point spot constant envmap",
        "texture": "bitmap prosim_brick prosim_stripes prosim_fractal prosim_product",
        "bsdf": "prosim_conductor prosim_dielectric prosim_lambertian prosim_composite prosim_phong diffuse conductor "
        "roughconductor dielectric roughdielectric plastic roughplastic blendbsdf",
    }.items()
    for plugin in plugins.split()
}


def plain(node: Node, transform: Callable[[np.ndarray], Any]) -> Node:
    """The dictionary for ``mi.load_dict``: no comments, defaults by their values, ``transform`` applied to matrices."""

    def value(v: Any) -> Any:
        if isinstance(v, dict):
            return plain(v, transform)
        return v.value if isinstance(v, Default) else transform(v) if isinstance(v, np.ndarray) else v

    return {key: value(v) for key, v in node.items() if not isinstance(v, Comment)}


def write(scene: Node) -> str:
    """The XML text of a scene."""
    root = ElementTree.Element("scene", version="3.0.0")
    for default in {d.name: d for d in _defaults(scene)}.values():
        ElementTree.SubElement(root, "default", name=default.name, value=number(default.value))
    statements = []  # where they begin, each with a comment
    for key, value in scene.items():
        if isinstance(value, Comment):
            statements.append(len(root))
        if key != "type":
            _entry(root, key, value, 1)
    ElementTree.indent(root, INDENT)
    for i in statements:  # a blank line before each
        if i:
            root[i - 1].tail = f"\n{root[i - 1].tail}"
        else:
            root.text = f"\n{root.text}"
    # ElementTree writes "<a />", and the line ends in a matrix as character references.
    text = ElementTree.tostring(root, encoding="unicode").replace(" />", "/>").replace("&#10;", "\n")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n'


def can_say(text: str) -> bool:
    """Whether a name can stand in XML: no control characters, nor bytes that were no UTF-8."""
    return not UNSPEAKABLE.search(text)


def number(value: float) -> str:
    """Ten digits, more than Mitsuba's single precision keeps."""
    return format(value, ".10g")


def _defaults(node: Node) -> Iterator[Default]:
    for value in node.values():
        if isinstance(value, Default):
            yield value
        elif isinstance(value, dict):
            yield from _defaults(value)


def _entry(parent: ElementTree.Element, key: str, value: Any, depth: int) -> None:
    """Adds a parameter, a plugin or a comment to ``parent``, whose children are indented ``depth`` times."""
    if isinstance(value, Comment):
        text = (
            UNSPEAKABLE.sub("?", value)
            .replace("&", "&amp;")
            .replace("<", "&lt;")
            .replace(">", "&gt;")
            .replace("--", "- -")
        )
        parent.append(ElementTree.Comment(f" {text} "))
    elif isinstance(value, dict):
        _element(parent, key, value, depth)
    else:
        _property(parent, key, value, depth)


def _element(parent: ElementTree.Element, key: str, node: Node, depth: int) -> None:
    if node["type"] == "rgb":
        ElementTree.SubElement(parent, "rgb", name=key, value=", ".join(map(number, node["value"])))
        return
    element = ElementTree.SubElement(parent, TAGS[node["type"]], type=node["type"])
    # An object in the scene is known by its id, a nested texture by the parameter that it is.
    if parent.tag == "scene":
        element.set("id", key)
    elif element.tag in ("texture", "bsdf", "medium"):
        element.set("name", key)
    for name, value in node.items():
        if name != "type":
            _entry(element, name, value, depth + 1)


def _property(parent: ElementTree.Element, name: str, value: Any, depth: int) -> None:
    if isinstance(value, np.ndarray):
        transform = ElementTree.SubElement(parent, "transform", name=name)
        # The rows stand one below the other.
        indent = "\n" + INDENT * (depth + 1) + " " * len('<matrix value="')
        ElementTree.SubElement(transform, "matrix", value=indent.join("  ".join(map(number, row)) for row in value))
        return
    if isinstance(value, list | tuple):
        x, y, z = map(number, value)
        ElementTree.SubElement(parent, "point" if isinstance(value, Point) else "vector", name=name, x=x, y=y, z=z)
        return
    kind, text = _scalar(value)
    ElementTree.SubElement(parent, kind, name=name, value=text)


def _scalar(value: Any) -> tuple[str, str]:
    if isinstance(value, Default):
        return _scalar(value.value)[0], f"${value.name}"
    if isinstance(value, bool):
        return "boolean", str(value).lower()
    if isinstance(value, int):
        return "integer", str(value)
    return ("float", number(value)) if isinstance(value, float) else ("string", value.replace("$", "\\$"))
