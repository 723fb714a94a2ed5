"""The controller contract: what a plug-in implements, and what the loop tells it."""

import hashlib
import inspect
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cache, wraps
from itertools import accumulate, pairwise
from numbers import Integral
from pathlib import Path
from types import FunctionType, MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from ddpc_cosim.codec import read
from ddpc_cosim.errors import ConfigError, DataError
from ddpc_cosim.files.csv_files import Column, write_table
from ddpc_cosim.files.logs import LogFormat, read_log
from ddpc_cosim.settings import SettingsError, check_settings, instead_of, to_plain
from ddpc_cosim.variables import FloatArray, Variable
from fmu_plants.spelling import did_you_mean

if TYPE_CHECKING:
    from ddpc_cosim.inspection.logs import LogSummary

OK = "ok"
_TABLES = ("u", "y", "measured", "d", "excitation")
_NOTHING: FloatArray = np.empty(0)
_NO_INFO: Mapping[str, float] = MappingProxyType({})
_NO_COLUMNS: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Bounds:
    """Limits of inputs and controlled outputs, in their units; infinite where there is none.

    Parameters
    ----------
    u_min, u_max : array, shape (m,)
        Input limits. The master saturates at them.
    y_min, y_max : array, shape (p,)
        Output limits: a wish that controllers may honour and metrics measure.
    """

    u_min: FloatArray
    u_max: FloatArray
    y_min: FloatArray
    y_max: FloatArray


