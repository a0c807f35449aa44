"""The command ``mitsuba`` after ``prosim link``: renders scenes with plugins in Python by a twin of the native program,
with the same options and the same order of steps, and lets the native program do everything else.
"""

import argparse
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NoReturn

import drjit as dr
import mitsuba as mi

from ..compat import EXR_THREADS, native_plugins
from ..parameters import pick_sensor
from ..scene import scene_file, session

#: Log levels of Mitsuba and of Dr.Jit; each -v selects the next level.
MITSUBA_LEVELS = (mi.LogLevel.Info, mi.LogLevel.Debug, mi.LogLevel.Trace)
DRJIT_LEVELS = tuple(getattr(dr.LogLevel, name) for name in ("Error", "Warn", "Info", "InfoSym", "Debug", "Trace"))


def definition(text: str) -> tuple[str, str]:
    """Returns the key and the value of ``key=value``; raises ValueError for another form."""
    key, value = text.split("=", 1)
    return key, value


class Arguments(argparse.ArgumentParser):
    """The options of the native program; wrong arguments raise ValueError."""

    def __init__(self) -> None:
        super().__init__("mitsuba", add_help=False, allow_abbrev=False)
        self.add_argument("-t", "--threads", type=int)
        self.add_argument("-v", "--verbose", action="count", default=0)
        self.add_argument("-D", "--define", action="append", default=[], type=definition)
        self.add_argument("-s", "--sensor", type=int, default=0)
        self.add_argument("-o", "--output")
        self.add_argument("-m", "--mode")
        self.add_argument("-a", "--append", default="")
        self.add_argument("-O", "-V", dest="compiler")
        self.add_argument("-S", "-W", dest="compiler", action="store_true")
        self.add_argument("scenes", nargs="*")

    def error(self, message: str) -> NoReturn:
        """Raises ValueError."""
        raise ValueError(message)


@contextmanager
def parsed(options: argparse.Namespace, path: str) -> Iterator[mi.parser.ParserState]:
    """Yields the parsed scene ``path``; inside the ``with`` block, Mitsuba's search path is that of the command."""
    folders = [*filter(None, options.append.split(";")), os.path.dirname(path) or "."]
    with session.search_path(last=folders):
        yield scene_file.parse(path, dict(options.define))


def needs_python(options: argparse.Namespace) -> bool:
    """Tells whether a scene has a plugin that is not native; sets the variant. Raises the errors of the parser."""
    mi.set_log_level(mi.LogLevel.Error)
    session.set_variant(options.mode)
    native = {"scene"} | native_plugins()
    for path in options.scenes:
        with parsed(options, path) as state:
            if any(node.props.plugin_name() not in native for node in state.nodes):
                return True
    return False


def render(options: argparse.Namespace) -> None:
    """Renders the scenes.

    An image is written to the option ``-o``, or to the path of its scene, with the suffix of the film's image format.
    """
    if options.compiler:
        raise ValueError("-O, -S, -V and -W do not work with plugins in Python; leave them out")
    mi.set_log_level(MITSUBA_LEVELS[min(options.verbose, len(MITSUBA_LEVELS) - 1)])
    dr.set_log_level(DRJIT_LEVELS[min(options.verbose, len(DRJIT_LEVELS) - 1)])
    # With fewer threads, Mitsuba waits forever when it reads or writes an EXR.
    dr.set_thread_count(max(options.threads or dr.thread_count(), EXR_THREADS))
    for path in options.scenes:
        with parsed(options, path) as state:
            target = os.path.dirname(options.output or path) or "."
            if not os.access(target, os.W_OK):  # Mitsuba would lose the image without a message
                raise OSError(f"{target}: no image can be written there")
            scene = scene_file.instantiate(state)
            sensor = pick_sensor(scene, options.sensor)
            scene.integrator().render(scene, sensor, develop=True, evaluate=True)
            dr.sync_thread()
            sensor.film().write(options.output or path)


def _main() -> int:
    """Runs the command; returns its exit code: 0, or 255 after an error, whose message is printed."""
    # Ctrl-C ends the process at once, as in the native command. An ignored signal stays ignored.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    options = None
    with suppress(ValueError):  # the native program tells what is wrong
        options = Arguments().parse_intermixed_args()
    try:
        if options is None or not needs_python(options):
            program = str(Path(mi.__file__).with_name("mitsuba"))
            os.execv(program, [program, *sys.argv[1:]])
        render(options)
        return 0
    except Exception as error:  # noqa: BLE001 (the native command does the same)
        sys.stdout.flush()
        sys.stderr.write(f"\x1b[31m\nCaught a critical exception: {session.message(error)}\x1b[0m\n")
        return 255
