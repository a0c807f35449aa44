"""Compiles the kernels of this process as the tests do: QUICK_LLVM in the environment is the LLVM that shall leave out
its optional passes, and VECTOR_WIDTH the width of the vectors of another x86-64 CPU.

Python imports this module at its start, where its folder is in PYTHONPATH.
"""

import ctypes
import importlib.util
import os
from pathlib import Path

#: LLVM's target by the width of its vectors. Dr.Jit takes reciprocals and roots otherwise with each: by the
#: approximations of AVX2 (8) and of AVX-512 (16), or exactly (4).
TARGETS = {4: "x86-64-v3", 8: "x86-64-v3", 16: "x86-64-v4"}


def compile_quickly(library: str) -> None:
    """Switches off LLVM's optional passes and its best register allocation, because most kernels are compiled for a few
    pixels. An image has the same bits, but a render would be slower; so these kernels stay out of the user's cache.
    """
    options = b"pytest", b"-opt-bisect-limit=0", b"-opt-bisect-verbose=0", b"-regalloc=basic"
    ctypes.CDLL(library).LLVMParseCommandLineOptions(4, (ctypes.c_char_p * 4)(*options), None)


def set_width(width: int) -> None:
    """Sets LLVM's target for all kernels that follow."""
    package = Path(importlib.util.find_spec("drjit").origin).parent
    core = ctypes.CDLL(str(next(package.glob("*drjit-core.*"))))
    core["_Z24jit_set_log_level_stderr8LogLevel"](1)  # errors
    core["_Z8jit_initj"](ctypes.c_uint32(1 << 2))  # LLVM; initialising it later would choose the machine's own target
    core["_Z19jit_llvm_set_targetPKcS0_j"](TARGETS[width].encode(), None, ctypes.c_uint32(width))


if "QUICK_LLVM" in os.environ:
    compile_quickly(os.environ["QUICK_LLVM"])
if "VECTOR_WIDTH" in os.environ:
    set_width(int(os.environ["VECTOR_WIDTH"]))