@dataclass(frozen=True, slots=True)
class Recording:
    """An experiment, or several one after the other: row i is measured before ``u[i]`` is applied.

    Several are a mosaic: each of its pieces goes on from row to row, and no window of rows may cross a seam.

    Parameters
    ----------
    u : array, shape (T, m)
        Inputs, time along axis 0.
    y : array, shape (T, p)
        Controlled outputs.
    measured : array, shape (T, q)
        All measurements.
    sampling_time : float
        Time between rows [s].
    seams : tuple of int
        The first row of every piece but the first; empty: the rows are one experiment.
    d : array, shape (T, n_d), optional
        Known disturbances, as they were measured; default: there are none, shape (T, 0).
    treatments : tuple of str, optional
        What was done to the logs that it comes from, such as ``"3 cells interpolated"``.
    excitation : array, shape (T, n_w), optional
        What moved the inputs from outside, whatever was measured: what was added to those of a controller,
        or its setpoints; default: not known, shape (T, 0).

    Raises
    ------
    DataError
        The arrays disagree in length, are not two-dimensional, or hold NaN or infinity; or seams that are
        not rows in their order.
    """

    u: FloatArray
    y: FloatArray
    measured: FloatArray
    sampling_time: float
    seams: tuple[int, ...] = ()
    d: FloatArray = field(default_factory=lambda: _NOTHING.reshape(0, 0))
    treatments: tuple[str, ...] = ()
    excitation: FloatArray = field(default_factory=lambda: _NOTHING.reshape(0, 0))

    def __post_init__(self) -> None:
        for name in ("d", "excitation"):
            table = getattr(self, name)
            if table.ndim == 2 and table.shape[1] == 0:  # of whatever length the other arrays had
                object.__setattr__(self, name, np.empty((len(self.u), 0)))
        shapes = {name: getattr(self, name).shape for name in _TABLES}
        if any(len(shape) != 2 for shape in shapes.values()) or len({s[0] for s in shapes.values()}) != 1:
            needed = "(T, m), (T, p), (T, q), (T, n_d) and (T, n_w)"
            raise DataError(
                f"recording: {', '.join(_TABLES[:-1])} and {_TABLES[-1]} need shapes {needed}; got {shapes}"
            )
        for name, shape in shapes.items():
            if shape[1] and not (is_finite := np.isfinite(getattr(self, name))).all():
                row, column = np.argwhere(~is_finite)[0]
                raise DataError(f"recording: {name}[{row}, {column}] is not finite")
        if any(first >= last for first, last in pairwise((0, *self.seams, len(self)))) and self.seams:
            raise DataError(
                f"recording: seams = {self.seams}; needed: rows from 1 to {len(self) - 1}, in order"
            )

    @classmethod
    def join(cls, recordings: Sequence["Recording"]) -> "Recording":
        """Return several recordings as one, with a seam between one and the next.

        Raises
        ------
        DataError
            There is none, or they have different signals or sampling times.
        """
        if not recordings:
            raise DataError("recordings: there are none to join")
        shapes = {tuple(getattr(part, name).shape[1] for name in _TABLES) for part in recordings}
        if len(shapes) > 1:
            numbers = ", ".join(map(str, sorted(shapes)))
            what = "(inputs, outputs, measurements, disturbances, excitation)"
            raise DataError(f"recordings: different numbers of {what}: {numbers}")
        times = {recording.sampling_time for recording in recordings}
        if max(times) - min(times) > 1e-9 * max(times):
            raise DataError(f"recordings: different sampling times: {sorted(times)} s")
        pieces = [piece for recording in recordings for piece in recording.pieces]
        first = list(accumulate(map(len, pieces)))
        u, y, measured, d, excitation = (
            np.vstack([getattr(piece, name) for piece in pieces]) for name in _TABLES
        )
        treatments = tuple(words for recording in recordings for words in recording.treatments)
        seams, sampling_time = tuple(first[:-1]), recordings[0].sampling_time
        return cls(u, y, measured, sampling_time, seams, d, treatments, excitation)

    @classmethod
    def read_csv(
        cls,
        *paths: str | Path,
        sampling_time: float,
        inputs: Sequence[Variable | str],
        outputs: Sequence[Variable | str],
        measurements: Sequence[Variable | str] = (),
        disturbances: Sequence[Variable | str] = (),
        excitation: Sequence[Variable | str] = (),
        columns: Mapping[str, str] = _NO_COLUMNS,
        **format: Any,
    ) -> "Recording":
        """Return what was logged in one CSV or Parquet file or several, which are pieces of a mosaic.

        Parameters
        ----------
        *paths : str or Path
            The files: text with a header, columns separated by commas, semicolons or tabs.
        sampling_time : float
            Time between rows [s].
        inputs, outputs, measurements, disturbances : sequence of Variable or str
            The signals, each in a column of its name; no measurements: the outputs. A variable's values are
            converted from the unit of the column's header to its own; those of a bare name are as they stand.
        excitation : sequence of Variable or str
            What moved the inputs from outside, likewise: see :class:`Recording`.
        columns : mapping of str to str
            Headers of the columns that are not called as their signals.
        **format
            How the files are read, and what is done about what is wrong with them: ``time_column``,
            ``time_tolerance``, ``dates``, ``time_zone``, ``encoding``, ``gaps``, ``missing``,
            ``missing_values``, ``duplicates``, ``resample`` and ``outliers``, as the keys of ``recording`` in
            a study file.

        Raises
        ------
        ConfigError
            A key of the format is unknown or impossible.
        DataError
            All that is wrong with the files, a line for each kind of fault: missing columns, units that do
            not fit, cells that are not finite numbers, uneven times, with the first places and the remedy.
        """
        tables = (inputs, outputs, measurements or outputs, disturbances, excitation)
        kinds = [list(table) for table in tables]
        signals = {_name(signal): signal for kind in kinds for signal in kind}
        wanted = [
            Column(None if isinstance(signal, str) else signal, columns.get(name, name))
            for name, signal in signals.items()
        ]
        places = {name: i for i, name in enumerate(signals)}
        u, y, measured, d, w = ([places[_name(signal)] for signal in kind] for kind in kinds)
        log = read_log(
            paths,
            sampling_time=sampling_time,
            format=read(LogFormat, format),
            columns=wanted,
            held=[_name(signal) for kind in (inputs, disturbances, excitation) for signal in kind],
        )
        signals_of = (log.values[:, u], log.values[:, y], log.values[:, measured])
        words = tuple(treatment.words for treatment in log.treatments)
        return cls(*signals_of, sampling_time, log.seams, log.values[:, d], words, log.values[:, w])

    def write_csv(
        self,
        path: str | Path,
        inputs: Sequence[Variable | str],
        outputs: Sequence[Variable | str],
        measurements: Sequence[Variable | str] = (),
        disturbances: Sequence[Variable | str] = (),
        excitation: Sequence[Variable | str] = (),
    ) -> None:
        """Write a CSV file that :meth:`read_csv` gives back; parameters as there.

        What moved the inputs from outside is left out where ``excitation`` does not name it.

        Raises
        ------
        DataError
            There are several pieces, which need a file each, other numbers of signals, or two signals with
            different values under one name.
        """
        if self.seams:
            raise DataError(
                f"recording: {len(self.pieces)} pieces do not go into one file: write each of them"
            )
        table = {"time [s]": np.arange(len(self), dtype=np.float64) * self.sampling_time}
        signals = (inputs, outputs, measurements or outputs, disturbances, excitation)
        for kind, values in zip(signals, (getattr(self, name) for name in _TABLES), strict=True):
            if len(kind) != values.shape[1] and (kind or values is not self.excitation):
                raise DataError(f"recording: {len(kind)} signals for {values.shape[1]} columns: {kind}")
            for signal, column in zip(kind, values.T, strict=False):
                header = signal if isinstance(signal, str) else signal.header
                if not np.array_equal(table.setdefault(header, column), column):
                    raise DataError(
                        f'recording: "{header}" has different values as one signal and as another'
                    )
        write_table(Path(path), table, {})

    def summary(
        self,
        inputs: Sequence[Variable | str] = (),
        outputs: Sequence[Variable | str] = (),
        disturbances: Sequence[Variable | str] = (),
    ) -> "LogSummary":
        """Return what the recording is good for, as ``ddpc-cosim inspect`` says it of a log.

        Parameters
        ----------
        inputs, outputs, disturbances : sequence of Variable or str
            Names and units of the signals; default: u1, u2, ..., y1, ... and d1, ...
        """
        from ddpc_cosim.inspection.logs import summary_of

        return summary_of(self, inputs, outputs, disturbances)

    @property
    def pieces(self) -> tuple["Recording", ...]:
        """The experiments that it consists of."""
        ends = pairwise((0, *self.seams, len(self)))
        return tuple(
            replace(self, **{name: getattr(self, name)[i:j] for name in _TABLES}, seams=(), treatments=())
            for i, j in ends
        )

    @property
    def digest(self) -> str:
        """A hash of its content: SHA-256, in hexadecimal digits."""
        content = hashlib.sha256(repr((self.seams, self.sampling_time)).encode())
        further = (table for table in (self.d, self.excitation) if table.size)
        for array in (self.u, self.y, self.measured, *further):
            content.update(repr(array.shape).encode() + array.tobytes())
        return content.hexdigest()

    def __len__(self) -> int:
        return len(self.u)


