# SPDX-License-Identifier: BSD-3-Clause
import ast
import dataclasses
import inspect
import json
import subprocess
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import epi360
import epi360_demo
import epi360_paper
import epi360_scenes
from epi360.extras import package_version

PACKAGE = Path(epi360.__file__).parent
OTHERS = {"epi360_scenes", "epi360_paper", "epi360_demo"}
PACKAGES = (epi360, epi360_scenes, epi360_paper, epi360_demo)
FOLDERS = [Path(module.__file__).parent for module in PACKAGES]
LAYERS = [
    "_core", "image_folders", "extras", "progress", "runs", "poses", "cameras", "features",
    "epipolar", "estimation", "places", "second_look", "two_view", "odometry", "synthetic",
    "interop", "epi360_scenes", "epi360_paper", "jobs", "report", "epi360_demo", "cli",
]  # fmt: skip
LAYERS_OF_JOBS = [
    "engines", "threads", "ray_tasks", "trajectories", "evaluation", "folder", "frames", "records",
    "pairs", "graph", "matching", "mapping", "tracking", "localization", "cubes", "batch",
]  # fmt: skip
LAYERS_OF_JOBS = [
    "engines", "threads", "ray_tasks", "trajectories", "evaluation", "folder", "frames", "records",
    "pairs", "graph", "matching", "mapping", "tracking", "localization", "cubes", "batch",
]  # fmt: skip
HEAVY = {"matplotlib", "cyclopts", "rich", "scipy"}
COMMANDS_OF_OTHERS = {
    "epi360/cli/demo.py", "epi360/cli/pair.py", "epi360/cli/render.py", "epi360/cli/reproduce.py",
}  # fmt: skip


def source_files() -> list[Path]:
    return sorted(path for folder in FOLDERS for path in folder.rglob("*.py"))


def room_files() -> list[Path]:
    front = {PACKAGE / "__init__.py", PACKAGE / "__main__.py"}
    return [path for path in source_files() if path not in front]


def parts_of(path: Path) -> tuple[str, ...]:
    """Package, folders and file of a source file."""
    folder = next(folder for folder in FOLDERS if path.is_relative_to(folder))
    return path.relative_to(folder.parent).parts


def name_in_package(path: Path) -> str:
    return "/".join(parts_of(path))


def room_of(path: Path) -> str:
    """Room of epi360, or the name of one of the other packages."""
    package, first, *_ = parts_of(path)
    return package if package in OTHERS else first.removesuffix(".py")


def module_of(path: Path) -> str:
    return ".".join(parts_of(path)).removesuffix(".py").removesuffix(".__init__")


