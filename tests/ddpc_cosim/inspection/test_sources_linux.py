"""FMUs that come as C sources only: an inspection compiles them, and says what they lack."""

import zipfile
from pathlib import Path

import pytest
from fmus.builder import CO_SIMULATION, HERE, LAG, describe, write_fmu

from ddpc_cosim.inspection import Inspection, inspect_fmu
from ddpc_cosim.inspection.systems import inspect_ssp


def inspected(tmp_path: Path, **files: str) -> Inspection:
    sources = {f"sources/{name.replace('_', '.')}": text for name, text in files.items()}
    text = describe("2.0", "lag", LAG, interfaces=CO_SIMULATION)
    return inspect_fmu(write_fmu(tmp_path / "lag.fmu", text, None, **sources))


def source(name: str, before: str = "", after: str = "") -> str:
    return before + (HERE / name).read_text(encoding="utf-8") + after


def complete(**front: str) -> dict[str, str]:
    return {
        "models_c": source("models.c"),
        "models_h": source("models.h"),
        "front2_c": source("front2.c", **front),
    }


def found(inspection: Inspection) -> dict[str, str]:
    return {defect.kind.name: "; ".join(defect.places) for defect in inspection.defects}


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("DDPC_COSIM_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_those_that_compile_are_kept_for_the_first_use(tmp_path: Path, own_cache: Path) -> None:
    inspection = inspected(tmp_path, **complete())
    assert (inspection.can_run, inspection.binaries.route) == (True, "sources")
    assert "compiled-here" in found(inspection)
    assert len(list(own_cache.rglob("models.so"))) == 1


def test_those_that_do_not_compile_are_told_in_the_compilers_words(tmp_path: Path) -> None:
    inspection = inspected(tmp_path, **complete(after="\n#error no such thing\n"))
    assert not inspection.can_run
    assert "no such thing" in found(inspection)["uncompiled"]
    assert inspection.binaries.route == ""


def test_those_of_another_fmi_version_lack_its_functions(tmp_path: Path) -> None:
    files = complete() | {"front2_c": source("front1.c")}
    inspection = inspected(tmp_path, **files)
    assert not inspection.can_run
    assert "fmi2EnterInitializationMode" in found(inspection)["no-functions"]


def test_those_that_call_functions_which_are_nowhere_are_told_which(tmp_path: Path) -> None:
    call = "\nvoid dgesv_(void); void solve(void) { dgesv_(); }\n"
    inspection = inspected(tmp_path, **complete(after=call))
    assert not inspection.can_run
    assert found(inspection)["unresolved"] == "dgesv_"


def test_those_that_may_be_missing_are_not(tmp_path: Path) -> None:
    call = "\n__attribute__((weak)) void tell(void); void solve(void) { if (tell) tell(); }\n"
    assert inspected(tmp_path, **complete(after=call)).can_run


def test_what_is_compiled_is_said_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    inspected(tmp_path, **complete())
    monkeypatch.setenv("DDPC_COSIM_CACHE", str(tmp_path / "another"))
    lines = list[str]()
    for _ in range(2):
        inspect_fmu(tmp_path / "lag.fmu", tell=lines.append)
    assert lines == ["compiling the C sources of lag.fmu"]


def test_so_it_is_of_a_part_of_an_ssp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    inspected(tmp_path, **complete())
    monkeypatch.setenv("DDPC_COSIM_CACHE", str(tmp_path / "another"))
    part = '<ssd:Component name="part" source="resources/lag.fmu"/>'
    with zipfile.ZipFile(tmp_path / "system.ssp", "w") as archive:
        archive.write(tmp_path / "lag.fmu", "resources/lag.fmu")
        archive.writestr(
            "SystemStructure.ssd",
            '<ssd:SystemStructureDescription xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"'
            f' version="1.0" name="test"><ssd:System name="test"><ssd:Elements>{part}</ssd:Elements>'
            "</ssd:System></ssd:SystemStructureDescription>",
        )
    lines = list[str]()
    for _ in range(2):
        assert inspect_ssp(tmp_path / "system.ssp", tell=lines.append).parts["part"].can_run
    assert lines == ["compiling the C sources of lag.fmu"]
