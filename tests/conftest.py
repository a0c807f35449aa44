"""The variants of Mitsuba in which the tests run.

A test that takes ``variant_rgb`` runs in ``llvm_ad_rgb``, and where there is a device also in ``cuda_ad_rgb`` or
``metal_ad_rgb``; ``variant_mono`` and ``variant_spectral`` likewise. ``variant`` is each of these in turn, and
``scalar_rgb``. As each change of variant loads all plugins anew, the tests of one variant run together.
"""

import gc
import os
import signal
import sys
from pathlib import Path

#: Else each of the many processes that tests start would compile the package again.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

#: Where Dr.Jit keeps the tests' kernels; see :func:`adjust_processes`.
os.environ["DRJIT_CACHE_DIR"] = str(Path(__file__).parents[1] / "build" / "kernels")

import drjit as dr
import mitsuba as mi
import mitsuba_prosim  # noqa: F401  (registers the plugins)
import pytest
from mitsuba_prosim import llvm

#: Where a variant computes, by the beginning of its name. The first is where tests run that name no variant.
DEVICES = ("llvm", "cuda", "metal")


def usable(device):
    """Whether this machine has what the variants of a device need."""
    backend = getattr(dr.JitBackend, {"llvm": "LLVM", "cuda": "CUDA", "metal": "Metal"}[device], None)
    return backend is not None and dr.has_backend(backend)


HERE = [device for device in DEVICES if usable(device)]


def jit(colours):
    """The variants with derivatives for ``colours`` (rgb, mono, spectral) that Mitsuba and this machine have."""
    return [name for name in (f"{device}_ad_{colours}" for device in HERE or ["llvm"]) if name in mi.variants()]


RGB, MONO, SPECTRAL, SCALAR = jit("rgb"), jit("mono"), jit("spectral"), ["scalar_rgb"]
VARIANTS = [*RGB, *MONO, *SPECTRAL, *SCALAR]


def activate(request):
    """Sets the variant that the test runs in; its name."""
    if not HERE and request.param not in SCALAR:
        pytest.skip("there is neither an LLVM nor a device")
    mi.set_variant(request.param)
    return request.param


variant_rgb = pytest.fixture(activate, params=RGB, name="variant_rgb")
variant_mono = pytest.fixture(activate, params=MONO, name="variant_mono")
variant_spectral = pytest.fixture(activate, params=SPECTRAL, name="variant_spectral")
variant_scalar = pytest.fixture(activate, params=SCALAR, name="variant_scalar")
variant = pytest.fixture(activate, params=VARIANTS, name="variant")


@pytest.fixture
def write_scene(tmp_path):
    """Writes a text into a scene file; its path."""

    def write(text, name="s.scn"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture(name="denoiser")
def needs_oidn():
    pytest.importorskip("mitsuba_oidn", reason="mitsuba-oidn is not installed: pip install 'mitsuba-prosim[denoise]'")


@pytest.fixture
def logged(monkeypatch):
    """What is logged during the test by Python: pairs ``(level, text)``."""
    entries = []
    monkeypatch.setattr(mi, "Log", lambda *entry: entries.append(entry))
    return entries


#: Files whose tests share what takes seconds to make: with -n one process runs them.
SHARING = "cluster compare mitsuba_command docs lamps language_server page sampling server sources"


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    from xdist.scheduler import LoadScopeScheduling

    if config.getvalue("dist") != "load":
        return None

    class Scheduling(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            path = Path(nodeid.partition("::")[0])
            return path.stem if path.stem.removeprefix("test_") in SHARING.split() else nodeid

    return Scheduling(config, log)


def share_the_cores():
    """Gives each process of ``-n`` its share of the cores, because threads that wait for work would use a quarter of
    the processor time. Tests of threads set their number by :func:`scenes.in_threads`.
    """
    dr.set_thread_count(max(1, dr.thread_count() // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))))


def adjust_processes():
    """Compiles quickly here and in the processes that tests start, in which Python imports processes/sitecustomize.py
    at their start; also in those of ``-n``, which come here again.
    """
    here, paths = str(Path(__file__).with_name("processes")), os.environ.get("PYTHONPATH", "").split(os.pathsep)
    if here in paths:
        return
    version, library = llvm.version(), llvm.library()
    if version and version[0] >= 17 and library:  # older ones would print the name of each pass
        os.environ["QUICK_LLVM"] = library
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [here, *paths]))
    import processes.sitecustomize  # noqa: F401


def pytest_configure():
    gc.disable()
    share_the_cores()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background of a shell would ignore it
    adjust_processes()


def pytest_collection_finish():
    """Leaves out of each later collection of garbage what has been imported."""
    gc.freeze()
    gc.set_threshold(100_000)
    gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup():
    """Frees the scenes of the test before, because a kernel depends on all objects in memory: after another order of
    tests it would be compiled again. Objects that outlive their test are not looked at again.
    """
    gc.collect(1)


def pytest_report_header():
    vectors = f"; vectors of {os.environ['VECTOR_WIDTH']}" if "VECTOR_WIDTH" in os.environ else ""
    return f"Mitsuba {mi.__version__} in {', '.join(VARIANTS if HERE else SCALAR)}{vectors}"


def pytest_collection_modifyitems(items):
    """One variant after the other; tests that name none are among the first, beside their neighbours."""

    def place(item):
        parameters = item.callspec.params if hasattr(item, "callspec") else {}
        return max(
            (VARIANTS.index(v) for name, v in parameters.items() if name.startswith("variant") and v in VARIANTS),
            default=0,
        )

    items.sort(key=place)
