"""What an editor is told of a metal, before the tables that Mitsuba ships."""

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from prosim_scene.descriptions import FIRST, JOINED, MEASURED, SECOND, UNNAMED

TABLES = Path(mi.__file__).parent / "data" / "ior"


def source(table):
    """Where the remarks of a table say that it is from."""
    remarks = "".join(line for line in table.read_text().splitlines() if line.startswith("#"))
    if "Concatenation" in remarks:
        return JOINED
    return SECOND if "Solids II" in remarks else FIRST if "Palik" in remarks else UNNAMED


@pytest.mark.parametrize("name", MEASURED)
def test_what_is_told_of_a_metal_is_what_is_measured(variant_rgb, name):
    told, files = MEASURED[name], [TABLES / f"{name}.{part}.spd" for part in ("eta", "k")]
    assert source(files[0]) == told.source
    tables = [np.loadtxt(file).T for file in files]
    assert [round(tables[0][0][i]) for i in (0, -1)] == [told.begins, told.ends]
    assert [float(f"{np.interp(589.3, *table):.3g}") for table in tables] == [told.n, told.k]
    visible = np.arange(360, 831)
    n, k = (np.interp(visible, *table) for table in tables)
    reflected = ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2)
    white = np.array(mi.cie1931_xyz(mi.Float(visible))) * np.array(mi.cie_d65(mi.Float(visible)))
    xyz = (white * reflected).sum(axis=1) / white[1].sum()
    rgb = np.array(mi.xyz_to_srgb(mi.Color3f([float(value) for value in xyz]))).ravel()
    assert np.allclose(rgb, told.rgb, atol=0.006)
