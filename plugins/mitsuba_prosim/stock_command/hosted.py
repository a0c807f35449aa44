"""The Python side of the ``mitsuba`` command: the same options, order of steps, messages and exit codes.

A stand-in (``stand_in.c``) starts this when a scene names a plugin that is written in Python. The native command has
said by then what it is, and has rendered the scenes that come before that one.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import drjit as dr
import mitsuba as mi

from ..scene import rendering, report, scene_file, session

#: Option -> (its long form, whether a value follows), in the order in which the native command tries them.
OPTIONS = {
    "-t": ("--threads", True),
    "-v": ("--verbose", False),
    "-D": ("--define", True),
    "-s": ("--sensor", True),
    "-o": ("--output", True),
    "-h": ("--help", False),
    "-m": ("--mode", True),
    "-a": ("--append", True),
    "-O": (None, True),
    "-W": (None, False),
    "-S": (None, False),
    "-V": (None, True),
}

#: The flags that -O0 .. -O5 switch on, one more with each step.
OPTIMIZATIONS = (
    dr.JitFlag.MergeFunctions,
    dr.JitFlag.ConstantPropagation,
    dr.JitFlag.ValueNumbering,
    dr.JitFlag.OptimizeCalls,
    dr.JitFlag.OptimizeLoops,
)

#: Option -> its values, None for each time that a flag is given.
Options = dict[str, list[Any]]

#: Not empty: a hang-up signal has come, and the image so far has not been written yet.
hang_ups: list[bool] = []


def parse_arguments(words: Iterable[str]) -> tuple[Options, list[str]]:
    """Returns ``(options, scenes)``: option -> list of values (None for each time that a flag is given)."""
    options: Options = {}
    scenes, words = [], list(words)
    while words:
        word = words.pop(0)
        if not word.startswith("-"):
            scenes.append(word)
            continue
        # As in the native command, -t4 is -t 4, -vv is -v -v, and what follows a long option is ignored.
        option = next(
            (
                o
                for o, (long, _) in OPTIONS.items()
                if word.startswith(long or o) or (not word.startswith("--") and word.startswith(o))
            ),
            None,
        )
        if option is None:
            raise ValueError(f'Argument "{word}" was not recognized!')
        long, has_value = OPTIONS[option]
        rest = "" if word.startswith("--") else word[len(option) :]
        value = None
        if has_value:
            if rest:
                words.insert(0, rest)
            if not words or words[0].startswith("-"):
                raise ValueError(f'Missing/invalid argument for argument "{long if word.startswith("--") else option}"')
            value = words.pop(0)
        elif rest:
            words.insert(0, "-" + rest)
        options.setdefault(option, []).append(value)
    return options, scenes


def integer(options: Options, option: str, default: int) -> int:
    """The whole number that an option gives (the first time), or the default."""
    if option not in options:
        return default
    try:
        return int(options[option][0])
    except ValueError:
        raise ValueError(f'Argument "{option}": value "{options[option][0]}" is not an integer!') from None


def set_up(options: Options) -> None:
    """Variant, threads, log and Dr.Jit's flags, as the options say."""
    verbose = len(options.get("-v", ()))
    if "-V" in options:
        raise ValueError("-V: the vector width can't be set for scenes with plugins that are written in Python.")
    mi.set_log_level([mi.LogLevel.Info, mi.LogLevel.Debug, mi.LogLevel.Trace][min(verbose, 2)])
    dr.set_log_level(
        [
            dr.LogLevel.Error,
            dr.LogLevel.Warn,
            dr.LogLevel.Info,
            dr.LogLevel.InfoSym,
            dr.LogLevel.Debug,
            dr.LogLevel.Trace,
        ][min(verbose, 5)]
    )
    if "-t" in options:
        dr.set_thread_count(max(integer(options, "-t", 1), 1))
    variant = session.set_variant(options["-m"][0] if "-m" in options else "scalar_rgb" if "-h" in options else None)
    if variant.startswith("scalar_"):
        if {"-O", "-W", "-S"} & set(options):
            raise ValueError("Specified an argument that only makes sense in a JIT (LLVM/CUDA/Metal) mode!")
        return
    level = integer(options, "-O", len(OPTIMIZATIONS))
    for i, flag in enumerate(OPTIMIZATIONS):
        dr.set_flag(flag, dr.flag(flag) and level > i)
    if "-W" in options:
        dr.set_flag(dr.JitFlag.SymbolicLoops, False)
        dr.set_flag(dr.JitFlag.SymbolicCalls, len(options["-W"]) == 1)
    if "-S" in options:
        dr.set_flag(dr.JitFlag.PrintIR, True)


def run(plugin: str, words: Iterable[str]) -> None:
    """Renders the scenes from the first that names ``plugin``: the native command has rendered those before it."""
    options, scenes = parse_arguments(words)
    set_up(options)
    parameters = {}
    for definition in options.get("-D", ()):
        key, equals, value = definition.partition("=")
        if not equals:
            raise ValueError("-D/--define: expect key=value pair!")
        parameters[key] = value
    begun = False
    folders = [folder for folder in options.get("-a", [""])[0].split(";") if folder]
    for path in scenes:
        with session.resolving(session.resolver(last=[*folders, os.path.dirname(path) or "."])):
            with quiet(not begun):
                state = scene_file.parse(path, parameters)
            begun = begun or plugin in scene_file.plugin_names(state)
            if begun:
                with session.enough_threads():
                    scene = scene_file.instantiate(state)
                render(scene, integer(options, "-s", 0), options.get("-o", [path])[0])
    if scenes and not begun:
        raise RuntimeError(f'Plugin "{plugin}" is named by none of the scenes!')


@contextmanager
def quiet(wanted: bool) -> Iterator[None]:
    """Logs warnings only, if wanted: the native command has said the rest."""
    level = mi.log_level()
    mi.set_log_level(mi.LogLevel.Warn if wanted else level)
    try:
        yield
    finally:
        mi.set_log_level(level)


def render(scene: mi.Scene, index: int, path: str) -> None:
    """Renders to the file that the film makes of ``path``; a hang-up signal writes the image so far."""
    sensor, integrator = scene_file.pick_sensor(scene, index), scene.integrator()

    def write():
        with session.enough_threads():
            sensor.film().write(path)

    progressive = rendering.progressive(scene, sensor)
    for _ in progressive:
        if hang_ups:
            hang_ups.clear()
            progressive.put()
            write()
    if said := report.sentence(integrator, progressive.reached, interrupted=False):
        mi.Log(mi.LogLevel.Info, said)
    write()


def main(plugin: str, *words: str) -> int:
    """Runs the command ``mitsuba WORDS...``, which has met ``plugin``; returns its exit code."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not, if it is ignored
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.signal(signal.SIGHUP, lambda *_: hang_ups.append(True))
    try:
        run(plugin, words)
        return 0
    except Exception as error:  # noqa: BLE001 (the native command does the same)
        sys.stdout.flush()
        sys.stderr.write(f"\x1b[31m\nCaught a critical exception: {session.message(error)}\x1b[0m\n")
        return 255
