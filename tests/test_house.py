"""Data flows one way: a module imports only from the rooms above its own."""

import ast
import gc
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from lobewise.settings import choices

SOURCE = Path(__file__).parents[1] / "src" / "lobewise"
ROOMS = [
    "errors",
    "settings",
    "work",
    "display",
    "records",
    "metrics",
    "lobes",
    "fitting",
    "io",
    "scenes",
    "render",
    "backend",
    "features",
    "engine",
    "guides",
    "filters",
    "peers",
    "interchange",
    "denoising",
    "recipes",
    "farm",
    "mitsuba",
    "interactive",
    "reporting",
    "exporting",
    "viewer",
    "cli",
]
INNER_ROOMS = {
    "work": ["chunks", "progress", "limits", "overlap", "arrays"],
    "records": ["images", "radiance", "lobe_table", "camera", "result", "frame", "sparse_frame"],
    "recipes": [
        "upsampling",
        "adaptive",
        "temporal",
        "windows",
        "streaming",
        "environment",
        "states",
        "ledger",
        "sequence",
        "files",
    ],
    "render": [
        "bridge",
        "variant",
        "camera",
        "camera_path",
        "loading",
        "moving",
        "materials",
        "tracing",
        "gbuffer",
        "coverage",
        "voxels",
        "virtual_lights",
        "images",
        "integrators",
        "own_light",
        "renderer",
        "sequence",
        "stages",
    ],
    "interactive": [
        "settings",
        "methods",
        "changes",
        "filter_choice",
        "temporal_gradients",
        "views",
        "direct_filter",
        "resting",
        "samples",
        "repairing",
        "session",
    ],
}
"""The order within rooms that have one, of their files and folders."""
OWNERS: dict[str, str | tuple[str, ...]] = {
    "halide": "backend",
    "lobewise.backend.compiler": ("backend", "features", "engine", "guides", "filters", "exporting"),
    "llvmlite": "backend",
    "mitsuba": "render",
    "drjit": "render",
    "OpenEXR": "io",
    "pyoidn": "peers",
    "typer": "cli",
    "rich": ("cli", "display", "viewer"),
    "flip_evaluator": "metrics",
    "scipy": "fitting",
    "matplotlib": "reporting",
    "viser": "viewer",
    "distributed": "farm",
    "dask": "farm",
    "PIL": ("display", "io", "viewer"),
    "PyOpenColorIO": "display",
}
"""The rooms that may import a library. Kernels read Halide by way of `lobewise.backend.compiler`."""


def list_modules() -> list[Path]:
    """Return every module of the package but its root."""
    return sorted(path for path in SOURCE.rglob("*.py") if path != SOURCE / "__init__.py")


@contextmanager
def leave_garbage() -> Iterator[None]:
    """Let nobody look for garbage: syntax trees hold none, and to look takes longer than to parse."""
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


@cache
@leave_garbage()
def read_tree(path: Path) -> ast.Module:
    """Return the syntax tree of a file."""
    return ast.parse(path.read_text())


@cache
@leave_garbage()
def list_nodes(path: Path) -> tuple[ast.AST, ...]:
    """Return all nodes of a file's syntax tree."""
    return tuple(ast.walk(read_tree(path)))


def get_room(path: Path) -> str:
    """Return the room of a source file."""
    room = path.relative_to(SOURCE).parts[0].removesuffix(".py")
    return "cli" if room == "__main__" else room


