"""Which LLVM Dr.Jit has found, and whether it is fit for Mitsuba.

Dr.Jit chooses its LLVM when it is imported: the file that ``DRJIT_LIBLLVM_PATH`` names, else the newest one in the
system's library folders. So that a good one is found whatever a program imports first, the installation adds the
start-up file ``mitsuba_prosim_llvm.pth``, which sets that variable if it is unset and the library that came with this
package is there.
"""

import os
import platform

import drjit as dr

#: Dr.Jit 1.5 emits ``llvm.minimum`` and ``llvm.maximum``, which LLVM's x86 back end can compile since version 17.
OLDEST_ON_X86 = 17


def requirement():
    """The LLVM that this package installs on x86-64 Linux, as its metadata name it (``karellen-llvm-core==...``)."""
    from importlib.metadata import requires
    return next(r.partition(";")[0].strip() for r in requires("mitsuba-prosim") if r.startswith("karellen-"))


def packaged():
    """File name of the library in that LLVM."""
    return f"libLLVM-{requirement().partition('==')[2].partition('.')[0]}.so"


def version():
    """Version of the LLVM that Dr.Jit has loaded, as a tuple, or None."""
    return dr.detail.llvm_version() if dr.has_backend(dr.JitBackend.LLVM) else None


def library():
    """Path of the LLVM that Dr.Jit has loaded, as far as it can be told (on Linux, or from the variable), or None."""
    try:
        with open("/proc/self/maps", encoding="utf-8", errors="replace") as maps:
            return next((line.split(maxsplit=5)[5].strip() for line in maps if "/libLLVM" in line), None)
    except OSError:
        return os.environ.get("DRJIT_LIBLLVM_PATH")


def problem():
    """Says what is wrong if the LLVM variants would abort the process or can't be had; None if all is well."""
    found = version()
    fit = found and (found[0] >= OLDEST_ON_X86 or platform.machine() not in ("x86_64", "AMD64"))
    if fit:
        return None
    advice = (f"Install LLVM {OLDEST_ON_X86} or later (on x86-64 Linux: pip install '{requirement()}'; elsewhere: "
              "apt install libllvm19, brew install llvm or the like), see that DRJIT_LIBLLVM_PATH is unset or names its "
              "libLLVM, and start again. The variant scalar_rgb needs none.")
    if found is None:
        path = os.environ.get("DRJIT_LIBLLVM_PATH")
        return f"Dr.Jit found no usable LLVM{f' (DRJIT_LIBLLVM_PATH is {path})' if path else ''}. {advice}"
    return (f"Dr.Jit found LLVM {'.'.join(map(str, found))} ({library()}). It can't compile Mitsuba's kernels on this "
            f"processor, it would abort the process. {advice}")
