"""Variants for the tests: a test that takes ``variant_rgb`` runs in llvm_ad_rgb, and so on."""

import mitsuba as mi
import mitsuba_prosim  # noqa: F401  (registers the plugins)
import pytest

VARIANTS = ("llvm_ad_rgb", "llvm_ad_mono", "llvm_ad_spectral", "scalar_rgb")


@pytest.fixture
def variant_rgb():
    mi.set_variant("llvm_ad_rgb")


@pytest.fixture
def variant_mono():
    mi.set_variant("llvm_ad_mono")


@pytest.fixture
def variant_spectral():
    mi.set_variant("llvm_ad_spectral")


@pytest.fixture
def variant_scalar():
    mi.set_variant("scalar_rgb")


@pytest.fixture(params=VARIANTS)
def variant(request):
    """Each of the variants in turn; its name."""
    mi.set_variant(request.param)
    return request.param
