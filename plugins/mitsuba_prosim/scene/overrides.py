"""Changes the film, the integrators and the samplers of a parsed scene, before Mitsuba loads the scene."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, TypeAlias

import mitsuba as mi

from .. import compat
from ..engine.plan import SAMPLING, TARGETS
from ..transport.transport_context import DEEPEST_TREE

#: Parameters of sampling that put ``prosim`` or ``prosim_adaptive`` in the place of an integrator that lacks them. The
#: others, such as ``samples``, do not: a user may give them by mistake.
WRAPPING = (*TARGETS, "max_samples", "adaptive")

#: The key, among the parameters of :func:`apply`, of those for a scene that has none of the :data:`TARGETS`.
UNLESS_LIMITED = "unless limited"

#: Limits of a film: pixels per side, and pixels in total. A film counts its values in 32 bits, with several values per
#: pixel.
LONGEST_SIDE, MOST_PIXELS = 2**16, 2**28

#: The size of an image (width, height), and a crop window (x, y, width, height), in pixels; None: as in the scene.
Size: TypeAlias = "tuple[int, int] | None"
Window: TypeAlias = "tuple[int, int, int, int] | None"

#: Mitsuba's materials through which a ray may pass straight on.
HOLES = ("mask", "null", "thindielectric", "polarizer", "circular", "retarder")

#: Why integrators that take no samples from a sensor have no targets.
FROM_LAMPS = "{} follows light from the lamps, and has no target; give --spp (in Python spp) alone, or --paths"

#: The parameters of a film for the crop window.
CROP = ("crop_offset_x", "crop_offset_y", "crop_width", "crop_height")


def check_size(width: int, height: int) -> None:
    """Raises ValueError if an image of ``width`` x ``height`` pixels is empty or too large for a film."""
    if not (min(width, height) >= 1 and max(width, height) <= LONGEST_SIDE and width * height <= MOST_PIXELS):
        raise ValueError(
            f"an image cannot have {width} x {height} pixels; allowed are 1 to {LONGEST_SIDE} pixels a side and "
            f"{MOST_PIXELS // 10**6} million in all"
        )


def apply(
    state: mi.parser.ParserState, resolution: Size, crop: Window, parameters: dict[str, Any], sensor: int = 0
) -> str | None:
    """Changes the film of the sensor with the index ``sensor``, and the integrators of a parsed scene; returns in words
    what became of the scene's integrator, such as "path within prosim_adaptive", or None.

    ``resolution`` is the new size (width, height) and ``crop`` the new crop window (x, y, width, height) in pixels, or
    None. ``parameters`` are new values for parameters of the integrator, with those for a scene without a target under
    the key :data:`UNLESS_LIMITED`; None deletes a parameter. Parameters of
    sampling, such as ``samples``, are set for the outermost integrator; those in :data:`WRAPPING`, such as ``noise``,
    first replace ``path`` by ``prosim``, which follows the same light paths, and nest another integrator of Mitsuba in
    ``prosim_adaptive``. All others are set for every integrator ``prosim``; if there is none, ``diffuse_bounces``
    replaces the scene's integrator by ``prosim``, with the same ``max_depth``. A scene without an integrator first gets
    Mitsuba's default, ``path``. Raises ValueError if a film cannot have this size, or if no integrator has the
    parameters.
    """
    _change_films(state, sensor, resolution, crop)
    if state.root.type == mi.ObjectType.Scene and not _integrators(state):
        state.root.props["integrator"] = _add(state, mi.ObjectType.Integrator, mi.Properties("path"))  # the default
    unless = parameters.get(UNLESS_LIMITED, {})
    if any(node.props.get(name, 0) for node in _integrators(state) for name in TARGETS):
        unless = {}
    parameters = unless | {name: value for name, value in parameters.items() if name != UNLESS_LIMITED}
    sampling = {name: value for name, value in parameters.items() if name in SAMPLING}
    others = {name: value for name, value in parameters.items() if name not in SAMPLING}
    integrators, replaced = _integrators(state), None
    named = ", ".join(node.props.plugin_name() for node in integrators) or "none"
    ours = [node.props for node in integrators if node.props.plugin_name() == "prosim"]
    if integrators and integrators[0].props.plugin_name() == "prosim_denoised":
        integrators = integrators[1:]  # the nested one, which takes the samples
    if integrators and _is_wrong_path(integrators[0].props):
        return None  # Mitsuba will say what is wrong
    if set(sampling) & set(WRAPPING) and integrators and _is_replaceable(integrators[0].props, state):
        others.setdefault("diffuse_bounces", -1)
    if others and not ours and integrators and "diffuse_bounces" in others:
        replaced = _replace(integrators, others)
        ours = [integrators[0].props]
    if others and not ours:
        raise ValueError(
            f"only the integrator prosim has {option_names(others)}; this scene's is {named}, which --paths (in Python "
            '{"diffuse_bounces": -1}) replaces by prosim'
        )
    for props in ours:
        _change_prosim(props, others)
    if not sampling or not integrators:
        return replaced
    props = mi.Properties(integrators[0].props)  # the parser puts an object before the objects nested in it
    plugin = props.plugin_name()
    if plugin in ("prosim", "prosim_adaptive"):
        _set(integrators[0].props, sampling.items())
        return replaced
    if not set(sampling) & set(WRAPPING):
        raise ValueError(
            f"only the integrators prosim and prosim_adaptive have {option_names(sampling)}; this scene's is {named}. "
            f"Any of {option_names(WRAPPING)} puts one of them in its place"
        )
    return _nest(state, props, sampling)


def _nest(state: mi.parser.ParserState, props: mi.Properties, sampling: dict[str, Any]) -> str:
    """Nests the integrator with these properties in ``prosim_adaptive``, and returns this in words."""
    plugin = props.plugin_name()
    if plugin == "ptracer":
        raise ValueError(FROM_LAMPS.format(plugin))
    wrapper = mi.Properties("prosim_adaptive")
    _set(wrapper, [("nested", _add(state, mi.ObjectType.Integrator, props)), *sampling.items()])
    outer, inner = next(node for node in _integrators(state) if node.props.plugin_name() == plugin), state.nodes[-1]
    outer.props, inner.file_index, inner.offset = wrapper, outer.file_index, outer.offset
    return f"{plugin} within prosim_adaptive"


def _is_wrong_path(props: mi.Properties) -> bool:
    """Tells whether ``props`` are those of a ``path`` that Mitsuba refuses, for example for an unknown parameter."""
    if props.plugin_name() != "path" or compat.children(props):
        return props.plugin_name() == "path"
    try:
        mi.load_dict({"type": "path", **dict(mi.Properties(props).items())})
    except RuntimeError:
        return True
    return False


def _is_replaceable(props: mi.Properties, state: mi.parser.ParserState) -> bool:
    """Tells whether an integrator is ``path``, and ``prosim`` gives the same image: always with a reflection, without
    the media that ``path`` ignores, and without holes and ``hide_emitters``, which Mitsuba does not apply behind holes.
    """
    reflects, hides = props.get("max_depth", -1) not in (0, 1), props.get("hide_emitters", False)
    has_media = mi.ObjectType.Medium in [node.type for node in state.nodes]
    has_holes = any(node.props.plugin_name() in HOLES for node in state.nodes)
    return props.plugin_name() == "path" and reflects and not has_media and not (hides and has_holes)


def _replace(integrators: Sequence[mi.parser.SceneNode], parameters: dict[str, Any]) -> str:
    """Replaces the first of ``integrators`` by ``prosim``, which keeps the parameters of all of them that it has, and
    returns this in words. A ``max_depth`` becomes a ``max_level`` of ``parameters``, unless they have one; ValueError
    if it allows no reflection.
    """
    depth = next((node.props["max_depth"] for node in integrators if "max_depth" in node.props), -1)
    if 0 <= depth < 2 and "max_level" not in parameters:
        raise ValueError(
            f"the scene's max_depth {depth} allows no reflection, but prosim always has one; give --max-level 0 for one"
        )
    parameters.setdefault("max_level", max(depth - 2, -1))  # a path of max_depth 2 has one reflection, as has level 0
    before, kept = integrators[0].props.plugin_name(), (*SAMPLING, "channels", "hide_emitters", "rr_depth", "aovs")
    inner_first = [mi.Properties(node.props) for node in reversed(integrators)]
    found = {name: props[name] for props in inner_first for name in kept if name in props}
    if "aovs" in found:
        found["aovs"] = ",".join(props["aovs"] for props in inner_first if "aovs" in props)
    integrators[0].props = mi.Properties("prosim")
    _set(integrators[0].props, found.items())
    return f"prosim in place of {before}"


def _change_prosim(props: mi.Properties, parameters: dict[str, Any]) -> None:
    """Sets ``parameters`` of an integrator ``prosim``; ValueError if its ray tree would have too many levels."""
    if parameters.get("diffuse_bounces") == -1:
        parameters = {"max_level": -1} | parameters
    _set(props, parameters.items())
    level, follows_paths = parameters.get("max_level", 0), props.get("diffuse_bounces", 0) != 0
    if not (follows_paths or 0 <= level <= DEEPEST_TREE):
        raise ValueError(
            f"--max-level {level}: a ray tree has 0 to {DEEPEST_TREE} levels; more, and -1 for all, "
            'go with --paths (in Python {"diffuse_bounces": -1})'
        )


def option_names(parameters: Iterable[str]) -> str:
    """Returns the names of the command's options for ``parameters`` of the integrator, separated by commas."""
    return ", ".join(f"--{name.replace('_', '-')}" for name in parameters if name != "ambient")


