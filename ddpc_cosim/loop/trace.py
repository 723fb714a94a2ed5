"""What one run leaves behind."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.controller import OK, Bounds, Charge
from ddpc_cosim.description import KeyFigureTags, applied_output
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.files.csv_files import write_table
from ddpc_cosim.files.durations import shown
from ddpc_cosim.files.tables import plain_table
from ddpc_cosim.files.texts import printable
from ddpc_cosim.key_figures import KeyFigures, TaggedSignal, factor_of
from ddpc_cosim.loop.plotting import Picture, drawn
from ddpc_cosim.metrics import MetricSettings, compute_installed_metrics, compute_metrics
from ddpc_cosim.responses import Actuation, BandResponse, Charged, Limits, Response, StepTimes, Tracking
from ddpc_cosim.variables import FloatArray, Variable, names

if TYPE_CHECKING:
    import pandas as pd


OWN_NOISE = "noise of the plant"
"""Stands among what acts on a plant that has noise of its own."""


class Outcome(StrEnum):
    """How a run ended. Only ``completed`` runs reached their last sample; the plant ``terminated`` others."""

    COMPLETED = "completed"
    DIVERGED = "diverged"
    FMU_ERROR = "fmu-error"
    FMU_DISCARDED = "fmu-discarded"
    FMU_FATAL = "fmu-fatal"
    CRASHED = "crashed"
    TIMED_OUT = "timed-out"
    CONTROLLER_ERROR = "controller-error"
    TERMINATED = "terminated"


@dataclass(frozen=True, slots=True, repr=False)
class Trace:
    """The samples of one run, how it ended, and what it was made from.

    Row k holds what was measured and decided at ``time[k]``; the inputs of the last row of a completed run
    were decided but not applied any more. A run that ended early keeps its samples up to the fault.

    Parameters
    ----------
    time : array, shape (K,)
        t0 + k * sampling_time [s].
    reference, y : array, shape (K, p)
        References and controlled outputs at ``time``, in the outputs' units; disturbances of the outputs are
        part of them.
    measured : array, shape (K, q)
        All measurements as the controller saw them; NaN where one was missing.
    u : array, shape (K, m)
        Inputs from ``time[k]`` on as the controller commanded them, within their bounds, in their units; NaN
        where it failed.
    status : tuple of str
        The controller's status per row, ``"ok"`` or why ``u`` is a fallback.
    solve_time : array, shape (K,)
        Wall-clock time of ``controller.step`` [s].
    inputs, outputs, measurements : tuple of Variable
        What the columns are.
    bounds : Bounds
        Limits of inputs and controlled outputs.
    sampling_time : float
        Time between rows [s].
    planned_samples : int
        Rows of a completed run.
    preview : int
        How many future references the controller saw.
    outcome : Outcome
        How the run ended.
    reason : str
        Why it ended early, with the time; empty if completed.
    transient : bool
        Whether it may end otherwise next time: the machine may be at fault.
    settings : dict
        Settings of the controller.
    diagnostics : dict
        What the controller says about its data or model.
    recorded_samples : int
        Length of the recording, where the controller needs one.
    knowledge : dict
        What the controller says it goes by: :meth:`ddpc_cosim.Controller.knowledge`.
    provenance : dict
        What the plant and the controller are: classes, versions, hashes.
    changed_inputs : tuple of Variable
        Inputs of which the plant may have been given something else: those with a disturbance or an actuator
        that has a delay or a rate limit, and those that no controller drives but a signal.
    applied : array, shape (K, len(changed_inputs))
        What the plant was given of them from ``time[k]`` on.
    info : dict of str to array, shape (K,)
        What the controller said of its steps, by name; NaN where it said nothing.
    warnings : tuple of str
        What spoke against the data or the model before the loop was closed.
    disturbances : tuple of Variable
        The known disturbances.
    d : array, shape (K, n_d)
        Them, as they were measured.
    forecast : array, shape (K, n_d)
        What the controller was told of them at up to five moments of the run: row k has what was expected of
        sample k at the last of these, NaN beyond its horizon and at these moments themselves; empty where
        there are no forecasts.
    bands : tuple of str
        The controlled outputs that are wanted within a band: their reference is its point nearest to them.
    band : array, shape (K, p, 2)
        Lower and upper edges for all outputs, both the reference where that is a line; empty without a band.
    moving_limits : tuple of str
        The inputs and controlled outputs whose limits change with time; ``bounds`` are the outermost.
    input_limits, output_limits : arrays, shapes (K, m, 2) and (K, p, 2)
        All limits over time; empty if none changes.
    charges : tuple of Charge
        The n_prices signals that are paid for.
    price, emission : arrays, shape (K, n_prices)
        What is paid and emitted per amount.
    charged : array, shape (K, n_prices)
        What the plant has of these signals: of an input from ``time[k]`` on, of an output at that time.
    monitors : tuple of Variable
        Outputs that were kept besides, whether or not a controller saw them.
    monitored : array, shape (K, len(monitors))
        Them, as they were.
    monitored_bands : tuple of str
        Those of them that are wanted within a band.
    monitored_band : array, shape (K, len(monitored_bands), 2)
        Lower and upper edges.
    substeps : int
        In how many communication steps the plant was advanced in a sampling interval.
    intersample_signals : tuple of Variable
        The q outputs that were read after each of them: those that are controlled, charged or monitored;
        none where there is one step.
    intersample : array, shape (K, (substeps - 1) * q)
        Them, as they were between ``time[k]`` and the next sample, all of one step after the other.
    engine : str
        What computed the samples: ``"compiled"``, or why it was Python though that was asked for; empty:
        Python, as nothing else was.
    acting : tuple of str
        Names of the declared disturbances, those that controllers know nothing of included; ``OWN_NOISE``
        where the plant has noise of its own.
    beyond_log : dict of str to float
        By input and output, in what share of the samples it was outside what the logs recorded that the plant
        is identified from, where it ever was; the most first.
    state : bytes
        The plant's state at the last sample, where it was asked for and the run completed; else empty.
    """

    time: FloatArray
    reference: FloatArray
    y: FloatArray
    measured: FloatArray
    u: FloatArray
    status: tuple[str, ...]
    solve_time: FloatArray
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    measurements: tuple[Variable, ...]
    bounds: Bounds
    sampling_time: float
    planned_samples: int
    preview: int = 0
    outcome: Outcome = Outcome.COMPLETED
    reason: str = ""
    transient: bool = False
    settings: dict[str, Any] = field(default_factory=dict)
    diagnostics: dict[str, float] = field(default_factory=dict)
    recorded_samples: int = 0
    knowledge: dict[str, str] = field(default_factory=dict)
    provenance: dict[str, str] = field(default_factory=dict)
    changed_inputs: tuple[Variable, ...] = ()
    applied: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    info: dict[str, FloatArray] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    disturbances: tuple[Variable, ...] = ()
    d: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    forecast: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    bands: tuple[str, ...] = ()
    band: FloatArray = field(default_factory=lambda: np.empty((0, 0, 2)))
    moving_limits: tuple[str, ...] = ()
    input_limits: FloatArray = field(default_factory=lambda: np.empty((0, 0, 2)))
    output_limits: FloatArray = field(default_factory=lambda: np.empty((0, 0, 2)))
    charges: tuple[Charge, ...] = ()
    price: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    emission: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    charged: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    monitors: tuple[Variable, ...] = ()
    monitored: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    monitored_bands: tuple[str, ...] = ()
    monitored_band: FloatArray = field(default_factory=lambda: np.empty((0, 0, 2)))
    substeps: int = 1
    intersample_signals: tuple[Variable, ...] = ()
    engine: str = ""
    intersample: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    acting: tuple[str, ...] = ()
    beyond_log: dict[str, float] = field(default_factory=dict)
    state: bytes = b""

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        samples = f"{len(self)} of {self.planned_samples} samples, {shown(self.sampling_time)} apart"
        signals = f"{' '.join(names(self.inputs))} -> {' '.join(names(self.outputs))}"
        return printable(f"Trace({self.outcome}, {samples}, {signals})")

    def _repr_html_(self) -> str:
        return plain_table(repr(self), ("metric", "value"), self.metrics().items()).html

    @property
    def completed(self) -> bool:
        """Whether the run reached its last sample."""
        return self.outcome is Outcome.COMPLETED

    @property
    def held(self) -> int:
        """Number of rows whose inputs were held over the sampling interval that follows."""
        return len(self) - 1 if self.completed else self.decided

    @property
    def decided(self) -> int:
        """Number of rows with inputs: a controller that ends the run leaves one without."""
        if len(self) == 0:
            return 0
        # What is left to the plant is not commanded from the first row on.
        each = zip(self.u[0].tolist(), self.u[-1].tolist(), strict=True)
        undecided = [not isfinite(last) for first, last in each if isfinite(first) or len(self) == 1]
        return len(self) - any(undecided)

    @property
    def communication_step(self) -> float:
        """How far the plant was advanced at once [s]."""
        return self.sampling_time / self.substeps

    @property
    def failures(self) -> int:
        """Number of samples at which the controller returned a fallback."""
        decided = self.decided
        return decided - self.status[:decided].count(OK)

    def metrics(self, settings: MetricSettings | None = None) -> dict[str, float]:
        """Return the metrics of :mod:`ddpc_cosim.metrics` by key, in the variables' display units.

        Parameters
        ----------
        settings : MetricSettings, optional
            What they depend on besides the samples, in a study; default: the preview of this run's own
            controller, and no quadratic cost.

        Warns
        -----
        CosimWarning
            A metric of a third party fails; its value is NaN.
        """
        settings = settings or MetricSettings(self.preview)
        return self._metrics(settings, self._responses(settings))

    def tracking(self, settings: MetricSettings | None = None) -> tuple[Tracking, ...]:
        """Return what the run is judged by, an entry per controlled output; parameters as in :meth:`metrics`.

        Whether it failed depends on what doing nothing comes to, too: in a study,
        :attr:`ddpc_cosim.CaseResult.failed`.
        """
        return _tracking(self._responses(settings or MetricSettings(self.preview)))

    def figures(self, settings: MetricSettings) -> tuple[dict[str, float], tuple[Tracking, ...]]:
        """Return :meth:`metrics` and :meth:`tracking`, which have much in common."""
        responses = self._responses(settings)
        return self._metrics(settings, responses), _tracking(responses)

    def _metrics(self, settings: MetricSettings, responses: Sequence[Response]) -> dict[str, float]:
        rows, h = slice(0, self.held), self.sampling_time
        table = compute_metrics(
            responses,
            [
                Actuation(variable, self.u[rows, i], self._limits(variable, i, of_input=True), h)
                for i, variable in enumerate(self.inputs)
            ],
            self.paid,
            StepTimes(self.solve_time, h, self.failures, len(self), settings.key_figures is not None),
            settings.cost,
            self._key_figures(settings.key_figures),
        )
        return table | compute_installed_metrics(self)

    def _responses(self, settings: MetricSettings) -> list[Response]:
        return [self._response(i, output, settings) for i, output in enumerate(self.outputs)]

    def _response(self, i: int, output: Variable, settings: MetricSettings) -> Response:
        rows = slice(0, self.held)
        of = (output, self.y[rows, i], self._limits(output, i), self.sampling_time, self.reference[rows, i])
        if output.name in self.bands:
            band = self.band[rows, i]
            return BandResponse(*of, settings.preview, self.preview, self._disturbed(), band=band)
        return Response(*of, settings.preview, self.preview, self._disturbed())

    def _limits(self, variable: Variable, i: int, *, of_input: bool = False) -> Limits:
        """Return the limits of an input or output at the held samples, arrays where they move."""
        limits = self._all_limits(variable, i, of_input=of_input)
        if isinstance(limits, tuple):
            return limits
        return limits[: self.held, 0], limits[: self.held, 1]

    def _all_limits(
        self, variable: Variable, i: int, *, of_input: bool = False
    ) -> tuple[float, float] | FloatArray:
        """Return the limits of an input or output at all samples, an array of shape (K, 2) if they move."""
        if variable.name in self.moving_limits and self.held:
            return (self.input_limits if of_input else self.output_limits)[:, i]
        bounds = self.bounds
        ends = (bounds.u_min, bounds.u_max) if of_input else (bounds.y_min, bounds.y_max)
        return float(ends[0][i]), float(ends[1][i])

    def _disturbed(self) -> NDArray[np.bool_] | None:
        """Return at which held samples a disturbance has another value than at the one before."""
        if not self.acting:
            return None
        courses = dict(zip(names(self.disturbances), self.d.T, strict=True))
        courses |= dict(zip(names(self.changed_inputs), self.applied.T, strict=True))  # what has really acted
        moves = np.zeros(self.held, dtype=bool)
        for name in courses.keys() & {*self.acting}:
            values = courses[name][: self.held]
            moves[1:] |= np.abs(np.diff(values)) > 1e-9 * np.ptp(values) if len(values) else False
        return moves

    @property
    def paid(self) -> Charged | None:
        """What is paid for; None without prices."""
        if not self.charges:
            return None
        held = {*names(self.inputs), *names(self.changed_inputs)}
        charged = [self._between(c.signal, self.charged[:, i]) for i, c in enumerate(self.charges)]
        steps = self.held * self.substeps
        price, emission = (
            np.repeat(table[: self.held], self.substeps, axis=0) for table in (self.price, self.emission)
        )
        return Charged.of(
            self.charges,
            np.column_stack(charged)[: steps + 1],
            held,
            price,
            emission,
            self.communication_step,
        )

    def _key_figures(self, tags: KeyFigureTags | None) -> KeyFigures | None:
        """Return what the key figures of a building are computed from; None without any."""
        if tags is None:
            return None
        sources = {signal: source for source, signals in tags.sources.items() for signal in signals}
        tagged = {name: self._tagged(name, source) for name, source in sources.items()}
        paid = [charge.unit for charge in self.charges if charge.signal in sources]
        return KeyFigures(
            tags,
            paid[0] if paid else "",
            any(signal.emits for signal in tagged.values() if signal is not None),
            self.communication_step,
            {name: signal for name, signal in tagged.items() if signal is not None},
            [self._moved(variable) for variable in self.inputs],
            self.completed,
        )

    def _tagged(self, name: str, source: str) -> TaggedSignal | None:
        """Return a signal of a source over the whole run; None where it is not known."""
        known = self._known(name)
        if known is None:
            return None
        variable, values = known
        factor = factor_of(source, variable.unit)
        limits = self._band_of(name)
        is_held = name in names((*self.inputs, *self.changed_inputs)) and name not in names(self.outputs)
        columns = [i for i, charge in enumerate(self.charges) if charge.signal == name]
        rates = np.array([self.charges[i].rate for i in columns]) / factor

        def repeated(table: FloatArray) -> FloatArray:
            return np.repeat(table, self.substeps, axis=0)[:steps]

        steps = (len(self) - 1) * self.substeps + 1
        return TaggedSignal(
            self._between(name, values)[:steps] * factor,
            self.communication_step,
            is_held,
            None if limits is None else repeated(limits) * factor,
            repeated(self.price[:, columns] @ rates) if columns else None,
            repeated(self.emission[:, columns] @ rates) if columns else None,
            holds=self.substeps > 1,
        )

    def _between(self, name: str, values: FloatArray) -> FloatArray:
        """Return a signal at the communication steps of all rows, shape (K * substeps,).

        ``values``, shape (K,), is it at the rows. An input, or what is not known after a fault, stays.
        """
        table = np.repeat(values[:, np.newaxis], self.substeps, axis=1)
        if name in names(self.intersample_signals):
            column = names(self.intersample_signals).index(name)
            table[:, 1:] = self.intersample[:, column :: len(self.intersample_signals)]
            known = np.where(np.isfinite(table), np.arange(self.substeps), 0)
            table = np.take_along_axis(table, np.maximum.accumulate(known, axis=1), axis=1)
        return table.ravel()

    def _known(self, name: str) -> tuple[Variable, FloatArray] | None:
        """Return a signal as the plant has it, with its variable; None where it was not kept."""
        kinds = (
            (self.monitors, self.monitored),
            (self.outputs, self.y),
            (self._charged_variables, self.charged),
            (self.changed_inputs, self.applied),
            (self.inputs, self.u),
        )
        for variables, table in kinds:
            for i, variable in enumerate(variables):
                if variable.name == name:
                    return variable, np.where(self._is_left(name), np.nan, table[:, i])
        return None

    def _is_left(self, name: str) -> NDArray[np.bool_]:
        """Return at which samples a signal is an input that is left to the plant."""
        if name not in names(self.inputs):
            return np.zeros(len(self), dtype=bool)
        return ~np.isfinite(self.u[:, names(self.inputs).index(name)])

    def _band_of(self, name: str) -> FloatArray | None:
        """Return the band of an output, shape (K, 2), that of what is monitored first; None without one."""
        if name in self.monitored_bands:
            return self.monitored_band[:, self.monitored_bands.index(name)]
        return self.band[:, names(self.outputs).index(name)] if name in self.bands else None

    def _moved(self, variable: Variable) -> TaggedSignal:
        """Return an input over the whole run; where it is left to the plant, what that says it applies."""
        applied = self._known(applied_output(variable.name))
        if applied is not None and applied[0].unit == variable.unit and self._is_left(variable.name).all():
            steps = (len(self) - 1) * self.substeps + 1
            return TaggedSignal(self._between(applied[0].name, applied[1])[:steps], self.communication_step)
        known = self._known(variable.name)
        assert known is not None
        return TaggedSignal(known[1], self.sampling_time, is_held=True)

    def plot(self, *others: "Trace", labels: Sequence[str] = ()) -> Picture:
        """Draw the samples in display units, over those of other runs of the same loop.

        Outputs have references or shaded bands, and limits that they come near; below are inputs,
        disturbances and prices. Of long runs time is in min, h or d.

        Parameters
        ----------
        *others : Trace
            Runs that are drawn along.
        labels : sequence of str
            What the runs are called, this one first; default: run 1, run 2, ...

        Returns
        -------
        picture : Picture
            It shows itself in a notebook; ``save`` writes it as SVG, PDF or PNG.

        Raises
        ------
        ConfigError
            The runs have other signals, or labels are too few, too many or the same.
        """
        runs = (self, *others)
        called = [*labels] or ([""] if len(runs) == 1 else [f"run {n}" for n in range(1, len(runs) + 1)])
        if len(called) != len(runs) or len({*called}) != len(runs):
            raise ConfigError(f"labels: {', '.join(called)}; needed: {len(runs)} different ones")
        picture: Picture = drawn("of_traces", dict(zip(called, runs, strict=True)))
        return picture

    def columns(self) -> dict[str, FloatArray]:
        """Return the numeric columns under the headers of ``signals.csv``, each of shape (K,).

        Headers are ``name [unit]``, values in the variables' own units, as exchanged with the plant. A
        reference is prefixed with ``reference``; a measurement that differs from the controlled output of its
        name (by noise) with ``measured``, and left out where it does not; an output or input whose header is
        taken with ``output`` or ``input``; what the plant was given of an input, where that may differ from
        what a controller commanded, with ``applied``. What the controller said of its steps is ``info.NAME``.
        The edges of a band are prefixed with ``lower`` and ``upper``, limits that change with ``min`` and
        ``max``, known disturbances as they were measured with ``disturbance``, and what was expected of
        them at a few moments with ``forecast``; of prices there are ``price``,
        ``emission`` and, of the signal that is paid for, ``charged``; outputs that were kept besides are
        prefixed with ``monitored``, and the edges of their bands with ``monitored lower`` and ``upper``. What
        outputs were between a row and the next is prefixed with ``after 300 s``, and how long after it is.
        """
        return self._columns(lambda variable, values: (variable.header, values))

    def write_csv(self, path: str | Path) -> None:
        """Write the samples as a study does: ``columns`` and ``status``, one row per sample.

        ``Recording.read_csv`` reads them back as data to learn from.
        """
        write_table(Path(path), self.columns(), {"status": self.status})

    def frame(self) -> "pd.DataFrame":
        """Return the samples as a DataFrame: ``status``, and ``columns`` in the variables' display units."""
        import pandas as pd

        def shown(variable: Variable, values: FloatArray) -> tuple[str, FloatArray]:
            unit = variable.shown_in
            return f"{variable.name} [{unit.name or '1'}]", unit.from_unit(values)

        return pd.DataFrame({**self._columns(shown), "status": np.asarray(self.status, dtype=object)})

    def _columns(
        self, shown: Callable[[Variable, FloatArray], tuple[str, FloatArray]]
    ) -> dict[str, FloatArray]:
        """Return header and values of all columns, of each variable as it is to be shown."""
        table = {"time [s]": self.time}
        info = {f"info.{name}": values for name, values in self.info.items()}
        reserved = {"time [s]", "solve_time [s]", *info}
        for i, output in enumerate(self.outputs):
            header, values = shown(output, self.y[:, i])
            _, table[f"reference {header}"] = shown(output, self.reference[:, i])
            table[("output " if header in reserved else "") + header] = values
        for i, variable in enumerate(self.measurements):
            header, values = shown(variable, self.measured[:, i])
            if header not in reserved | table.keys():
                table[header] = values
            elif not np.array_equal(table.get(header, ()), values):
                table[f"measured {header}"] = values
        for i, variable in enumerate(self.inputs):
            header, values = shown(variable, self.u[:, i])
            table[("input " if header in reserved | table.keys() else "") + header] = values
        for i, variable in enumerate(self.changed_inputs):
            header, values = shown(variable, self.applied[:, i])
            table[f"applied {header}"] = values
        for title, variable, values in self._further():
            header, values = shown(variable, values)
            table[f"{title} {header}"] = values
        table["solve_time [s]"] = self.solve_time
        table |= info
        for i, prefix in enumerate(self.intersample_prefixes):
            for j, variable in enumerate(self.intersample_signals):
                column = self.intersample[:, i * len(self.intersample_signals) + j]
                header, values = shown(variable, column)
                table[f"{prefix} {header}"] = values
        return table

    @property
    def intersample_prefixes(self) -> list[str]:
        """What headers of columns begin with of what was between rows, a prefix per communication step."""
        return [f"after {i * self.communication_step:.12g} s" for i in range(1, self.substeps)]

    def _further(self) -> Iterator[tuple[str, Variable, FloatArray]]:
        """Yield bands, limits that change, disturbances and prices: prefix of a column, variable, values."""
        for i, output in enumerate(self.outputs):
            if output.name in self.bands:
                yield "lower", output, self.band[:, i, 0]
                yield "upper", output, self.band[:, i, 1]
        for variables, limits in ((self.inputs, self.input_limits), (self.outputs, self.output_limits)):
            for i, variable in enumerate(variables):
                if variable.name in self.moving_limits:
                    yield "min", variable, limits[:, i, 0]
                    yield "max", variable, limits[:, i, 1]
        for i, variable in enumerate(self.disturbances):
            yield "disturbance", variable, self.d[:, i]
            if self.forecast.size:
                yield "forecast", variable, self.forecast[:, i]
        for i, (charge, variable) in enumerate(zip(self.charges, self._charged_variables, strict=True)):
            yield "price", Variable(charge.name, f"{charge.unit}/{charge.amount}"), self.price[:, i]
            yield "emission", Variable(charge.name, f"kg/{charge.amount}"), self.emission[:, i]
            yield "charged", replace(variable, name=charge.name), self.charged[:, i]
        for i, variable in enumerate(self.monitors):
            yield "monitored", variable, self.monitored[:, i]
            if variable.name in self.monitored_bands:
                edges = self.monitored_band[:, self.monitored_bands.index(variable.name)]
                yield "monitored lower", variable, edges[:, 0]
                yield "monitored upper", variable, edges[:, 1]

    @property
    def _charged_variables(self) -> list[Variable]:
        """The signals that are paid for; what takes no part in the loop is known by its name alone."""
        known = (*self.measurements, *self.outputs, *self.disturbances, *self.changed_inputs, *self.inputs)
        by_name = {variable.name: variable for variable in known}
        return [by_name.get(charge.signal, Variable(charge.signal)) for charge in self.charges]


def _tracking(responses: Sequence[Response]) -> tuple[Tracking, ...]:
    with np.errstate(over="ignore", invalid="ignore"):  # a run can have values of any size
        return tuple(response.tracking for response in responses)
