"""Adds to the wheel the stand-ins by which Mitsuba's own command finds our plugins, where there is a C compiler."""

import importlib.util
import os
import sys
import sysconfig
import tempfile
from pathlib import Path

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class StandIns(BuildHookInterface):
    def initialize(self, version, build_data):
        files = build_data["force_include"]
        files["plugins/mitsuba_prosim_llvm.pth"] = "mitsuba_prosim_llvm.pth"
        package = Path(self.root, "plugins", "mitsuba_prosim")
        try:
            if sys.platform != "linux":
                raise RuntimeError("they exist for Linux only")
            if elsewhere := mitsuba_elsewhere():
                raise RuntimeError(f"Mitsuba is in {elsewhere}, where this package will not be")
            stand_in = load(package / "command" / "stand_in.py")
            self.built = tempfile.TemporaryDirectory()
            file = os.path.join(self.built.name, "stand_in.so")
            stand_in.compile_stand_in(file)
        except RuntimeError as problem:
            self.app.display_warning(f"Built without stand-ins for the mitsuba command: {problem}. "
                                     "After installing, prosim doctor tells how to get them; prosim render needs none.")
        else:
            # One file has one place in the table, so each name needs a path of its own.
            for name in (*stand_in.names_in_source(package), *stand_in.BUNDLED):
                os.link(file, named := os.path.join(self.built.name, f"{name}.so"))
                files[named] = f"mitsuba/plugins/{name}.so"
            build_data["pure_python"] = False
            build_data["tag"] = "py3-none-" + sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["force_include_editable"] = dict(files)


def load(path):
    """Imports one file, without its package (which needs Mitsuba)."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def mitsuba_elsewhere():
    """The folder in which Mitsuba is already, if that is not where pip will put this package; else None.

    pip installs beside this interpreter's other packages, and to the user's folder where it may not write there. Our
    files in a folder ``mitsuba`` of their own would hide Mitsuba's from its launcher.
    """
    import site
    own = sysconfig.get_path("purelib")
    target = own if os.access(own, os.W_OK) else site.getusersitepackages()
    folders = {own, sysconfig.get_path("platlib"), *site.getsitepackages(), site.getusersitepackages()}
    for folder in folders - {target}:
        if os.path.isfile(os.path.join(folder, "mitsuba", "__init__.py")):
            return folder
    return None
