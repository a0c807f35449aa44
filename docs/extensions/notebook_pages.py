"""The notebooks of ``examples``, which are stored with their outputs, as pages.

``python docs/extensions/notebook_pages.py [NAME...]`` runs the notebooks whose code has changed since their outputs
were made, and stores them with their new outputs.
"""

import base64
import hashlib
import io
import sys
from pathlib import Path

import nbformat
from PIL import Image
from sphinx import addnodes

EXAMPLES = Path(__file__).parents[2] / "examples"
WIDGET = "application/vnd.jupyter.widget-view+json"


def code_hash(notebook):
    """The hash of the code of all cells, which the metadata of the notebook has beside the outputs of this code."""
    code = "\0".join(cell.source for cell in notebook.cells if cell.cell_type == "code")
    return hashlib.sha256(code.encode()).hexdigest()


def smaller(output):
    """The output with its image as JPEG, if this is smaller than PNG."""
    data = output.get("data", {})
    if png := data.get("image/png"):
        jpeg = io.BytesIO()
        Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB").save(jpeg, "JPEG", quality=88)
        encoded = base64.b64encode(jpeg.getvalue()).decode()
        if len(encoded) < len(png):
            del data["image/png"]
            data["image/jpeg"] = encoded
    return output


def store_outputs(only):
    """Runs the notebooks whose code has changed; keeps their outputs, except widgets, which need scripts."""
    from nbclient import NotebookClient

    for path in sorted(EXAMPLES.glob("*.ipynb")):
        notebook = nbformat.read(path, as_version=4)
        if (only and path.stem not in only) or notebook.metadata.get("outputs_of") == code_hash(notebook):
            continue
        NotebookClient(notebook, timeout=1800, resources={"metadata": {"path": str(EXAMPLES)}}).execute()
        for cell in notebook.cells:
            cell.metadata.pop("execution", None)  # the times
            if cell.cell_type == "code":
                shown = [output for output in cell.outputs if WIDGET not in output.get("data", {})]
                cell.outputs = [smaller(output) for output in shown if output.get("name") != "stderr"]
        notebook.metadata = {
            "kernelspec": notebook.metadata["kernelspec"],
            "language_info": {"name": "python"},
            "outputs_of": code_hash(notebook),
        }
        nbformat.write(notebook, path)
        print(path)


def write_pages(app):
    """Writes the pages of ``docs/notebooks`` that have changed."""
    folder = Path(app.srcdir, "notebooks")
    folder.mkdir(exist_ok=True)
    for path in sorted(EXAMPLES.glob("*.ipynb")):
        page, notebook = folder / path.name, nbformat.read(path, as_version=4)
        notebook.cells[0].source += f"\n\n{{download}}`This notebook <../../examples/{path.name}>`"
        text = nbformat.writes(notebook)
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")


def link_pages(app, doctree):
    """Changes links to notebooks in ``examples`` to links to their pages."""
    for node in doctree.findall(addnodes.pending_xref):
        path = Path(node["reftarget"])
        if path.parent == EXAMPLES and (EXAMPLES / f"{path.name}.ipynb").exists():
            node["reftarget"] = f"notebooks/{path.name}"


def setup(app):
    app.connect("builder-inited", write_pages)
    app.connect("doctree-read", link_pages)
    return {"parallel_read_safe": True}


if __name__ == "__main__":
    store_outputs(sys.argv[1:])
