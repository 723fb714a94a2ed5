"""A controller of a study as an FMU: the loop of its case is set up, in a worker, up to its first sample."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.exporting import block_of, write_block
from ddpc_cosim.exporting.vector import SAMPLES, vector_of
from ddpc_cosim.study.case_runs import controller_of, run_case, started
from ddpc_cosim.study.cases import Case
from ddpc_cosim.study.problems import WholeStudy
from ddpc_cosim.study.resolve import ResolvedProblems
from ddpc_cosim.study.runner import Progress, answer_of
from ddpc_cosim.study.single import single_case
from ddpc_cosim.variables import DisplayUnit
from fmu_plants import Variable
from fmu_plants.export.platforms import ALL, parse_platforms
from fmu_plants.export.sampled_block import SampledBlock
from fmu_plants.model import ExportUsageError

_VECTOR = "test_vector.csv"
_SIGNALS = ("measurements", "references", "controls")


def export_from_study(
    resolved: ResolvedProblems,
    controller: str,
    path: Path | None,
    fmi_version: str,
    platforms: str | Sequence[str] | None,
    progress: Progress,
    *,
    problem: str | None = None,
    scenario: str | None = None,
    seed: int | None = None,
    sandboxed: bool = False,
) -> Path:
    """Write the FMU of a controller as it is at the first sample of one of its cases, and return its path.

    Parameters
    ----------
    resolved : ResolvedProblems
        The study.
    controller : str
        The controller's name there.
    path : Path or None
        The file; default: the controller's name, in the current folder.
    fmi_version, platforms
        As of :func:`ddpc_cosim.export_controller`.
    progress : Progress
        Follows what is done.
    problem, scenario : str or None
        Which of the study's; default: the only problem, the first scenario.
    seed : int or None
        Of the recording; default: the study's first.
    sandboxed : bool
        Whether the experiment runs in a sandbox.

    Raises
    ------
    CosimError
        The study has no such controller, problem or scenario; the controller cannot be exported; the
        experiment or the compiler fails.
    """
    path = path or Path(f"{controller}.fmu")
    _check_wishes(path, platforms)
    case, single = single_case(
        resolved,
        controller,
        progress,
        problem=problem,
        scenario=scenario,
        seed=seed,
        sandboxed=sandboxed,
    )
    facts = {
        "controller": controller,
        "study": resolved.head.name,
        "problem": "" if len(resolved.problems) == 1 else problem,
        "scenario": case.scenario,
        "seed": case.seed,
        "case": case.id,
    }
    progress.prepare(f"starting {case.name}")
    written = WholeStudy.of(single.study).toml().decode()
    answer = answer_of(case, partial(_block, name=path.stem, facts=facts, study=written))
    return write_block(_read(answer), path, fmi_version, platforms, progress.prepare)


def _check_wishes(path: Path, platforms: str | Sequence[str] | None) -> None:
    """Refuse before the experiment what cannot be written after it."""
    faults = []
    if not path.parent.is_dir():
        faults.append(f"the FMU cannot be written to {path}: there is no folder {path.parent}")
    try:
        parse_platforms(ALL if platforms is None else platforms)
    except ExportUsageError as error:
        faults.append(str(error))
    if faults:
        raise ConfigError(faults)


def _block(case: Case, name: str, facts: dict[str, Any], study: str) -> dict[str, Any]:
    """Return, in a worker, a case's controller as a block, in plain values."""
    controller, loop = started(case)
    block = block_of(controller, loop, name, facts, {"study.toml": study})
    late = max(case.conditions.delay.values(), default=0.0)
    steps = min(round(case.duration / case.sampling_time), SAMPLES + round(late / case.sampling_time))
    trace = run_case(replace(case, duration=steps * case.sampling_time))
    vector = {_VECTOR: vector_of(block, partial(controller_of, case), loop, trace)} if len(trace) else {}
    return asdict(replace(block, resources={**block.resources, **vector}))


def _read(answer: dict[str, Any]) -> SampledBlock:
    """Return the block that a worker told in plain values."""

    def variable(fields: dict[str, Any]) -> Variable:
        shown = fields["display_unit"]
        return Variable(**fields | {"display_unit": shown and DisplayUnit(**shown)})

    return SampledBlock(**answer | {key: [variable(signal) for signal in answer[key]] for key in _SIGNALS})
