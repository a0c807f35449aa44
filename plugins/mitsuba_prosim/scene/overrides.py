"""Changes of a parsed scene: its film, and its integrator, which ``prosim_adaptive`` may wrap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import mitsuba as mi
from prosim_scene import misfit

from ..transport.transport_context import DEEPEST_TREE

#: Parameters of ``prosim`` and ``prosim_adaptive`` that ask for our sampling: they wrap any other integrator.
ENOUGH = ("noise", "noise_99", "noise_999", "time", "max_samples", "adaptive")

#: All parameters of the sampling. (``samples`` and ``threshold`` alone may be meant for another scene.)
SAMPLING = ("samples", "threshold", *ENOUGH)

#: Limits of a film: pixels per side, and pixels. Its values are counted in 32 bits, several per pixel.
LONGEST_SIDE, MOST_PIXELS = 2**16, 2**28


@dataclass(frozen=True)
class Changes:
    """Changes of a scene."""

    #: Values of its ``$names``.
    definitions: Mapping[str, str] = field(default_factory=dict)
    #: (width, height), and (x, y, width, height), both in pixels; N of the N-rook sampling.
    resolution: tuple[int, int] | None = None
    crop: tuple[int, int, int, int] | None = None
    samples: int | None = None
    #: Parameters of the integrator; None removes one. Those of :data:`SAMPLING` are the outermost integrator's, the
    #: others those of every ``prosim``.
    integrator: Mapping[str, Any] = field(default_factory=dict)


def check_size(width: int, height: int) -> None:
    """Raises ValueError where no film can hold the image."""
    if not (min(width, height) >= 1 and max(width, height) <= LONGEST_SIDE and width * height <= MOST_PIXELS):
        raise ValueError(
            f"an image of {width} x {height} pixels; allowed are 1 to {LONGEST_SIDE} pixels a side and "
            f"{MOST_PIXELS // 10**6} million in all"
        )


def apply(state: mi.parser.ParserState, changes: Changes) -> str | None:
    """Changes a parsed scene; returns the name of the integrator that ``prosim_adaptive`` now wraps, or None.

    Raises ValueError where the changes do not fit the scene.
    """
    crop = changes.crop
    for props in (node.props for node in state.nodes if node.type == mi.ObjectType.Film):
        _set(props, dict(zip(("width", "height"), changes.resolution or ())))
        _set(props, dict(zip(("crop_offset_x", "crop_offset_y", "crop_width", "crop_height"), crop or ())))
        width, height = props.get("width", 768), props.get("height", 576)
        check_size(width, height)
        if crop is not None and (crop[0] + crop[2] > width or crop[1] + crop[3] > height):
            raise ValueError(
                f"a crop window of {crop[2]} x {crop[3]} pixels at ({crop[0]}, {crop[1]}) leaves the image of {width} "
                f"x {height}; choose a smaller one"
            )
    if state.root.type == mi.ObjectType.Scene and _outermost(state) is None:
        state.root.props["integrator"] = _add(state, mi.Properties("path"))  # Mitsuba's default
    parameters = ({"samples": changes.samples} if changes.samples else {}) | dict(changes.integrator)
    sampling = {name: value for name, value in parameters.items() if name in SAMPLING}
    others = {name: value for name, value in parameters.items() if name not in SAMPLING}
    integrators = [node.props for node in state.nodes if node.type == mi.ObjectType.Integrator]
    ours = [props for props in integrators if props.plugin_name() == "prosim"]
    named = ", ".join(props.plugin_name() for props in integrators) or "none"
    if others and not ours:
        raise ValueError(f"only the integrator prosim has {', '.join(others)}; this scene's is {named}")
    for props in ours:
        _set(props, others)
        if not (0 <= props.get("max_level", 4) <= DEEPEST_TREE or props.get("diffuse_bounces", 0)):
            raise ValueError(
                f"the maximum depth is {props['max_level']}; a tree of rays allows 0 to {DEEPEST_TREE}, and --paths any"
            )
    name = _outermost(state)
    if not sampling or name is None:
        return None
    inner = state.root.props[name]
    props = state.nodes[inner.index()].props
    plugin = props.plugin_name()
    if plugin in ("prosim", "prosim_adaptive"):
        _set(props, sampling)
        return None
    if not set(sampling) & set(ENOUGH):
        raise ValueError(
            f"only the integrators prosim and prosim_adaptive have {', '.join(sampling)}; this scene's is {named}. Any "
            f"of {', '.join(ENOUGH)} puts it inside prosim_adaptive"
        )
    wrapper = mi.Properties("prosim_adaptive")
    wrapper["nested"] = inner
    _set(wrapper, sampling)
    state.root.props[name] = _add(state, wrapper)
    return plugin


def _outermost(state: mi.parser.ParserState) -> str | None:
    """Name of the scene's own integrator among its properties, or None."""
    integrators = (
        name
        for name, value in state.root.props.items()
        if isinstance(value, mi.Properties.ResolvedReference)
        and state.nodes[value.index()].type == mi.ObjectType.Integrator
    )
    return next(integrators, None)


def _add(state: mi.parser.ParserState, props: mi.Properties) -> mi.Properties.ResolvedReference:
    """Adds an integrator; returns its reference. Nodes that were taken from ``state`` before are invalid then."""
    node = mi.parser.SceneNode()
    node.type, node.props = mi.ObjectType.Integrator, props
    state.nodes.append(node)
    return mi.Properties.ResolvedReference(len(state.nodes) - 1)


def _set(props: mi.Properties, parameters: Mapping[str, Any]) -> None:
    """Sets properties, or deletes those that are None."""
    for name, value in parameters.items():
        if value is not None:
            props[name] = value
        elif name in props:
            del props[name]


def distortion(state: mi.parser.ParserState, width: int, height: int) -> str | None:
    """A warning where an image of this size has no square pixels; see :func:`prosim_scene.misfit`."""
    for props in (node.props for node in state.nodes if node.props.plugin_name() == "prosim_window"):
        left, right, bottom, top = (
            props.get(name, value) for name, value in zip(("left", "right", "bottom", "top"), (-1.0, 1.0, -1.0, 1.0))
        )
        if wrong := misfit(width, height, (right - left) / (top - bottom)):
            return wrong
    return None
