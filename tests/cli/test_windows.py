"""Nothing is imported or named at import time that Windows lacks, and a scene renders without it.

A process stands for Windows that says it is on Windows, and has none of these modules, names of ``os`` and names of
``signal``. Other packages are imported before that.
"""

import subprocess
import sys

import pytest
from running import names, scene_text

MODULES = "fcntl grp posix pty pwd resource syslog termios tty"
OS = "O_NOFOLLOW WNOHANG chown fork getpgid getuid killpg mkfifo posix_fallocate pread sched_getaffinity uname"
SIGNALS = "SIGALRM SIGCHLD SIGCONT SIGHUP SIGKILL SIGPIPE SIGQUIT SIGTSTP SIGUSR1 SIGWINCH pthread_sigmask setitimer"

WINDOWS = f"""if True:
    import builtins, contextlib, importlib, os, pkgutil, signal, sys
    import click, drjit, manifold3d, mitsuba, numpy, OpenEXR, tqdm.auto
    others = "ctypes.util distributed flip_evaluator jinja2 matplotlib mitsuba_oidn pygls.lsp.server"
    for name in [*others.split(), "starlette.applications", "uvicorn.main", "ipywidgets"]:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    for module, lacks in ((os, "{OS}"), (signal, "{SIGNALS}")):
        for name in lacks.split():
            delattr(module, name) if hasattr(module, name) else None
    sys.platform, original = "win32", builtins.__import__
    ours = ("mitsuba_prosim", "prosim_scene", "prosim_start")

    def importing(name, globals=None, *rest):
        if name.partition(".")[0] in {MODULES.split()} and (globals or {{}}).get("__name__", "").startswith(ours):
            raise ModuleNotFoundError(f"Windows has no {{name}}", name=name)
        return original(name, globals, *rest)

    builtins.__import__ = importing
    mitsuba.set_variant("scalar_rgb")
    for package in map(importlib.import_module, ours):
        for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            if not module.name.endswith("__main__"):
                importlib.import_module(module.name)
    from prosim_start import main
    from prosim_start.group import prosim
    prosim([*sys.argv[1:], "-m", "scalar_rgb"], standalone_mode=False)
    main()
    """


@pytest.mark.slow
def test_every_module_is_imported_and_a_scene_is_rendered(tmp_path):
    """With a log, in a scalar variant and in the usual one."""
    (tmp_path / "scene.xml").write_text(scene_text('<integrator type="prosim"/>'))
    command = [sys.executable, "-c", WINDOWS, "render", tmp_path / "scene.xml", "-v"]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert names(tmp_path) == ["scene.exr", "scene.png", "scene.xml"] and "INFO" in done.stderr
