"""The house itself: imports run downwards, docstrings equal signatures, the README holds what it promises."""

import ast
import dataclasses
import functools
import importlib
import inspect
import json
import re
import subprocess
from pathlib import Path

import pytest

import rvjax
from rvjax import models
from rvjax.records import Record

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "rvjax"
MODELS = ("four_bar", "lost_motion", "mesh_force", "dynamics", "loaded")

# From the ground up; a module may import modules of the lines above its own, and of its own package.
DIAGRAM = re.search(r"```text\n(.*?)```", (ROOT / "docs" / "architecture.md").read_text(), re.DOTALL).group(1)
FLOORS = tuple(tuple(re.split(r" {2,}", line)[0].split()) for line in DIAGRAM.splitlines())
FLOOR = {name: number for number, names in enumerate(FLOORS) for name in names}


PRIVATE = ("base", "_jax")  # folders of single modules, without names in their `__init__`


def rooms():
    """Every file but the top `__init__`."""
    return sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


def name_of(path):
    """Dotted name below rvjax: ("loaded", "newton"); a package for its `__init__`."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return parts[:-1] if parts[-1] == "__init__" else parts


NAMES = {name_of(path) for path in rooms()} | {()}


@functools.cache
def parsed(path):
    return ast.parse(path.read_text())


@functools.cache
def statements(path):
    """Nodes of a file that import: one walk through each tree serves all tests."""
    return [node for node in ast.walk(parsed(path)) if isinstance(node, (ast.Import, ast.ImportFrom))]


@functools.cache
def imports(path):
    """Dotted names below rvjax that a file imports, for types only too."""
    return [*_imports(statements(path))]


def _imports(nodes):
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "rvjax":
            module = tuple(node.module.split(".")[1:])
            for alias in node.names:
                deeper = (*module, alias.name)
                yield deeper if deeper in NAMES or not module else module
        elif isinstance(node, ast.Import):
            yield from (tuple(a.name.split(".")[1:]) for a in node.names if a.name.startswith("rvjax."))


def floor_name(name):
    """Entry of the diagram: the module of a private folder if it has a separate line, else the first part."""
    return ".".join(name[:2]) if ".".join(name[:2]) in FLOOR else name[0]


def test_imports_run_downwards():
    for path in rooms():
        name = floor_name(name_of(path))
        assert name in FLOOR, f"{name} is missing in docs/architecture.md"
        for other in imports(path):
            if other[0] not in FLOOR or (other[0] == name_of(path)[0] and other[0] not in PRIVATE):
                continue
            above = FLOOR[floor_name(other)] >= FLOOR[name]
            assert not above or other[0] == name, f"{path.relative_to(ROOT)} imports {'.'.join(other)}"


def circles(edges):
    """Names that import each other, over any number of steps: {name: set of the names that it imports}."""
    reached = {name: set(others) for name, others in edges.items()}
    for middle in edges:
        for others in reached.values():
            if middle in others:
                others |= reached[middle]
    return sorted(name for name in edges if name in reached[name])


def test_the_search_for_circles_finds_them():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == ["b", "c"]
    assert circles({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


def test_no_packages_import_each_other():
    """In every folder: its modules and subpackages, as one name each; private folders are checked by module above."""
    found = {}
    for folder in sorted({name[:depth] for name in NAMES for depth in range(len(name))}):
        edges = {}
        for path in rooms():
            name = name_of(path)
            if name[: len(folder)] != folder or len(name) == len(folder):
                continue
            own = name[len(folder)]
            others = edges.setdefault(own, set())
            for other in imports(path):
                if other[: len(folder)] == folder and len(other) > len(folder) and other[len(folder)] != own:
                    others.add(other[len(folder)])
        edges = {name: others for name, others in edges.items() if name not in PRIVATE}
        edges = {name: {other for other in others if other in edges} for name, others in edges.items()}
        if circles(edges):
            found[".".join(folder)] = circles(edges)
    assert found == {}


def test_no_files_import_each_other():
    """An `__init__` counts as the package: what it imports does not import from it."""
    edges = {name_of(path): {*imports(path)} - {name_of(path)} for path in rooms()}
    assert circles({name: others & set(edges) for name, others in edges.items()}) == []


def test_packages_are_imported_through_their_init():
    """Another package takes a name from `rvjax.population`, never from a file below it; models give their outputs."""
    deep = []
    for path in rooms():
        for node in statements(path):
            parts = node.module.split(".") if isinstance(node, ast.ImportFrom) and node.module else []
            below = len(parts) > 2 and parts[0] == "rvjax" and parts[1] != name_of(path)[0]
            if below and (PACKAGE / parts[1]).is_dir() and parts[1] not in PRIVATE:
                deep.append(f"{path.relative_to(PACKAGE)}: {node.module}")
    assert deep == []


def test_the_top_level_holds_what_belongs_there():
    """Of what is submitted: a note left behind would land with it."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode or not listed.stdout:
        pytest.skip("no checkout")
    known = {".ci", ".github", ".gitignore", ".pre-commit-config.yaml", "CHANGELOG.md", "CITATION.cff"}
    known |= {"CONTRIBUTING.md", "LICENSE", "README.md", "pyproject.toml"}
    known |= {"benchmarks", "docs", "notebooks", "rvjax", "tests"}
    assert {name.split("/")[0] for name in listed.stdout.splitlines()} == known