def _name(signal: Variable | str) -> str:
    return signal if isinstance(signal, str) else signal.name


class Charge(NamedTuple):
    """What a signal costs over time, but for the price: that is :attr:`Sample.price`.

    An input or a measurement held at x over one sampling time costs ``price * rate * x * sampling_time``.

    Parameters
    ----------
    name : str
        Name of the price.
    signal : str
        The input or measurement that is paid for.
    rate : float
        Amounts that one unit of the signal comes to in a second: 1 / 3.6e6 kWh where it is power in W.
    unit : str
        Unit of the money, such as ``"EUR"``.
    known : bool
        Whether prices of the future are known; otherwise that of now is held over the horizon.
    amount : str
        Unit of the amounts, such as ``"kWh"``.
    """

    name: str
    signal: str
    rate: float
    unit: str
    known: bool
    amount: str = "1"


@dataclass(frozen=True, slots=True)
class Loop:
    """What a controller learns about the loop before its first sample.

    Parameters
    ----------
    sampling_time : float
        Time between samples [s].
    inputs, outputs, measurements : tuple of Variable
        The m inputs, p controlled outputs and q measurements.
    bounds : Bounds
        Limits of inputs and controlled outputs; of those that move with time the outermost.
    recording : Recording or None
        The experiments to learn from, where the study has some.
    rng : numpy.random.Generator
        The only source of randomness a controller may use: seeded by the case.
    preview : int
        How many of the future references this controller is told: its horizon, or fewer where the study
        limits how far anyone may look ahead.
    continues_recording : bool
        The loop goes on where the recording, which is one piece, ended. Otherwise it starts from rest:
        before the first sample the inputs were at their start values and the measurements as they are at
        that sample.
    disturbances : tuple of Variable
        The n_d known disturbances: what acts on the plant besides the inputs, and is measured.
    bands : tuple of str
        The controlled outputs that are wanted within a band in place of at a reference.
    moving_limits : tuple of str
        The inputs and controlled outputs whose limits change with time: see :attr:`Sample.input_limits`.
    charges : tuple of Charge
        The n_prices signals that are paid for.
    past : Recording or None
        The last samples before the first one, up to that just before it, where the controller takes over a
        running plant; None: it starts from rest, as above.
    """

    sampling_time: float
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    measurements: tuple[Variable, ...]
    bounds: Bounds
    recording: Recording | None
    rng: np.random.Generator
    preview: int = 1
    continues_recording: bool = False
    disturbances: tuple[Variable, ...] = ()
    bands: tuple[str, ...] = ()
    moving_limits: tuple[str, ...] = ()
    charges: tuple[Charge, ...] = ()
    past: Recording | None = None


