"""Who may import whom, read from the sources."""

import ast
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import ddpc_cosim

ROOT = Path(__file__).parents[2]
ROOMS = {
    "fmu_plants": ROOT / "fmu_plants",
    "ddpc_cosim": ROOT / "ddpc_cosim",
    "ddpc_controllers": ROOT / "controllers" / "ddpc_controllers",
    "ddpc_reports": ROOT / "reports" / "ddpc_reports",
}
# Modules that plug-ins may use besides the names of the package.
PUBLIC_MODULES = {
    "files.tables",
    "files.texts",
    "loop.data_quality",
    "metrics",
    "plugins",
    "responses",
    "testing",
}
PUBLIC_MODULES |= {
    f"study.verdicts.{name}"
    for name in (
        "baselines",
        "changes",
        "claims",
        "findings",
        "judgement",
        "ranks",
        "requirements",
        "sentences",
        "reliability",
        "shares",
        "standings",
        "statistics",
    )
}
PUBLIC_MODULES |= {"codec", "conditions", "study.file_format.sections", "study.file_format.sweeps"}


def modules(room: str) -> dict[str, Path]:
    """Return the modules of a room by full name."""
    table = {}
    for path in sorted(ROOMS[room].rglob("*.py")):
        parts = path.relative_to(ROOMS[room]).with_suffix("").parts
        table[".".join((room, *(part for part in parts if part != "__init__")))] = path
    return table


def imports(path: Path) -> Iterator[tuple[str, str]]:
    """Yield (module, name) of every import, also of those in functions and for type checkers."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute here"
            yield from ((str(node.module), alias.name) for alias in node.names)


def rooms_imported(room: str) -> set[str]:
    imported = {module.split(".")[0] for path in modules(room).values() for module, _ in imports(path)}
    return imported & ROOMS.keys() - {room}


def test_fmu_plants_imports_none_of_the_others() -> None:
    assert rooms_imported("fmu_plants") == set()


def test_the_master_never_imports_controllers_or_reports() -> None:
    assert rooms_imported("ddpc_cosim") <= {"fmu_plants"}


def test_controllers_and_reports_import_only_the_master() -> None:
    assert rooms_imported("ddpc_controllers") == {"ddpc_cosim"}
    assert rooms_imported("ddpc_reports") == {"ddpc_cosim"}


@pytest.mark.parametrize("room", ["ddpc_controllers", "ddpc_reports"])
def test_plug_ins_use_public_names_only(room: str) -> None:
    for path in modules(room).values():
        for module, name in imports(path):
            package, _, below = module.partition(".")
            if package == "ddpc_cosim":
                public = name in ddpc_cosim.__all__ if not below else below in PUBLIC_MODULES
                assert public, f"{path.name}: from {module} import {name}"
                assert not name.startswith("_")


def test_no_module_imports_itself_in_a_circle() -> None:
    """Lazy imports and imports for type checkers count too."""
    known = {name: path for room in ROOMS for name, path in modules(room).items()}
    needs = {
        name: {
            target
            for module, part in imports(path)
            if (target := f"{module}.{part}" if f"{module}.{part}" in known else module) in known
        }
        for name, path in known.items()
    }
    try:
        TopologicalSorter(needs).prepare()
    except CycleError as error:
        pytest.fail(f"an import circle: {' <- '.join(error.args[1])}")


def test_every_public_name_resolves() -> None:
    assert len(set(ddpc_cosim.__all__)) == len(ddpc_cosim.__all__)
    for name in ddpc_cosim.__all__:
        assert getattr(ddpc_cosim, name) is not None
    assert set(ddpc_cosim.__all__) <= set(dir(ddpc_cosim))


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="No ddpc_cosim attribute Plnat"):
        _ = ddpc_cosim.Plnat
