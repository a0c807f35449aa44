"""Running the ``prosim`` command within the test, and looking at what it wrote."""

from pathlib import Path

import mitsuba as mi
import numpy as np
from click.testing import CliRunner
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


def pixels(path):
    return np.array(mi.Bitmap(str(path)))


def names(folder):
    return sorted(path.name for path in folder.iterdir())
