"""What is changed in a parsed scene: its film, and its integrator, which may get ours around it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import mitsuba as mi

from ..transport.context import DEEPEST_TREE

#: How it is sampled: parameters of ``prosim`` and ``prosim_adaptive``, which has any other integrator within.
SAMPLING = ("samples", "threshold", "noise", "noise_99", "noise_999", "time", "max_samples", "adaptive")

#: Those of them that ask for our sampling where the scene's integrator has none. (``samples`` and ``threshold`` alone
#: may be meant for another scene.)
ENOUGH = ("noise", "noise_99", "noise_999", "time", "max_samples", "adaptive")


#: Limits of a film: pixels a side, and pixels. Its values are counted in 32 bits, several a pixel.
LONGEST_SIDE, MOST_PIXELS = 2**16, 2**28


@dataclass(frozen=True)
class Changes:
    """What is changed in a scene."""

    #: Values of its ``$names``; of XML those of its parameters.
    definitions: Mapping[str, str] = field(default_factory=dict)
    #: (width, height), and (x, y, width, height), both in pixels; N of the N-rook sampling.
    resolution: tuple[int, int] | None = None
    crop: tuple[int, int, int, int] | None = None
    samples: int | None = None
    #: Other parameters of the integrator ``prosim`` or ``prosim_adaptive``; None takes one away. Those of
    #: :data:`ENOUGH` put any other integrator within ``prosim_adaptive``.
    integrator: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.resolution:
            check_size(*self.resolution)


def apply(state: mi.parser.ParserState, changes: Changes) -> str | None:
    """Changes a parsed scene; returns the name of the integrator that was put within ``prosim_adaptive``, or None.
    Raises ValueError.
    """
    window, crop = ("crop_offset_x", "crop_offset_y", "crop_width", "crop_height"), changes.crop
    for props in (node.props for node in state.nodes if node.type == mi.ObjectType.Film):
        _give(props, dict(zip(("width", "height"), changes.resolution or ())) | dict(zip(window, crop or ())))
        width, height = props.get("width", 768), props.get("height", 576)
        check_size(width, height)
        if crop is not None and (crop[0] + crop[2] > width or crop[1] + crop[3] > height):
            raise ValueError(
                f"a crop window of {crop[2]} x {crop[3]} pixels from ({crop[0]}, {crop[1]}) on, in an image of {width} "
                f"x {height}: it has to be within"
            )
    if state.root.type == mi.ObjectType.Scene and _outermost(state) is None:
        index = _add(state, mi.Properties("path"), state.root)  # Mitsuba's default
        state.root.props["integrator"] = mi.Properties.ResolvedReference(index)
    samples = {"samples": changes.samples} if changes.samples else {}
    return change(state, samples | dict(changes.integrator))


def check_size(width: int, height: int) -> None:
    """Raises ValueError for an image that no film can hold."""
    if not (min(width, height) >= 1 and max(width, height) <= LONGEST_SIDE and width * height <= MOST_PIXELS):
        raise ValueError(
            f"an image of {width} x {height} pixels; allowed are 1 to {LONGEST_SIDE} pixels a side and "
            f"{MOST_PIXELS // 10**6} million in all"
        )


def change(state: mi.parser.ParserState, parameters: Mapping[str, Any]) -> str | None:
    """Gives ``parameters`` to the scene's integrator; None takes one away. Returns the name of the integrator that was
    put within ``prosim_adaptive`` for that, or None.

    Those of :data:`SAMPLING` are the outermost integrator's, the others those of every ``prosim``. Raises ValueError
    where there is no integrator that has them, or where it can't go so deep. What is no scene is left as it is.
    """
    sampling = {name: value for name, value in parameters.items() if name in SAMPLING}
    others = {name: value for name, value in parameters.items() if name not in SAMPLING}
    nodes = [node for node in state.nodes if node.type == mi.ObjectType.Integrator]
    ours = [node.props for node in nodes if node.props.plugin_name() == "prosim"]
    named = ", ".join(node.props.plugin_name() for node in nodes) or "none"
    if others and not ours:
        raise ValueError(f"only the integrator prosim has {', '.join(others)}; this scene's is {named}")
    for props in ours:
        _give(props, others)
        level = others.get("max_level")
        if level is not None and not (0 <= level <= DEEPEST_TREE or props.get("diffuse_bounces", 0)):
            raise ValueError(
                f"the deepest level is to be {level}, and a tree of rays has levels 0 to {DEEPEST_TREE}; any other "
                "goes with --paths, which follows every path of light"
            )
    outermost = _outermost(state)
    if not sampling or outermost is None:
        return None
    props = state.nodes[outermost].props
    if props.plugin_name() in ("prosim", "prosim_adaptive"):
        _give(props, sampling)
        return None
    if not set(sampling) & set(ENOUGH):
        raise ValueError(
            f"only the integrators prosim and prosim_adaptive have {', '.join(sampling)}; this scene's is {named}, "
            f"which is put within prosim_adaptive where one of {', '.join(ENOUGH)} is asked for as well"
        )
    return _wrap(state, outermost, sampling)


def _outermost(state: mi.parser.ParserState) -> int | None:
    """Index of the integrator that is the scene's own, not another's, if there is one."""
    children = [
        value.index() for _, value in state.root.props.items() if isinstance(value, mi.Properties.ResolvedReference)
    ]
    return next((index for index in children if state.nodes[index].type == mi.ObjectType.Integrator), None)


def _wrap(state: mi.parser.ParserState, index: int, parameters: Mapping[str, Any]) -> str:
    """Puts ``prosim_adaptive`` around the integrator of that index; returns the name of what is within."""
    names = [
        name
        for name, value in state.root.props.items()
        if isinstance(value, mi.Properties.ResolvedReference) and value.index() == index
    ]
    props = mi.Properties("prosim_adaptive")
    props["nested"] = mi.Properties.ResolvedReference(index)
    _give(props, parameters)
    wrapper = _add(state, props, state.nodes[index])
    for name in names:
        state.root.props[name] = mi.Properties.ResolvedReference(wrapper)
    return state.nodes[index].props.plugin_name()


def _add(state: mi.parser.ParserState, props: mi.Properties, beside: mi.parser.SceneNode) -> int:
    """Adds an integrator, said to stand in the file where another node does; returns its index. Nodes that
    were got from ``state`` before may not be used any more: the list has moved in memory.
    """
    node = mi.parser.SceneNode()
    node.type, node.props = mi.ObjectType.Integrator, props
    node.file_index, node.offset = beside.file_index, beside.offset
    state.nodes.append(node)
    return len(state.nodes) - 1


def _give(props: mi.Properties, parameters: Mapping[str, Any]) -> None:
    """Sets properties, or deletes those that are None."""
    for name, value in parameters.items():
        if value is not None:
            props[name] = value
        elif name in props:
            del props[name]
