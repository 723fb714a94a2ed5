"""The files of one case: written in one move and sealed, accepted from a worker, read to the last byte."""

import errno
import hashlib
import json
import math
import os
import shutil
import stat
import sys
import warnings
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from itertools import chain, islice
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from ddpc_cosim.controller import Bounds, Charge
from ddpc_cosim.errors import ConfigError, CosimError, CosimWarning
from ddpc_cosim.files.csv_files import PARQUET, read_parquet, write_table
from ddpc_cosim.files.path_lengths import RANDOM
from ddpc_cosim.files.tables import own_rows
from ddpc_cosim.files.texts import recorded
from ddpc_cosim.loop.trace import Outcome, Trace
from ddpc_cosim.metrics import MetricSettings
from ddpc_cosim.processes.requests import held
from ddpc_cosim.responses import Tracking
from ddpc_cosim.variables import DisplayUnit, FloatArray, Variable
from fmu_plants.files import temporary_name, write_atomically, write_through

RUN_FILE, _STATE_FILE = "run.json", "plant.state"
STAGING = ".staging-"
"""What the names of folders begin with in which files stand until they are complete."""
# What holds the samples, by how they are stored.
_SIGNALS_FILES = {"csv": "signals.csv", "parquet": f"signals{PARQUET}"}
# A JSON file ends with the checksum of all that stands before it.
_SEAL = b',\n "sha256": "%s"\n}\n'

LEFT_FOLDER = "left"
"""Where in a case's folder stands what it has left in its working directory, if that is kept."""
_MOST_LEFT, _MOST_LOOKED_AT, _DEEPEST_LEFT = 100, 20_000, 50
DOING_NOTHING = "doing-nothing"
"""The controller of the runs that the tool makes itself, with inputs at rest: no result is one of them."""
OWN_CONTROL = "the plant's own control"
"""What such a run is labelled where the plant's own control acts in it."""
_ENTRIES_AT_ONCE = 1000
_LONGEST_RUN, _LONGEST_STATE = 1 << 26, 1 << 29
# These may end otherwise next time: only a result that would come out the same is kept.
_TRANSIENT = (Outcome.CRASHED, Outcome.TIMED_OUT)
# What reading a file raises that has been cut off or changed, or that another version wrote.
DAMAGED = (
    OSError,
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    StopIteration,
    RecursionError,
)


