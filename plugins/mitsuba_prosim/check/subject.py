"""The plugin under test, which is loaded in several variants and with changed parameters."""

import importlib
import inspect
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from prosim_scene import TemporaryFolder

from ..compat import children, instantiate, is_users
from ..scene import scene_file, session

#: The kinds of plugins that have tests: name of Mitsuba's class -> name.
KINDS = {"PhaseFunction": "phase", "ReconstructionFilter": "rfilter"}
for _name in "BSDF", "Emitter", "Texture", "Shape", "Sampler", "Sensor", "Integrator", "Medium", "Film":
    KINDS[_name] = _name.lower()

#: What plugins cannot be loaded without, if only numbers and texts are given; volpath is the reference of images.
DEFAULTS: dict[str, dict[str, Any]] = {
    "srgb": {"color": {"type": "rgb", "value": [0.2, 0.5, 0.3]}},
    "aov": {"aovs": "depth:depth"},
    "prosim_adaptive": {"nested": {"type": "volpath"}},
    "prosim_denoised": {"nested": {"type": "volpath"}},
}

#: Exceptions of a plugin that does not accept a value or a variant.
REFUSED = (RuntimeError, ValueError, TypeError, KeyError, AttributeError)


class Subject:
    """A plugin that can be loaded again.

    ``source`` is the name of a type, a dictionary as of ``mi.load_dict``, or the path of a scene file. ``node`` is the
    number of the plugin's node in the parsed scene, 0 for the whole. ``modules`` are names or .py files of modules that
    register plugins.
    """

    def __init__(self, source: str | Path | Mapping[str, Any], node: int = 0, modules: Sequence[str] = ()) -> None:
        if isinstance(source, str):
            source = Path(source) if Path(source).suffix else {"type": source}
        self.source: Path | Mapping[str, Any] = source
        self.node, self.modules = node, tuple(modules)
        self._states: dict[str, Any] = {}
        self._search: list[str] = []

    def set_variant(self, variant: str) -> None:
        """Sets a variant and registers all plugins for it."""
        session.set_variant(variant)
        for module in self.modules:
            import_module(module)

    @contextmanager
    def other_variant(self, variant: str) -> Iterator[None]:
        """Activates another variant during a ``with`` statement."""
        before = mi.variant() or ""
        try:
            self.set_variant(variant)
            yield
        finally:
            self.set_variant(before)

    @property
    def state(self) -> Any:
        """The parsed scene in the active variant."""
        variant = mi.variant() or ""
        if variant not in self._states or isinstance(self.source, Mapping):
            self._states[variant] = self._parse(mi.parser.ParserConfig(variant))
        return self._states[variant]

    def _parse(self, config: Any) -> Any:
        if isinstance(self.source, Path):
            self._folder = TemporaryFolder()
            file = scene_file.SceneFile(self.source, self._folder.path)
            self._search = [*file.resolver]
            return file.state
        plain = all(isinstance(value, (str, int, float)) for value in self.source.values())
        defaults = DEFAULTS.get(self.source.get("type", ""), {}) if plain else {}
        state = mi.parser.parse_dict(config, _copied({**defaults, **self.source}))
        scene_file.check_parameters(state)
        mi.parser.transform_resolve_references(config, state)
        return state

    @property
    def props(self) -> Any:
        """The plugin's properties as the user wrote them."""
        return self.state.nodes[self.node].props

    @property
    def name(self) -> str:
        """The plugin's type."""
        return str(self.props.plugin_name())

    def types(self, node: int | None = None) -> dict[str, int]:
        """Returns the types of the plugin and of those in it, with the number of a node of each."""
        node = self.node if node is None else node
        found = {self.state.nodes[node].props.plugin_name(): node}
        for _, child in children(self.state.nodes[node].props):
            found = self.types(child.index()) | found
        return found

    def load(self, **changes: Any) -> Any:
        """Returns a new object, with some properties changed; None removes one. Raises Mitsuba's errors."""
        state, root = mi.parser.ParserState(self.state), mi.parser.SceneNode()
        root.type, root.props = state.nodes[self.node].type, mi.Properties(state.nodes[self.node].props)
        for key, value in changes.items():
            if value is not None:
                root.props[key] = value
            elif key in root.props:
                del root.props[key]
        state.nodes[0] = root
        with session.search_path(self._search):
            loaded: Any = instantiate(mi.parser.ParserConfig(mi.variant() or ""), state, self.types())
        loaded = loaded[0] if isinstance(loaded, list) else loaded
        for method in [one for cls in type(loaded).__mro__ for one in vars(cls).values() if inspect.isfunction(one)]:
            if inspect.getargs(method.__code__).args[-1:] == ["active"] and not method.__defaults__:
                method.__defaults__ = (True,)  # Mitsuba always passes it, so methods in Python may have no default
        return loaded

    def changed(self, **changes: Any) -> Any:
        """Returns what :meth:`load` returns; None if the plugin refuses the changes."""
        with suppress(*REFUSED):
            return self.load(**changes)
        return None

    def nodes(self) -> Iterator[int]:
        """Yields the number of each plugin of the scene that has tests, equal plugins once."""
        seen = set()
        for number, node in enumerate(self.state.nodes):
            nested = [(name, str(self.state.nodes[child.index()].props)) for name, child in children(node.props)]
            key = node.type.name, node.props.plugin_name(), str(node.props).partition("elements")[2], str(nested)
            if node.type.name in KINDS and key not in seen:
                seen.add(key)
                yield number


class OnCopies:
    """A plugin in Python whose methods get copies of their arguments, as from Mitsuba: they may change them."""

    def __init__(self, plugin: Any) -> None:
        self._plugin = plugin

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._plugin, name)
        return (lambda *args: found(*dr.copy(args))) if callable(found) else found


def on_copies(plugin: Any) -> Any:
    """Returns ``plugin``; a user's as :class:`OnCopies`."""
    return OnCopies(plugin) if is_users(plugin) else plugin


def import_module(name: str) -> Any:
    """Imports a module by its name or its .py file, again for another variant; raises ImportError for any failure."""
    path = Path(name)
    stem = path.stem if path.suffix == ".py" else name
    folder = str(path.parent.resolve()) if path.suffix == ".py" else ""
    if folder not in sys.path:
        sys.path.insert(0, folder)
    set_variant, mi.set_variant = mi.set_variant, lambda *names: None  # it may choose one, but another one is tested
    try:
        return importlib.reload(sys.modules[stem]) if stem in sys.modules else importlib.import_module(stem)
    except Exception as error:  # noqa: BLE001 (a module may raise anything)
        raise ImportError(f"{name} cannot be imported: {type(error).__name__}: {error}") from None
    finally:
        mi.set_variant = set_variant


def _copied(value: Any) -> Any:
    """Copies a dictionary, its tensors and its bitmaps, because Mitsuba 3.9 empties or converts those that it loads."""
    if isinstance(value, Mapping):
        return {key: _copied(one) for key, one in value.items()}
    if isinstance(value, mi.Bitmap):
        return mi.Bitmap(value)
    return mi.TensorXf(np.array(value)) if dr.is_tensor_v(value) else value