class Sample(NamedTuple):
    """What a controller sees at one sample.

    Parameters
    ----------
    k : int
        Number of the sample, 0 at the start.
    time : float
        t0 + k * sampling_time [s].
    y : array, shape (p,)
        Controlled outputs, measured now.
    measured : array, shape (q,)
        All measurements, taken now.
    reference : array, shape (horizon, p)
        Future references r_{k+1} ... r_{k+horizon}, time along axis 0. Those beyond the loop's preview are
        not known: the last one that is known, with a preview of 0 the setpoint, stands in their place.
    setpoint : array, shape (p,)
        The reference at this sample, r_k.
    disturbance : array, shape (n_d,)
        Known disturbances, measured now: of an input the value that the plant holds over [t_k, t_k+1). It is
        the last value that arrived where that is missing, and never NaN.
    forecast : array, shape (horizon, n_d)
        What is expected to be measured of them later: row i at t_{k+1+i}, of an input that over
        [t_{k+1+i}, t_{k+2+i}).
    band_now, band : arrays, shapes (p, 2) and (horizon, p, 2)
        Between what the outputs are wanted, lower and upper: at this sample, and from t_{k+1} on as far as
        the reference is known. Both are the reference where that is a line; where it is a band the reference
        is its point nearest to what is measured now.
    price : array, shape (horizon + 1, n_prices)
        Prices, row 0 for [t_k, t_{k+1}).
    input_limits : array, shape (horizon + 1, m, 2)
        Lower and upper limits of the inputs, row 0 for [t_k, t_{k+1}), known as far as the reference is.
    output_limits : array, shape (horizon, p, 2)
        Those of the controlled outputs, row i at t_{k+1+i}.
    """

    k: int
    time: float
    y: FloatArray
    measured: FloatArray
    reference: FloatArray
    setpoint: FloatArray
    disturbance: FloatArray = _NOTHING
    forecast: FloatArray = _NOTHING.reshape(0, 0)
    band_now: FloatArray = _NOTHING.reshape(0, 2)
    band: FloatArray = _NOTHING.reshape(0, 0, 2)
    price: FloatArray = _NOTHING.reshape(0, 0)
    input_limits: FloatArray = _NOTHING.reshape(0, 0, 2)
    output_limits: FloatArray = _NOTHING.reshape(0, 0, 2)


class Action(NamedTuple):
    """A controller's answer when it has more to say than ``u``.

    Parameters
    ----------
    u : array, shape (m,)
        Inputs to hold until the next sample.
    status : str
        ``"ok"``, or in a few words why ``u`` is a fallback. Anything but ``"ok"`` is counted and reported.
    info : mapping of str to float
        Values about this step, by name: finite numbers, NaN for none. They are recorded, of 64 names a run.
    """

    u: FloatArray
    status: str = OK
    info: Mapping[str, float] = _NO_INFO