@cache
def list_imports(path: Path) -> list[str]:
    """Return the absolute names of everything that a file imports, at its top or inside functions."""
    names: list[str] = []
    for node in list_nodes(path):
        if isinstance(node, ast.Import):
            names.extend(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            module = node.module or ""
            names.extend([module, *(f"{module}.{alias.name}" for alias in node.names)])
    return names


def check_inner_order(path: Path, name: list[str]) -> None:
    """Assert that a file imports only from the files and folders above its own of a room that has an order."""
    room, *inner = path.relative_to(SOURCE).with_suffix("").parts
    order = INNER_ROOMS.get(room)
    if order is None or name[1] != room or len(name) < 3 or inner[0] == "__init__":
        return
    assert inner[0] in order, f"{inner[0]} is not in the list of rooms within {room}"
    if name[2] in order:
        assert order.index(name[2]) <= order.index(inner[0]), f"{path.name} imports {'.'.join(name)} from below"


def test_imports_point_one_way() -> None:
    rooms = {path.stem for path in SOURCE.iterdir()}
    for path in list_modules():
        room = get_room(path)
        assert room in ROOMS, f"{room} is not in the list of rooms"
        for name in list_imports(path):
            parts = name.split(".")
            if parts[0] == "lobewise" and len(parts) > 1 and parts[1] in rooms:
                assert ROOMS.index(parts[1]) <= ROOMS.index(room), f"{path} imports {name} from a room below"
                check_inner_order(path, parts)
            owner = OWNERS.get(name, OWNERS.get(parts[0]))
            owners = (owner,) if isinstance(owner, str) else owner
            assert owners is None or room in owners, f"{path} imports {name}, which belongs to {owner}"


def test_no_file_of_the_lobes_is_for_tests_alone() -> None:
    """Every public name of the lobes is read by another file of the package, or by its own."""
    modules = [*list_modules(), SOURCE / "__init__.py"]
    for path in (SOURCE / "lobes").glob("[a-z]*.py"):
        names = {node.name for node in read_tree(path).body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
        users = [other for other in modules if other != path and f"lobes.{path.stem} import" in other.read_text()]
        assert users, f"nothing in the package imports {path.stem}"
        read = [node for other in [path, *users] for node in list_nodes(other)]
        used = {node.id for node in read if isinstance(node, ast.Name)}
        assert {name for name in names if not name.startswith("_")} <= used, path


def list_circle(edges: dict[str, set[str]]) -> list[str]:
    """Return the nodes of a directed graph along a circle, the first one repeated at the end; none if it has none."""
    finished: set[str] = set()

    def walk(way: list[str]) -> list[str]:
        for following in sorted(edges[way[-1]] - finished):
            if following in way:
                return [*way[way.index(following) :], following]
            if found := walk([*way, following]):
                return found
        finished.add(way[-1])
        return []

    return next((found for name in sorted(edges) if name not in finished and (found := walk([name]))), [])


def test_no_import_closes_a_circle() -> None:
    """No module of the package imports itself by way of others, not even for types or inside functions."""
    modules = {
        ".".join(["lobewise", *path.relative_to(SOURCE).with_suffix("").parts]).removesuffix(".__init__"): path
        for path in list_modules()
    }
    edges: dict[str, set[str]] = {}
    for module, path in modules.items():
        imported = list_imports(path)
        # Of "from package import module" the package is no import of its own.
        packages = {name.rpartition(".")[0] for name in imported if name in modules}
        names = {name for name in imported if name not in packages}
        parents = {name.rpartition(".")[0] for name in names - set(modules)}
        edges[module] = {name for name in names | parents if name in modules} - {module}
    assert list_circle({"a": {"b", "c"}, "b": {"c"}, "c": {"d"}, "d": {"b"}}) == ["b", "c", "d", "b"]
    assert list_circle(edges) == []


MAX_FILES_IN_FOLDER, MAX_LINES_OF_FILE, MAX_CODE_LINES_OF_FUNCTION = 15, 600, 60


def count_code_lines(node: ast.FunctionDef | ast.AsyncFunctionDef, lines: list[str]) -> int:
    """Return the lines of a function without docstring, comments and blank lines; ``lines`` are those of its file."""
    words = ast.get_docstring(node) is not None and node.body[0]
    in_words = range(words.lineno, words.end_lineno + 1) if words else ()
    numbers = (number for number in range(node.lineno, node.end_lineno + 1) if number not in in_words)
    return sum(not lines[number - 1].strip().startswith("#") and bool(lines[number - 1].strip()) for number in numbers)


def test_no_folder_is_two_rooms() -> None:
    for folder in {path.parent for path in SOURCE.rglob("*.py")}:
        assert len(list(folder.glob("*.py"))) <= MAX_FILES_IN_FOLDER, folder


def test_files_are_short_and_say_what_they_are() -> None:
    for path in list_modules():
        text = path.read_text()
        assert text.count("\n") <= MAX_LINES_OF_FILE, path
        assert ast.get_docstring(read_tree(path)), path
        for node in list_nodes(path):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                lines = count_code_lines(node, text.splitlines())
                assert lines <= MAX_CODE_LINES_OF_FUNCTION, f"{path}: {node.name}"


HEADING = re.compile(r"\s*# (Signature|Algorithm|Schedule)(?=\W|$)")
"""The headings of a kernel, each on a line of its own above its part."""
DIRECTIVES = re.compile(r"\.(compute_at|compute_root|vectorize|parallel|gpu_tile|gpu_blocks|hoist_storage)\(")
"""What says how a function is computed."""
SHARED_SCHEDULES = "scheduling.py"
"""The file of what schedules have in common."""


def list_misplaced_schedules(text: str) -> list[str]:
    """Return the lines of a file that schedule a function and do not stand below the heading of a schedule."""
    found, heading = [], ""
    for line in text.splitlines():
        named = HEADING.match(line)
        heading = named[1] if named else heading
        if DIRECTIVES.search(line) and heading != "Schedule":
            found.append(line.strip())
    return found


def test_a_kernel_is_one_file_with_its_schedule_under_a_heading() -> None:
    text = "f[x] = 1\n# Schedule\nf.parallel(y)\n# Algorithm\ng.vectorize(x)\n"
    assert list_misplaced_schedules(text) == ["g.vectorize(x)"]
    texts = {path: path.read_text() for path in (SOURCE / "filters").rglob("*.py") if path.name != SHARED_SCHEDULES}
    assert {path: found for path, text in texts.items() if (found := list_misplaced_schedules(text))} == {}
    for path, text in texts.items():
        if 'Signature("' in text:
            headings = {named[1] for line in text.splitlines() if (named := HEADING.match(line))}
            assert headings == {"Signature", "Algorithm", "Schedule"}, path


def list_compared_names(nodes: Iterable[ast.AST], names: set[str]) -> list[str]:
    """Return the comparisons among nodes whose one side speaks of a similarity or quality and whose other is a name."""
    found = []
    for node in nodes:
        if not isinstance(node, ast.Compare):
            continue
        sides = [node.left, *node.comparators]
        speaks = any("similarity" in ast.unparse(side) or "quality" in ast.unparse(side) for side in sides)
        constants = {each.value for side in sides for each in ast.walk(side) if isinstance(each, ast.Constant)}
        if speaks and constants & names:
            found.append(ast.unparse(node))
    return found


def test_no_name_of_a_similarity_or_quality_is_compared() -> None:
    """Code asks the record of a similarity or quality (`lobewise.settings.choices`), and does not compare its name."""
    names = {*choices.SIMILARITIES, *choices.QUALITIES}
    assert list_compared_names(ast.walk(ast.parse('a.similarity == "sg" and quality in ("high", "x")')), names) == [
        "a.similarity == 'sg'",
        "quality in ('high', 'x')",
    ]
    compared = {str(path): list_compared_names(list_nodes(path), names) for path in list_modules()}
    assert {path: found for path, found in compared.items() if found} == {}


PUBLIC_FINDERS = {"find_disoccluded", "find_orbit_centre", "find_specular_pixels", "find_unsupported"}
"""Functions that users call, and that keep their names."""
CORE = {
    *("settings", "metrics", "lobes", "backend", "features", "engine", "guides", "filters", "denoising", "upsampling"),
    *("adaptive", "temporal", "windows", "streaming"),
}
"""Rooms in which a name means one thing."""
ONE_MEANING = {"Vector"}
"""Names with several definitions of one meaning: the components of a vector, of Halide or of any library."""


def list_definitions(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """Yield the public names at the top of a module, and their values; functions and classes have no value."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names, value = {node.name}, ""
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = {part.id for target in targets for part in ast.walk(target) if isinstance(part, ast.Name)}
            value = ast.unparse(node.value) if node.value else ""
        else:
            continue
        yield from ((name, value) for name in names if not name.startswith("_"))


def list_ambiguous(trees: Iterable[ast.Module]) -> set[str]:
    """Return the names that several modules define, unless as the same constant."""
    values: dict[str, list[str]] = {}
    for tree in trees:
        for name, value in dict(list_definitions(tree)).items():
            values.setdefault(name, []).append(value)
    return {name for name, each in values.items() if len(each) > 1 and ("" in each or len(set(each)) > 1)}


def test_no_function_says_find() -> None:
    """`find` says neither compute nor estimate, measure, mark, choose, list or look up."""
    nodes = (node for path in list_modules() for node in list_nodes(path) if isinstance(node, ast.FunctionDef))
    assert {node.name for node in nodes if re.match("_?find_", node.name)} == PUBLIC_FINDERS


def test_a_name_of_the_core_means_one_thing() -> None:
    texts = ["A = 1\nB = 1\nC: int = 1", "A = 2\nB = 1\ndef c(): ...", "class c: ..."]
    assert list_ambiguous(map(ast.parse, texts)) == {"A", "c"}
    assert list_ambiguous(read_tree(path) for path in list_modules() if get_room(path) in CORE) == ONE_MEANING
