"""The plugins are there whatever the order of imports, in every variant, with a good LLVM; their examples load."""

import inspect
import os
import re
import subprocess
import sys
import sysconfig
import textwrap
from importlib.metadata import entry_points
from pathlib import Path

import mitsuba as mi
import mitsuba_prosim
import pytest
from mitsuba_prosim import llvm, registry

mi.set_variant("llvm_ad_rgb")

SCENE = """{"type": "scene",
    "integrator": {"type": "direct"},
    "sensor": {"type": "perspective", "film": {"type": "hdrfilm", "width": 4, "height": 4},
               "sampler": {"type": "nrook", "sample_count": 4}},
    "light": {"type": "constant"}}"""

RENDER = f"image = mi.render(mi.load_dict({SCENE}), spp=4); assert abs(image.array[0] - 1) < 1e-5\n"

#: Asks for the boxes of plugins in one place.
BOXES = "[mi.load_dict({'type': name}).bbox().min[0] for name in ('prosim_point', 'prosim_window')]"


def python(code, **env):
    """Runs ``code`` in a new interpreter, without the DRJIT_LIBLLVM_PATH of this one."""
    environment = {k: v for k, v in os.environ.items() if k != "DRJIT_LIBLLVM_PATH"} | env
    return subprocess.run([sys.executable, "-c", code], check=False, env=environment, capture_output=True, text=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    "code",
    [
        "import mitsuba_prosim; import mitsuba as mi; mi.set_variant('llvm_ad_rgb')",
        "import mitsuba as mi; mi.set_variant('llvm_ad_rgb'); import mitsuba_prosim",
        "import drjit; import mitsuba as mi; mi.set_variant('scalar_rgb'); import mitsuba_prosim",
    ],
    ids=["first", "after", "scalar"],
)
def test_any_order_of_imports_renders(code):
    """What renders is imported with the first image: it would take longer than all plugins together. Once another
    variant was set, ``mi`` keeps names that a scalar variant lacks, as for the boxes of points.
    """
    late = {"numpy", "mitsuba_prosim.engine.accumulators", "mitsuba_prosim.denoising"}
    loaded = f"import sys; print(*({late} & sys.modules.keys()), 'mitsuba_prosim.integrators.prosim' in sys.modules)"
    done = python(f"{code}\n{loaded}\n{RENDER}{BOXES}")
    assert done.returncode == 0 and done.stdout.strip() == "True", done.stderr


def test_every_plugin_follows_the_variant():
    """Each class derives from the active variant's base class, also after a return to an earlier variant."""
    for variant in ("llvm_ad_rgb", "scalar_rgb", "llvm_ad_rgb"):
        mi.set_variant(variant)
        bases = (mi.BSDF, mi.Emitter, mi.Texture, mi.Sensor, mi.Sampler, mi.Integrator)
        assert registry.PLUGINS and all(issubclass(cls, bases) for cls in registry.PLUGINS.values())
        sampler = mi.load_dict({"type": "nrook", "sample_count": 9})
        assert isinstance(sampler, mi.Sampler) and sampler.sample_count() == 9


def test_types_are_known_to_scalar_rgb(variant_rgb):
    """Mitsuba 3.9 asks scalar_rgb for the type of a plugin, whatever the variant."""
    manager = mi.PluginManager.instance()
    assert all(manager.plugin_type(name) != mi.ObjectType.Unknown for name in registry.PLUGINS)


def test_registering_again_changes_nothing(variant_rgb):
    """Mitsuba 3.10 reloads the package that its entry point names, beside calling the variant callback."""
    before = dict(registry.PLUGINS)
    registry.register_plugins()
    assert all(registry.PLUGINS[name] is cls for name, cls in before.items())


def test_distribution_has_the_entry_point():
    assert any(entry.load() is mitsuba_prosim for entry in entry_points(group="mitsuba"))


def startup_file():
    """What the start-up file would set DRJIT_LIBLLVM_PATH to, if it were unset: the path, or None."""
    line = Path(sysconfig.get_path("purelib"), "mitsuba_prosim_llvm.pth").read_text()
    code = f"import os; os.environ.pop('DRJIT_LIBLLVM_PATH', None)\n{line}\nprint(os.environ.get('DRJIT_LIBLLVM_PATH'))"
    done = python(code)
    assert done.stderr == ""
    return None if done.stdout == "None\n" else done.stdout.strip()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux" or os.uname().machine != "x86_64", reason="no LLVM is installed there")