def test_statistics_know_no_gears():
    """The package itself is named for its version alone."""
    ground = {"__version__", "base", "_jax", "records", "roots", "status", "units"}
    ground |= {"population", "response", "tolerances"}
    for room in ("population", "response", "tolerances", "identify", "assembly", "compensation"):
        for path in (PACKAGE / room).rglob("*.py"):
            below = {"identify"} if room == "compensation" else set()  # orders of a curve
            assert {other[0] for other in imports(path)} <= ground | below | {room}, path.name


def test_no_thread_but_of_progress_and_processes_and_no_look_into_the_interpreter():
    """A computation is one thread; nothing reads bytecode or frames, or changes what a fork does."""
    modules = {"threading": set(), "concurrent": set(), "multiprocessing": set(), "dis": set(), "_thread": set()}
    names = {"co_code", "co_consts", "_getframe", "currentframe", "register_at_fork", "fork"}
    looks = []
    for path in rooms():
        for node in statements(path):
            loaded = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            loaded += [name.name for name in node.names] if isinstance(node, ast.Import) else []
            for module in {name.split(".")[0] for name in loaded} & modules.keys():
                modules[module].add(path.relative_to(PACKAGE).as_posix())
        for node in ast.walk(parsed(path)) if any(name in path.read_text() for name in names) else ():
            if getattr(node, "attr", getattr(node, "id", None)) in names:
                looks.append(f"{path.relative_to(PACKAGE)}:{node.lineno}")
    watching = {"base/progress.py", "_jax/distributed.py", "tolerances/batch/shares.py"}
    assert modules.pop("threading") == watching | {"commands/montecarlo/batch.py"}
    assert (looks, set().union(*modules.values())) == ([], set())


def forks(tree, classes):
    """Lines that ask for one of these classes: `isinstance`, `issubclass`, a comparison, a case of a `match`."""
    for node in ast.walk(tree):
        called = node.func.id if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) else ""
        asked = node.args[1:] if called in ("isinstance", "issubclass") else []
        asked += [node] if isinstance(node, (ast.Compare, ast.MatchClass, ast.MatchValue)) else []
        names = {getattr(x, "id", getattr(x, "attr", "")) for one in asked for x in ast.walk(one)}
        if names & classes:
            yield node.lineno


def test_only_a_kind_asks_for_the_class_of_a_design():
    """What differs between kinds of reducers is in `study/kinds`, looked up by the class; else each has many places."""
    classes = {cls.__name__ for cls in models.kinds().values()}
    assert {"RVReducer", "CamRollerReducer"} <= classes
    asking = [
        "isinstance(d, RVReducer)", "isinstance(d, (Record, designs.RVReducer))", "issubclass(c, RVReducer)",
        "type(d) is RVReducer", "RVReducer == c", "kind == RVReducer.kind", "c in (RVReducer, Other)",
    ]  # fmt: skip
    for text in asking:
        assert list(forks(ast.parse(f"if {text}:\n    pass"), classes)) == [1], text
    assert list(forks(ast.parse("match d:\n    case RVReducer():\n        pass"), classes)) == [2]
    for text in ("isinstance(d, Record)", "RVReducer(a, b)", "KINDS[RVReducer]", "d: RVReducer = x"):
        assert not list(forks(ast.parse(text), classes)), text
    homes = [PACKAGE / "designs.py", *(PACKAGE / "study" / "kinds").rglob("*.py")]
    told = {path: any(name in path.read_text() for name in classes) for path in rooms() if path not in homes}
    found = {path: [*forks(parsed(path), classes)] if named else [] for path, named in told.items()}
    assert len(found) > 200 and {path: lines for path, lines in found.items() if lines} == {}


