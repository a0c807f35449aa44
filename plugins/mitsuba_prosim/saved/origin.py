"""What made the samples of an image, as far as their bits depend on it."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version

import mitsuba as mi

from .. import __version__, llvm


def here() -> dict[str, str]:
    """Names and versions of what makes samples in this process."""
    found = llvm.version() if (mi.variant() or "").startswith("llvm") else None
    return {
        "mitsuba-prosim": __version__,
        "mitsuba": mi.__version__,
        "drjit": _version("drjit"),
        "variant": mi.variant() or "",
        "LLVM": ".".join(map(str, found)) if found else "",
        "processor": processor(),
    }


#: What has to be the same, and what may differ with a warning: samples are then as good, but not the same to the bit.
EXACT, CLOSE = ("mitsuba-prosim", "mitsuba", "drjit", "variant"), ("LLVM", "processor")


def differences(theirs: Mapping[str, str], ours: Mapping[str, str], names: tuple[str, ...]) -> str:
    """In what of ``names`` the two differ, in words; empty where in nothing."""
    return ", ".join(
        f"{name} {theirs.get(name) or 'unknown'} there, {ours[name] or 'none'} here"
        for name in names
        if theirs.get(name) != ours[name]
    )


def processor() -> str:
    """The kind of this machine's processor: its model, and which vector instructions it has, as far as can be known."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            lines = dict(line.rstrip().split("\t: ", 1) for line in file if "\t: " in line)
    except OSError:
        lines = {}
    model = lines.get("model name") or platform.processor() or platform.machine()
    vectors = [flag for flag in ("avx2", "fma", "avx512f") if flag in lines.get("flags", "").split()]
    return " ".join([model, *vectors])


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
