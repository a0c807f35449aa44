"""A scene as nested dictionaries (those of ``mi.load_dict``) -> XML."""

from xml.sax.saxutils import escape, quoteattr

import numpy as np

from .lights import point

#: The element of each plugin that the translator uses.
TAGS = {
    "integrator": "prosim path",
    "sensor": "perspective prosim_window",
    "film": "hdrfilm",
    "sampler": "nrook multijitter",
    "rfilter": "box",
    "shape": "ply sphere",
    "emitter": "prosim_area prosim_point area point spot constant envmap",
    "texture": "bitmap prosim_brick prosim_stripes prosim_fractal prosim_product",
    "bsdf": "prosim_conductor prosim_dielectric prosim_lambertian prosim_composite prosim_phong diffuse conductor "
            "roughconductor dielectric roughdielectric plastic roughplastic blendbsdf twosided",
}
TAGS = {plugin: tag for tag, plugins in TAGS.items() for plugin in plugins.split()}


class Default:
    """A value that the user may set on Mitsuba's command line: ``-D name=value``."""

    def __init__(self, name, value):
        self.name, self.value = name, value


class Comment(str):
    """A comment that goes before the next element; its key does not matter."""


def plain(node, transform):
    """The dictionary for ``mi.load_dict``: no comments, defaults by their values, ``transform`` applied to matrices."""
    def value(v):
        if isinstance(v, dict):
            return plain(v, transform)
        return v.value if isinstance(v, Default) else transform(v) if isinstance(v, np.ndarray) else v
    return {key: value(v) for key, v in node.items() if not isinstance(v, Comment)}


def _defaults(node):
    for value in node.values():
        if isinstance(value, Default):
            yield value
        elif isinstance(value, dict):
            yield from _defaults(value)


def number(value):
    """Ten digits, more than Mitsuba's single precision keeps."""
    return format(value, ".10g")


def _property(name, value, indent):
    name = quoteattr(name)
    if isinstance(value, Default):
        kind = "integer" if isinstance(value.value, int) else "float"
        return [f'{indent}<{kind} name={name} value="${value.name}"/>']
    if isinstance(value, bool):
        return [f'{indent}<boolean name={name} value="{str(value).lower()}"/>']
    if isinstance(value, int):
        return [f'{indent}<integer name={name} value="{value}"/>']
    if isinstance(value, float):
        return [f'{indent}<float name={name} value="{number(value)}"/>']
    if isinstance(value, str):
        return [f"{indent}<string name={name} value={quoteattr(value)}/>"]
    if isinstance(value, np.ndarray):
        rows = ["  ".join(number(x) for x in row) for row in value]
        pad = "\n" + indent + " " * 19
        return [f"{indent}<transform name={name}>", f'{indent}    <matrix value="{pad.join(rows)}"/>', f"{indent}</transform>"]
    x, y, z = map(number, value)
    return [f'{indent}<{"point" if isinstance(value, point) else "vector"} name={name} x="{x}" y="{y}" z="{z}"/>']


def _element(key, node, indent, top):
    kind = node["type"]
    if kind == "rgb":
        return [f'{indent}<rgb name={quoteattr(key)} value="{", ".join(map(number, node["value"]))}"/>']
    if kind == "ref":
        name = f' name={quoteattr(key)}' if not top else ""
        return [f'{indent}<ref{name} id={quoteattr(node["id"])}/>']
    tag = TAGS[kind]
    # An object in the scene is known by its id, a nested texture by the parameter that it is.
    label = f" id={quoteattr(key)}" if top else f" name={quoteattr(key)}" if tag in ("texture", "bsdf") else ""
    lines = [f'{indent}<{tag} type="{kind}"{label}>']
    for name, value in node.items():
        if name == "type":
            continue
        lines += _entry(name, value, indent + "    ", False)
    if len(lines) == 1:
        return [lines[0][:-1] + "/>"]
    return lines + [f"{indent}</{tag}>"]


def _entry(name, value, indent, top):
    if isinstance(value, Comment):
        text = escape(value).replace("--", "- -")
        return ([""] if top else []) + [f"{indent}<!-- {text} -->"]
    return _element(name, value, indent, top) if isinstance(value, dict) else _property(name, value, indent)


def write(scene):
    """The XML text of a scene."""
    lines = ['<?xml version="1.0" encoding="utf-8"?>', '<scene version="3.0.0">']
    for default in {d.name: d for d in _defaults(scene)}.values():
        lines.append(f'    <default name="{default.name}" value="{number(default.value)}"/>')
    for name, value in scene.items():
        if name != "type":
            lines += _entry(name, value, "    ", True)
    return "\n".join([*lines, "</scene>", ""])