def public_functions():
    for path in [PACKAGE / "__init__.py", *rooms()]:
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        if path.name == "__main__.py":
            continue
        module = importlib.import_module(name)
        for attribute, value in vars(module).items():
            home = getattr(value, "__module__", None)
            if attribute.startswith("_") or home != name:
                continue
            if inspect.isfunction(inspect.unwrap(value)) if callable(value) else False:
                yield f"{name}.{attribute}", inspect.unwrap(value)
            elif inspect.isclass(value):
                yield f"{name}.{attribute}", value
                for method, function in vars(value).items():
                    function = getattr(function, "__func__", function)
                    if not method.startswith("_") and inspect.isfunction(function):
                        yield f"{name}.{attribute}.{method}", function


PUBLIC = dict(public_functions())


def parameters(function):
    """Names of what a caller gives; the first one of a method is the object itself."""
    bound = ("self", "cls") if "." in function.__qualname__ else ()
    return [p for p in inspect.signature(function).parameters if p not in bound]


def told(name):
    """Whether the docstring of a public name lists the arguments of its signature, if it lists any."""
    thing = PUBLIC[name]
    assert thing.__doc__, f"{name} has no docstring"
    section = re.search(r"\n\s*(?:Args|Attributes):\n(.*?)(?=\n\s*\n|\Z)", inspect.cleandoc(thing.__doc__), re.DOTALL)
    if section is None:
        return True
    if inspect.isclass(thing):
        assert dataclasses.is_dataclass(thing), name
        expected = [f.name for f in dataclasses.fields(thing)]
    else:
        expected = parameters(thing)
    return re.findall(r"^ {4}\*{0,2}(\w+):", section.group(1), re.MULTILINE) == expected


def test_docstrings_tell_the_parameters_of_the_signature():
    """Every public name has a docstring; where it lists arguments, they are those of the signature."""
    assert len(PUBLIC) > 1000
    assert [name for name in PUBLIC if not told(name)] == []


def exported():
    """Functions in the `__all__` of a package or module; without one those that it takes from its own files.

    Of a module without one: all, if the pages of the API show it.
    """
    pages = "".join(path.read_text() for path in (ROOT / "docs" / "api").glob("*.md"))
    shown = re.findall(r"automodule:: (\S+)\n +:members:", pages)
    for path in [PACKAGE / "__init__.py", *rooms()]:
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        module = None if path.name == "__main__.py" else importlib.import_module(name)
        own = (
            [key for key, value in vars(module).items() if f"{name}." in f"{getattr(value, '__module__', '')}."]
            if module
            else []
        )
        listed = vars(module) if name in shown else own if path.name == "__init__.py" else ()
        for attribute in getattr(module, "__all__", listed):
            value = inspect.unwrap(getattr(module, attribute))
            full = f"{getattr(value, '__module__', '')}.{getattr(value, '__name__', '')}"
            yield from (public for public in PUBLIC if public == full or public.startswith(f"{full}."))


EXPORTED = sorted({name for name in exported() if not inspect.isclass(PUBLIC[name])})


def overrides(name):
    """A method whose arguments a class above it tells."""
    home, _, attribute = name.rpartition(".")
    above = PUBLIC[home].__mro__[1:] if inspect.isclass(PUBLIC.get(home)) else ()
    return any("Args:" in (getattr(vars(cls).get(attribute), "__doc__", None) or "") for cls in above)


def test_every_exported_function_of_two_parameters_tells_each():
    """The test above holds that the section names them all, in their order."""
    assert {"rvjax.four_bar.reducer.revolution", "rvjax.records.field", "rvjax.status.worst"} <= set(EXPORTED)
    assert "rvjax.errors.Errors.for_design" in EXPORTED  # a method of a base of records
    several = [name for name in EXPORTED if len(parameters(PUBLIC[name])) > 1 and not overrides(name)]
    assert [name for name in several if "\nArgs:\n" not in inspect.cleandoc(PUBLIC[name].__doc__)] == []


def test_every_record_declares_unit_and_meaning():
    def below(cls):
        for child in cls.__subclasses__():
            yield child
            yield from below(child)

    seen = 0
    for cls in below(Record):
        for f in dataclasses.fields(cls) if dataclasses.is_dataclass(cls) else ():  # an abstract base has none
            assert f.metadata["meaning"] and f.metadata["unit"], f"{cls.__name__}.{f.name}"
            seen += 1
    assert seen > 50


