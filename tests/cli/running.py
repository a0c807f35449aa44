"""Scenes for the ``prosim`` command, running it within the test, and looking at what it wrote."""

import os
import subprocess
from pathlib import Path

import mitsuba as mi
import numpy as np
import OpenEXR
from click.testing import CliRunner
from mitsuba_prosim.cli.terminal import Progress
from prosim_start import group

PALITO = Path(__file__).parents[2] / "examples" / "palito.scn"

CONSTANT = '<emitter type="constant"><rgb name="radiance" value="$radiance"/></emitter>'
LIT_FLOOR = """<shape type="rectangle"><transform name="to_world">
        <rotate y="1" angle="180"/><scale value="9"/><translate z="4"/></transform></shape>
    <shape type="sphere"><point name="center" x="1.5" y="1" z="2"/><float name="radius" value="0.3"/>
        <emitter type="area"><rgb name="radiance" value="9"/></emitter></shape>"""
PATH = '<integrator type="path"/>'
AOV = '<integrator type="aov"><string name="aovs" value="d:depth"/>{}</integrator>'
ADAPTIVE_PATH = f'<integrator type="prosim_adaptive">{PATH}<integer name="band" value="100"/></integrator>'


def scene_text(integrator=PATH, content=CONSTANT, width=12, height=8, sampler="nrook", spp=4):
    """The XML of a scene."""
    return f"""<scene version="3.0.0">
    <default name="radiance" value="0.5"/>
    {integrator}
    <sensor type="perspective">
        <film type="hdrfilm"><integer name="width" value="{width}"/><integer name="height" value="{height}"/></film>
        <sampler type="{sampler}"><integer name="sample_count" value="{spp}"/></sampler>
    </sensor>
    {content}
</scene>
"""


PIPES = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
XML = scene_text()
LAMP = scene_text(ADAPTIVE_PATH, LIT_FLOOR, 32, 24)


def prosim(*arguments):
    return CliRunner().invoke(group.prosim, [str(a) for a in arguments])


def done(*arguments):
    """A command that has to succeed."""
    result = prosim(*arguments)
    assert result.exit_code == 0, result.output
    return result


def refused(says, *arguments, code=2, folder=None):
    """A command that has to fail with these words, and to write nothing into a folder: that of its file, the second of
    the ``arguments``.
    """
    folder = folder or arguments[1].parent
    before = names(folder)
    result = prosim(*arguments)
    assert result.exit_code == code and says in result.stderr and "Traceback" not in result.output, result.output
    assert names(folder) == before


def at_step(monkeypatch, step, number):
    """Sends the signal ``number`` to this process at that step of a render."""
    show, steps = Progress.show, []

    def shown(self, *how):
        steps.append(how)
        if len(steps) == step:
            os.kill(os.getpid(), number)
        return show(self, *how)

    monkeypatch.setattr(Progress, "show", shown)
    monkeypatch.setattr(os, "_exit", lambda _: None)
    return steps


def pixels(path):
    if path.suffix != ".exr":
        return np.array(mi.Bitmap(str(path)))
    return np.dstack([channel.pixels for channel in OpenEXR.File(str(path)).channels().values()])


def alike(*paths):
    """Whether the images of these names have the same bytes in the PNG and the same pixels in the EXR."""
    images = {(path.with_suffix(".png").read_bytes(), pixels(path.with_suffix(".exr")).tobytes()) for path in paths}
    return len(images) == 1


def metadata(path):
    """The metadata of an image of ours."""
    header = OpenEXR.File(str(path.with_suffix(".exr")), header_only=True).header()
    return {name[7:]: value for name, value in header.items() if name.startswith("prosim.")}


def names(folder):
    return sorted(path.name for path in folder.iterdir())
