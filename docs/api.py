"""Writes docs/api.rst: plugins and Python functions with their parameters, and the words of the scene language.

``python docs/api.py`` writes the page; the tests check that it is up to date.
"""

import ast
import importlib
import inspect
import re
import sys
import textwrap
from pathlib import Path

import mitsuba as mi
from prosim_scene.language.words import TABLE, WORDS

DOCS = Path(__file__).parent
PAGE = DOCS / "api.rst"
sys.path.insert(0, str(DOCS / "extensions"))
from plugin_pages import plugins

FOLDERS = {
    "integrators": "Integrators",
    "samplers": "Samplers",
    "bsdfs": "BSDFs",
    "emitters": "Emitters",
    "textures": "Textures",
    "sensors": "Sensors",
}

#: Module -> its public names; None: those of ``__all__``.
MODULES = {
    "mitsuba_prosim": None,
    "mitsuba_prosim.denoising": ["render"],
    "mitsuba_prosim.live.result": ["Result"],
    "mitsuba_prosim.engine.integrator": ["ProgressiveIntegrator.progressive"],
    "mitsuba_prosim.engine.render": [
        f"Render.{name}"
        for name in ("image", "error", "counts", "noise_bound", "reached", "checkpoint", "stop", "close")
    ],
    "mitsuba_prosim.engine.checkpoint": ["load", "merge", "save"],
    "mitsuba_prosim.engine.tiles": ["Part"],
    "prosim_scene": None,
}

HEAD = """.. Written by docs/api.py from the docstrings: change those, and run the script again.

API
===

All plugins and all public Python functions with their parameters. P: ``mi.traverse`` shows the parameter; ∂: it has
derivatives; D: it moves an edge, whose share of the derivative is missing. :doc:`plugins/index` has examples of each
plugin, :doc:`python` of the translator.
"""


def plain(text):
    """``text`` without the roles that only Mitsuba's documentation and Sphinx know."""
    text = " ".join(text.split())
    text = re.sub(r":(?:ref|doc):`([^`<]*[^`< ]) ?<[^`]*>`", r"\1", text)
    text = re.sub(r":ref:`\w+-(\w+)`", r"``\1``", text)
    text = re.sub(r":(?:class|func|meth|mod|doc):`[~.]*([^`]*)`", r"``\1``", text)
    text = re.sub(r":(?:monosp|paramtype):`([^`]*)`", r"``\1``", text)
    return re.sub(r"\|(\w+)\|", r"\1", text)


def sentence(text):
    """The first sentence."""
    return re.split(r"(?<=[^.\d]\.) (?=[A-Z:(`])", plain(text), maxsplit=1)[0]


def table(head, rows):
    """A table in reStructuredText."""
    lines = [".. list-table::", "   :header-rows: 1", ""]
    for row in [head, *rows]:
        lines += [f"   {'*' if i == 0 else ' '} - {cell}".rstrip() for i, cell in enumerate(row)]
    return "\n".join(lines)


def plugin_section(name, docstring):
    """Title, first sentence and parameters of a plugin."""
    _, _, rest = docstring.partition(".. pluginparameters::\n")
    listed, about = re.match(r"((?: [^\n]*\n|\n)*)(.*?)(?=\n\.\. tabs::|\Z)", rest, re.DOTALL).groups()
    rows = []
    for item in re.split(r"^ \* - ", listed, flags=re.MULTILINE)[1:]:
        cells = [plain(cell) for cell in re.split(r"^   - ", item, flags=re.MULTILINE)] + [""]
        parameter, kind, meaning, flags = cells[:4]
        default = "; ".join(re.findall(r"\(Default: (.*?)\)(?=[.,;]?$|[.,;]? )", meaning))
        meaning = re.sub(r" ?\(Default: .*?\)(?=[.,;]?$|[.,;]? )", "", meaning)
        flags = flags.replace("exposed", "P").replace("differentiable", "∂").replace("discontinuous", "D")
        rows.append([f"``{parameter}``", kind, default, meaning, flags.replace(",", "")])
    head = ["parameter", "type", "default", "meaning", ""]
    return f"{name}\n{'~' * len(name)}\n\n{sentence(about)}\n\n{table(head, rows)}\n"


def signature(function):
    """The parameters of a function, with types and defaults, as the source has them."""
    definition = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
    definition.args.args = [arg for arg in definition.args.args if arg.arg not in ("self", "cls")]
    returns = f" -> {ast.unparse(definition.returns)}" if definition.returns else ""
    return f"({ast.unparse(definition.args)}){returns}"


def function_section(module, name):
    """Name, parameters and first sentence of a function, a method, a class or a constant."""
    found = importlib.import_module(module)
    for part in name.split("."):
        found = inspect.getattr_static(found, part) if inspect.isclass(found) else getattr(found, part)
    if not (callable(found) or isinstance(found, property)):
        return f"``{name}`` = ``{found!r}``\n"
    code = name + signature(found) if inspect.isfunction(found) else name
    code = textwrap.fill(code, 110, initial_indent="   ", subsequent_indent="       ", break_on_hyphens=False)
    return f".. code-block:: python\n\n{code}\n\n{sentence(inspect.getdoc(found).split(chr(10) * 2)[0])}\n"


def words_section():
    """The words of the scene language: spellings, and which numbers follow."""
    rows = []
    for word in WORDS:
        first, *others = (f"``{spelling}``" for spelling in word.spellings)
        numbers = word.numbers
        takes, bounds = (numbers.count_in_words(), numbers.range_in_words()) if numbers.count else ("", "")
        rows.append([first, ", ".join(others), takes, bounds])
    title = "Words of the scene language"
    words = table(["word", "other spellings", "takes", "range"], rows)
    named = [
        [cells[1].replace(" / ", " ").replace(" ", ", "), f"``{cells[2]}``"]
        for cells in TABLE["metals"] + TABLE["glasses"]
    ]
    materials = table(["metal or glass", "table of Mitsuba, or material of prosim_dielectric"], named)
    return f"{title}\n{'-' * len(title)}\n\n{words}\n\n{materials}\n"


def page():
    """The whole page."""
    mi.set_variant("scalar_rgb")
    parts = [HEAD]
    for folder, title in FOLDERS.items():
        parts += [f"{title}\n{'-' * len(title)}\n", *(plugin_section(*plugin) for plugin in plugins(folder))]
    for module, names in MODULES.items():
        parts.append(f"{module}\n{'-' * len(module)}\n")
        parts += [function_section(module, name) for name in names or importlib.import_module(module).__all__]
    parts.append(words_section())
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