def _change_films(state: mi.parser.ParserState, sensor: int, resolution: Size, crop: Window) -> None:
    """Changes the film of one ``sensor``, and only checks the others."""
    if resolution or crop:
        _add_to_sensors(state, mi.ObjectType.Film, mi.Properties("hdrfilm"))  # the default

    def of(kind: mi.ObjectType, numbers: Iterable[int]) -> list[int]:
        return [number for number in numbers if state.nodes[number].type == kind]

    objects = _nested(state, 0)
    # As in the loaded scene, those of shapes are the last.
    sensors = of(mi.ObjectType.Sensor, objects)
    for shape in of(mi.ObjectType.Shape, objects):
        sensors += of(mi.ObjectType.Sensor, _nested(state, shape))
    changed = {number for chosen in sensors[sensor : sensor + 1] for number in _nested(state, chosen)}
    for number in of(mi.ObjectType.Film, range(len(state.nodes))):
        _change_film(state.nodes[number].props, *((resolution, crop) if number in changed else (None, None)))


def _change_film(props: mi.Properties, resolution: Size, crop: Window) -> None:
    """Sets the size and the crop window of a film; see :func:`apply`."""
    old = props.get("width", 768), props.get("height", 576)
    size, window = resolution or old, crop or tuple(map(props.get, CROP, (0, 0, *old)))
    if size != old and not crop:
        if window != (0, 0, *old):
            raise ValueError(
                f"the film has the crop window {','.join(map(str, window))} of {old[0]}x{old[1]} pixels, which "
                "--resolution does not change; give the window by --crop, too"
            )
        window = 0, 0, *size
    check_size(*size)
    x, y, width, height = window
    if not (0 <= x <= x + width <= size[0] and 0 <= y <= y + height <= size[1] and min(width, height) >= 1):
        raise ValueError(
            f"the crop window {','.join(map(str, window))} is not within the image of {size[0]}x{size[1]} pixels"
        )
    _set(props, zip(("width", "height", *CROP), (*size, *window)))


