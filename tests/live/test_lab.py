"""``mitsuba_prosim.show`` in JupyterLab, driven in a browser."""

import importlib.util
import json
import os
import socket
import subprocess
import sys

import nbformat
import pytest
from little import BROWSER, LITTLE, until

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(BROWSER is None, reason="no Chromium or Chrome on this machine"),
    pytest.mark.skipif(
        importlib.util.find_spec("jupyterlab") is None, reason="JupyterLab is not installed: pip install '.[notebooks]'"
    ),
]

CELLS = [
    "import mitsuba as mi, mitsuba_prosim; mi.set_variant('llvm_ad_rgb')",
    "view = mitsuba_prosim.show('little.scn', spp=2**16)",
]

LIVE, STILL = ".jp-OutputArea-output .widget-image", ".jp-RenderedImage img"


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "notebooks"
    folder.mkdir()
    (folder / "little.scn").write_text(LITTLE)
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    cells = [nbformat.v4.new_code_cell(cell) for cell in CELLS]
    nbformat.write(nbformat.v4.new_notebook(cells=cells, metadata={"kernelspec": kernel}), folder / "little.ipynb")
    return folder


def listens(port):
    with socket.socket() as sock:
        return sock.connect_ex(("127.0.0.1", port)) == 0


@pytest.fixture
def lab(folder):
    """The address of a JupyterLab that knows no settings."""
    home = folder.with_name("home")
    home.mkdir()
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "jupyterlab", "--no-browser", "--allow-root", "--expose-app-in-browser"]
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("JUPYTER", "XDG_", "IPYTHON"))}
    with subprocess.Popen(
        [*command, f"--port={port}", "--ServerApp.port_retries=0", f"--ServerApp.root_dir={folder}"],
        env=kept | {"HOME": str(home), "JUPYTER_TOKEN": "secret"},
        stdout=subprocess.DEVNULL,
        stderr=(home / "log").open("w"),
    ) as process:
        try:
            until(lambda: process.poll() is not None or listens(port))
            assert process.poll() is None, (home / "log").read_text()
            yield f"http://127.0.0.1:{port}/"
        finally:
            process.terminate()
            process.wait(20)


@pytest.fixture
def page(browser, lab):
    page = browser.new_page(viewport={"width": 1400, "height": 900})
    said, asked = [], []
    page.on("console", lambda message: said.append(message.text) if message.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    yield page
    page.close()
    assert said == []
    assert all(url.startswith((lab, "blob:", "data:")) for url in asked)


def test_an_image_that_is_stopped_stays_in_the_notebook(page, lab, folder):
    page.goto(f"{lab}lab/tree/little.ipynb?token=secret")
    page.wait_for_function(
        """() => { const kernel = window.jupyterapp?.shell.currentWidget?.sessionContext?.session?.kernel;
        return kernel?.connectionStatus === "connected" && kernel.status === "idle"; }""",
        timeout=60000,
    )

    def do(command):
        page.evaluate("name => { window.jupyterapp.commands.execute(name); }", command)

    do("notebook:run-all-cells")
    page.wait_for_function(f"document.querySelector('{LIVE}')?.naturalWidth === 64", timeout=60000)
    assert page.locator(LIVE).bounding_box()["width"] == 64  # a pixel a pixel, however wide the cell
    assert "samples a pixel" in page.inner_text(".jp-OutputArea-output")
    picture = page.get_attribute(LIVE, "src")
    page.click("button:has-text('Error')")
    page.wait_for_function(f"document.querySelector('{LIVE}').src !== '{picture}'")
    assert page.locator("progress, .progress-bar").count() == 1
    page.click("button:has-text('Stop')")
    page.wait_for_selector(STILL)
    assert page.locator(LIVE).count() == page.locator("button:has-text('Stop')").count() == 0
    do("docmanager:save")
    until(lambda: "image/png" in (folder / "little.ipynb").read_text())
    (output,) = json.loads((folder / "little.ipynb").read_text())["cells"][1]["outputs"]
    assert set(output["data"]) == {"image/png", "text/plain"} and "stopped: " in "".join(output["data"]["text/plain"])
    page.goto(f"{lab}lab/tree/little.ipynb?reset")
    page.wait_for_function(f"document.querySelector('{STILL}')?.naturalWidth === 64", timeout=60000)
