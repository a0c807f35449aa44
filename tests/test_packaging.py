"""What is built holds all that is needed, with a C compiler and without."""

import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import mitsuba_prosim
import pytest
from mitsuba_prosim import llvm

ROOT = Path(__file__).parents[1]

pytestmark = pytest.mark.slow


def wheel(folder, **env):
    """The wheel that is built with these environment variables, as a zip file, and what was said."""
    done = subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)],
        check=True,
        cwd=ROOT,
        env={**os.environ, **env},
        capture_output=True,
        text=True,
    )
    (path,) = folder.glob("*.whl")
    return zipfile.ZipFile(path), done.stdout + done.stderr


def test_wheel_without_a_compiler(tmp_path):
    built, said = wheel(tmp_path, PATH="", CC="")
    assert Path(built.filename).name == f"mitsuba_prosim-{mitsuba_prosim.__version__}-py3-none-any.whl"
    assert "no C compiler" in said and "prosim doctor" in said
    names = set(built.namelist())
    assert {"mitsuba_prosim/py.typed", "prosim_scene/py.typed", "mitsuba_prosim/command/stand_in.c"} <= names
    assert llvm.packaged() in built.read("mitsuba_prosim_llvm.pth").decode()
    assert not [name for name in names if name.endswith(".so")]
    sources = {
        path.relative_to(folder).as_posix()
        for folder in (ROOT / "plugins", ROOT / "scene_translator")
        for path in folder.rglob("*.*")
        if path.suffix in (".py", ".c", ".html", ".css", ".js", ".lark")
    }
    assert sources <= names


@pytest.mark.skipif(sys.platform != "linux" or not shutil.which("cc"), reason="needs a C compiler, and Linux")
def test_wheel_with_a_compiler(tmp_path):
    built, _ = wheel(tmp_path)
    stand_ins = {Path(name).stem for name in built.namelist() if name.startswith("mitsuba/plugins/")}
    plugins = {
        name
        for path in (ROOT / "plugins" / "mitsuba_prosim").glob("*/*.py")
        for name in re.findall(r'^@plugin\("\w+", "(\w+)"\)', path.read_text("utf-8"), re.MULTILINE)
    }
    assert plugins and plugins <= stand_ins
    assert "linux" in Path(built.filename).name
