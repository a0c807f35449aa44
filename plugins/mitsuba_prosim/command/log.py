"""Mitsuba's log while a command runs."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

import mitsuba as mi
from tqdm.auto import tqdm


class Log(mi.Appender):
    """Mitsuba's log on standard error, out of the progress bar's way."""

    def append(self, level, text):
        tqdm.write(text, file=sys.stderr)

    def log_progress(self, *args):
        """The bar shows it."""


@contextmanager
def log(verbose: int) -> Iterator[None]:
    """Sends Mitsuba's log to standard error: warnings, or more if ``verbose``."""
    logger, level = mi.logger(), mi.log_level()
    before = [logger.appender(i) for i in range(logger.appender_count())]
    logger.clear_appenders()
    logger.add_appender(Log())
    mi.set_log_level([mi.LogLevel.Warn, mi.LogLevel.Info, mi.LogLevel.Debug, mi.LogLevel.Trace][min(verbose, 3)])
    try:
        yield
    finally:
        logger.clear_appenders()
        for appender in before:
            logger.add_appender(appender)
        mi.set_log_level(level)
