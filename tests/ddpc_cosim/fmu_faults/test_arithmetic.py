"""FMUs that change how the process computes: no figure of a controller or a metric is another one for it."""

import ctypes
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from fmus.builder import Fault, library_name, model_fmu, model_library, write_archive
from studies import run_file, study_text, write

from ddpc_cosim import Action, Constant, Controller, CosimWarning, FMUPlant, Loop, Sample, Trace, cosimulate
from ddpc_cosim.fmu.arithmetic import KeptArithmetic, departures
from ddpc_cosim.study.case_files import read_run, read_trace
from fmu_plants.export.compiler import compile_library, find_compiler

from .loop import FAULT_TIME, H

WORDS = {
    Fault.ROUND_UP: "this process now rounds up",
    Fault.ROUND_TO_ZERO: "this process now rounds towards zero",
    Fault.FLUSH_DENORMALS: "this process now takes denormal numbers for zero",
}
_ROUNDING = """
#include <fenv.h>
__attribute__((visibility("default"))) int round_up(void) { return fesetround(FE_UPWARD); }
__attribute__((visibility("default"))) int round_to_nearest(void) { return fesetround(FE_TONEAREST); }
"""


@dataclass(kw_only=True)
class Computes(Controller):
    """Tells what it computes: a tenth and a third, which are rounded, and a denormal number."""

    numerator: float = 1.0
    smallest: float = 1e-310

    def start(self, loop: Loop) -> None:
        pass

    def step(self, sample: Sample) -> Action:
        rounded = self.numerator / 10.0, self.numerator / 3.0
        info = {"tenth": rounded[0], "third": rounded[1], "denormal": 0.5 * self.smallest}
        return Action(np.array([1.0 - sample.y[0] * rounded[1]]), info=info)


def run(plant: FMUPlant, **parameters: float) -> Trace:
    return cosimulate(
        plant,
        Computes(),
        sampling_time=H,
        duration=1.0,
        reference=Constant(1.0),
        outputs=["y"] if "y" in {output.name for output in plant.outputs} else None,
        parameters=parameters,
    )


def assert_same_figures(trace: Trace, undisturbed: Trace) -> None:
    assert trace.outcome == undisturbed.outcome == "completed"
    np.testing.assert_array_equal(trace.u, undisturbed.u)
    np.testing.assert_array_equal(trace.y, undisturbed.y)
    for name, values in undisturbed.info.items():
        np.testing.assert_array_equal(trace.info[name], values)
    for name, value in undisturbed.metrics().items():
        assert "solve_time" in name or trace.metrics()[name] == value or np.isnan(value), name


@pytest.fixture(autouse=True)
def as_usual() -> Iterator[None]:
    """No test begins or ends with another arithmetic."""
    assert departures() == ""
    yield
    assert departures() == ""


@pytest.mark.parametrize(("version", "isolated"), [(2, False), (3, True)])
@pytest.mark.parametrize("fault", WORDS, ids=lambda fault: fault.name)
def test_co_simulation(fault: Fault, version: int, isolated: bool, faulty_fmus: dict[int, Path]) -> None:
    with FMUPlant(faulty_fmus[version], isolated=isolated) as plant:
        undisturbed = run(plant)
        assert plant.warnings == ()
        with pytest.warns(CosimWarning) as caught:
            trace = run(plant, fault=int(fault), fault_time=FAULT_TIME)
        (warning,) = caught
        told_of = (
            f"faulty{version}.fmu: its library changes how numbers are computed: {WORDS[fault]}; it was put"
        )
        assert told_of in str(warning.message)
        assert WORDS[fault] in trace.provenance["fmu_warnings"]
        assert len(plant.warnings) == 1
        assert_same_figures(trace, undisturbed)


