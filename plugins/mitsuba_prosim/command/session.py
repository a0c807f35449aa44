"""What ``prosim render`` and the ``mitsuba`` command share: a variant, the plugins of all packages, a scene, a film."""

import re
import warnings
from contextlib import contextmanager
from importlib.metadata import entry_points
from pathlib import Path

import drjit as dr
import mitsuba as mi

from .stand_in import MARK

#: The order in which the native command tries them, as far as what it tries first can be had.
PREFERRED = {
    "cuda_ad_rgb": dr.JitBackend.CUDA,
    "metal_ad_rgb": dr.JitBackend.Metal,
    "llvm_ad_rgb": dr.JitBackend.LLVM,
    "scalar_rgb": None,
}


def default_variant():
    """The most capable variant whose backend this machine has, by the native command's order."""
    return next(variant for variant, backend in PREFERRED.items()
                if variant in mi.variants() and (backend is None or dr.has_backend(backend)))


def set_variant(variant=None):
    """Sets the variant (default: ``default_variant()``) and loads the plugins of all packages."""
    mi.set_variant(variant or default_variant())
    load_plugins()


def load_plugins():
    """Loads the plugins of every package that offers some.

    A package does so by an entry point in the group ``mitsuba``, which names a module that registers them for the
    active variant when it is imported. Mitsuba 3.10 and later load these by themselves, 3.9 does not.
    """
    for entry in entry_points(group="mitsuba"):
        try:
            entry.load()
        except Exception as error:  # noqa: BLE001 (whatever another package does, our plugins can be used)
            warnings.warn(f"the plugins of {entry.value} could not be loaded: {error}", stacklevel=2)


def parse(path, parameters):
    """Parses a scene file; ``parameters`` replace its ``$key`` constants. Returns Mitsuba's parser state."""
    if taken := {"config", "filename"} & set(parameters):
        raise ValueError(f'-D {taken.pop()}=...: Mitsuba\'s Python parser keeps this name for itself; choose another')
    return mi.parser.parse_file(mi.parser.ParserConfig(mi.variant()), str(path), **parameters)


def plugin_names(state):
    """Names of all plugins in a parsed scene."""
    return {node.props.plugin_name() for node in state.nodes}


def instantiate(state):
    """Makes the scene of a parser state."""
    config = mi.parser.ParserConfig(mi.variant())
    mi.parser.transform_all(config, state)
    return mi.parser.instantiate(config, state)


def message(error):
    """What an error says, without the Python traceback that Mitsuba puts in the midst of its own words."""
    return re.sub(r"Traceback \(most recent call last\):\n(?: .*\n)+(?:\w+: )?", "", str(error))


@contextmanager
def search_paths(first=(), last=()):
    """Adds folders to both ends of Mitsuba's search path, for a while."""
    before = mi.file_resolver()
    resolver = mi.FileResolver(before)
    for path in reversed(list(first)):
        resolver.prepend(str(path))
    for path in last:
        resolver.append(str(path))
    mi.set_file_resolver(resolver)
    try:
        yield
    finally:
        mi.set_file_resolver(before)


@contextmanager
def threads(count):
    """Works with so many threads, for a while; None: with as many as before."""
    before = dr.thread_count()
    dr.set_thread_count(count or before)
    try:
        yield
    finally:
        dr.set_thread_count(before)


def enough_threads():
    """Mitsuba 3.9 waits for ever when it reads or writes an EXR with one or two threads: lends it a third, for a while."""
    return threads(max(dr.thread_count(), 3))


def pick_sensor(scene, index):
    """The sensor of that index, or an error in the native command's words."""
    if not isinstance(scene, mi.Scene):
        raise TypeError("Root element of the input file must be a <scene> tag!")
    if not scene.sensors():
        raise ValueError(f"No sensor specified for scene: {scene}")
    if not 0 <= index < len(scene.sensors()):
        raise ValueError("Specified sensor index is out of bounds!")
    return scene.sensors()[index]


def plugin_folder():
    """Mitsuba's folder of plugins."""
    return Path(mi.__file__).with_name("plugins")


def stand_ins():
    """Plugin name -> path, of every stand-in that is in place."""
    return {path.stem: path for path in plugin_folder().glob("*.so") if is_stand_in(path)}


def render(scene, sensor, seed=0, spp=0):
    """Renders into the sensor's film, and waits for the end."""
    # Mitsuba's own integrators in Python insist on developing the film, so all do; writing it is another step.
    scene.integrator().render(scene, sensor, seed=seed, spp=spp, develop=True, evaluate=True)
    dr.sync_thread()


def is_stand_in(path):
    """Whether a file is a stand-in (of any version), not a plugin of Mitsuba's."""
    return path.stat().st_size < 2**16 and MARK in path.read_bytes()