class Footprint(NamedTuple):
    """What a controller in C takes of a target's memory besides its instructions.

    Parameters
    ----------
    constants : int
        Numbers that do not change, such as gains and limits, and those that the state begins with [bytes].
    state : int
        ``ControllerState``: what changes, with all that a step works with [bytes]; each instance has its own.
    """

    constants: int
    state: int


@dataclass(frozen=True, slots=True)
class ControllerCode:
    """A started controller as C code: what :func:`ddpc_cosim.export_controller` makes an FMU of.

    Parameters
    ----------
    sources : mapping of str to str
        The files by name, C99 without a heap. ``controller.h`` declares a type ``ControllerState`` that holds
        all that changes, and ::

            void controller_start(ControllerState *state);
            unsigned controller_step(ControllerState *state, const double y[], const double r[], double u[]);

        ``y`` are the controlled outputs, then the measurements that are not among them, NaN where one is
        missing; ``r`` the setpoint r_k and after it r_{k+1} ... r_{k+preview}, the outputs of a sample side
        by side, and after that what :func:`further_arguments` lists, which only some loops have;
        ``u`` takes the inputs, finite and within their bounds. The step returns 0, or a sum of
        powers of two that say why ``u`` is a fallback; ``state->status`` is this value, and
        ``state->iterations`` and ``state->active_bounds`` are what the optimisation needed and met.
    statuses : mapping of int to str
        What each of these powers of two says.
    follows : bool
        Whether ``controller.h`` declares ``controller_follow`` too, with the arguments of
        ``controller_step`` and called in its place while something else drives the plant: ``u`` is what that
        applies at this sample, and comes back finite and within the bounds. The step after it goes on as a
        controller does that was started with these samples as :attr:`Loop.past`. The first call after a
        step, or after the start, begins a new past.
    numbers : array, shape (n,)
        What ``controller.h`` then declares ``void controller_load(const double numbers[])`` for: it is to be
        called before the start. Code whose numbers stand apart is the same for all recordings that have
        given a law of the same size. Empty: all of it is in the code.
    footprint : Footprint or None
        What it takes of a target's memory; None: that is not known.
    """

    sources: Mapping[str, str]
    statuses: Mapping[int, str]
    follows: bool = False
    numbers: FloatArray = field(default_factory=lambda: np.empty(0), compare=False)
    footprint: Footprint | None = None


def further_arguments(loop: Loop, horizon: int) -> dict[str, tuple[int, ...]]:
    """Return what follows the references in ``r`` of ``controller_step``, in its order.

    Parameters
    ----------
    loop : Loop
        The loop that the controller was started with.
    horizon : int
        The controller's.

    Returns
    -------
    shapes : dict of str to tuple of int
        Fields of :class:`Sample` that this loop has, and how much of each: time along axis 0 but for
        ``disturbance`` and ``band_now``. What is known as far as the reference has its rows only, the first
        ones of the field (of ``output_limits`` one at least); the last one holds beyond. NaN is what is not
        known, in place of which the row before holds, of the first row the last value that was known.
    """
    preview = min(loop.preview, horizon)
    m, p, n_d, prices = map(len, (loop.inputs, loop.outputs, loop.disturbances, loop.charges))
    shapes: dict[str, tuple[int, ...]] = {}
    if n_d:
        shapes |= {"disturbance": (n_d,), "forecast": (horizon, n_d)}
    if loop.bands:
        shapes |= {"band_now": (p, 2), "band": (preview, p, 2)}
    if prices:
        shapes |= {"price": (horizon + 1, prices)}
    if loop.moving_limits:
        shapes |= {"input_limits": (preview + 1, m, 2), "output_limits": (max(preview, 1), p, 2)}
    return shapes


