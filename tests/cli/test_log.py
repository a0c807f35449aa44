"""Mitsuba's log, and the progress of a command."""

import re
import subprocess
import sys
from functools import partialmethod

import mitsuba as mi
import pytest
from mitsuba_prosim.cli.log import log
from mitsuba_prosim.cli.progress import Progress
from tqdm import tqdm

#: A thread makes a scene of a dozen native plugins, each of which is logged under Mitsuba's locks. After the first the
#: main thread keeps the interpreter to itself for a second; prints how many lines were logged until its end.
HOLD_THE_INTERPRETER = """
import ctypes, os, threading
import mitsuba as mi
import mitsuba_prosim
from mitsuba_prosim.cli.log import log

mi.set_variant("llvm_ad_rgb")
names = "diffuse conductor dielectric plastic roughplastic roughconductor roughdielectric principled null".split()
shapes = "".join(f'<shape type="sphere"><bsdf type="{name}"/></shape>' for name in names)
config = mi.parser.ParserConfig(mi.variant())
state = mi.parser.parse_string(config, f'<scene version="3.0.0">{shapes}</scene>')
libc = ctypes.PyDLL(None)  # calls of it do not release the interpreter
with log(2):
    thread = threading.Thread(target=mi.parser.instantiate, args=(config, state))
    thread.start()
    while os.fstat(1).st_size == 0:
        pass
    libc.usleep(1_000_000)
    size = libc.lseek(1, 0, os.SEEK_END)
    lines = os.pread(1, size, 0).count(b"\\n")
    thread.join()
print(lines)
"""


def test_logging_needs_no_interpreter():
    """Else a thread that logs and one that makes a plugin in Python can wait for each other for ever."""
    code = [sys.executable, "-c", HOLD_THE_INTERPRETER]
    done = subprocess.run(code, check=True, capture_output=True, text=True, timeout=60)
    assert int(done.stdout) >= 9
    assert 'Loading plugin "plugins/principled' in done.stderr


@pytest.mark.parametrize("verbose, expected", [(0, ["warning", "lines"]), (1, ["information", "warning", "lines"])])
def test_log_goes_to_standard_error(variant_rgb, capfd, verbose, expected):
    with log(verbose):
        mi.Log(mi.LogLevel.Debug, "debugging")
        mi.Log(mi.LogLevel.Info, "information")
        for _ in range(2):
            mi.Log(mi.LogLevel.Warn, "warning\nof two lines")
    print("afterwards")
    printed = capfd.readouterr()
    assert [line.split()[-1] for line in printed.err.splitlines()] == expected
    assert printed.out == "afterwards\n" and "\x1b" not in printed.err


@pytest.fixture
def clock(monkeypatch):
    """Sets the time of progress bars, in seconds."""
    now = [1000.0]
    monkeypatch.setattr("tqdm.std.time", lambda: now[0])

    def set_clock(second):
        now[0] = 1000.0 + second

    return set_clock


def test_a_log_has_few_lines(capsys, clock):
    """An hour is some forty lines; the part that is done never becomes less."""
    with Progress("comparing") as steps:
        for second in range(3601):
            clock(second)
            steps.show(second % 1800 / 1800, "reference" if second < 1800 else "rounds")
        said = capsys.readouterr().err.splitlines()
        assert said[:2] == ["reference: 1 %, 00:10 passed, 29:50 left", "reference: 1 %, 00:20 passed, 29:40 left"]
        assert 30 < len(said) < 45 and re.fullmatch(r"rounds: \d\d %, 2\d:\d\d passed, 0\d:\d\d left", said[-1])
        tqdm.write("warning: between", file=sys.stderr)
        assert capsys.readouterr().err == "warning: between\n"
    assert capsys.readouterr().err == ""


def test_the_bar_of_a_continued_step(monkeypatch, clock):
    """A reference, half of which was stored: the time left is by its new part, and the bar never goes back."""
    monkeypatch.setattr(tqdm, "__init__", partialmethod(tqdm.__init__, ncols=80))
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with Progress("comparing") as steps:

        def shown(second, doing, done):
            clock(second)
            steps.show(done, doing)
            return str(steps)

        assert "reference:  50%" in shown(0, "reference", 0.5) and "? left" in str(steps)
        assert "reference:  62%" in shown(10, "reference", 0.625) and "| 00:10, 00:30 left" in str(steps)
        assert "reference:  62%" in shown(20, "reference", 0.5625) and "| 00:20, 01:00 left" in str(steps)
        assert "turns:   0%" in shown(20, "turns", 0.0) and "| 00:00" in str(steps)
        assert "turns:  25%" in shown(50, "turns", 0.25) and "| 00:30, 01:30 left" in str(steps)