@pytest.mark.parametrize("fault", WORDS, ids=lambda fault: fault.name)
def test_model_exchange(fault: Fault, tmp_path: Path) -> None:
    """What CVode computes between two calls of the FMU within a step is the plant's own."""
    (tmp_path / "faulty").mkdir()
    only = '<ModelExchange modelIdentifier="models"/>'
    with (
        FMUPlant(model_fmu(tmp_path, "2.0", "lag", interfaces=only), outputs=["x"]) as plant,
        FMUPlant(
            model_fmu(tmp_path / "faulty", "2.0", "lag", fault, interfaces=only), outputs=["x"]
        ) as faulty,
    ):
        undisturbed = run(plant)
        with pytest.warns(CosimWarning, match=WORDS[fault]) as caught:
            trace = run(faulty)
        assert len(caught) == 1
    for name, values in undisturbed.info.items():
        np.testing.assert_array_equal(trace.info[name], values)
    np.testing.assert_allclose(trace.y, undisturbed.y, rtol=1e-9)


@pytest.fixture(scope="module")
def fast_math_fmu(files: dict[str, bytes], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An FMU whose library flushes denormal numbers to zero as soon as it is loaded."""
    library = model_library("2.0", complete=True, fast_math=True)
    return write_archive(
        tmp_path_factory.mktemp("fast") / "fast.fmu", {**files, library_name("2.0"): library}
    )


@pytest.mark.parametrize("isolated", [False, True])
def test_fast_math(isolated: bool, fast_math_fmu: Path, faulty_fmus: dict[int, Path]) -> None:
    """It is told at the first reset, and once, however often it is loaded."""
    with FMUPlant(faulty_fmus[2], isolated=isolated) as plant:
        undisturbed = run(plant)
    with FMUPlant(fast_math_fmu, isolated=isolated) as plant:
        with pytest.warns(CosimWarning, match="takes denormal numbers for zero; it was put back") as caught:
            plant.reset()
        assert len(caught) == 1
        assert_same_figures(run(plant), undisturbed)
        assert_same_figures(run(plant), undisturbed)


def test_in_a_study(fast_math_fmu: Path, faulty_fmus: dict[int, Path], tmp_path: Path) -> None:
    """In the workers that run it: the same figures, and a warning in what is known of the plant."""
    traces = {}
    for path in (fast_math_fmu, faulty_fmus[2]):
        text = study_text(
            plant={"fmu": str(path), "outputs": ["y"]},
            reference={"y": 1e-310},
            controllers={"pid": {"type": "pid", "settings": {"proportional": 0.3}}},
        )
        results = run_file(write(tmp_path, text), path.stem)
        (case,) = results.cases
        traces[path.stem] = read_trace(case.folder)
        warned = read_run(case.folder)["provenance"].get("fmu_warnings", "")
        assert ("takes denormal numbers for zero" in warned) is (path == fast_math_fmu)
        assert ("takes denormal numbers for zero" in str(results.provenance)) is (path == fast_math_fmu)
    assert np.any(traces["faulty2"].u != 0.0)
    assert_same_figures(traces["fast"], traces["faulty2"])


@pytest.fixture
def rounding(tmp_path: Path) -> ctypes.CDLL:
    """C's own functions: the numbers of the ways to round are those of the machine."""
    compiler = find_compiler()
    library = tmp_path / f"rounding{compiler.platform.suffix}"
    functions = ["round_up", "round_to_nearest"]
    library.write_bytes(compile_library(compiler, {"rounding.c": _ROUNDING}, functions))
    return ctypes.CDLL(str(library))


def test_whoever_computes_otherwise_goes_on_so(rounding: ctypes.CDLL, faulty_fmus: dict[int, Path]) -> None:
    """What is put back is what was there before, the caller's own included; that is not the FMU's fault."""
    with FMUPlant(faulty_fmus[2]) as plant, warnings.catch_warnings():
        warnings.simplefilter("error")
        plant.reset()
        try:
            assert rounding.round_up() == 0
            plant.step(np.ones(1), H)
            after_a_step = departures()
            with KeptArithmetic():
                rounding.round_to_nearest()
            after_another = departures()
        finally:
            rounding.round_to_nearest()
        assert plant.warnings == ()
    assert (after_a_step, after_another) == ("rounds up", "rounds up")
