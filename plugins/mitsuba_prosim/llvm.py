"""The LLVM library that Dr.Jit has loaded, and whether this library works with Mitsuba.

When Dr.Jit is imported, it loads the LLVM that ``DRJIT_LIBLLVM_PATH`` names, or else the newest LLVM in the system's
library folders. The file ``mitsuba_prosim_llvm.pth``, which Python executes at its start, sets this variable, if it is
unset, to the LLVM that this package requires. ``pyproject.toml``, that file and this module name the same version.
"""

import os
import platform

import drjit as dr

#: Minimum version of LLVM on x86: Dr.Jit 1.5 emits ``llvm.minimum`` and ``llvm.maximum``, which older x86 back ends
#: cannot compile.
OLDEST_ON_X86 = 17

#: The LLVM package that this package requires on x86-64 Linux.
REQUIREMENT = "karellen-llvm-core==23.1.*"


def version() -> tuple[int, ...] | None:
    """Returns the version of the LLVM that Dr.Jit has loaded, or None if Dr.Jit has loaded no LLVM."""
    return dr.detail.llvm_version() if dr.has_backend(dr.JitBackend.LLVM) else None


def library() -> str | None:
    """Returns the path of the LLVM that Dr.Jit has loaded, or None; ``DRJIT_LIBLLVM_PATH`` if not on Linux."""
    try:
        with open("/proc/self/maps", encoding="utf-8", errors="replace") as maps:
            return next((line.split(maxsplit=5)[5].strip() for line in maps if "/libLLVM" in line), None)
    except OSError:
        return os.environ.get("DRJIT_LIBLLVM_PATH")


def problem() -> str | None:
    """Returns why LLVM variants would abort the process or are missing, with advice; None if they work."""
    found = version()
    if found is not None and (found[0] >= OLDEST_ON_X86 or platform.machine() not in ("x86_64", "AMD64")):
        return None
    advice = (
        f"Install LLVM {OLDEST_ON_X86} or later (on x86-64 Linux: pip install '{REQUIREMENT}'; elsewhere: "
        "apt install libllvm19, brew install llvm or the like), see that DRJIT_LIBLLVM_PATH is unset or names "
        "its libLLVM, and start again. The variant scalar_rgb needs none."
    )
    if found is None:
        path = os.environ.get("DRJIT_LIBLLVM_PATH")
        return f"Dr.Jit found no usable LLVM{f' (DRJIT_LIBLLVM_PATH is {path})' if path else ''}. {advice}"
    return (
        f"Dr.Jit found LLVM {'.'.join(map(str, found))} ({library()}). It can't compile Mitsuba's kernels on "
        f"this processor, but would abort the process. {advice}"
    )