@dataclass(frozen=True)  # without slots, whose memory those in columns would have for nothing
class CaseResult:
    """One case: what it was, how it ended, and its metrics.

    Parameters
    ----------
    id : str
        Readable name and hash; the name of its folder.
    controller, label : str
        The controller's name in the study and in reports.
    scenario : str
        The scenario's name.
    seed : int
        The seed.
    outcome : Outcome
        How the run ended.
    reason : str
        Why it ended early; empty if completed.
    tracking : tuple of Tracking
        What it is judged by, an entry per controlled output.
    metrics, diagnostics : mapping of str to float
        Values of the run, and of the controller's data or model.
    settings : dict
        The controller's settings, defaults filled in.
    warnings : tuple of str
        What spoke against the data or the model before the loop was closed, and metrics that failed.
    folder : Path
        Where its files are.
    sandbox : str
        The sandbox that it ran in, in words; empty: none.
    transient : bool
        Whether it is run again next time, as it may end otherwise: it crashed, was late, or the machine may
        be at fault.
    problem : str
        The problem's name; of a flat study its own.
    recorded_samples : int
        How many samples of the recording the controller learned from.
    failed : bool
        Whether it did not complete, ends further than half of its task away, or is worse than doing nothing.
    failure : str
        Why a run that completed failed.
    settles : bool or None
        Whether it leaves no more than 5 % of any step; None where its reference is never constant.
    left : float
        What it leaves of a step at worst [%], beyond what the scenario makes unavoidable; infinite of a run
        that did not complete, and NaN where its reference is never constant.
    tasks : mapping of str to float
        By controlled output, the size of its task, in the unit in which it is shown.
    wall_time : float
        How long its worker took for it [s]; NaN if it was lost.
    simulated_time : float
        From its first sample to its last [s].
    versions : mapping of str to str
        Of this program, Python and the packages that decide figures, where it ran; empty if it was lost.
    engine : str
        What computed its samples: ``"compiled"``, or why it was Python though that was asked for; empty:
        Python, as nothing else was.
    drawn : mapping of str to float
        The plant parameters that its seed has drawn, by name and unit: ``"mass [kg]"``.
    beyond_log : dict of str to float
        By input and output, in what share of the samples it was outside what the logs recorded that its plant
        is identified from, where it ever was.
    batched : bool
        Whether its figures are in a batch of many cases: samples are kept of few of these.
    """

    id: str
    controller: str
    label: str
    scenario: str
    seed: int
    outcome: Outcome
    reason: str
    tracking: tuple[Tracking, ...]
    metrics: Mapping[str, float]
    diagnostics: Mapping[str, float]
    settings: dict[str, Any]
    warnings: tuple[str, ...]
    folder: Path
    sandbox: str = ""
    transient: bool = False
    problem: str = ""
    recorded_samples: int = 0
    failed: bool = False
    failure: str = ""
    settles: bool | None = None
    left: float = math.nan
    tasks: Mapping[str, float] = field(default_factory=dict)
    wall_time: float = field(default=math.nan, compare=False)
    simulated_time: float = 0.0
    versions: Mapping[str, str] = field(default_factory=dict)
    engine: str = ""
    drawn: Mapping[str, float] = field(default_factory=dict)
    beyond_log: dict[str, float] = field(default_factory=dict)
    batched: bool = field(default=False, compare=False)

    @property
    def is_own_control(self) -> bool:
        """Whether it is a run of doing nothing in which the plant controls itself."""
        return self.controller == DOING_NOTHING and self.label == OWN_CONTROL

    @property
    def has_samples(self) -> bool:
        """Whether its samples are kept."""
        return not self.batched or (self.folder / RUN_FILE).is_file()

    def trace(self) -> Trace:
        """Read the samples of the run.

        Raises
        ------
        ConfigError
            The files are missing or damaged, or only its figures are kept.
        """
        if not self.has_samples:
            raise ConfigError(
                f"{self.id}: only its figures are kept; for its samples run it again alone, into the same "
                f"folder: --only {self.controller} --seeds {self.seed}"
            )
        try:
            with _unmoved(self.folder):
                return read_trace(self.folder)
        except DAMAGED as error:
            raise damaged_files(self.folder, error) from error


def load_case(folder: Path, id: str = "") -> CaseResult:
    """Read one case, whose files have to be what was written to the last byte.

    What is concluded of it depends on another run too: :func:`ddpc_cosim.study.verdicts.judgement.judged`.

    Parameters
    ----------
    folder : Path
        Its folder.
    id : str
        Which case it has to be; empty: the one that its folder is called after.

    Raises
    ------
    ConfigError
        Its files are missing or damaged.
    """
    with _unmoved(folder):
        return _checked(folder, id or folder.name)[1]


def _checked(folder: Path, id: str) -> tuple[dict[str, Any], CaseResult]:
    """Return ``run.json`` and the case in a folder that nobody moves; errors as of :func:`load_case`."""
    try:
        run = _read_run(folder)
        _signals(folder, run)
        if run["id"] != id:
            raise ValueError(f"{RUN_FILE} is of case {run['id']}")
        return run, result_of_run(run, folder)
    except DAMAGED as error:
        raise damaged_files(folder, error) from error


