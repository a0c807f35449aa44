"""What ``prosim watch`` lets a scene read."""

import mitsuba as mi
import pytest
from click.testing import CliRunner
from mitsuba_prosim.live import viewer
from mitsuba_prosim.scene.confinement import OutsideError
from prosim_start import group


@pytest.mark.parametrize("options", [[], ["--allow-outside"]])
def test_a_scene_in_xml_names_files_of_its_folder_alone(variant_rgb, tmp_path, monkeypatch, options):
    """Unless it is said that it may name others; the command's scene is opened as the page's is."""
    scene = tmp_path / "scene" / "scene.xml"
    scene.parent.mkdir()
    (tmp_path / "part.xml").write_text('<scene version="3.0.0"><sensor type="perspective"/></scene>')
    scene.write_text('<scene version="3.0.0"><include filename="../part.xml"/></scene>')
    opened = []

    monkeypatch.setattr(viewer, "Viewer", lambda path, open_scene, *_: opened.append(open_scene().scene))
    done = CliRunner().invoke(group.prosim, ["watch", str(scene), "--no-browser", "-m", mi.variant(), *options])
    if options:
        assert isinstance(opened[0], mi.Scene), done.output
    else:
        assert not opened
        assert isinstance(done.exception, OutsideError) and "--allow-outside" in str(done.exception)
