"""The optional dependencies (extras) of this project, and the message about a missing extra."""

from importlib.util import find_spec

#: Extra -> the modules that it needs, each with the name of the package that contains the module.
EXTRAS = {
    "cluster": {"distributed": "distributed"},
    "compare": {
        "matplotlib": "matplotlib",
        "skimage": "scikit-image",
        "flip_evaluator": "flip-evaluator",
        "jinja2": "jinja2",
    },
    "denoise": {"mitsuba_oidn": "mitsuba-oidn"},
    "editors": {"pygls": "pygls"},
    "notebooks": {"ipywidgets": "ipywidgets"},
    "tev": {"tevclient": "tevclient"},
    "watch": {"starlette": "starlette", "uvicorn": "uvicorn"},
}


def missing(extra: str) -> list[str]:
    """Lists the packages of an extra that are not installed."""
    return [package for module, package in EXTRAS[extra].items() if find_spec(module) is None]


def needs(feature: str, extra: str) -> str:
    """Returns the message that a feature needs an extra: the missing packages, and the command that installs the
    extra.
    """
    packages = ", ".join(missing(extra)) or "a package that can be imported"
    return f"{feature} needs {packages}; to get it: pip install 'mitsuba-prosim[{extra}]'"
