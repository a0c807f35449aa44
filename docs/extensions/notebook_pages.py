"""The notebooks of ``examples`` as pages.

``-D notebooks=run`` runs each from its first cell to its last and keeps the outputs in ``docs/notebooks`` until the
notebook changes. By default none is run, and pages that have no outputs yet are shown without them.
"""

import hashlib
import os
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from sphinx import addnodes
from sphinx.util import logging

EXAMPLES = Path(__file__).parents[2] / "examples"
WIDGET = "application/vnd.jupyter.widget-view+json"

#: How a page was made, from worst to best; small is what the tests run.
UNRUN, SMALL, FULL = range(3)


def run(notebook):
    """Runs the notebook and keeps its outputs, except widgets, which need scripts."""
    NotebookClient(notebook, timeout=1800, resources={"metadata": {"path": str(EXAMPLES)}}).execute()
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if WIDGET not in output.get("data", {})]
    notebook.metadata.pop("widgets", None)


def write_pages(app):
    """Writes the pages of ``docs/notebooks`` that have changed."""
    folder = Path(app.srcdir, "notebooks")
    folder.mkdir(exist_ok=True)
    wanted = UNRUN if app.config.notebooks == "unrun" else SMALL if "PROSIM_SMALL" in os.environ else FULL
    for path in sorted(EXAMPLES.glob("*.ipynb")):
        page, source = folder / path.name, hashlib.sha256(path.read_bytes()).hexdigest()
        if page.exists():
            made = nbformat.read(page, as_version=4).metadata.get("made", {})
            if made.get("of") == source and made.get("how", UNRUN) >= wanted:
                continue
        notebook = nbformat.read(path, as_version=4)
        if wanted > UNRUN:
            logging.getLogger(__name__).info("running %s", path.name)
            run(notebook)
        notebook.metadata["made"] = {"of": source, "how": wanted}
        notebook.cells[0].source += f"\n\n{{download}}`This notebook <../../examples/{path.name}>`"
        nbformat.write(notebook, page)


def link_pages(app, doctree):
    """Changes links to notebooks in ``examples`` to links to their pages."""
    for node in doctree.findall(addnodes.pending_xref):
        path = Path(node["reftarget"])
        if path.parent == EXAMPLES and (EXAMPLES / f"{path.name}.ipynb").exists():
            node["reftarget"] = f"notebooks/{path.name}"


def setup(app):
    app.add_config_value("notebooks", "unrun", "env", str)
    app.connect("builder-inited", write_pages)
    app.connect("doctree-read", link_pages)
    return {"parallel_read_safe": True}