def result_of_run(run: dict[str, Any], folder: Path, *, batched: bool = False) -> CaseResult:
    """Return the case that a ``run.json`` tells of, whose folder is or would be the given one."""
    keys = ("id", "controller", "label", "scenario", "seed", "reason", "sandbox", "recorded_samples")
    head = {key: run[key] for key in keys} | {"problem": run.get("problem", "")}
    warning_texts, outcome = (*run["warnings"], *run["metric_warnings"]), Outcome(run["outcome"])
    transient = run["transient"] or outcome in _TRANSIENT
    return CaseResult(
        **head,
        metrics=_numbers(run["metrics"]),
        diagnostics=_numbers(run["diagnostics"]),
        settings=run["settings"],
        tracking=tuple(map(Tracking.read, run["tracking"])),
        outcome=outcome,
        failed=outcome is not Outcome.COMPLETED,
        warnings=warning_texts,
        folder=folder,
        transient=transient,
        wall_time=float(run.get("wall_time", math.nan)),
        simulated_time=max(run["signals"]["rows"] - 1, 0) * run["sampling_time"],
        versions=run.get("versions", {}),
        engine=str(run.get("engine", "")),
        drawn=_numbers(run.get("drawn", {})),
        beyond_log=dict(run.get("beyond_log", {})),
        batched=batched,
    )


def damaged_files(folder: Path, error: Exception) -> ConfigError:
    """Say what is wrong with a folder of results, from what reading it has raised."""
    why = f"{Path(error.filename).name}: {error.strerror}" if isinstance(error, OSError) else str(error)
    return ConfigError(f"{folder}: damaged: {why}; run the study again, which runs only what is damaged")


def write_case(
    folder: Path,
    trace: Trace,
    head: dict[str, Any],
    staging: Path | None = None,
    settings: MetricSettings | None = None,
) -> None:
    """Write a case's folder in one move, replacing an older one.

    Parameters
    ----------
    folder : Path
        The case's folder.
    trace : Trace
        What the run left behind.
    head : dict
        What the case is: id, controller, scenario, seed, ...
    staging : Path, optional
        Where it stands until it is complete, on the same disk; default: next to the folder.
    settings : MetricSettings, optional
        What its metrics depend on besides its samples; default: as for a run that stands alone.

    Raises
    ------
    CosimError
        It cannot be written, and why; an older one is kept.
    """
    staged = (staging or folder.parent) / f".{folder.name}.{os.getpid()}"
    shutil.rmtree(staged, ignore_errors=True)  # of a process of the same number that died here
    try:
        staged.parent.mkdir(parents=True, exist_ok=True)
        stage_case(staged, trace, head, settings)
        _move_into_place(staged, folder)
    except OSError as error:
        raise _not_written(folder, error) from error
    finally:
        shutil.rmtree(staged, ignore_errors=True)


def stage_case(
    staged: Path, trace: Trace, head: dict[str, Any], settings: MetricSettings | None = None
) -> None:
    """Write a case's files into a folder that is not yet its own; parameters as of :func:`write_case`.

    What that stands in is not made: of a run that has ended meanwhile nothing comes back.

    Raises
    ------
    OSError
        They cannot be written.
    """
    run = described(trace, head, settings or MetricSettings(trace.preview))
    staged.mkdir(exist_ok=True)
    file = staged / _SIGNALS_FILES[run["storage"]]
    write_table(file, trace.columns(), {"status": trace.status})
    signals = {"rows": len(trace), "sha256": checksum(file.read_bytes())}
    state = {"state": checksum(trace.state)} if trace.state else {}
    if state:
        (staged / _STATE_FILE).write_bytes(trace.state)
    (staged / RUN_FILE).write_bytes(sealed_json(run | {"signals": signals} | state))
    for name in (file.name, RUN_FILE):  # by each worker for itself: it waits for the disk
        write_through(staged / name)


