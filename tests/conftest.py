"""The variants of Mitsuba in which the tests run.

A test that takes ``variant_rgb`` runs in ``llvm_ad_rgb``, and where there is a device also in ``cuda_ad_rgb`` or
``metal_ad_rgb``; ``variant_mono`` and ``variant_spectral`` likewise. ``variant`` is each of these in turn, and
``scalar_rgb``. As each change of variant loads all plugins anew, the tests of one variant run together.
"""

import drjit as dr
import mitsuba as mi
import mitsuba_prosim  # noqa: F401  (registers the plugins)
import pytest

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


def pytest_report_header():
    absent = [device for device in DEVICES if device not in HERE]
    nothing = f"; there is nothing for {' and '.join(absent)} here" if absent else ""
    return f"Mitsuba {mi.__version__} in {', '.join(VARIANTS if HERE else SCALAR)}{nothing}"


def pytest_collection_modifyitems(items):
    """One variant after the other; tests that name none are among the first, beside their neighbours."""

    def place(item):
        parameters = item.callspec.params if hasattr(item, "callspec") else {}
        return max(
            (VARIANTS.index(v) for name, v in parameters.items() if name.startswith("variant") and v in VARIANTS),
            default=0,
        )

    items.sort(key=place)
