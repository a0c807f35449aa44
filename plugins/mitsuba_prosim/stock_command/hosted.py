"""A Python program that replaces the native command ``mitsuba``, with the same options and the same order of steps.

When a scene uses a plugin in Python, the plugin's stand-in (``stand_in.c``) replaces the process of the native command
by this program. Before this program starts, the native command has checked the options, and has rendered the scenes
that come before the scene with the plugin on the command line.
"""

import argparse
import os
import signal
import sys
from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from ..compat import EXR_THREADS
from ..scene import scene_file, session

#: Log levels of Mitsuba and of Dr.Jit; each -v selects the next level.
MITSUBA_LEVELS = (mi.LogLevel.Info, mi.LogLevel.Debug, mi.LogLevel.Trace)
DRJIT_LEVELS = tuple(getattr(dr.LogLevel, name) for name in ("Error", "Warn", "Info", "InfoSym", "Debug", "Trace"))


def parse_arguments(words: Sequence[str]) -> argparse.Namespace:
    """Parses the arguments of the native command ``mitsuba``, except for ``-V``, ``-O``, ``-W`` and ``-S`` of Dr.Jit's
    compiler. Wrong arguments end the process.
    """
    parser = argparse.ArgumentParser("mitsuba", add_help=False, allow_abbrev=False)
    parser.add_argument("-t", "--threads", type=int)
    parser.add_argument("-v", "--verbose", action="count", default=0)
    parser.add_argument("-D", "--define", action="append", default=[])
    parser.add_argument("-s", "--sensor", type=int, default=0)
    parser.add_argument("-o", "--output")
    parser.add_argument("-m", "--mode")
    parser.add_argument("-a", "--append", default="")
    parser.add_argument("scenes", nargs="*")
    return parser.parse_intermixed_args(words)


def run(plugin: str, words: Sequence[str]) -> None:
    """Renders the first scene of the command's arguments ``words`` that uses ``plugin``, and all scenes after it; the
    native command has rendered the others.

    An image is written to the option ``-o``, or to the path of its scene, with the suffix of the film's image format.
    """
    options = parse_arguments(words)
    mi.set_log_level(MITSUBA_LEVELS[min(options.verbose, len(MITSUBA_LEVELS) - 1)])
    dr.set_log_level(DRJIT_LEVELS[min(options.verbose, len(DRJIT_LEVELS) - 1)])
    # With fewer threads, Mitsuba waits forever when it reads or writes an EXR.
    dr.set_thread_count(max(options.threads or dr.thread_count(), EXR_THREADS))
    session.set_variant(options.mode)
    parameters = dict(definition.split("=", 1) for definition in options.define)
    started = False
    for path in options.scenes:
        folders = [*filter(None, options.append.split(";")), os.path.dirname(path) or "."]
        with session.search_path(last=folders):
            state = scene_file.parse(path, parameters)
            started = started or plugin in {node.props.plugin_name() for node in state.nodes}
            if started:
                target = os.path.dirname(options.output or path) or "."
                if not os.access(target, os.W_OK):  # Mitsuba would lose the image without a message
                    raise OSError(f"{target}: no image can be written there")
                scene = scene_file.instantiate(state)
                sensor = scene_file.pick_sensor(scene, options.sensor)
                scene.integrator().render(scene, sensor, develop=True, evaluate=True)
                dr.sync_thread()
                sensor.film().write(options.output or path)


def main(plugin: str, *words: str) -> int:
    """Calls :func:`run`; returns the exit code of the process: 0, or 255 after an error, whose message is printed."""
    # Ctrl-C ends the process at once, as in the native command. An ignored signal stays ignored.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        run(plugin, words)
        return 0
    except Exception as error:  # noqa: BLE001 (the native command does the same)
        sys.stdout.flush()
        sys.stderr.write(f"\x1b[31m\nCaught a critical exception: {session.message(error)}\x1b[0m\n")
        return 255