def described(trace: Trace, head: dict[str, Any], settings: MetricSettings) -> dict[str, Any]:
    """Return what ``run.json`` says of a run besides its files; parameters as of :func:`write_case`."""
    return {
        "printed": "",
        "left": {},
        "sandbox": "",
        "problem": "",
        "storage": "csv",
        "versions": {},
        "wall_time": math.nan,
        **head,
        "outcome": trace.outcome.value,
        "reason": recorded(trace.reason),
        "transient": trace.transient,
        **evaluated(trace, settings),
        "diagnostics": trace.diagnostics,
        "info": list(trace.info),
        "warnings": list(trace.warnings),
        "settings": _recorded(trace.settings),
        "sampling_time": trace.sampling_time,
        "planned_samples": trace.planned_samples,
        "preview": trace.preview,
        "inputs": [_plain(v) for v in trace.inputs],
        "outputs": [_plain(v) for v in trace.outputs],
        "measurements": [_plain(v) for v in trace.measurements],
        "changed_inputs": [_plain(v) for v in trace.changed_inputs],
        "bounds": {
            name: getattr(trace.bounds, name).tolist() for name in ("u_min", "u_max", "y_min", "y_max")
        },
        "recorded_samples": trace.recorded_samples,
        "knowledge": trace.knowledge,
        "provenance": trace.provenance,
        **_further(trace),
    }


@cache
def _plain(variable: Variable) -> dict[str, Any]:
    """Return what JSON can say of a variable; it is not to be changed."""
    return asdict(variable)


def _further(trace: Trace) -> dict[str, Any]:
    """Return what the further columns of a trace are, as far as there are some."""
    further = {
        "disturbances": [_plain(variable) for variable in trace.disturbances],
        "acting": list(trace.acting),
        "bands": list(trace.bands),
        "moving_limits": list(trace.moving_limits),
        "charges": [charge._asdict() for charge in trace.charges],
        "monitors": [_plain(variable) for variable in trace.monitors],
        "monitored_bands": list(trace.monitored_bands),
        "substeps": trace.substeps if trace.substeps > 1 else None,
        "intersample_signals": [_plain(variable) for variable in trace.intersample_signals],
        "engine": trace.engine,
        "beyond_log": trace.beyond_log,
    }
    return {key: value for key, value in further.items() if value}


def longest_files(folder: PurePath, case_ids: Iterable[str]) -> Iterator[PurePath]:
    """Yield the longest path of each case that is run into a folder, and that of those not complete yet."""
    written = temporary_name(RUN_FILE)
    yield folder / f"{STAGING}{RANDOM}" / f"tmp{RANDOM}.older" / written
    for case_id in case_ids:
        yield folder / case_id / written


def accept_case(
    staged: Path,
    folder: Path,
    head: dict[str, Any],
    printed: str,
    longest: int,
    left: Mapping[str, int] | None = None,
    *,
    keeps_state: bool = False,
) -> None:
    """Move what a process that has ended has staged to where its case belongs, if it is that case.

    Parameters
    ----------
    staged, folder : Path
        Where it lies, and where it belongs; both on one disk.
    head : dict
        What the case is, as of :func:`write_case`.
    printed : str
        What the process printed last.
    longest : int
        Bytes that its samples can take.
    left : mapping of str to int, optional
        What it has left, as of :func:`left_in`; default: what the process says itself.
    keeps_state : bool
        Whether the plant's state may be among its files.

    Raises
    ------
    ConfigError
        It is not that case: an FMU may have written into the folder, or linked to what is not its own.
    CosimError
        It cannot be moved, and why.
    """
    allowed = {RUN_FILE: _LONGEST_RUN, _SIGNALS_FILES[head["storage"]]: longest}
    _check_staged(staged, allowed | ({_STATE_FILE: _LONGEST_STATE} if keeps_state else {}))
    run, _ = _checked(staged, head["id"])
    for key, value in head.items():
        if run[key] != value:
            raise ConfigError(f"{RUN_FILE} is of {key} {str(run[key])[:100]}")
    try:
        if printed or left:
            left_behind = {"printed": printed, "left": run["left"] if left is None else dict(left)}
            write_atomically(staged / RUN_FILE, sealed_json(run | left_behind))
        _move_into_place(staged, folder)
    except OSError as error:
        raise _not_written(folder, error) from error


