"""What is built holds all that is needed and nothing of this machine, and works with other versions of packages."""

import os
import re
import runpy
import subprocess
import sys
import zipfile
from pathlib import Path

import mitsuba_prosim
import pytest
from mitsuba_prosim import llvm

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text("utf-8")
STARTUP = ROOT / "plugins" / "mitsuba_prosim_llvm.pth"

index_readme = runpy.run_path(str(ROOT / "hatch_build.py"))["absolute"]


@pytest.mark.slow
def test_wheel(tmp_path):
    """It is the same for every machine: pip may keep it, and install it elsewhere."""
    subprocess.run([sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", tmp_path], check=True, cwd=ROOT)
    (path,) = tmp_path.iterdir()
    assert path.name == f"mitsuba_prosim-{mitsuba_prosim.__version__}-py3-none-any.whl"
    with zipfile.ZipFile(path) as built:
        names = set(built.namelist())
        assert built.read("mitsuba_prosim_llvm.pth") == STARTUP.read_bytes()
        (metadata,) = (name for name in names if name.endswith(".dist-info/METADATA"))
        assert index_readme(README, None) in built.read(metadata).decode()
    assert {"mitsuba_prosim/py.typed", "prosim_scene/py.typed"} <= names
    folders = {name.split("/")[0] for name in names if ".dist-info" not in name}
    assert folders == {"mitsuba_prosim", "prosim_start", "prosim_scene", "mitsuba_prosim_llvm.pth"}
    sources = {
        path.relative_to(folder).as_posix()
        for folder in (ROOT / "plugins", ROOT / "scene_translator")
        for path in folder.rglob("*.*")
        if path.suffix in (".py", ".c", ".html", ".css", ".js", ".lark", ".txt")
    }
    assert sources <= names


@pytest.mark.parametrize("source", [None, "https://example.org/prosim"])
def test_readme_of_a_package_index_has_no_relative_links(source):
    text = index_readme(README, source)
    links = re.findall(r"(!?)\[[^]]*\]\(([^)]+)\)", text)
    assert links and all(link.startswith("https://") for _, link in links) and "<img" not in text
    assert {"!" for picture, _ in links if picture} == ({"!"} if source else set())


def test_the_start_up_file_names_the_llvm_that_is_required(tmp_path, monkeypatch):
    """Where that is there, and DRJIT_LIBLLVM_PATH is unset; Python runs each of its lines alone."""
    (line,) = STARTUP.read_text(encoding="utf-8").splitlines()
    assert f'"{llvm.REQUIREMENT}; ' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    library = tmp_path / "lib" / f"libLLVM-{llvm.REQUIREMENT.partition('==')[2].partition('.')[0]}.so"
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr("site.getuserbase", lambda: str(tmp_path / "nowhere"))
    monkeypatch.setattr(os, "environ", {})
    exec(line, {})
    assert "DRJIT_LIBLLVM_PATH" not in os.environ
    library.parent.mkdir()
    library.touch()
    for chosen in str(library), "another":
        exec(line, {})
        assert os.environ.setdefault("DRJIT_LIBLLVM_PATH", "none") == chosen
        os.environ["DRJIT_LIBLLVM_PATH"] = "another"


OLDEST = ("mitsuba==3.9.0", 'numpy==1.26.*; python_version < "3.13"', "lark==1.2.*")
#: What the tests import, without mitsuba-oidn, which is built for the Dr.Jit of Mitsuba 3.9.1.
WITHOUT_DENOISING = (
    f"{ROOT}[cluster,compare,editors,figures,watch]",
    *("hatchling", "ipykernel", "nbclient", "playwright", "sphinx"),
    *("pytest", "pytest-lsp", "pytest-xdist", "scipy"),
)


@pytest.mark.versions
@pytest.mark.parametrize("version", ["3.10", "3.13"])
@pytest.mark.parametrize(
    "packages", [(*WITHOUT_DENOISING, *OLDEST), (f"{ROOT}[test]", "mitsuba==3.9.1")], ids=["3.9.0", "3.9.1"]
)
def test_quick_tests_pass(tmp_path, packages, version):
    """With the oldest packages and the oldest and newest Python that pyproject.toml admits, and with each Mitsuba.

    Most of the minutes install the packages.
    """
    if subprocess.run(["env", f"python{version}", "-m", "venv", tmp_path], check=False).returncode:
        pytest.skip(f"this machine has no Python {version}")
    python = tmp_path / "bin" / "python"
    subprocess.run([python, "-m", "pip", "install", "-q", *packages], check=True)
    alone = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "DRJIT_LIBLLVM_PATH")}
    command = [python, "-m", "pytest", "-p", "no:cacheprovider"]
    done = subprocess.run(command, check=False, cwd=ROOT, env=alone, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-10000:]
