"""Open loop: a plant on given signals of its inputs, in a process of its own, and what came of it.

It is the loop of a study without a controller: one case that runs in a worker. Inputs are held from sample
to sample, outputs are those at the end of each interval.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ddpc_cosim.errors import ConfigError, CosimError, CosimWarning
from ddpc_cosim.files.csv_files import CSVFile, split_unit, write_table
from ddpc_cosim.files.durations import EXPECTED_MOMENT, moment_of
from ddpc_cosim.loop.master import Resumption
from ddpc_cosim.loop.safe_calls import DEFAULT_STEP_TIMEOUT
from ddpc_cosim.loop.trace import Outcome, Trace
from ddpc_cosim.plant import FMIType, ParameterValue
from ddpc_cosim.processes.sandbox import demanded
from ddpc_cosim.processes.scratch import ScratchFolder
from ddpc_cosim.signals.signals import values_at
from ddpc_cosim.simulation.golden import OUTCOME, TIME, Difference
from ddpc_cosim.simulation.request import Prepared, SimulationRequest, prepare
from ddpc_cosim.simulation.state_file import PlantState
from ddpc_cosim.study.case_files import load_case
from ddpc_cosim.study.case_runs import partial_trace
from ddpc_cosim.study.runner import Update, run_cases
from ddpc_cosim.variables import FloatArray, Variable, not_names

if TYPE_CHECKING:
    import pandas as pd

INTERRUPTED = "interrupted"


@dataclass(frozen=True, slots=True)
class Simulation:
    """What a simulation left behind.

    Parameters
    ----------
    plant : str
        The FMU's file name, or the plant's name.
    time : array, shape (K,)
        Sample times [s].
    outputs, inputs : tuple of Variable
        What was recorded, and what was driven.
    y, u : array, shapes (K, p) and (K, m)
        Outputs at ``time``, and inputs held from there on, in their units.
    sampling_time : float
        Time between samples [s].
    planned_samples : int
        Samples of a run that reaches its stop time.
    outcome : str
        A value of :class:`ddpc_cosim.Outcome`, or ``"interrupted"``.
    reason : str
        Why it ended early; empty if completed.
    notes : tuple of str
        What was chosen where nothing was said, and the FMU's warnings.
    provenance : dict
        What the plant is.
    interrupted_by : KeyboardInterrupt or None
        What interrupted it.
    state : PlantState or None
        The plant at its last sample, where that was asked for and reached.
    """

    plant: str
    time: FloatArray
    outputs: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    y: FloatArray
    u: FloatArray
    sampling_time: float
    planned_samples: int
    outcome: str
    reason: str
    notes: tuple[str, ...]
    provenance: dict[str, str]
    interrupted_by: KeyboardInterrupt | None = None
    state: PlantState | None = None

    @property
    def completed(self) -> bool:
        """Whether it reached its last sample."""
        return self.outcome == Outcome.COMPLETED

    @property
    def failed(self) -> bool:
        """Whether something ended it that neither the stop time nor the plant itself asked for."""
        return self.outcome not in (Outcome.COMPLETED, Outcome.TERMINATED)

    def columns(self) -> dict[str, FloatArray]:
        """Return time, outputs and inputs under headers ``name [unit]``, each of shape (K,)."""
        table = {f"{TIME} [s]": self.time}
        for variables, values, what in ((self.outputs, self.y, "output"), (self.inputs, self.u, "input")):
            for i, variable in enumerate(variables):
                header = variable.header
                table[f"{what} {header}" if header in table else header] = values[:, i]
        return table

    def compare(self, prepared: "Prepared", rel: float) -> Difference | None:
        """Compare it with the golden file that it was prepared for; None if there is none."""
        if prepared.golden is None:
            return None
        columns = np.column_stack((self.y, self.u))
        named = {v.name: columns[:, i] for i, v in enumerate((*self.outputs, *self.inputs))}
        return prepared.golden.compare(named, rel, f"{self.outcome}: {self.reason}")

    def write_csv(self, path: Path) -> None:
        """Write the columns; one more, of texts, says how a run ended that was not completed."""
        ended = {} if self.completed else {OUTCOME: [self.outcome] * len(self.time)}
        write_table(path, self.columns(), ended)

    def frame(self) -> "pd.DataFrame":
        """Return the columns as a DataFrame, as :func:`simulate` does."""
        import pandas as pd

        frame = pd.DataFrame(self.columns())
        if not self.completed:
            frame[OUTCOME] = self.outcome
        frame.attrs |= {OUTCOME: self.outcome, "reason": self.reason, "notes": list(self.notes)}
        return frame


def simulate(
    plant: str | Path,
    *,
    inputs: "pd.DataFrame | str | Path | None" = None,
    parameters: Mapping[str, ParameterValue] | None = None,
    start: float | str | date | None = None,
    stop: float | str | date | None = None,
    step: float | None = None,
    outputs: Sequence[str] | None = None,
    fmi_type: FMIType = "auto",
    library_path: Sequence[str | Path] = (),
    step_timeout: float = DEFAULT_STEP_TIMEOUT,
    trace_calls: str | Path | None = None,
    sandbox: bool = False,
    save_state: str | Path | None = None,
    load_state: str | Path | None = None,
    coupling: Mapping[str, Any] | None = None,
) -> "pd.DataFrame":
    """Simulate a plant in open loop, in a process of its own.

    Parameters
    ----------
    plant : str or Path
        An FMU, an SSP archive, whose parts exchange values once a step if ``coupling`` does not say
        otherwise, the name of a plant, or ``module:attribute``.
    inputs : DataFrame, str or Path, optional
        Signals of inputs: a frame or a CSV file with a column ``time`` (or a frame's index), and one
        for each input to drive, its unit in brackets if it is not the plant's own. Real inputs that are
        continuous are interpolated, others hold; inputs without a column keep their start values.
    parameters : mapping of str to float, int, bool or str, optional
        Parameters, start values, and inputs that are not driven. A number may have its unit: ``"50 [cm]"``.
    start, stop : float, str or date, optional
        Start and end of the run [s], or moments as of ``loop.start_time`` of a study: ``"day 23"``, a date of
        which the time of its year counts, ``"8 h"``. Default: the FMU's default experiment, else 0 and the
        end of the inputs or 10 s. The times of ``inputs`` and of the result are on the same axis.
    step : float, optional
        Time between samples [s]; default: the FMU's default experiment, else 500 intervals.
    outputs : sequence of str, optional
        What is recorded; default: the outputs, of an FMU without any its states or local variables.
    fmi_type : str
        How an FMU is run, as in :class:`FMUPlant`.
    library_path : sequence of str or Path
        Libraries that FMUs need, as of :class:`FMUPlant`.
    step_timeout : float
        Longest time for any call of the plant [s].
    trace_calls : str or Path, optional
        File that every FMI call is written to.
    sandbox : bool
        Whether it runs in a sandbox, as of :class:`FMUPlant`.
    save_state : str or Path, optional
        File for the plant's state at the last sample, which another simulation can go on from; nothing is
        written of a run that ends early.
    load_state : str or Path, optional
        Such a file, of this very plant: the run begins at its time, with its parameters and its step, and
        ``parameters`` may only change what is tunable.
    coupling : mapping of str to float or str, optional
        How the parts of an SSP archive are coupled: the keys of ``plant.coupling`` in a study file, such as
        ``{"algorithm": "monolithic"}``.

    Returns
    -------
    frame : DataFrame
        Columns ``time [s]``, outputs and driven inputs, in the plant's units. ``frame.attrs`` has outcome,
        reason and notes. A run that ended early has a last column ``outcome``.

    Raises
    ------
    ConfigError
        What is asked for is not possible; all faults at once.
    CosimError
        The plant cannot be loaded, or fails before its first sample.

    Warns
    -----
    CosimWarning
        The run ended early.

    Examples
    --------
    >>> frame = simulate(pendulum_fmu, parameters={"angle": 0.1}, stop=1.0, step=0.01)
    >>> list(frame.columns)
    ['time [s]', 'angle [rad]', 'rate [rad/s]']
    """
    faults = [
        f"{name} = {value!r} is not possible; needed: {words}"
        for name, value, fits, words in (
            ("plant", plant, isinstance(plant, str | Path), "a file or the name of a plant"),
            ("inputs", inputs, _are_signals(inputs), "a DataFrame, or the name of a CSV file"),
            (
                "parameters",
                parameters,
                isinstance(parameters, Mapping | None),
                "a mapping of names to values",
            ),
            *(
                (name, moment, isinstance(moment, Real | str | date | None), EXPECTED_MOMENT)
                for name, moment in (("start", start), ("stop", stop))
            ),
            ("step", step, isinstance(step, Real | None), "a number of seconds"),
            ("step_timeout", step_timeout, isinstance(step_timeout, Real), "a number of seconds"),
            *(
                (name, path, isinstance(path, str | Path | None), "the name of a file")
                for name, path in (
                    ("trace_calls", trace_calls),
                    ("save_state", save_state),
                    ("load_state", load_state),
                )
            ),
            ("coupling", coupling, isinstance(coupling, Mapping | None), "a mapping of names to values"),
        )
        if not fits
    ]
    if outputs is not None and (fault := not_names("outputs", outputs)):
        faults.append(fault)
    moments = list[float | None]()
    for name, moment in (("start", start), ("stop", stop)):
        try:
            moments.append(moment_of(moment))
        except ValueError as error:
            faults.append(f"{name} = {moment!r} is not possible: {error}")
    if faults:
        raise ConfigError(faults)
    request = SimulationRequest(
        plant=str(plant),
        inputs=None if inputs is None else _input_file(inputs),
        values=parameters or {},
        start=moments[0],
        stop=moments[1],
        step=step,
        outputs=outputs,
        fmi_type=fmi_type,
        library_path=[str(Path(place).absolute()) for place in library_path],
        step_timeout=step_timeout,
        trace_calls=str(trace_calls or ""),
        resumed=None if load_state is None else PlantState.read(Path(load_state)),
        keeps_state=save_state is not None,
        coupling=coupling or {},
    )
    with demanded(sandbox):
        prepared = prepare(request)
    simulation = run(prepared, sandboxed=sandbox)
    if simulation.interrupted_by is not None:
        raise simulation.interrupted_by
    if not len(simulation.time):
        raise CosimError(f"{simulation.plant}: {simulation.outcome}: {simulation.reason}")
    if simulation.state is not None and save_state is not None:
        simulation.state.write(Path(save_state))
    if not simulation.completed:
        text = f"{simulation.plant}: {simulation.outcome}: {simulation.reason}"
        warnings.warn(text, CosimWarning, stacklevel=2)
    return simulation.frame()


def _are_signals(inputs: object) -> bool:
    return isinstance(inputs, str | Path | None) or hasattr(inputs, "to_csv")


def _input_file(inputs: "pd.DataFrame | str | Path") -> CSVFile:
    if isinstance(inputs, str | Path):
        return CSVFile(Path(inputs))
    has_time = any(split_unit(str(column))[0] == TIME for column in inputs.columns)
    text = inputs.to_csv(index=not has_time, index_label=TIME)
    return CSVFile(Path("inputs"), text)


def run(
    prepared: Prepared, watch: Callable[[Update], None] | None = None, *, sandboxed: bool = False
) -> Simulation:
    """Run a simulation in a worker, or a sandbox; what ends it early is in its outcome, an interrupt too.

    Raises
    ------
    KeyboardInterrupt
        It was interrupted before its first sample.
    """
    case, latest = prepared.case, list[Update]()

    def look(update: Update) -> None:
        latest[:] = [update]
        if watch is not None:
            watch(update._replace(case=prepared.label))

    with ScratchFolder() as folder:
        try:
            for _ in run_cases([case], folder, 1, look, sandboxed=sandboxed):
                pass
            trace = load_case(folder / case.id).trace()
            outcome, reason = trace.outcome.value, trace.reason
        except KeyboardInterrupt as interrupt:
            for update in latest:
                update.rows.look()
            if not latest or not latest[0].rows.count:
                raise
            trace = partial_trace(case, latest[0].rows, Outcome.CRASHED, "")
            return replace(_result(prepared, trace, INTERRUPTED, ""), interrupted_by=interrupt)
    return _result(prepared, trace, outcome, reason)


def _result(prepared: Prepared, trace: Trace, outcome: str, reason: str) -> Simulation:
    case, warnings = prepared.case, trace.provenance.get("fmu_warnings", "")
    if not trace.completed and len(trace):
        reason = f"{len(trace)} of {trace.planned_samples} samples, to t = {trace.time[-1]:g} s" + (
            f": {reason}" if reason else ""
        )
    u = [values_at(signal, name, trace.time) for name, signal in prepared.driven.items()]
    return Simulation(
        plant=prepared.label,
        time=trace.time,
        outputs=case.measurements,
        inputs=case.undriven,
        y=trace.measured,
        u=np.column_stack(u) if u else np.empty((len(trace), 0)),
        sampling_time=case.sampling_time,
        planned_samples=trace.planned_samples,
        outcome=outcome,
        reason=reason,
        notes=(*prepared.notes, *([f"the FMU: {warnings}"] if warnings else [])),
        provenance=trace.provenance,
        state=_state(prepared, trace),
    )


def _state(prepared: Prepared, trace: Trace) -> PlantState | None:
    """Return the plant's state at the last sample, if the run has left it."""
    case, last = prepared.case, trace.time[-2:-1]  # inputs are held from there on to the last sample
    if not trace.state:
        return None
    earlier = prepared.resumed
    before = case.resumed or Resumption(b"", case.start_time)
    held = {name: float(values_at(signal, name, last)[0]) for name, signal in prepared.driven.items()}
    return PlantState(
        plant=prepared.label,
        content=prepared.content,
        platform=prepared.platform,
        reset_time=before.reset_time,
        start_time=case.start_time,
        sampling_time=case.sampling_time,
        samples=before.samples + len(trace) - 1,
        parameters=case.parameters,
        changed={**(earlier.changed if earlier else {}), **before.changed},
        inputs={**(earlier.inputs if earlier else {}), **held},
        state=trace.state,
    )
