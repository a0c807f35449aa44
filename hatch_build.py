"""Adds to the wheel what finds a good LLVM, and the stand-ins by which Mitsuba's own command finds our plugins."""

import importlib.util
import os
import re
import site
import sys
import sysconfig
import tempfile
from pathlib import Path

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

#: Python runs this line when it starts: it names to Dr.Jit the LLVM that this package installs, where that is there.
STARTUP = (
    "import os, sys, site; "
    '[os.environ.setdefault("DRJIT_LIBLLVM_PATH", p) for p in (d + "/lib/libLLVM-{}.so" for d in '
    '(sys.prefix, sys.prefix + "/local", site.getuserbase())) if os.path.exists(p)]\n'
)


class BuildHook(BuildHookInterface):
    """The start-up file always; the stand-ins on Linux, where there is a C compiler."""

    def initialize(self, version, build_data):
        self.built = tempfile.TemporaryDirectory()
        files = build_data["force_include"]
        files[self.startup_file()] = "mitsuba_prosim_llvm.pth"
        try:
            stand_ins = self.stand_ins()
        except RuntimeError as problem:
            self.app.display_warning(
                f"Built without stand-ins for the mitsuba command: {problem}. "
                "After installing, prosim doctor tells how to get them; prosim render needs none."
            )
        else:
            files |= {path: f"mitsuba/plugins/{Path(path).name}" for path in stand_ins}
            build_data["pure_python"] = False
            build_data["tag"] = "py3-none-" + sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["force_include_editable"] = dict(files)

    def finalize(self, version, build_data, artifact_path):
        self.built.cleanup()

    def startup_file(self):
        """Path of the start-up file, written for the LLVM that pyproject.toml requires."""
        requirement = next(d for d in self.metadata.core.dependencies if d.startswith("karellen-llvm-core"))
        path = Path(self.built.name, "startup.pth")
        path.write_text(STARTUP.format(re.search(r"==(\d+)", requirement)[1]), encoding="utf-8")
        return str(path)

    def stand_ins(self):
        """Paths of the stand-ins, one for each plugin; raises RuntimeError where there can be none, with the reason."""
        if sys.platform != "linux":
            raise RuntimeError("they exist for Linux only")
        if elsewhere := mitsuba_elsewhere():
            raise RuntimeError(f"Mitsuba is in {elsewhere}, where this package will not be")
        package = Path(self.root, "plugins", "mitsuba_prosim")
        stand_in = load(package / "command" / "stand_in.py")
        compiled = Path(self.built.name, "stand_in.so")
        stand_in.compile_stand_in(str(compiled))
        # One file has one place in the table, so each name needs a path of its own.
        paths = [
            Path(self.built.name, f"{name}.so") for name in (*stand_in.names_in_source(package), *stand_in.BUNDLED)
        ]
        for path in paths:
            path.hardlink_to(compiled)
        return [str(path) for path in paths]


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
    own = sysconfig.get_path("purelib")
    target = own if os.access(own, os.W_OK) else site.getusersitepackages()
    folders = {own, sysconfig.get_path("platlib"), *site.getsitepackages(), site.getusersitepackages()}
    return next((f for f in folders - {target} if Path(f, "mitsuba", "__init__.py").is_file()), None)