def missing(source):
    """Names of rvjax that do not exist among those that code imports, or takes from a module that it imports."""
    tree, names, found = ast.parse(source), {}, []

    def value(node):
        """Object that a dotted name stands for, looked up in modules only; else None."""
        above = value(node.value) if isinstance(node, ast.Attribute) else None
        return getattr(above, node.attr, None) if inspect.ismodule(above) else names.get(getattr(node, "id", None))

    for node in ast.walk(tree):
        home = f"from {node.module} " if isinstance(node, ast.ImportFrom) else ""
        for alias in node.names if isinstance(node, (ast.Import, ast.ImportFrom)) else ():
            statement = f"{home}import {ast.unparse(alias)}"
            if re.match(r"(from|import) rvjax\b", statement):
                try:
                    exec(statement, names)
                except ImportError:
                    found.append(statement)
    for node in ast.walk(tree):
        above = value(node.value) if isinstance(node, ast.Attribute) else None
        if inspect.ismodule(above) and not hasattr(above, node.attr):
            found.append(f"{above.__name__}.{node.attr}")
    return sorted(found)


def test_pages_that_messages_and_comments_name_exist():
    """Pages of the docs, and headings on them, in code, tables of commands, studies, templates and notebooks."""
    texts = [path for path in (ROOT / "rvjax").rglob("*") if path.suffix in (".py", ".toml", ".j2", ".js")]
    named = {
        (page, anchor)
        for path in [*texts, *(ROOT / "notebooks").glob("*.ipynb"), *ROOT.glob("*.md")]
        for page, anchor in re.findall(r"\b(docs/[\w/]+\.md)(?:#([\w-]+))?", path.read_text("utf-8"))
    }
    assert len(named) > 8
    for page, anchor in sorted(named):
        headings = re.findall(r"^(?:#+ (.*)|\(([\w-]+)\)=)$", (ROOT / page).read_text("utf-8"), re.M)
        known = {label or re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title, label in headings}
        assert not anchor or anchor in known, (page, anchor)


def test_notebooks_take_from_the_package_what_it_has():
    """A name that moved fails here, long before the notebooks run."""
    moved = "from rvjax.tolerances import gone, sample\nfrom rvjax import plotting as p, study\nimport rvjax.gone\n"
    used = "p.drawings.reducer({}); p.drawings.gone(study.load('x').gone); rvjax.gone()"
    expected = ["from rvjax.tolerances import gone", "import rvjax.gone", "rvjax.plotting.drawings.gone"]
    assert missing(f"{moved}{used}") == expected
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        cells = json.loads(path.read_text("utf-8"))["cells"]
        code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
        assert "import rvjax\n" in code and missing(code) == [], path.name


def test_readme_begins_with_the_two_commands():
    blocks = re.findall(r"^```(\w*)\n(.*?)^```", (ROOT / "README.md").read_text(), re.MULTILINE | re.DOTALL)
    shell = [text for language, text in blocks if language == "sh"]
    assert "rvjax allocate" in shell[0]
    assert shell[1].endswith("-e '.[dev]' && .venv/bin/pytest\n")  # with lint, which is a test


def test_continuous_integration_runs_the_jobs_that_contributing_lists():
    """And the default profile has none, or only the quick tests, of the files that are jobs."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    jobs = r"^ {4}(mypy|pytest tests/interfaces|HYPOTHESIS_PROFILE=long pytest (tests/[\w{},/]+\.py)) {2,}"
    listed = re.findall(jobs, text, re.MULTILINE)
    assert len(listed) == 8
    steps = "".join(path.read_text() for path in (ROOT / ".github" / "workflows").glob("*.yml"))
    for command, files in listed:
        assert re.search(rf"\b{re.escape(files or command)}\n", steps), command
        start, _, names = files.removesuffix(".py").removesuffix("}").partition("{")  # as the shell reads them
        for name in names.split(",") if files else ():
            assert "pytest.mark.long" in (ROOT / f"{start}{name}.py").read_text(), command


def test_the_version_is_said_once():
    citation = (ROOT / "CITATION.cff").read_text()
    assert f"\nversion: {rvjax.__version__}\n" in citation
    assert f"## {rvjax.__version__}" in (ROOT / "CHANGELOG.md").read_text()