def left_in(work: Path) -> dict[str, int]:
    """Return the bytes of the files that a case has left in its working directory, by path there.

    Links count as what they are and lead nowhere, and so do folders in 50 others; beyond 100 files, the rest
    are one entry.
    """
    sizes = {recorded(path): status.st_size for path, status in islice(_left(work), _MOST_LOOKED_AT)}
    named = dict(sorted(sizes.items())[:_MOST_LEFT])
    rest = len(sizes) - len(named)
    return named | ({f"and {rest} more": sum(sizes.values()) - sum(named.values())} if rest else {})


def keep_left(work: Path, folder: Path) -> None:
    """Keep what a case has left in its working directory beside its files: plain files, and no links.

    What cannot be read, or have so long a path there, is only listed by :func:`left_in`.

    Raises
    ------
    CosimError
        It cannot be written, and why.
    """
    kept = folder / LEFT_FOLDER
    for path, status in _left(work):
        if not stat.S_ISREG(status.st_mode):
            continue
        try:
            source = (work / path).open("rb")
        except OSError:
            continue
        target = kept / path
        try:
            with source:
                target.parent.mkdir(parents=True, exist_ok=True)
                with target.open("wb") as file:
                    shutil.copyfileobj(source, file)
        except OSError as error:
            if error.errno != errno.ENAMETOOLONG:
                raise _not_written(kept, error) from error


def _left(work: Path) -> Iterator[tuple[str, os.stat_result]]:
    """Yield what lies in a working directory, by path there: no folders, but for those that are too deep."""
    waiting = deque([("", 0)])
    while waiting:
        place, depth = waiting.popleft()
        with suppress(OSError), os.scandir(work / place) as entries:
            for entry in entries:
                path, is_folder = f"{place}{entry.name}", entry.is_dir(follow_symlinks=False)
                if is_folder and depth < _DEEPEST_LEFT:
                    waiting.append((f"{path}/", depth + 1))
                else:
                    yield (f"{path}/" if is_folder else path), entry.stat(follow_symlinks=False)


def _check_staged(staged: Path, longest: dict[str, int]) -> None:
    """Refuse what cannot be what :func:`stage_case` has written, before any of it is read."""
    try:
        if staged.is_symlink():
            raise ConfigError("its folder is a link")
        for path in staged.iterdir():
            status = path.lstat()
            if not (path.name in longest and stat.S_ISREG(status.st_mode) and status.st_nlink == 1):
                raise ConfigError(f"{recorded(path.name)} is not a file of its own")
            if status.st_size > longest[path.name]:
                raise ConfigError(f"{path.name} has {status.st_size} bytes; allowed: {longest[path.name]}")
    except OSError as error:
        raise damaged_files(staged, error) from error


def _not_written(folder: Path, error: OSError) -> CosimError:
    reason = error.strerror or str(error)
    return CosimError(f"{folder}: cannot be written: {reason}; finished cases are kept")


def recompute_metrics(folder: Path, settings: MetricSettings) -> None:
    """Compute the metrics of a case again from its samples, where they depend on other settings by now.

    Raises
    ------
    CosimError
        The case cannot be read or written, and why.
    """
    try:
        with _unmoved(folder, by_this=True):
            run = _read_run(folder)
            if run["metric_settings"] == asdict(settings):
                return
            run |= evaluated(read_trace(folder), settings)
            write_atomically(folder / RUN_FILE, sealed_json(run))
    except DAMAGED as error:
        raise CosimError(f"{folder}: metrics cannot be computed again: {error}") from error


