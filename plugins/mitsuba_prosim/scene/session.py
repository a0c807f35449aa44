"""Sets up Mitsuba: the variant, the plugins of all packages, the number of threads and the search path."""

import difflib
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import drjit as dr
import mitsuba as mi

from .. import registry
from ..alone import alone
from ..compat import NO_PARAMETER, SOURCE_LINE, TRACEBACK
from ..registry import register_plugins

#: First part of a variant's name -> (the backend, and what the backend requires).
BACKENDS = {
    "scalar": (None, ""),
    "llvm": (dr.JitBackend.LLVM, "LLVM"),
    "cuda": (dr.JitBackend.CUDA, "an NVIDIA GPU with its driver"),
    "metal": (dr.JitBackend.Metal, "a GPU of Apple's"),
}

#: The order in which the native command tries variants.
PREFERRED = ("cuda_ad_rgb", "metal_ad_rgb", "llvm_ad_rgb", "scalar_rgb")


def has_backend(variant: str) -> bool:
    """Tells whether this machine has the Dr.Jit backend (such as LLVM or CUDA) that a variant of Mitsuba needs."""
    backend, _ = BACKENDS[variant.partition("_")[0]]
    return backend is None or bool(dr.has_backend(backend))


def default_variant() -> str:
    """Returns the first of the :data:`PREFERRED` variants that works on this machine."""
    return next(variant for variant in PREFERRED if variant in mi.variants() and has_backend(variant))


def set_variant(variant: str | None = None) -> str:
    """Sets Mitsuba's variant, :func:`default_variant` if it is None, loads all plugins, and returns the name of the
    variant.

    Raises ImportError if Mitsuba does not have the variant, and RuntimeError if this machine lacks its backend.
    """
    variant = variant or default_variant()
    if variant in mi.variants() and not has_backend(variant):
        _, need = BACKENDS[variant.partition("_")[0]]
        raise RuntimeError(
            f"{variant} needs {need}, and Dr.Jit finds none here. This machine can run "
            f"{', '.join(filter(has_backend, mi.variants()))}; run prosim doctor."
        )
    mi.set_variant(variant)
    register_plugins()  # again, if an earlier attempt has set the variant and then failed
    load_plugins()
    return variant


@cache
def _packages_with_plugins() -> tuple[EntryPoint, ...]:
    """Returns the entry points of plugins; looks for them once, because this takes as long as a small render."""
    return tuple(entry_points(group="mitsuba"))


def load_plugins() -> None:
    """Imports the modules of the entry points in the group ``mitsuba``, which register the plugins of all installed
    packages, as Mitsuba 3.10 does itself. Warns if a module cannot be loaded.
    """
    for entry in _packages_with_plugins():
        try:
            entry.load()
        except Exception as error:  # noqa: BLE001 (the plugins of this package do not depend on others)
            warnings.warn(f"the plugins of {entry.value} could not be loaded: {error}", stacklevel=2)


def message(error: BaseException) -> str:
    """Returns the messages of an exception and of its cause, without Python tracebacks and lines of Mitsuba's source
    code.

    The message that a plugin lacks some parameters is shortened to their names, with similar or all parameters of a
    plugin of this package.
    """
    cause = f" {message(error.__cause__)}" if error.__cause__ else ""
    text = str(error)
    # Mitsuba has quoted a text in another encoding. In Python 3.10 the message is then lost.
    if isinstance(error, UnicodeDecodeError) or (isinstance(error, RuntimeError) and not text):
        read = getattr(error, "object", b"a file of the scene").decode("utf-8", "replace")
        text = f"{read}: this is not UTF-8; save the file as UTF-8, or unpack it"
    words = SOURCE_LINE.sub("", TRACEBACK.sub("", text) + cause)

    def shortened(found: re.Match[str]) -> str:
        names = re.findall(r'- \w+ "([^"\n]+)":', found[2])
        known = registry.parameters(found[1])
        near = [word for name in names for word in difflib.get_close_matches(name, known, 1)]
        hint = f". Did you mean {' and '.join(near)}?" if near else f"; it has {', '.join(known)}" if known else ""
        return f"{found[1]} has no parameter {', '.join(names)}{hint}"

    return NO_PARAMETER.sub(shortened, words)


@contextmanager
def search_path(first: Sequence[str | Path] = (), last: Sequence[str | Path] = ()) -> Iterator[mi.FileResolver]:
    """Inside the ``with`` block, Mitsuba's search path, which is yielded, begins with the folders ``first`` and ends
    with the folders ``last``. Other threads that call this function wait.
    """
    with alone():
        before = mi.file_resolver()
        resolver = mi.FileResolver(before)
        for path in reversed(first):
            resolver.prepend(str(path))
        for path in last:
            resolver.append(str(path))
        mi.set_file_resolver(resolver)
        try:
            yield resolver
        finally:
            mi.set_file_resolver(before)


@contextmanager
def threads(count: int | None) -> Iterator[None]:
    """Sets the number of Dr.Jit's threads to ``count`` inside the ``with`` block; None changes nothing, because Dr.Jit
    1.5 may, very rarely, wait forever when threads end.
    """
    before = dr.thread_count()
    if count in (None, before):
        yield
        return
    _set_thread_count(count)
    try:
        yield
    finally:
        _set_thread_count(before)


def _set_thread_count(count: int) -> None:
    """Waits for all kernels first: those that add to a copy of an array for each thread, as Mitsuba's films do, would
    write beyond the copies of which there are as many as there were threads.
    """
    dr.eval()
    dr.sync_thread()
    dr.set_thread_count(count)
