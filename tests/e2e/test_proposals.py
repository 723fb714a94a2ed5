"""`init` is examined: thirty FMUs under strangers' names, each with answers that an engineer would sign.

Each is delivered as a file of a stranger's name into an empty folder, and answered by the command line
alone. What is written is read as plain TOML and judged by what the plant's equations say, see
`proposal_plants.py`.
"""

import math
import os
import re
import subprocess
import tomllib
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from e2e.proposal_plants import DELIVERIES, Delivery, Levels
from fmu_plants import export_fmu

pytestmark = pytest.mark.slow

RIGHT_AT_LEAST = 27
BEYOND = 0.2  # of the reachable range: how far setpoints may be from what inputs can hold
MOVES = 0.02  # of the reachable range: less than that is not a step
FACTOR = 3.0  # between the sampling time and a good one
SAMPLES_PER_CONSTANT = 10.0
ROUNDING = 1e-6
POINTS = {1: 401, 2: 61, 3: 15}
"""Of a grid along each input, by their number."""
RULES = ("runs", "signals", "disturbances", "levels", "setpoints", "sampling", "period", "words")
_TO_BASE = {
    "degC": (1.0, 273.15),
    "kPa": (1e3, 0.0),
    "bar": (1e5, 0.0),
    "mbar": (100.0, 0.0),
    "MPa": (1e6, 0.0),
}
_KEYS_OF_VALUES = ("value", "values", "from_value", "to_value", "low", "high", "lower", "upper", "offset")
_DEFAULT_EXPERIMENT = re.compile(r'(<DefaultExperiment[^>]*?) tolerance="[^"]*" stepSize="[^"]*"')
_GENERATOR = re.compile(r'generationTool="[^"]*"')

Table = Mapping[str, Any]


@dataclass(frozen=True)
class Answer:
    """What `init` has answered: its exit code, what it has said, and the study if there is one."""

    exit_code: int
    said: str
    text: str = ""
    study: Table = field(default_factory=dict)

    @property
    def driven(self) -> frozenset[str]:
        """The inputs that controllers drive."""
        return frozenset(self.study["plant"]["inputs"])

    @property
    def controlled(self) -> frozenset[str]:
        """The outputs with a reference."""
        return frozenset(self.study["reference"])

    @property
    def disturbances(self) -> frozenset[str]:
        """The inputs that are known disturbances."""
        return frozenset(self.study.get("disturbances", {}))


def deliver(delivery: Delivery, folder: Path) -> Path:
    """Write the FMU as a supplier would: names with dots, no hint at who made it, no step size."""
    path = export_fmu(delivery.model, folder / "made.fmu", delivery.fmi)
    delivered = folder / "Delivery 4711 (rev C).fmu"
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(delivered, "w", zipfile.ZIP_DEFLATED) as target:
        for name in source.namelist():
            content = source.read(name)
            if name == "modelDescription.xml":
                text = content.decode("utf-8")
                for old, new in delivery.spelt.items():
                    text = text.replace(f'name="{old}"', f'name="{new}"')
                text = _GENERATOR.sub('generationTool="Dymola"', _DEFAULT_EXPERIMENT.sub(r"\1", text))
                content = text.encode("utf-8")
            if not name.startswith("sources/"):
                target.writestr(name, content)
    path.unlink()
    return delivered


def ask(program: str, fmu: Path) -> Answer:
    """Run `init` on a file in its folder, and read what it writes there."""
    ran = subprocess.run(
        [program, "init", fmu.name],
        cwd=fmu.parent,
        env={**os.environ, "COLUMNS": "200"},
        capture_output=True,
        text=True,
        encoding="utf-8",
        timeout=900,
    )
    study = fmu.parent / "study.toml"
    text = study.read_text(encoding="utf-8") if study.exists() else ""
    return Answer(ran.returncode, ran.stdout + ran.stderr, text, tomllib.loads(text))


def judge(delivery: Delivery, answer: Answer) -> dict[str, str]:
    """Return what is wrong with an answer, by rule."""
    if delivery.is_controller:
        faults = {"words": _words_missing(delivery, answer)}
        if "Traceback" in answer.said:
            faults["runs"] = answer.said
        return {rule: fault for rule, fault in faults.items() if fault}
    if answer.exit_code or not answer.study:
        return {"runs": f"exit code {answer.exit_code}: {answer.said.strip()}"}
    faults = {
        "runs": _not_finite(answer),
        "signals": _wrong_signals(delivery, answer),
        "disturbances": _wrong_disturbances(delivery, answer),
        "levels": _wrong_levels(delivery, answer),
        "setpoints": _wrong_setpoints(delivery, answer),
        "sampling": _wrong_sampling(delivery, answer),
        "period": _wrong_period(delivery, answer),
        "words": _words_missing(delivery, answer),
    }
    return {rule: fault for rule, fault in faults.items() if fault}


def _not_finite(answer: Answer) -> str:
    bad = [".".join(place) for place, value in _numbers(answer.study) if math.isnan(value)]
    return f"not a number: {', '.join(bad)}" if bad else ""