def evaluated(trace: Trace, settings: MetricSettings) -> dict[str, Any]:
    """Return what ``run.json`` says of a run's samples, and what that depends on besides them."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        metrics, each = trace.figures(settings)
    return {
        "tracking": [tracking.written() for tracking in each],
        "metrics": metrics,
        "metric_warnings": [
            recorded(warning.message) for warning in caught if issubclass(warning.category, CosimWarning)
        ],
        "metric_settings": asdict(settings),
    }


def _recorded(value: Any) -> Any:
    """Return settings whose texts can be kept, whatever they are."""
    if isinstance(value, str):
        return recorded(value)
    if isinstance(value, dict):
        return {recorded(key): _recorded(item) for key, item in value.items()}
    return [_recorded(item) for item in value] if isinstance(value, (list, tuple)) else value


def sealed_json(content: dict[str, Any]) -> bytes:
    """Return a JSON object whose last entry is the checksum of all before it."""
    return b"".join(sealed_parts(content))


def sealed_parts(content: dict[str, Any]) -> Iterator[bytes]:
    """Yield the parts of :func:`sealed_json`, for what is long."""
    seal, before = hashlib.sha256(), "{\n"
    for key, value in content.items():
        for part in chain([f"{before} {json.dumps(str(key))}: "], _json_parts(value)):
            seal.update(part.encode())
            yield part.encode()
        before = ",\n"
    yield _SEAL % seal.hexdigest().encode()


def _json_parts(value: Any) -> Iterator[str]:
    """Yield the JSON of a value, that of a long list some entries after the other."""
    if not isinstance(value, list) or len(value) <= _ENTRIES_AT_ONCE:
        yield json.dumps(_finite(value))
        return
    for first in range(0, len(value), _ENTRIES_AT_ONCE):
        yield ", " if first else "["
        yield json.dumps(_finite(value[first : first + _ENTRIES_AT_ONCE]))[1:-1]
    yield "]"


def read_sealed(path: Path) -> dict[str, Any]:
    """Return what :func:`sealed_json` was given; ValueError unless the file holds it to the last byte."""
    return parse_sealed(path.read_bytes(), path.name)


def parse_sealed(content: bytes, name: str) -> dict[str, Any]:
    """Return what :func:`sealed_json` was given; ValueError unless that is the content of a file."""
    text = content[: -len(_SEAL % checksum(b"").encode())]
    if content != text + _SEAL % checksum(text).encode():
        raise ValueError(f"{name} is not what was written: its checksum differs")
    read: dict[str, Any] = json.loads(text + b"\n}")
    return read


def _signals(folder: Path, run: dict[str, Any]) -> bytes:
    """Return the file of samples; raises ValueError unless it holds what was written to the last byte."""
    name, written = _SIGNALS_FILES[_storage(run)], run["signals"]
    content = (folder / name).read_bytes()
    if checksum(content) != written["sha256"]:
        rows = f"{len(content.splitlines()[1:])} rows, " if name.endswith(".csv") else ""
        fault = f"its checksum differs ({rows}{written['rows']} were written)"
        raise ValueError(f"{name} is not what was written: {fault}")
    return content


def _state(folder: Path, run: dict[str, Any]) -> bytes:
    """Return the plant's state, empty if it was not kept; ValueError: it is not what was written."""
    if "state" not in run:
        return b""
    state = (folder / _STATE_FILE).read_bytes()
    if checksum(state) != run["state"]:
        raise ValueError(f"{_STATE_FILE} is not what was written: its checksum differs")
    return state


def _storage(run: dict[str, Any]) -> str:
    """Return how the samples are stored; earlier versions had one way."""
    storage: str = run.get("storage", "csv")
    return storage


def checksum(content: bytes) -> str:
    """Return the SHA-256 of a file's content."""
    return hashlib.sha256(content).hexdigest()


