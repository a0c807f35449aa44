"""The examples in the plugins' documentation can be loaded, and the XML and the Python example mean the same."""

import inspect
import re
import textwrap

import mitsuba as mi
import pytest
from mitsuba_prosim import registry

mi.set_variant("llvm_ad_rgb")


def example(name, language):
    """The code of the example in that language (xml or python) in a plugin's class docstring."""
    text = inspect.getdoc(registry.PLUGINS[name])
    block = re.search(rf"\.\. code-tab:: {language}\n((?:[ ]*\n|[ ]{{4,}}.*\n?)+)", text)
    assert block, f"{name}: no example in {language}"
    return textwrap.dedent(block[1].split(".. code-tab::")[0])


def from_xml(text):
    """The object of the example, loaded by itself as Mitsuba loads any file whose root is a plugin."""
    root = re.match(r"\s*<(\w+)", text)[1]
    return mi.load_string(re.sub(rf"<{root}\b", f'<{root} version="3.0.0"', text, count=1))


def from_python(text):
    """The object of the example: the inside of a dictionary, either a plugin's own or one that holds a named plugin."""
    entries = eval(f"{{{text}}}")
    return mi.load_dict(entries if "type" in entries else entries.popitem()[1])


@pytest.mark.parametrize("name", sorted(registry.PLUGINS))
def test_examples_load_and_agree(name, variant_rgb):
    xml, python = from_xml(example(name, "xml")), from_python(example(name, "python"))
    assert type(xml) is type(python)
    assert str(xml) == str(python)
    xml_parameters, python_parameters = mi.traverse(xml), mi.traverse(python)
    assert sorted(k for k, _ in xml_parameters) == sorted(k for k, _ in python_parameters)
    for key, value in xml_parameters:
        assert str(value) == str(python_parameters[key])


@pytest.mark.parametrize("name", sorted(registry.PLUGINS))
def test_documentation_is_complete(name):
    text = inspect.getdoc(registry.PLUGINS[name])
    assert re.search(rf"^\.\. _\w+-{name}:$", text, re.MULTILINE)
    assert f":monosp:`{name}`" in text and ".. pluginparameters::" in text


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
