"""Nothing is imported or named at import time that Windows lacks, and a scene renders without it.

A process stands for Windows that says it is on Windows, and has none of these modules, names of ``os`` and names of
``signal``. Other packages are imported before that.
"""

import subprocess
import sys

import pytest
from running import names, scene_text

#: What Windows lacks. (``os.set_blocking`` it has from Python 3.12 on; before, the signal module needs none there.)
MODULES = "fcntl grp posix pty pwd resource syslog termios tty"
OS = """
    O_NOFOLLOW WNOHANG chown fchmod fork getegid geteuid getgid getloadavg getpgid getuid killpg mkfifo pathconf
    posix_fallocate posix_spawn pread pwrite sched_getaffinity setsid sysconf uname
    """
SIGNALS = """
    SIGALRM SIGCHLD SIGCONT SIGHUP SIGKILL SIGPIPE SIGQUIT SIGSTOP SIGTSTP SIGUSR1 SIGUSR2 SIGWINCH alarm pause
    pthread_sigmask setitimer siginterrupt sigwait
    """

WINDOWS = f"""if True:
    import builtins, contextlib, importlib, os, pkgutil, signal, sys
    import click, drjit, manifold3d, mitsuba, numpy, OpenEXR, tqdm.auto
    for name in (
        "ctypes.util distributed flip_evaluator ipywidgets jinja2 matplotlib mitsuba_oidn pygls.lsp.server "
        "skimage starlette.applications tevclient uvicorn.main"
    ).split():
        with contextlib.suppress(ImportError):
            importlib.import_module(name)

    OURS = ("mitsuba_prosim", "prosim_scene", "prosim_start")
    for module, names in ((os, {OS.split()}), (signal, {SIGNALS.split()})):
        for name in names:
            if hasattr(module, name):
                delattr(module, name)
    sys.platform = "win32"
    original = builtins.__import__

    def importing(name, globals=None, *rest):
        if name.partition(".")[0] in {MODULES.split()} and (globals or {{}}).get("__name__", "").startswith(OURS):
            raise ModuleNotFoundError(f"Windows has no {{name}}", name=name)
        return original(name, globals, *rest)

    builtins.__import__ = importing
    """

IMPORT_ALL = """
    mitsuba.set_variant("scalar_rgb")
    missing = set()
    for package in map(importlib.import_module, OURS):
        for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            try:
                if not module.name.endswith("__main__"):
                    importlib.import_module(module.name)
            except ModuleNotFoundError as error:  # an extra that is not installed
                if error.msg.startswith("Windows"):
                    raise
                missing.add(error.name)
    assert "mitsuba_prosim.parallel.cluster" in sys.modules or missing, "nothing was imported"
    """

RENDER = """
    from prosim_start import main
    from prosim_start.group import prosim
    prosim([*sys.argv[1:], "-m", "scalar_rgb"], standalone_mode=False)
    main()
    """


@pytest.mark.slow
def test_every_module_is_imported_and_a_scene_is_rendered(tmp_path):
    """With a log, in a scalar variant and in the usual one."""
    (tmp_path / "scene.xml").write_text(scene_text('<integrator type="prosim"/>'))
    command = [sys.executable, "-c", WINDOWS + IMPORT_ALL + RENDER, "render", tmp_path / "scene.xml", "-v"]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert names(tmp_path) == ["scene.exr", "scene.png", "scene.xml"] and "INFO" in done.stderr