def _move_into_place(staged: Path, folder: Path) -> None:
    """Put a completely written folder in its place, while other runs may do the same."""
    older = staged.with_name(f"{staged.name}.older")
    with held(), _unmoved(folder, by_this=True):
        with suppress(FileNotFoundError):
            folder.replace(older)  # quicker than removing it: hardly a moment without a case
        try:
            staged.replace(folder)
        except OSError:
            if not (folder / RUN_FILE).is_file():
                with suppress(FileNotFoundError):
                    older.replace(folder)
                raise
            # Another run has just written the same case, and what decides its result is the same.
    shutil.rmtree(older, ignore_errors=True)


@contextmanager
def _unmoved(folder: Path, *, by_this: bool = False) -> Iterator[None]:
    """Have a case's folder stay as it is while it is read, or let nobody read it while this process moves it.

    Several runs can work in one folder of results: between two moves there is no case, and files of two are
    not of one. Where folders cannot be locked, as on Windows, nothing is held up.
    """
    with ExitStack() as stack:
        if sys.platform != "win32":
            import fcntl

            with suppress(OSError):
                cases = os.open(folder.parent, os.O_RDONLY)
                stack.callback(os.close, cases)
                fcntl.flock(cases, fcntl.LOCK_EX if by_this else fcntl.LOCK_SH)
        yield


def read_run(folder: Path) -> dict[str, Any]:
    """Return ``run.json`` of a case.

    Raises
    ------
    ConfigError
        It is missing or damaged.
    """
    try:
        with _unmoved(folder):
            return _read_run(folder)
    except DAMAGED as error:
        raise damaged_files(folder, error) from error


def _read_run(folder: Path) -> dict[str, Any]:
    run = read_sealed(folder / RUN_FILE)
    return run | {key: _numbers(run[key]) for key in ("metrics", "diagnostics")}


def _numbers(stored: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in stored.items()}


