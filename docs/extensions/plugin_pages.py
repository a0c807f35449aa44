"""Pages made of the plugins' docstrings, in the form of Mitsuba's.

``.. plugins:: FOLDER`` shows every plugin in ``plugins/mitsuba_prosim/FOLDER``, each with its picture from
``docs/pictures``; ``.. pluginparameters::`` is the table of parameters; references to Mitsuba's plugins lead to
Mitsuba's site. The sources are read, not run.
"""

import ast
import inspect
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst.directives.tables import ListTable
from sphinx.util.docutils import SphinxDirective

SOURCES = Path(__file__).parents[2] / "plugins" / "mitsuba_prosim"

#: Where a reference such as ``bsdf-conductor`` is found on Mitsuba's site, by what stands before the hyphen.
MITSUBA = "https://mitsuba.readthedocs.io/en/stable/src/generated/plugins_{}.html#{}"
MITSUBA_PAGES = {
    "bsdf": "bsdfs",
    "emitter": "emitters",
    "texture": "textures",
    "sensor": "sensors",
    "sampler": "samplers",
    "integrator": "integrators",
    "shape": "shapes",
    "film": "films",
}


def plugins(folder):
    """Yields ``(name, docstring)`` of each plugin in the folder."""
    for path in sorted((SOURCES / folder).glob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef):
                for decorator in node.decorator_list:
                    if isinstance(decorator, ast.Call) and getattr(decorator.func, "id", "") == "plugin":
                        yield decorator.args[1].value, inspect.cleandoc(ast.get_docstring(node, clean=False))


def example(docstring):
    """Returns the example in a plugin's docstring as a dictionary for ``mi.load_dict``."""
    return ast.literal_eval("{" + docstring.partition(".. code-tab:: python")[2] + "}")


class Plugins(SphinxDirective):
    """All plugins of one folder."""

    required_arguments = 1

    def run(self):
        (folder,) = self.arguments
        self.env.note_dependency(str(SOURCES / folder))
        text = "\n\n".join(self.with_picture(name, docstring) for name, docstring in plugins(folder))
        return self.parse_text_to_nodes(text, allow_section_headings=True)

    def with_picture(self, name, docstring):
        """Returns the docstring, with the plugin's picture under the title if it exists."""
        if not (Path(self.env.srcdir) / "pictures" / f"{name}.jpg").exists():
            return docstring
        head, mark, rest = docstring.partition(".. pluginparameters::")
        return f"{head}.. image:: /pictures/{name}.jpg\n   :alt: {name}\n   :class: plugin-picture\n\n{mark}{rest}"


class PluginParameters(ListTable):
    """A table of name, type, meaning and, optionally, flags."""

    required_arguments = optional_arguments = 0

    def run(self):
        content = nodes.Element()
        self.state.nested_parse(self.content, self.content_offset, content)
        rows = [[cell.children for cell in row[0]] for row in content[0]]
        rows = [row + [[]] * (4 - len(row)) for row in rows]
        head = [[nodes.paragraph("", word)] for word in ("Parameter", "Type", "Meaning", "")]
        table = self.build_table_from_list([head, *rows], [18, 14, 60, 8], header_rows=1, stub_columns=0)
        table["classes"] += ["plugin-parameters"]
        for cell in (row[0] for row in table[0][-1]):
            for paragraph in cell:
                paragraph["classes"] += ["monosp"]
        return [table]


def mitsuba_reference(app, env, node, content):
    """Returns a link to Mitsuba's site for the label of one of its plugins."""
    kind, _, name = node["reftarget"].partition("-")
    if node["reftype"] != "ref" or kind not in MITSUBA_PAGES or not name:
        return None
    uri = MITSUBA.format(MITSUBA_PAGES[kind], nodes.make_id(node["reftarget"]))
    return nodes.reference("", content.astext(), refuri=uri, internal=False)


def setup(app):
    app.add_directive("plugins", Plugins)
    app.add_directive("pluginparameters", PluginParameters)
    app.connect("missing-reference", mitsuba_reference)
    return {"parallel_read_safe": True}