def absolute_modules(node: ast.AST, path: Path) -> list[str]:
    """Full names of the modules (or names in modules) that an import statement asks for."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if not isinstance(node, ast.ImportFrom):
        return []
    base = node.module.split(".") if node.module else []
    if node.level:
        package = list(parts_of(path)[:-1])
        base = package[: len(package) - node.level + 1] + base
    return [".".join([*base, alias.name]) for alias in node.names]


def rooms_imported_by(path: Path) -> set[str]:
    """Rooms that a file imports anywhere, also inside functions; "" is the front page."""
    names = {tuple(name.split(".")) for name in modules_imported_by(path)}
    inside = {name[1] if len(name) > 1 else "" for name in names if name[0] == "epi360"}
    others = {name[0] for name in names} & OTHERS
    return {room if is_room(room) else "" for room in inside} | others


def modules_imported_by(path: Path) -> set[str]:
    """Full names that a file imports anywhere, also inside functions."""
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    return {name for node in nodes for name in absolute_modules(node, path)}


def statements_run_by_an_import(statements: list[ast.stmt]) -> Iterator[ast.stmt]:
    """Statements outside functions and blocks for the type checker."""
    for statement in statements:
        if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if isinstance(statement, ast.If) and ast.unparse(statement.test) == "TYPE_CHECKING":
            continue
        yield statement
        for block in ("body", "orelse", "finalbody"):
            yield from statements_run_by_an_import(getattr(statement, block, []))


def import_graph() -> dict[str, set[str]]:
    """Modules of all packages, each with those that it imports, lazily or not."""
    modules = {module_of(path): path for path in source_files()}
    graph = {}
    for module, path in modules.items():
        names = modules_imported_by(path) - {"epi360._core"}  # native: it has no source file here
        # "from package import name" is the module package.name where there is one, else package.
        homes = {name if name in modules else name.rpartition(".")[0] for name in names}
        graph[module] = (homes & set(modules)) - {module}
    return graph


def is_room(name: str) -> bool:
    return name in LAYERS or (PACKAGE / name).is_dir() or (PACKAGE / f"{name}.py").is_file()


def public_objects() -> dict[str, object]:
    """Public functions, classes and modules, and the public methods of the classes."""
    objects: dict[str, object] = {}
    for name in epi360.__all__:
        value = getattr(epi360, name)
        if callable(value) or inspect.ismodule(value):  # constants have no docstring
            objects[name] = value
        if inspect.isclass(value):
            objects |= {f"{name}.{m}": member for m, member in public_members(value).items()}
    return objects


def public_members(cls: type) -> dict[str, object]:
    kinds = (property, classmethod, staticmethod)
    return {
        name: member
        for name, member in vars(cls).items()
        if not name.startswith("_") and (inspect.isfunction(member) or isinstance(member, kinds))
    }


def test_every_room_has_its_place_in_the_list_of_layers():
    unknown = {room_of(path) for path in room_files()} - set(LAYERS)
    assert not unknown, f"add {sorted(unknown)} to LAYERS, or put the code into an existing room"


@pytest.mark.parametrize("path", room_files(), ids=name_in_package)
def test_imports_point_to_earlier_rooms(path):
    for imported in rooms_imported_by(path):
        if room_of(path) == "cli" and imported == "":
            continue  # the command line is a user of the public names
        assert imported, f"{path} imports the front page of epi360; import from the room instead"
        assert LAYERS.index(imported) <= LAYERS.index(room_of(path)), f"{path} imports {imported}"


def test_folders_of_jobs_import_only_those_before_them():
    for path in sorted((PACKAGE / "jobs").rglob("*.py")):
        names = (name.split(".") for name in modules_imported_by(path))
        imported = {name[2] for name in names if name[:2] == ["epi360", "jobs"]}
        folder = parts_of(path)[2].removesuffix(".py")
        later = LAYERS_OF_JOBS[LAYERS_OF_JOBS.index(folder) + 1 :] if folder != "__init__" else []
        assert not imported & set(later), f"{path} imports {sorted(imported & set(later))}"
        assert imported <= set(LAYERS_OF_JOBS)


def test_no_file_imports_one_that_imports_it():
    try:
        TopologicalSorter(import_graph()).prepare()
    except CycleError as error:
        pytest.fail("import cycle: " + " -> ".join(reversed(error.args[1])))


def test_a_lazy_import_back_is_an_import_cycle(tmp_path, monkeypatch):
    folder = tmp_path / "epi360"
    folder.mkdir()
    (folder / "a.py").write_text("from epi360.b import one\n")
    (folder / "b.py").write_text("def one():\n    from epi360 import a\n")
    monkeypatch.setitem(globals(), "FOLDERS", [folder])
    assert import_graph() == {"epi360.a": {"epi360.b"}, "epi360.b": {"epi360.a"}}
    with pytest.raises(pytest.fail.Exception, match=r"epi360\.a -> epi360\.b"):
        test_no_file_imports_one_that_imports_it()


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=name_in_package)
def test_only_four_commands_load_the_other_packages_and_only_when_they_run(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    if name_in_package(path) in COMMANDS_OF_OTHERS:
        nodes = list(statements_run_by_an_import(tree.body))
    else:
        nodes = list(ast.walk(tree))
    names = {name for node in nodes for name in absolute_modules(node, path)}
    assert {name for name in names if name.partition(".")[0] in OTHERS} == set()


def test_importing_the_command_does_not_load_the_other_packages():
    assert not loaded_by("import epi360.cli") & OTHERS


def test_relative_and_absolute_imports_are_both_seen(tmp_path):
    path = PACKAGE / "estimation" / "example.py"
    seen = {
        name
        for statement in ("from ..poses import Pose", "from . import result", "import epi360.cli")
        for name in absolute_modules(ast.parse(statement).body[0], path)
    }
    assert seen == {"epi360.poses.Pose", "epi360.estimation.result", "epi360.cli"}


def test_importing_epi360_does_not_load_the_heavy_libraries():
    assert not loaded_by("import epi360") & HEAVY


def loaded_by(statement: str) -> set[str]:
    """Packages that a new interpreter has loaded after a statement."""
    code = f"import json, sys; {statement}; print(json.dumps(sorted(sys.modules)))"
    answer = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    return {name.partition(".")[0] for name in json.loads(answer.stdout)}


def test_public_names_exist_and_are_listed_once():
    assert len(set(epi360.__all__)) == len(epi360.__all__)
    assert epi360.__version__ == package_version()
    assert [name for name in epi360.__all__ if not hasattr(epi360, name)] == []


@pytest.mark.parametrize("name", sorted(public_objects()))
def test_public_name_is_documented(name):
    value = public_objects()[name]
    doc = inspect.getdoc(value) or ""
    assert doc.strip(), f"epi360.{name} has no docstring"
    if dataclasses.is_dataclass(value):  # a dataclass without docstring is given its signature
        assert not doc.startswith(f"{value.__name__}("), f"epi360.{name} has no docstring"


@pytest.mark.parametrize(
    "name", sorted(name for name, value in public_objects().items() if inspect.isfunction(value))
)
def test_public_function_documents_each_of_its_parameters(name):
    value = public_objects()[name]
    doc = inspect.getdoc(value) or ""
    parameters = [p for p in inspect.signature(value).parameters if p != "self"]
    assert [p for p in parameters if p not in doc] == []


@pytest.mark.parametrize("path", source_files(), ids=name_in_package)
def test_source_file_states_its_licence_and_prints_nothing(path):
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# SPDX-License-Identifier: BSD-3-Clause\n")
    if room_of(path) != "cli":
        calls = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
        assert not [call for call in calls if getattr(call.func, "id", "") == "print"]
