"""Mitsuba's log while a command runs."""

import re
import subprocess
import sys
from functools import partialmethod

import mitsuba as mi
import pytest
from mitsuba_prosim.cli import progress
from mitsuba_prosim.cli.log import log
from mitsuba_prosim.cli.progress import Lines
from tqdm.auto import tqdm

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
    done = subprocess.run(
        [sys.executable, "-c", HOLD_THE_INTERPRETER], check=True, capture_output=True, text=True, timeout=60
    )
    assert int(done.stdout) >= 9
    assert 'Loading plugin "plugins/principled' in done.stderr


@pytest.mark.parametrize("verbose, expected", [(0, ["warning"]), (1, ["information", "warning"])])
def test_log_goes_to_standard_error(variant_rgb, capfd, verbose, expected):
    with log(verbose):
        mi.Log(mi.LogLevel.Debug, "debugging")
        mi.Log(mi.LogLevel.Info, "information")
        for _ in range(2):
            mi.Log(mi.LogLevel.Warn, "warning")
    print("afterwards")
    printed = capfd.readouterr()
    assert [line.split()[-1] for line in printed.err.splitlines()] == expected
    assert printed.out == "afterwards\n" and "\x1b" not in printed.err


def test_a_log_says_now_and_then_how_far_it_is(capsys):
    """Seldom where it takes long: an hour is some twenty lines."""
    now = [0.0]
    lines = Lines(lambda: now[0])
    for second in range(3601):
        now[0] = float(second)
        lines("reference" if second < 1800 else "rendering by turns", second % 1800 / 1800)
    said = capsys.readouterr().err.splitlines()
    assert said[:2] == ["reference: 1 %, 00:10 passed", "reference: 1 %, 00:20 passed, 29:40 left"]
    assert 20 < len(said) < 30 and re.fullmatch(r"rendering by turns: \d\d %, 5\d:\d\d passed, 0\d:\d\d left", said[-1])


def test_what_a_log_says_is_done_is_never_less(capsys):
    """Of an estimate that has become worse the time left alone tells."""
    now = [0.0]
    lines = Lines(lambda: now[0])
    for now[0], done in [(0, 0), (20, 0.5), (40, 0.25), (60, 0.75)]:
        lines("rendering", done)
    said = [line.partition(" passed")[0] for line in capsys.readouterr().err.splitlines()]
    assert said == [f"rendering: {part} %, {time}" for part, time in [(50, "00:20"), (50, "00:40"), (75, "01:00")]]


def test_the_bar_of_a_step_that_had_begun_before(monkeypatch):
    """A reference, half of which was kept: the time left is by what is made of it now, and the bar never goes back."""
    now = 1000.0
    monkeypatch.setattr("tqdm.std.time", lambda: now)
    monkeypatch.setattr(tqdm, "__init__", partialmethod(tqdm.__init__, ncols=80))
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with progress.Progress("comparing", clock=lambda: now) as steps:

        def told(second, doing, done):
            nonlocal now
            now = 1000.0 + second
            steps.show(done, doing)
            return str(steps.bar)

        assert "reference:  50%" in told(0, "reference", 0.5) and "left" not in str(steps.bar)
        assert "reference:  62%" in told(10, "reference", 0.625) and "| 00:10, 00:30 left" in str(steps.bar)
        assert "reference:  62%" in told(20, "reference", 0.5625) and "| 00:20, 02:20 left" in str(steps.bar)
        assert "turns:   0%" in told(20, "turns", 0.0) and "| 00:00" in str(steps.bar)
        assert "turns:  25%" in told(50, "turns", 0.25) and "| 00:30, 01:30 left" in str(steps.bar)
