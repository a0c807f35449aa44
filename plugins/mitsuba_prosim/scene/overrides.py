"""The integrator of a parsed scene: other parameters, and ours around one that has none of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mitsuba as mi

from ..transport.context import DEEPEST_TREE

#: How it is sampled: parameters of ``prosim`` and ``prosim_adaptive``, which has any other integrator within.
SAMPLING = ("samples", "threshold", "noise", "noise_99", "time", "max_samples", "adaptive")

#: Those of them that ask for our sampling where the scene's integrator has none. (``samples`` and ``threshold`` alone
#: may be meant for another scene.)
ENOUGH = ("noise", "noise_99", "time", "max_samples", "adaptive")


def complete(state: mi.parser.ParserState) -> None:
    """Gives a scene that has no integrator Mitsuba's default one."""
    if state.root.type == mi.ObjectType.Scene and _outermost(state) is None:
        index = _add(state, mi.Properties("path"), state.root)
        state.root.props["integrator"] = mi.Properties.ResolvedReference(index)


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