def _numbers(value: Any, place: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], float]]:
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _numbers(item, (*place, key))
    elif isinstance(value, list):
        for i, item in enumerate(value):
            yield from _numbers(item, (*place, str(i)))
    elif isinstance(value, float):
        yield place, value


def _wrong_signals(delivery: Delivery, answer: Answer) -> str:
    faults = []
    if answer.driven not in delivery.driven:
        faults.append(f"drives {_listed([answer.driven])}, not {_listed(delivery.driven)}")
    if answer.controlled not in delivery.controlled:
        faults.append(f"controls {_listed([answer.controlled])}, not {_listed(delivery.controlled)}")
    return "; ".join(faults)


def _listed(sets: Iterable[Iterable[str]]) -> str:
    return " | ".join(",".join(sorted(names)) for names in sets) or "nothing"


def _wrong_disturbances(delivery: Delivery, answer: Answer) -> str:
    missing = delivery.disturbances - answer.disturbances
    wrong = answer.disturbances - delivery.disturbances - delivery.may_disturb
    faults = [f"not among them: {_listed([missing])}"] if missing else []
    return "; ".join([*faults, *([f"wrongly among them: {_listed([wrong])}"] if wrong else [])])


def _wrong_levels(delivery: Delivery, answer: Answer) -> str:
    """Name inputs that rest where they should not: what is not driven stays where its supplier says."""
    declared = {delivery.spelt.get(v.name, v.name): (v.start, v.start) for v in delivery.model.inputs}
    held = {name: ends for name, ends in declared.items() if name not in answer.driven}
    levels = _levels(delivery, answer.study)
    faults = [
        f"{name} rests at {levels[name]:g}, not within {low:g} to {high:g}"
        for name, (low, high) in {**held, **delivery.levels}.items()
        if not low - ROUNDING <= levels[name] <= high + ROUNDING
    ]
    return "; ".join(faults)


def _levels(delivery: Delivery, study: Table) -> dict[str, float]:
    """Return where each input rests, in its own unit: by the study, else as the FMU declares it."""
    plant = study["plant"]
    levels: dict[str, float] = {}
    for variable in delivery.model.inputs:
        name = delivery.spelt.get(variable.name, variable.name)
        level = float(plant.get("start", {}).get(name, variable.start))
        if name in plant.get("switches", {}).values():
            level = 1.0
        if signal := study.get("disturbances", {}).get(name, {}).get("signal"):
            level = _mean(signal, variable.unit, level)
        levels[name] = level
    return levels


def _mean(signal: Any, unit: str, otherwise: float) -> float:
    """Return the mean of a signal of a study as far as it can be read off, in a variable's unit."""
    if isinstance(signal, int | float):
        return float(signal)
    values = _values(signal)
    return _in_unit(float(np.mean(values)), signal.get("unit", unit), unit) if values else otherwise


def _values(signal: Any) -> list[float]:
    """Return the values that a signal of a study is made of."""
    if isinstance(signal, int | float):
        return [float(signal)]
    if isinstance(signal, list):
        return [value for entry in signal for value in _values(entry)]
    return [value for key in _KEYS_OF_VALUES if key in signal for value in _values(signal[key])]


def _in_unit(value: float, given: str, wanted: str) -> float:
    if given == wanted:
        return value
    (factor, offset), (wanted_factor, wanted_offset) = (_TO_BASE.get(u, (1.0, 0.0)) for u in (given, wanted))
    return (factor * value + offset - wanted_offset) / wanted_factor


def _wrong_setpoints(delivery: Delivery, answer: Answer) -> str:
    units = {v.name: v.unit for v in delivery.model.outputs}
    wanted = {}
    for name, signal in answer.study["reference"].items():
        unit = units[name]
        wanted[name] = np.array([_in_unit(v, signal.get("unit", unit), unit) for v in _values(signal)])
    faults = [f"{name} stays at {values[0]:g}" for name, values in wanted.items() if len({*values}) < 2]
    for name, values in wanted.items():
        low, high = delivery.plausible.get(name, (-math.inf, math.inf))
        if values.min() < low or values.max() > high:
            goes = f"{name} goes from {values.min():g} to {values.max():g}"
            faults.append(f"{goes}, beyond {low:g} to {high:g}")
    known = answer.driven in delivery.driven and answer.controlled in delivery.controlled
    if delivery.steady is not None and known:
        faults += _unreachable(delivery, answer, wanted)
    return "; ".join(faults)


