"""Running the ``prosim`` command within the test, and looking at what it wrote."""

import os
from pathlib import Path

import mitsuba as mi
import numpy as np
import OpenEXR
from click.testing import CliRunner
from mitsuba_prosim.cli.progress import Progress
from prosim_start import group

PALITO = Path(__file__).parents[2] / "examples" / "palito.scn"

XML = """<scene version="3.0.0">
    <default name="radiance" value="0.5"/>
    <integrator type="path"/>
    <sensor type="perspective">
        <film type="hdrfilm"><integer name="width" value="12"/><integer name="height" value="8"/></film>
        <sampler type="nrook"><integer name="sample_count" value="4"/></sampler>
    </sensor>
    <emitter type="constant"><rgb name="radiance" value="$radiance"/></emitter>
</scene>
"""


def prosim(*arguments):
    return CliRunner().invoke(group.prosim, [str(a) for a in arguments])


def done(*arguments):
    """A command that has to succeed."""
    result = prosim(*arguments)
    assert result.exit_code == 0, result.output
    return result


def refused(says, *arguments, folder, code=2):
    """A command that has to fail with these words, and to write nothing."""
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
    return np.array(mi.Bitmap(str(path)))


def facts(path):
    """The metadata of an image of ours."""
    header = OpenEXR.File(str(path.with_suffix(".exr")), header_only=True).header()
    return {name[7:]: value for name, value in header.items() if name.startswith("prosim.")}


def names(folder):
    return sorted(path.name for path in folder.iterdir())
