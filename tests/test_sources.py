"""What the sources import and name, found by reading them."""

import ast
import functools
import re
from graphlib import TopologicalSorter
from pathlib import Path

import prosim_scene
import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "plugins" / "mitsuba_prosim"
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text("utf-8")


@functools.cache
def nodes(path):
    """The nodes of a module's syntax tree."""
    return list(ast.walk(ast.parse(path.read_text("utf-8"))))


def modules():
    """Path -> nodes, of all modules of the plugins."""
    return {path: nodes(path) for path in PACKAGE.rglob("*.py")}


def test_packages_import_only_packages_of_lower_lines():
    """All packages are in the list of CONTRIBUTING.md, and imports point downwards there, or to the right."""
    (said,) = re.findall(r"^```\n(prosim_start .*?)^```$", CONTRIBUTING, re.MULTILINE | re.DOTALL)
    listed = [name for line in said.splitlines() for name in line.split("   ")[0].split()]
    parts = {path.relative_to(PACKAGE).with_suffix("").parts: found for path, found in modules().items()}
    packages = {first for first, *_ in parts} - {"__init__"}
    assert packages == set(listed[1:])
    upwards = []
    for here, found in parts.items():
        for node in found:
            if here != ("__init__",) and isinstance(node, ast.ImportFrom) and node.level == len(here):
                names = [node.module] if node.module else [alias.name for alias in node.names]
                others = {name.partition(".")[0] for name in names} & packages - {here[0]}
                upwards += [(here, name) for name in others if listed.index(name) < listed.index(here[0])]
    assert not upwards


def imported(path):
    """The modules of its package that the module at ``path`` imports, also for types only."""
    for node in nodes(path):
        if isinstance(node, ast.ImportFrom) and node.level:
            module = path.parents[node.level - 1].joinpath(*(node.module or "").split("."))
            names = [module, *(module / alias.name for alias in node.names)]
            yield from (name.with_suffix(".py") for name in names if name.with_suffix(".py").exists())


@pytest.mark.parametrize("base", [PACKAGE, Path(prosim_scene.__file__).parent], ids=lambda base: base.name)
def test_imports_of_modules_go_in_no_circles(base):
    """Also within a package, and where only types are imported."""
    graph = {path: set(imported(path)) - {path} for path in base.rglob("*.py") if path.stem != "__init__"}
    TopologicalSorter(graph).prepare()


def test_no_two_modules_on_the_path_share_a_name():
    """Among what tests, benchmarks and the documentation import from their folders."""
    folders = {path.parent for name in ("tests", "benchmarks", "docs") for path in (ROOT / name).rglob("*.py")}
    names = [path.stem for folder in {*folders, ROOT / "examples"} for path in folder.glob("*.py")]
    assert {name for name in names if names.count(name) > 1} <= {"conftest"}


def test_plugins_import_only_public_names_of_the_translator():
    others, public = [], {*prosim_scene.__all__, "extras"}
    for path, found in modules().items():
        for node in found:
            if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "prosim_scene":
                names = {alias.name for alias in node.names} - public
                others += [(path.name, node.module, names)] if names or node.module != "prosim_scene" else []
    assert not others


def test_functions_do_not_change_their_arguments():
    """``a &= b`` changes an array of Dr.Jit in place, the caller's as well where ``a`` is an argument as it came."""
    changed = []
    for path, found in modules().items():
        for function in (node for node in found if isinstance(node, ast.FunctionDef)):
            given = {a.arg: ast.unparse(a.annotation or a) for a in (*function.args.args, *function.args.kwonlyargs)}
            given = {name for name, annotation in given.items() if annotation not in ("int", "float")}
            for node in function.body:  # an argument that is assigned anew is the function's own from then on
                if isinstance(node, ast.Assign):
                    given -= {target.id for target in node.targets if isinstance(target, ast.Name)}
                augmented = [one for one in ast.walk(node) if isinstance(one, ast.AugAssign)]
                changed += [(path.name, ast.unparse(one)) for one in augmented if getattr(one.target, "id", 0) in given]
    assert not changed


def test_class_variables_have_types():
    """Python 3.10 evaluates no bare ``ClassVar``, so Dr.Jit cannot walk through its class there."""
    annotated = [(path.name, n) for path, found in modules().items() for n in found if isinstance(n, ast.AnnAssign)]
    assert not [(name, n.lineno) for name, n in annotated if ast.unparse(n.annotation) == "ClassVar"]