def _unreachable(delivery: Delivery, answer: Answer, wanted: Mapping[str, Any]) -> Iterator[str]:
    """Yield which setpoints no inputs within plausible limits hold, all outputs at the same time."""
    assert delivery.steady is not None
    driven, names = sorted(answer.driven), sorted(wanted)
    rest = _levels(delivery, answer.study)
    grids = [np.linspace(*delivery.ends[name], POINTS[len(driven)]) for name in driven]
    rows = []
    for point in product(*grids):
        u: Levels = {**rest, **dict(zip(driven, map(float, point), strict=True))}
        try:
            held = delivery.steady(u)
        except ZeroDivisionError:  # an end at which there is no rest
            continue
        rows.append([held[name] for name in names])
    reached = np.array(rows)
    low, high = reached.min(axis=0), reached.max(axis=0)
    for j, name in enumerate(names):
        kept_low, kept_high = delivery.plausible.get(name, (-math.inf, math.inf))
        low[j], high[j] = max(low[j], kept_low), min(high[j], kept_high)
        if np.ptp(wanted[name]) < MOVES * (high[j] - low[j]):
            yield f"{name} moves by {np.ptp(wanted[name]):.3g} of {high[j] - low[j]:.3g} that are possible"
    for row in _together(answer.study, names, wanted):
        apart = np.min(np.max(np.abs(reached - row) / (high - low), axis=1))
        if apart > BEYOND:
            texts = ", ".join(f"{name} = {value:g}" for name, value in zip(names, row, strict=True))
            ends = ", ".join(f"{a:.4g} to {b:.4g}" for a, b in zip(low, high, strict=True))
            yield f"{texts} is {apart:.0%} of the range away from what can be held ({ends})"


def _together(study: Table, names: list[str], wanted: Mapping[str, Any]) -> list[Any]:
    """Return what is wanted of all outputs at the same time, shape (p,), one after the other."""
    tables = [study["reference"][name] for name in names]
    if any("times" not in table for table in tables):
        return [np.array(row) for row in product(*(wanted[name] for name in names))]
    instants = sorted({time for table in tables for time in table["times"]})
    return [
        np.array(
            [
                wanted[name][max(np.searchsorted(table["times"], instant, side="right") - 1, 0)]
                for name, table in zip(names, tables, strict=True)
            ]
        )
        for instant in instants
    ]


def _wrong_sampling(delivery: Delivery, answer: Answer) -> str:
    sampling = answer.study["loop"]["sampling_time"]
    low, high = delivery.sampling or (0.0, math.inf)
    if delivery.constants:
        low = delivery.constants[0] / SAMPLES_PER_CONSTANT / FACTOR
        high = delivery.constants[1] / SAMPLES_PER_CONSTANT * FACTOR
    within = low * (1 - ROUNDING) <= sampling <= high * (1 + ROUNDING)
    return "" if within else f"{sampling:g} s is not within {low:.3g} to {high:.3g} s"


def _wrong_period(delivery: Delivery, answer: Answer) -> str:
    if delivery.period is None:
        return ""
    loop, samples = answer.study["loop"], answer.study.get("recording", {}).get("samples", 0)
    times = {"the loop": loop["duration"], "the recording": samples * loop["sampling_time"]}
    wrong = [
        f"{what} takes {time / delivery.period:.3g} periods"
        for what, time in times.items()
        if abs(time / delivery.period - round(time / delivery.period)) > ROUNDING
    ]
    return "; ".join(wrong)


def _words_missing(delivery: Delivery, answer: Answer) -> str:
    text = " ".join(re.sub(r"\n# ?", " ", answer.said + "\n" + answer.text).split())
    missing = [pattern for pattern in delivery.told if not re.search(pattern, text, re.IGNORECASE)]
    if delivery.is_unstable and "recording" in answer.study:
        missing.append("an experiment in open loop of an unstable plant")
    said = f"; said: {answer.said.strip()[:300]}" if missing and delivery.is_controller else ""
    return f"not told: {', '.join(missing)}{said}" if missing else ""


def examine(program: str, folder: Path, labels: Iterable[str] = DELIVERIES) -> dict[str, dict[str, str]]:
    """Return the faults of the answer to each delivery, by rule; two are asked about at a time."""

    def examined(label: str) -> dict[str, str]:
        place = folder / label.replace(" ", "_")
        place.mkdir()
        return judge(DELIVERIES[label], ask(program, deliver(DELIVERIES[label], place)))

    labels = [*labels]
    with ThreadPoolExecutor(2) as pool:
        return dict(zip(labels, pool.map(examined, labels), strict=True))


def table_of(faults: Mapping[str, Mapping[str, str]]) -> str:
    """Return who is right, who is wrong and why, and how often each rule is broken."""
    right = [label for label, broken in faults.items() if not broken]
    lines = [f"{len(right)} of {len(faults)} right"]
    for label, broken in faults.items():
        lines += [f"  {'right' if not broken else 'WRONG'}  {label}"]
        lines += [f"           {rule}: {fault}" for rule, fault in broken.items()]
    broken_by_rule = {rule: sum(rule in broken for broken in faults.values()) for rule in RULES}
    return "\n".join([*lines, ", ".join(f"{rule} {count}" for rule, count in broken_by_rule.items())])


def test_most_proposals_are_such_as_an_engineer_would_sign(program: str, tmp_path: Path) -> None:
    faults = examine(program, tmp_path)
    assert sum(not broken for broken in faults.values()) >= RIGHT_AT_LEAST, table_of(faults)


def test_a_study_is_named_after_its_model_not_its_file(program: str, tmp_path: Path) -> None:
    title = ask(program, deliver(DELIVERIES["fishery"], tmp_path)).study["title"]
    assert DELIVERIES["fishery"].model.name in title
    assert "4711" not in title
