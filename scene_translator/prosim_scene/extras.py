"""The optional dependencies (extras) of this project, and the message about a missing extra."""

from importlib.util import find_spec

#: Extra -> the modules that it needs.
EXTRAS = {
    "cluster": ["distributed", "cryptography"],
    "compare": ["flip_evaluator", "jinja2"],
    "denoise": ["mitsuba_oidn"],
    "editors": ["pygls"],
    "notebooks": ["IPython"],
    "watch": ["starlette", "uvicorn"],
}


def missing(extra: str) -> list[str]:
    """Lists the modules that the extra ``extra`` needs and that are not installed."""
    return [module for module in EXTRAS[extra] if find_spec(module) is None]


def needs(feature: str, extra: str) -> str:
    """Returns the message that ``feature`` needs an extra, with the missing modules and how to install it."""
    # If all modules of the extra are installed, the import of one of them has failed.
    modules = ", ".join(missing(extra)) or "a module that can be imported"
    return f"{feature} needs {modules}; to get it: pip install 'mitsuba-prosim[{extra}]', in a clone '.[{extra}]'"