def set_sampler(state: mi.parser.ParserState, plugin: str) -> None:
    """Replaces every sampler of a parsed scene by the sampler ``plugin`` with as many samples, Mitsuba's default four
    if the scene does not say.
    """
    _add_to_sensors(state, mi.ObjectType.Sampler, mi.Properties(plugin))
    for node in [node for node in state.nodes if node.type == mi.ObjectType.Sampler]:
        count, node.props = node.props.get("sample_count", 4), mi.Properties(plugin)
        node.props["sample_count"] = count


def _add_to_sensors(state: mi.parser.ParserState, kind: mi.ObjectType, added: mi.Properties) -> None:
    """Adds an object with the properties ``added`` to each sensor that has no object of this kind."""
    types = [node.type for node in state.nodes]
    for number in [number for number, type_ in enumerate(types) if type_ == mi.ObjectType.Sensor]:
        if kind not in [types[index] for index in _nested(state, number)]:
            state.nodes[number].props[kind.name.lower()] = _add(state, kind, mi.Properties(added))


def _nested(state: mi.parser.ParserState, number: int) -> list[int]:
    """Returns the numbers of the objects that belong to the object with this number in a parsed scene."""
    props = state.nodes[number].props
    nested = [child.index() for _, child in compat.children(props)]
    return nested + [state.id_to_index[name] for _, name in props.references()]


def _integrators(state: mi.parser.ParserState) -> list[mi.parser.SceneNode]:
    return [node for node in state.nodes if node.type == mi.ObjectType.Integrator]


def _add(state: mi.parser.ParserState, kind: mi.ObjectType, props: mi.Properties) -> mi.Properties.ResolvedReference:
    """Adds an object to a parsed scene; returns a reference to it. Nodes that were taken from ``state.nodes`` before
    become invalid.
    """
    node = mi.parser.SceneNode()
    node.type, node.props = kind, props
    state.nodes.append(node)
    return mi.Properties.ResolvedReference(len(state.nodes) - 1)


def _set(props: mi.Properties, parameters: Iterable[tuple[str, Any]]) -> None:
    """Sets ``parameters`` in ``props``; deletes those whose new value is None."""
    for name, value in parameters:
        if value is not None:
            props[name] = value
        elif name in props:
            del props[name]
