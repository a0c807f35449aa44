"""The software and the processor of a process: the bits of its samples depend on them."""

from __future__ import annotations

import platform
from collections.abc import Mapping

import drjit as dr
import mitsuba as mi

from .. import __version__, llvm

#: Names that must have the same values; and those that may differ, with a warning: samples are as good, but not
#: bit-identical.
MUST_AGREE, MAY_DIFFER = ("mitsuba-prosim", "mitsuba", "drjit", "variant"), ("LLVM", "processor")


def this_environment() -> dict[str, str]:
    """Names and versions of the software, the variant and the processor of this process."""
    found = llvm.version() if (mi.variant() or "").startswith("llvm") else None
    return {
        "mitsuba-prosim": __version__,
        "mitsuba": mi.__version__,
        "drjit": dr.__version__,
        "variant": mi.variant() or "",
        "LLVM": ".".join(map(str, found)) if found else "",
        "processor": processor(),
    }


def differences(theirs: Mapping[str, str], names: tuple[str, ...]) -> str:
    """How the environment ``theirs`` differs from that of this process in ``names``, in words; empty if it does not."""
    ours = this_environment()
    return ", ".join(
        f"{name} {theirs.get(name) or 'unknown'} there, {ours[name] or 'none'} here"
        for name in names
        if theirs.get(name) != ours[name]
    )


def processor() -> str:
    """The kind of this machine's processor: its model, and which vector instructions it has, as far as is known."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            lines = dict(line.rstrip().split("\t: ", 1) for line in file if "\t: " in line)
    except OSError:
        lines = {}
    model = lines.get("model name") or platform.processor() or platform.machine()
    vectors = [flag for flag in ("avx2", "fma", "avx512f") if flag in lines.get("flags", "").split()]
    return " ".join([model, *vectors])
