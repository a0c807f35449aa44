"""What the sources import and name, found by reading them."""

import ast
import functools
import re
from graphlib import TopologicalSorter
from pathlib import Path

import prosim_scene
import pytest
from test_pages import PAGES

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "plugins" / "mitsuba_prosim"
ROOMS = "plugins", "scene_translator", "benchmarks", "docs"
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text("utf-8")


@functools.cache
def nodes(path):
    """The nodes of a module's syntax tree."""
    return list(ast.walk(ast.parse(path.read_text("utf-8"))))


def modules():
    """Path -> nodes, of all modules of the plugins."""
    return {path: nodes(path) for path in PACKAGE.rglob("*.py")}


def test_rooms():
    """All rooms are in the list, and imports point downwards there, or to the right: none go in circles."""
    (said,) = re.findall(r"^```\n(prosim_start .*?)^```$", CONTRIBUTING, re.MULTILINE | re.DOTALL)
    listed = [room for line in said.splitlines() for room in line.split("   ")[0].split()]
    parts = {path.relative_to(PACKAGE).with_suffix("").parts: found for path, found in modules().items()}
    rooms = {first for first, *_ in parts} - {"__init__"}
    assert rooms == set(listed[1:])
    upwards = []
    for here, found in parts.items():
        for node in found:
            if here != ("__init__",) and isinstance(node, ast.ImportFrom) and node.level == len(here):
                names = [node.module] if node.module else [alias.name for alias in node.names]
                others = {name.partition(".")[0] for name in names} & rooms - {here[0]}
                upwards += [(here, room) for room in others if listed.index(room) < listed.index(here[0])]
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
    """Also within a room, and where only types are imported."""
    graph = {path: set(imported(path)) - {path} for path in base.rglob("*.py") if path.stem != "__init__"}
    TopologicalSorter(graph).prepare()


def test_no_two_modules_on_the_path_share_a_name():
    """Among what tests, benchmarks and the documentation import from their folders."""
    folders = {path.parent for room in ("tests", "benchmarks", "docs") for path in (ROOT / room).rglob("*.py")}
    names = [path.stem for folder in {*folders, ROOT / "examples"} for path in folder.glob("*.py")]
    assert {name for name in names if names.count(name) > 1} <= {"conftest"}


def test_plugins_import_nothing_of_the_translator_but_what_is_public():
    others, public = [], {*prosim_scene.__all__, "extras"}
    for path, found in modules().items():
        for node in found:
            if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "prosim_scene":
                names = {alias.name for alias in node.names} - public
                others += [(path.name, node.module, names)] if names or node.module != "prosim_scene" else []
    assert not others


def test_arguments_are_left_as_they_are():
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


def names(path):
    """The names in a module: its own, and those of functions, classes, arguments, variables, attributes and imports."""
    fields = [vars(node).get(field) for node in nodes(path) for field in ("name", "arg", "id", "attr")]
    return {path.stem, *(field for field in fields if isinstance(field, str))}


def test_names_that_have_gone_do_not_come_back():
    """Those in the first column of the table of terms in CONTRIBUTING.md."""
    (table,) = re.findall(r"^\| gone \| term \|\n\|.*\n((?:\|.*\n)+)", CONTRIBUTING, re.MULTILINE)
    gone = {word for row in table.splitlines() for word in row.split("|")[1].strip().split(", ")}
    assert len(gone) > 20
    found = {name: path for room in ROOMS for path in (ROOT / room).rglob("*.py") for name in names(path)}
    back = []
    for name, path in found.items():
        parts = {part.lower() for part in re.findall("[A-Z]?[a-z]+|[A-Z]+", name)} | {name.lower()}
        back += [f"{path.relative_to(ROOT)}: {name}" for _ in parts & gone]
    for page in PAGES:
        if page.name != "CONTRIBUTING.md":
            back += [f"{page.name}: {code}" for code in re.findall(r"`(\w+)`", page.read_text("utf-8")) if code in gone]
    assert not back