def test_the_installed_llvm_is_the_one_in_use():
    file = Path(startup_file())
    assert file.is_file() and llvm.REQUIREMENT.endswith(f"=={file.stem.removeprefix('libLLVM-')}.1.*")
    done = python("import mitsuba; from mitsuba_prosim import llvm; print(llvm.problem(), llvm.library())")
    problem, library = done.stdout.split()
    assert problem == "None" and Path(library).samefile(file)
    assert python("import os; print(os.environ['DRJIT_LIBLLVM_PATH'])").stdout.strip() == str(file)


@pytest.mark.parametrize("found, says", [((15, 0, 6), "LLVM 15.0.6"), (None, "no usable LLVM"), ((19, 1, 0), None)])
def test_unfit_llvm_is_a_message(monkeypatch, found, says):
    monkeypatch.setattr(llvm, "version", lambda: found)
    monkeypatch.setattr(llvm.platform, "machine", lambda: "x86_64")
    problem = llvm.problem()
    assert problem is None if says is None else says in problem and "karellen-llvm-core" in problem


def test_unfit_llvm_stops_an_llvm_variant(monkeypatch):
    mi.set_variant("scalar_rgb")
    monkeypatch.setattr(llvm, "version", lambda: (15, 0, 6))
    monkeypatch.setattr(llvm.platform, "machine", lambda: "x86_64")
    with pytest.raises(RuntimeError, match="abort the process"):
        mi.set_variant("llvm_ad_rgb")
    monkeypatch.undo()
    mi.set_variant("scalar_rgb")
    mi.set_variant("llvm_ad_rgb")
    assert isinstance(mi.load_dict({"type": "nrook"}), mi.Sampler)


# ------------------------------------------------------------------ XML and Python in their documentation mean the same


def example(name, language):
    """The code of the example in that language (xml or python) in a plugin's class docstring."""
    text = inspect.getdoc(registry.PLUGINS[name])
    block = re.search(rf"\.\. code-tab:: {language}\n((?:[ ]*\n|[ ]{{4,}}.*\n?)+)", text)
    assert block, f"{name}: no example in {language}"
    return textwrap.dedent(block[1].split(".. code-tab::")[0])


@pytest.mark.parametrize("name", sorted(registry.PLUGINS))
def test_examples_load_and_agree(name, variant_rgb):
    """The XML is loaded by itself, as Mitsuba loads files whose root is a plugin. The example in Python is the inside
    of a dictionary, either a plugin's own or one that holds a named plugin.
    """
    text, entries = example(name, "xml"), eval(f"{{{example(name, 'python')}}}")
    root = re.match(r"\s*<(\w+)", text)[1]
    xml = mi.load_string(re.sub(rf"<{root}\b", f'<{root} version="3.0.0"', text, count=1))
    python = mi.load_dict(entries if "type" in entries else entries.popitem()[1])
    assert type(xml) is type(python)
    assert str(xml) == str(python)
    xml_parameters, python_parameters = mi.traverse(xml), mi.traverse(python)
    assert sorted(k for k, _ in xml_parameters) == sorted(k for k, _ in python_parameters)
    for key, value in xml_parameters:
        assert str(value) == str(python_parameters[key])


MORE = {
    "metal": {"type": "prosim_conductor", "material": "Au"},
    "black": {"type": "prosim_point", "intensity": 0.0},
    "aovs": {"type": "prosim", "aovs": "distance:depth"},
}


@pytest.mark.parametrize("name", [*sorted(registry.PLUGINS), *MORE])
def test_no_plugin_loads_another_as_a_scene(name, variant_rgb, monkeypatch):
    """Mitsuba exchanges its file resolver while it loads: made in a thread, such a plugin would disturb the others."""
    load, entries = mi.load_dict, MORE.get(name) or eval(f"{{{example(name, 'python')}}}")
    monkeypatch.setattr(mi, "load_dict", lambda *_, **__: pytest.fail("loaded within a plugin"))
    load(entries if "type" in entries else entries.popitem()[1])
