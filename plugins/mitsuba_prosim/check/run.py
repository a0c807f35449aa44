"""Runs all tests of a plugin, in this process or in another one that may crash."""

import multiprocessing
from collections.abc import Callable, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..compat import is_users
from ..scene import session
from .kinds import emitter, images, scattering, shape, texture  # noqa: F401 (they define the tests)
from .report import FAILS, NOTE, SKIPPED, Report
from .subject import KINDS, Subject
from .tests import Tests

#: What Mitsuba's errors say of a method that a plugin does not have.
MISSING = "not implemented", "pure virtual", "explicitly disabled", "not supported", "was queried for", "is not defined"

#: Tests that fail for both principled BSDFs, and for blendbsdf; the fault of meshes.
SUM = "components add up"
IGNORES = "reciprocity", "sampled_type", SUM, "eval() is 0 if", "variants agree", "finite with"
SMOOTH = "on a smooth mesh, sample_position() returns the normals of the vertices", "sampled normals"
BLENDED = "ideal lobes", "weight is", "pdf of", "samples follow", "reflection", "the flags have", SUM

#: Faults of Mitsuba 3.9 itself: plugin -> (what is wrong, beginnings of the tests that find it, with their places; "*"
#: is any text). They are notes.
FAULTS = {
    "area": ("with a texture on a mesh, it samples other places", "samples follow pdf()", "light by"),
    "bitmap": ("the gradient has the resolution of the wrong axes if to_uv turns it", "eval_1_grad()"),
    "blendbsdf": ("it weights samples of ideal lobes and of dark sides wrongly", *BLENDED, "sampled_component"),
    "blendphase": ("one component's pdf has the weight of the blend", "weight of", "pdf of", "samples follow"),
    "checkerboard": ("eval_1() swaps both colours", "eval_1()"),
    "envmap": ("with a rotation, rays start on a disk that is not perpendicular to them", "flux of sample_ray()"),
    "hair": ("the second component is never sampled; the pdf is no exact one", "every lobe", "samples follow pdf()"),
    "mask": ("with one component in the context, sample() takes the other", "samples follow", "sampled_type", SUM),
    "obj": SMOOTH,
    "path": ("it drops the light of paths that leave the scene through a mask", "* of volpath mask"),
    "perspective": ("sample_direction() loses a part of the film with a principal point", "points of rays"),
    "ply": SMOOTH,
    "prb_basic": ("it finds no point lights", "blocks have", "images have"),
    "principled": ("not reciprocal, ignores components, spec_tint depends on wavelengths, wrong if eta is 1", *IGNORES),
    "principledthin": ("not reciprocal, ignores components, has lobes of weight 0", "every lobe", *IGNORES),
    "ptracer": ("it loses lights behind a mask", "* of volpath mask"),
    "roughplastic": ("the table of transmittances has no derivative", "derivatives"),
    "serialized": SMOOTH,
    "sggx": ("the frame of sampled normals is transposed", "samples follow pdf()"),
    "sphere": ("the normals of a turned sphere are not turned", "sampled normals"),
    "sunsky": ("sun_direction does not turn", "to_world moves the light", "updated"),
    "timed_sunsky": ("the scalar variant sees the sun in all directions", "variants agree"),
    "twosided": ("with two BSDFs, one component has the light of both sides", SUM, "sampled_"),
}

#: Seconds after which a test of a process apart is ended.
PATIENCE = 300


def check(
    source: str | Path | Mapping[str, Any],
    *,
    node: int = 0,
    modules: Sequence[str] = (),
    begun: Callable[[str], None] = lambda test: None,
) -> Report:
    """Tests a plugin in the active variant, and compares it with other variants; returns the report.

    ``source``, ``node`` and ``modules`` are those of :class:`.Subject`. ``begun`` is called with the name of each test
    when it begins. Raises RuntimeError in scalar variants, TypeError for a kind of plugin without tests, and Mitsuba's
    errors if it can't be loaded.
    """
    if not dr.is_jit_v(mi.Float):
        raise RuntimeError(f"check: {mi.variant()} takes one input at a time; use an llvm or cuda variant.")
    subject = Subject(source, node, modules)
    loaded = subject.load()
    name = next((name for name in KINDS if isinstance(loaded, getattr(mi, name))), type(loaded).__name__)
    if name not in KINDS:
        raise TypeError(f"{subject.name} is a {name}; there are tests for {', '.join(KINDS)}")
    report = Report(subject.name, KINDS[name])
    tests = {one.__name__: one for one in Tests.__subclasses__()}[name]
    for test, run in tests(subject, report).tests():
        begun(test)
        try:
            with np.errstate(all="ignore"):
                run()
        except Exception as error:  # noqa: BLE001 (a plugin in Python may raise anything; other tests may tell why)
            words = session.message(error).strip().splitlines() or [repr(error)]
            lacks = [line for line in words if any(phrase in line.lower() for phrase in MISSING)]
            if lacks or isinstance(error, NotImplementedError):
                report.add(test, SKIPPED, [*lacks, words[-1]][0])
            else:
                report.add(test, FAILS, f"{type(error).__name__}: {words[-1]}")
    report.finish()
    for name, number in subject.types().items():
        reason, *known = FAULTS.get(name, ("",))
        failed = [one for one in report.results if one.verdict == FAILS and _is_of(one, known)]
        if failed and is_users(loaded):  # it may be wrong itself, so only faults that the plugin in it has alone count
            inner = number != subject.node
            alone = check(source, node=number, modules=modules, begun=begun).results if inner else []
            noted = {one.test for one in alone if one.verdict == NOTE and _is_of(one, known)}
            failed = [one for one in failed if one.test in noted]
        for result in failed:
            result.verdict, result.statistic = NOTE, f"{result.statistic}; a fault of Mitsuba: {reason}"
    return report


def _is_of(result: Any, known: Sequence[str]) -> bool:
    return any(fnmatchcase(f"{result.test} {result.where}", f"{test}*") for test in known)


def check_apart(variant: str, source: str | Path | Mapping[str, Any], **how: Any) -> Report:
    """Tests a plugin in a new process; returns the report, which names the test that crashed or does not end.

    ``how`` are arguments of :func:`check`. Raises RuntimeError with the message of a plugin that cannot be loaded.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_child, args=(sender, variant, source, how))
    process.start()
    sender.close()
    message: Any = "loading"
    try:
        while isinstance(message, str):
            test, end = message, f"does not end within {PATIENCE} s"
            if not receiver.poll(PATIENCE):
                break
            message = receiver.recv()
    except EOFError:
        process.join()
        end = f"ends the process (exit code {process.exitcode})"
    finally:
        process.kill()
    if isinstance(message, Exception):
        raise message
    if isinstance(message, str):
        message = Report(str(source["type"] if isinstance(source, Mapping) else source))
        message.add("the process survives", FAILS, f"the plugin {end}", f"in the test: {test}")
    return message


def _child(sender: Any, variant: str, source: str | Path | Mapping[str, Any], how: dict[str, Any]) -> None:
    """Tests a plugin in this process, and sends the names of tests, and then the report or an exception."""
    try:
        Subject(source, modules=how.get("modules", ())).set_variant(variant)
        mi.set_log_level(mi.LogLevel.Error)
        sender.send(check(source, begun=sender.send, **how))
    except Exception as error:  # noqa: BLE001 (the parent reports it)
        sender.send(RuntimeError(session.message(error)))