def read_trace(folder: Path) -> Trace:
    """Return the trace that :func:`write_case` wrote."""
    run = _read_run(folder)
    inputs, outputs, measurements, changed_inputs = (
        [_variable(v) for v in run[key]] for key in ("inputs", "outputs", "measurements", "changed_inputs")
    )
    columns, status = _read_signals(_signals(folder, run), _storage(run))

    def table(variables: list[Variable], prefixes: tuple[str, ...] = ("",)) -> FloatArray:
        selected = [
            next(columns[header] for p in prefixes if (header := p + v.header) in columns) for v in variables
        ]
        return np.column_stack(selected) if selected else np.empty((len(status), 0))

    bounds = Bounds(**{name: np.array(values, dtype=float) for name, values in run["bounds"].items()})
    disturbances = [_variable(variable) for variable in run.get("disturbances", ())]
    foretold = [v for v in disturbances if f"forecast {v.header}" in columns]
    charges = [Charge(**{**charge, "rate": float(charge["rate"])}) for charge in run.get("charges", ())]
    reference = table(outputs, ("reference ",))
    bands, moving = run.get("bands", ()), run.get("moving_limits", ())

    def pairs(
        variables: list[Variable], names: Sequence[str], prefixes: tuple[str, str], constant: tuple[Any, Any]
    ) -> FloatArray:
        """Return lower and upper values of all variables, shape (K, n, 2): in columns, or constant."""
        if not names:
            return np.empty((0, 0, 2))
        table = np.empty((len(status), len(variables), 2))
        for side, (prefix, values) in enumerate(zip(prefixes, constant, strict=True)):
            for i, variable in enumerate(variables):
                is_column = variable.name in names
                table[:, i, side] = columns[f"{prefix} {variable.header}"] if is_column else values[..., i]
        return table

    def of_charges(prefix: str) -> FloatArray:
        chosen = [
            next(v for header, v in columns.items() if header.startswith(f"{prefix} {charge.name} ["))
            for charge in charges
        ]
        return np.column_stack(chosen) if chosen else np.empty((0, 0))

    monitors, monitored_bands = (
        [_variable(variable) for variable in run.get("monitors", ())],
        run.get("monitored_bands", ()),
    )
    edges = ("monitored lower", "monitored upper")
    within = [variable for variable in monitors if variable.name in monitored_bands]
    limits = ("min", "max")
    between = [_variable(variable) for variable in run.get("intersample_signals", ())]
    trace = Trace(
        state=_state(folder, run),
        disturbances=tuple(disturbances),
        acting=tuple(run.get("acting", ())),
        d=table(disturbances, ("disturbance ",)) if disturbances else np.empty((0, 0)),
        forecast=table(foretold, ("forecast ",)) if foretold else np.empty((0, 0)),
        bands=tuple(bands),
        band=pairs(outputs, bands, ("lower", "upper"), (reference, reference)),
        moving_limits=tuple(moving),
        input_limits=pairs(inputs, moving, limits, (bounds.u_min, bounds.u_max)),
        output_limits=pairs(outputs, moving, limits, (bounds.y_min, bounds.y_max)),
        beyond_log=dict(run.get("beyond_log", {})),
        charges=tuple(charges),
        price=of_charges("price"),
        emission=of_charges("emission"),
        charged=of_charges("charged"),
        monitors=tuple(monitors),
        monitored=table(monitors, ("monitored ",)) if monitors else np.empty((0, 0)),
        monitored_bands=tuple(monitored_bands),
        monitored_band=pairs(within, monitored_bands, edges, ((), ())),
        time=columns["time [s]"],
        reference=reference,
        y=table(outputs, ("output ", "")),
        measured=table(measurements, ("measured ", "")),
        u=table(inputs, ("input ", "")),
        applied=table(changed_inputs, ("applied ",)),
        status=status,
        solve_time=columns["solve_time [s]"],
        inputs=tuple(inputs),
        changed_inputs=tuple(changed_inputs),
        outputs=tuple(outputs),
        measurements=tuple(measurements),
        bounds=bounds,
        sampling_time=run["sampling_time"],
        planned_samples=run["planned_samples"],
        preview=run["preview"],
        outcome=Outcome(run["outcome"]),
        reason=run["reason"],
        transient=run["transient"],
        settings=run["settings"],
        diagnostics=run["diagnostics"],
        recorded_samples=run["recorded_samples"],
        knowledge=run["knowledge"],
        provenance=run["provenance"],
        info={name: columns[f"info.{name}"] for name in run["info"]},
        warnings=tuple(run["warnings"]),
        substeps=run.get("substeps", 1),
        intersample_signals=tuple(between),
        engine=run.get("engine", ""),
    )
    if not between:
        return trace
    steps = [table(between, (f"{prefix} ",)) for prefix in trace.intersample_prefixes]
    return replace(trace, intersample=np.hstack(steps))


def _read_signals(content: bytes, storage: str) -> tuple[dict[str, FloatArray], tuple[str, ...]]:
    if storage == "parquet":
        numbers, texts = read_parquet(content)
        return numbers, texts["status"]
    header, rows = own_rows(content.decode())
    cells = list(zip(*rows, strict=True)) or [()] * len(header)
    columns = {name: np.array(column, dtype=float) for name, column in zip(header[:-1], cells, strict=False)}
    return columns, tuple(cells[-1])


def _variable(stored: dict[str, Any]) -> Variable:
    shown = stored["display_unit"]
    numbers = {key: float(stored[key]) for key in ("min", "max", "nominal", "start")}
    return Variable(**{**stored, **numbers, "display_unit": DisplayUnit(**shown) if shown else None})


def _finite(value: Any) -> Any:
    """Return JSON's version of a value: infinity and NaN, which JSON lacks, as text that ``float`` reads."""
    if isinstance(value, float):  # most of what there is in a batch of cases
        return float(value) if math.isfinite(value) else repr(float(value))
    if value is None or isinstance(value, (str, int)):
        return value
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return _finite(value.tolist()) if isinstance(value, (np.ndarray, np.generic)) else repr(value)
