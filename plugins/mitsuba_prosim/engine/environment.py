"""The software versions and the processor of a process, on which the bits of the samples depend."""

from __future__ import annotations

import platform
from collections.abc import Mapping

import drjit as dr
import mitsuba as mi

from .. import __version__, llvm

#: Entries of an environment that must agree; and entries that may differ, with a warning: then samples are equally
#: good, but not bit-identical.
MUST_AGREE, MAY_DIFFER = ("mitsuba-prosim", "mitsuba", "drjit", "variant"), ("LLVM", "processor")


def this_environment() -> dict[str, str]:
    """Returns the software versions, the variant, the processor and, if used, LLVM, of this process."""
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
    """Returns the differences between the environment ``theirs`` of another process and that of this process, as text.

    Only the entries ``names`` of the environments are compared. The returned text is empty if these entries agree in
    both environments. An entry that ``theirs`` lacks is different, and "unknown" in the text.
    """
    ours = this_environment()
    return ", ".join(
        f"{name} {theirs.get(name) or 'unknown'} there, {ours[name] or 'none'} here"
        for name in names
        if theirs.get(name) != ours[name]
    )


def processor() -> str:
    """Returns the model of this machine's processor, and which of AVX2, FMA and AVX-512 the processor supports.

    On other systems than Linux, the result has only the model, as Python's module ``platform`` describes it.
    """
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            lines = dict(line.rstrip().split("\t: ", 1) for line in file if "\t: " in line)
    except OSError:
        lines = {}
    model = lines.get("model name") or platform.processor() or platform.machine()
    vectors = [flag for flag in ("avx2", "fma", "avx512f") if flag in lines.get("flags", "").split()]
    return " ".join([model, *vectors])