class Controller(ABC):
    """A sampled controller.

    A subclass is a dataclass with keyword-only fields (``@dataclass(kw_only=True)``) made by
    :func:`ddpc_cosim.setting`: they are its settings, checked here at construction. A run asks for these, in
    this order:

    1. ``uses_recording``, once, before anything runs; may be set.
    2. ``horizon``, before and after ``start``, which does not change it; may be set.
    3. ``start``, once; must be set. It forgets everything learned before.
    4. ``settings``, once; need not be set in a dataclass.
    5. ``knowledge``, once; may be set.
    6. ``warnings``, once; may be set.
    7. ``accepts_missing``, once, if the loop loses measurements; may be set.
    8. ``step``, at every sample: n + 1 times for n sampling intervals; must be set.
    9. ``diagnostics``, once, after the last sample, however the run ended; may be set.

    Reading a study asks an object that is never started for ``settings``, ``uses_recording``, ``horizon``
    and, where there is a recording, ``recording_length``; ``ddpc-cosim tune`` asks such a one for
    ``settings_as``, ``ddpc-cosim inspect`` one for ``prediction_errors``, and ``ddpc-cosim
    export-controller`` a started one for ``c_code``. :func:`ddpc_cosim.replay` asks one that is never started
    for ``past_length``, and has a started one ``restart`` before each ``step``. These may be set, too.
    """

    # These may be set: as attributes, which may be settings, or as properties.
    horizon: int = 1
    """How many future reference samples ``step`` wants; a subclass may make it a setting.

    It is known once the controller is made; ``start`` does not change it.
    """

    @property
    def uses_recording(self) -> bool:
        """Whether ``start`` needs ``loop.recording``; a class whose answer is fixed sets an attribute."""
        return False

    @property
    def past_length(self) -> int:
        """How many of the last samples of ``loop.past`` it needs: with fewer it supposes what was before.

        A class whose answer is fixed sets an attribute.
        """
        return 1

    @property
    def accepts_missing(self) -> bool:
        """Whether ``step`` answers NaN in a sample (missing measurements) by finite inputs and a status.

        Where it does not, a loop that loses measurements hands it the last values that arrived instead, and
        counts such samples as fallbacks.
        """
        return False

    def __init_subclass__(cls, **more: Any) -> None:
        """Let ``recording_length`` be an integer, or a method that does not ask for disturbances."""
        super().__init_subclass__(**more)
        owner = next(base for base in cls.__mro__ if "recording_length" in vars(base))
        if owner is not cls and issubclass(owner, Controller):
            return
        said = vars(owner)["recording_length"]
        if isinstance(said, Integral):

            def recording_length(self: Self, *signals: int) -> int:
                return int(said)

            cls.recording_length = recording_length  # type: ignore[assignment, method-assign]
        elif isinstance(said, _METHODS) and not _asks_for_disturbances(said.__get__(object(), cls)):

            @wraps(said.__get__(object(), cls))
            def of_undisturbed(self: Self, *signals: int) -> Any:
                return said.__get__(self, type(self))(*signals[:3])

            cls.recording_length = of_undisturbed  # type: ignore[assignment, method-assign]

    def __new__(cls, *_: Any, **settings: Any) -> Self:
        """Make a controller; an unknown setting is told with the one that may be meant."""
        allowed = _keywords_of(cls)
        if allowed is not None:
            unknown = [name for name in settings if name not in allowed]
            if unknown:
                what = f"unknown setting of {cls.__name__}"
                hints = {name: instead_of(cls, name) or did_you_mean(name, allowed) for name in unknown}
                raise SettingsError([((name,), f"{what}; {hint}") for name, hint in hints.items()])
        return super().__new__(cls)

    def __post_init__(self) -> None:
        check_settings(self)

    @abstractmethod
    def start(self, loop: Loop) -> None:
        """Prepare for one run.

        Raises
        ------
        DataError
            The recording cannot serve this controller.
        ConfigError
            A setting does not fit the loop.
        """

    def restart(self, loop: Loop) -> None:
        """Begin anew in the loop that it was started in, of which nothing but the past is another one.

        It then decides as after a ``start`` with that loop. A subclass may keep what it has learned.
        """
        self.start(loop)

    @abstractmethod
    def step(self, sample: Sample) -> FloatArray | Action:
        """Return the inputs for this sample, shape (m,), or an ``Action``."""

    def recording_length(self, inputs: int, outputs: int, measurements: int, disturbances: int = 0) -> int:
        """Return the fewest samples of a recording that ``start`` can work with, for so many signals.

        ``disturbances`` are the known ones; a method that leaves this parameter out needs no more for them.
        Any integer type will do. A class whose answer is fixed sets an integer in place of the method.
        """
        return 0

    def settings_as(
        self, other: type["Controller"], inputs: int, outputs: int, samples: int
    ) -> Mapping[str, Any] | None:
        """Return with which settings another class decides as this controller does; None if with none.

        For a method that another one contains: ``ddpc-cosim tune`` tries the settings found for the one with
        the other too, so that the larger one does not come out worse for having more to search.

        Parameters
        ----------
        other : type
            The other class, or one derived from it.
        inputs, outputs, samples : int
            Numbers of the loop's inputs and outputs, and of the recording's samples (0: there is none).
        """
        return None

    def prediction_errors(self, recording: Recording) -> FloatArray | None:
        """Return how far the method's predictions from a recording are off on samples that it held out.

        For ``ddpc-cosim inspect`` and :meth:`Recording.summary`; the object is not used for a run after it.

        Parameters
        ----------
        recording : Recording
            The experiment, by which it knows the plant.

        Returns
        -------
        errors : array, shape (n, p), or None
            Root mean square over the recording's last quarter, which nothing was fitted to, in parts of each
            output's standard deviation: row i of predictions i + 1 samples after the last known output. None
            if the method does not predict, or too few samples are left to test it.

        Raises
        ------
        DataError
            The recording cannot serve this method.
        """
        return None

    def diagnostics(self) -> Mapping[str, float]:
        """Return values about the data or model of this run (rank, order, ...); valid after ``start``."""
        return {}

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return what the controller goes by, in words for the report's account of fairness.

        Asked once, after ``start``. What is left out is reported as not known.

        Parameters
        ----------
        loop : Loop
            The loop it was started with.

        Returns
        -------
        facts : mapping of str to str
            ``"measures"``: the signals it uses, by name. ``"plant"``: what it was told of the plant
            beforehand, by a model or by settings, or ``"nothing"``.
        """
        return {}

    def c_code(self, loop: Loop) -> ControllerCode:
        """Return the controller, as ``start`` has left it, as C code that behaves as ``step`` does.

        Parameters
        ----------
        loop : Loop
            The loop it was started with.

        Raises
        ------
        ConfigError
            It cannot be exported, and why.
        """
        raise ConfigError(f"{type(self).__name__} cannot be exported: its class has no c_code()")

    def loadable_c_code(self, loop: Loop) -> ControllerCode:
        """Return the same code with its numbers apart, so that it need not be compiled for each recording.

        Parameters and errors as of :meth:`c_code`. Default: all numbers are in the code.
        """
        return self.c_code(loop)

    def warnings(self) -> Sequence[str]:
        """Return what speaks against the recording or the model that it has got; valid after ``start``.

        One sentence each: what, its value, and the remedy. What makes the run hopeless is a ``DataError``.
        """
        return ()

    def settings(self) -> dict[str, Any]:
        """Return the settings in plain values: what a study file would say."""
        if not is_dataclass(self):
            return {}
        return {field.name: to_plain(getattr(self, field.name)) for field in fields(self) if field.init}


_METHODS = (FunctionType, staticmethod, classmethod)


@cache
def _keywords_of(kind: type[Any]) -> Sequence[str] | None:
    """Return by which keywords a class is made; None: by any."""
    known = list(inspect.signature(kind.__init__).parameters.values())[1:]
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in known):
        return None
    return [parameter.name for parameter in known]


def _asks_for_disturbances(recording_length: Callable[..., Any]) -> bool:
    """Whether a method takes the number of known disturbances after those of the other signals."""
    try:
        inspect.signature(recording_length).bind(1, 1, 1, 0)
    except TypeError:
        return False
    return True
