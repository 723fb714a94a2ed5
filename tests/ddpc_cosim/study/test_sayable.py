"""Python says whatever a study file can, and the reverse; keys and fields are those that classes declare."""

import dataclasses
import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import date
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import numpy as np
import pytest

from ddpc_controllers import MFAPC, PID, DeePC
from ddpc_cosim import (
    PRBS,
    Band,
    Chirp,
    Choice,
    Conditions,
    ConfigError,
    Connection,
    Constant,
    Drift,
    Entry,
    Factor,
    ForecastFile,
    GaussianNoise,
    Identification,
    Integer,
    Interpolated,
    KnownDisturbance,
    Linear,
    Log,
    LogNormal,
    MixedExcitation,
    Multisine,
    Normal,
    ParameterChange,
    Price,
    Problem,
    Product,
    Ramp,
    RandomLevels,
    RecordedSignal,
    Recording,
    Scenario,
    SignalExcitation,
    SignalFromFile,
    SignalFromResource,
    Sine,
    Steps,
    Study,
    Sum,
    Triangular,
    Uniform,
    UniformRandom,
    WhiteNoise,
)
from ddpc_cosim.codec import Kinds, declared_fields
from ddpc_cosim.conditions import all_conditions
from ddpc_cosim.metrics import all_metrics
from ddpc_cosim.responses import SampledSignal
from ddpc_cosim.study.cases import cases_of
from ddpc_cosim.study.file_format.sections import Study as StudyTables
from ddpc_cosim.study.problems import WholeStudy
from ddpc_cosim.study.reading import read_study, resolve_file

OF_TOOLS = {("Study", "based_on")} | {
    (owner, key) for owner in ("Study", "ControllerSection") for key in ("variant_of", "varied")
}
"""What only the written form of a study that was run says: where it comes from."""
OPEN_LOOP: dict[str, Any] = {"sampling_time": 0.1, "duration": 1.0, "reference": Constant(0.1)}
FILE_SIGNAL = SignalFromFile("a.csv", column="b", time_column="t", interpolation="linear", unit="deg")
SIGNALS = {
    "constant": Constant(1.0, unit="deg"),
    "steps": Steps([0.0], [1.0], unit="deg", period=2.0),
    "interpolated": Interpolated([0.0], [1.0], unit="deg", period=2.0),
    "ramp": Ramp(0.0, 1.0, 0.0, 1.0, unit="deg"),
    "sine": Sine(1.0, 2.0, 3.0, 4.0, unit="deg"),
    "file": FILE_SIGNAL,
    "resource": SignalFromResource("a.csv", "b", interpolation="linear", unit="deg"),
}
RANDOM = RandomLevels(0.0, 1.0, 0.5, interpolation="linear", unit="deg")
ACTING = SIGNALS | {
    "random": RANDOM,
    "sum": Sum([Constant(1.0), RANDOM], unit="deg"),
    "product": Product([RANDOM, Constant(0.5)], unit="deg"),
}
EXPERIMENT = MixedExcitation(
    (
        (UniformRandom(-1.0, 1.0, 64, unit="deg"), (0,)),
        (PRBS(-1.0, 1.0, 64, clock_period=2, unit="deg"), (1,)),
        (
            Multisine(
                *(-1.0, 1.0, 64),
                sampling_time=0.1,
                min_frequency=0.1,
                max_frequency=2.0,
                phases="random",
                unit="deg",
            ),
            (2,),
        ),
        (
            Chirp(
                *(-1.0, 1.0, 64),
                sampling_time=0.1,
                from_frequency=0.1,
                to_frequency=2.0,
                sweep="logarithmic",
                unit="deg",
            ),
            (3,),
        ),
        (SignalExcitation([RecordedSignal("a.csv", column="b", time_column="", unit="deg")], 64, 0.1), (4,)),
    )
)


def pendulum(**changes: Any) -> Problem:
    """A problem that can be resolved, with all that does not need files."""
    rough = Scenario(
        label="Rough",
        parameters={"mass": Uniform(0.9, 1.2)},
        noise=GaussianNoise({"angle": 0.01}),
        conditions=Conditions(
            disturbances={"torque": [Steps([0.5], [0.1]), WhiteNoise(0.1, 0.2, unit="N.m")]},
            rate_limit={"torque": 50.0},
            delay={"torque": 0.1},
            backlash={"torque": 0.1},
            quantum={"angle": 0.01},
            loss={"angle": 0.05},
        ),
        events=[ParameterChange(2.5, {"damping": 0.2})],
        drifts=[Drift(parameter="radius", start=1.0, stop=1.2, start_time=2.0, stop_time=2.5)],
        bounds={"torque": (-1.0, 1.0)},
        preview="horizon",
        excitation=UniformRandom(-2.0, 2.0, samples=90),
        start_time=1.8,
    )
    given: dict[str, Any] = {
        "plant": "pendulum",
        "sampling_time": 0.1,
        "duration": 1.0,
        "reference": {"angle": SIGNALS["steps"]},
        "inputs": ["torque"],
        "outputs": ["angle"],
        "measurements": ["angle", "angular_velocity"],
        "bounds": {"torque": (-3.5, 3.5), "angle": {"max": 90.0, "unit": "deg"}},
        "excitation": UniformRandom(-3.5, 3.5, samples=80),
        "stabiliser": PID(proportional=2.0),
        "parameters": {
            "mass": Normal(1.05, 0.1, low=0.5, high=1.5),
            "gravity": LogNormal(9.81, 1.01, low=9.0, high=10.0),
            "torque_gain": Triangular(0.9, 1.0, 1.2),
        },
        "sampling": "sobol",
        "scenarios": {"nominal": Scenario(), "rough": rough},
        "preview": 3,
        "start_time": 2.0,
        "cost": {"outputs": {"angle": 1.0}, "inputs": {"torque": 0.1}, "changes": {"torque": 0.01}},
        "relevant": {"absolute": 0.1, "percent": 2.0},
        "start": {"torque": 0.1},
        "nominal": {"torque": 3.5},
        "switches": {"torque": ""},
        "display_units": {"angle": "rad"},
        "step_timeout": 20.0,
        "case_timeout": 100.0,
        "memory_limit": 1.0,
        "engine": "compiled",
        "isolated": False,
        "title": "The pendulum",
        "summary": "It swings.",
        "source": "A book",
        "report": {"limitations": ["short"]},
        "requirements": {"rmse.angle": {"max": 1.0}},
    }
    return Problem(**given | changes)


REPORT: dict[str, Any] = {
    "panels": [{"title": "All", "controllers": ["pid", "DeePC-short"]}],
    "limitations": ["It is short."],
    "author": "Its author",
    "comment": "It is short.",
    "logo": "logo.svg",
    "scenario": "nominal",
    "baseline": "pid",
    "claims": [
        {"text": "PID is best", "metric": "rmse.angle", "lowest": "mfapc"},
        {"text": "DeePC is worst", "metric": "rmse.angle", "highest": "ipid"},
        {"text": "In order", "metric": "rmse.angle", "order": ["mfapc", "ipid"]},
        {"text": "No matter", "metric": "rmse.angle", "alike": "DeePC-short", "within": 20.0},
    ],
    "reproduction": {
        "source": "A book",
        "metrics": {"rmse.angle": "RMSE"},
        "methods": [
            {
                "label": "DeePC",
                "printed": "DeePC-short",
                "published_code": "pid",
                "values": {"rmse.angle": 1.0},
                "rest_samples": 1,
            }
        ],
        "notes": ["as printed"],
        "parameters": "Parameters",
    },
}
TUNED = {
    "settings": ["lambda_g"],
    "trials": 3,
    "seeds": [100],
    "by": "median rmse",
    "source": "here",
    "sampler_seed": 1,
    "at_ends": ["lambda_g"],
}
DEEPC = Entry(
    controller=DeePC(horizon=4),
    note="It sees four samples.",
    bounds={"torque": (-2.0, 2.0)},
    sweep=[{"lambda_g": [1.0, 5.0]}, {"zip": True, "horizon": (5, 6), "initial_length": np.array([3, 4])}],
    search={
        "lambda_g": Log(1.0, 100.0),
        "lambda_sigma": Factor(0.1, 10.0),
        "horizon": Integer(4, 8),
        "forgetting_factor": Linear(0.9, 1.0),
        "regulariser": Choice(["ridge"]),
        "initial_length": False,
    },
    first_trials=[{"lambda_g": 2.0}],
    tuned=TUNED,
    seeds="first",
)


def study(**changes: Any) -> Study:
    return Study(
        pendulum(),
        {"pid": PID(proportional=5.0), "DeePC, short": DEEPC, "mfapc": MFAPC(), "ipid": "ipid"},
        **{
            "seeds": range(2),
            "name": "all",
            "title": "All",
            "summary": "All that can be said.",
            "source": "A paper",
            "report": REPORT,
            "reference_points": ("pid", "DeePC, short"),
            "sweep": {"loop.sampling_time": [0.05]},
            **changes,
        },
    )


PARTS = {
    "one": {
        "parameters": {"a": 1.0},
        "start": {"u": 1.0},
        "step": 0.05,
        "fmi_type": "co-simulation",
        "isolated": True,
    }
}
PROBLEMS = {
    "pendulum": pendulum(),
    "fmu": Problem(
        plant=Path("plant.fmu"),
        inputs=["a", "b", "c", "d", "e"],
        outputs=["y"],
        fmi_type="model-exchange",
        library_path=[Path("libraries")],
        switches={"a": "a_on"},
        excitation=EXPERIMENT,
        recorded_inputs={"w": SIGNALS["steps"]},
        continue_recording=True,
        conditions=Conditions(inputs=dict(ACTING), recorded_inputs={"steps": Constant(1.0)}),
        noise={"y": 0.1},
        events=[ParameterChange(0.5, {"a": 0.2})],
        **OPEN_LOOP,
    ),
    "logged": Problem(
        plant="pendulum",
        outputs=["angle"],
        recording={
            "file": ["log.csv"],
            "columns": {"torque": "u"},
            "excitation_columns": ["setpoint"],
            "time_column": "t",
            "time_tolerance": 0.1,
            "dates": "excel",
            "time_zone": "Europe/Berlin",
            "encoding": "cp1252",
            "gaps": "split",
            "missing": 2,
            "missing_values": [-999.0],
            "duplicates": "mean",
            "resample": "linear",
            "outliers": 5.0,
            "part": [0.0, 0.5],
        },
        **OPEN_LOOP,
    ),
    "coupled": Problem(
        plant={"one": "one.fmu", "two": "pendulum"},
        outputs=["one.y"],
        connections=[Connection("one.y", "two.torque", factor=2.0, offset=1.0, convert_units=False)],
        coupling={
            "algorithm": "parallel",
            "communication_step": 0.05,
            "extrapolation": "linear",
            "loop_tolerance": 1e-6,
            "error_tolerance": 1e-3,
            "steps": {"two": 0.01},
        },
        parts=PARTS,
        **OPEN_LOOP,
    ),
    "regulated": Problem(
        plant="building",
        inputs=["heating"],
        outputs=["room_temperature"],
        sampling_time="15 min",
        duration="14 d",
        start_time=date(2026, 1, 23),
        reference=Band(20.0, Steps([0.0], [24.0]), "degC"),
        bounds={"heating": (0.0, Steps([0.0], [1.0]))},
        excitation=UniformRandom(0.0, 1.0, samples=90),
        disturbances={
            "outdoor_temperature": KnownDisturbance(
                signal=SIGNALS["sine"], lag=1, forecast=ForecastFile("f.csv", "issued", "degC")
            ),
            "sun": KnownDisturbance(signal=SIGNALS["steps"], known="medium"),
        },
        recorded_disturbances={"sun": Constant(1.0)},
        recording_start="day 3",
        prices={
            "electricity": Price(
                signal="heating",
                price=0.25,
                unit="EUR/kWh",
                factor=0.3,
                known=False,
                emissions=SIGNALS["steps"],
                emissions_unit="g/kWh",
            )
        },
        communication_step="5 min",
        warm_up="7 d",
        warm_up_controller=PID(proportional=2.0),
        ranking="pareto",
        key_figures={
            "set": "boptest",
            "area": 120.0,
            "sources": {"ElectricPower": ["heating"], "AirZoneTemperature[1]": ["attic"]},
            "bands": {"attic": {"band": {"lower": 15.0, "upper": 25.0}, "unit": "degC"}},
        },
        requirements={"controllers": ["pid"], "share": 0.9}
        | {
            f"{name}.room_temperature" if issubclass(metric.of, SampledSignal) else name: {
                "min": 0.0,
                "max": 1.0,
                "share": 0.8,
                "unit": "K",
                "scenarios": ["cold"],
            }
            for name, metric in all_metrics().items()
        },
        scenarios={
            "cold": Scenario(
                known={"sun": "perfect"},
                prices={"electricity": Steps([0.0], [0.4])},
                bounds={"heating": (0, 2)},
            )
        },
    ),
    "log": Problem(
        plant=Identification(
            file=["log.csv"],
            disturbances=["sun"],
            columns={"sun": "E1"},
            sampling_time=60.0,
            method="arx",
            order=2,
            members=5,
            noise=False,
            start="log-end",
            time_column="t",
            time_tolerance=0.1,
            dates="excel",
            time_zone="Europe/Berlin",
            encoding="cp1252",
            gaps="split",
            missing=2,
            missing_values=[-999.0],
            duplicates="mean",
            resample="linear",
            outliers=5.0,
            part=[0.5, 1.0],
        ),
        inputs=["u"],
        outputs=["y"],
        **OPEN_LOOP,
    ),
    "ssp": Problem(plant="system.ssp", outputs=["y"], parts=PARTS, **OPEN_LOOP),
}


def classes_of(hint: Any, table: Any = None) -> Sequence[Any]:
    """Return the classes that a type names, or those that a table is of."""
    if get_origin(hint) is Annotated:
        kinds = next((argument for argument in get_args(hint) if isinstance(argument, Kinds)), None)
        if kinds and table is not None:
            return [kinds.marked_in(table) or kinds.classes[table.get(kinds.key, kinds.default)]]
        return (
            [*kinds.classes.values(), *kinds.marked.values()]
            if kinds
            else classes_of(get_args(hint)[0], table)
        )
    if get_origin(hint) in (Union, UnionType):
        return [kind for argument in get_args(hint) for kind in classes_of(argument, table)]
    return [hint] if dataclasses.is_dataclass(hint) else []


def all_keys(kind: Any) -> Iterator[tuple[str, str]]:
    """Yield the keys of a class and of what its fields hold, with the class that declares each."""
    for key, field in declared_fields(kind).items():
        yield kind.__name__, key
        pending = [field.hint]
        while pending:
            hint = pending.pop()
            pending += [] if classes_of(hint) else get_args(hint)
            for inner in classes_of(hint):
                yield from all_keys(inner)


def keys_in(hint: Any, value: Any) -> Iterator[tuple[str, str]]:
    """Yield the keys that a value of a file has, with the class that declares each."""
    if isinstance(value, list):
        inner = get_args(hint)[0] if get_origin(hint) is Annotated and not classes_of(hint) else hint
        for item in value:
            yield from keys_in(get_args(inner)[0] if get_origin(inner) is list else hint, item)
    elif isinstance(value, dict):
        if get_origin(hint) is Annotated and not classes_of(hint):
            yield from keys_in(get_args(hint)[0], value)
        elif get_origin(hint) in (Union, UnionType) and not classes_of(hint):
            for argument in get_args(hint):
                yield from keys_in(argument, value)
        elif get_origin(hint) in (dict, Mapping):
            for item in value.values():
                yield from keys_in(get_args(hint)[1], item)
        for kind in classes_of(hint, value):
            for key, item in value.items():
                if key in declared_fields(kind):
                    yield kind.__name__, key
                    yield from keys_in(declared_fields(kind)[key].hint, item)


def said_in(tables: Mapping[str, Any]) -> set[tuple[str, str]]:
    return set(keys_in(StudyTables, tables))


def test_python_says_every_key_of_a_study_file(tmp_path: Path) -> None:
    """Also of those that are yet to come: whoever adds one finds here that Python must say it, too."""
    said = said_in(tomllib.loads(study().write(tmp_path / "all.toml").read_text("utf-8")))
    for problem in PROBLEMS.values():
        said |= said_in(problem.tables())
    assert set(all_keys(StudyTables)) - said == OF_TOOLS
    assert {key for kind, key in said if kind == "ScenarioSection"} >= set(all_conditions())


def is_said(given: Any, field: dataclasses.Field[Any], tables: Any) -> bool:
    """Whether what an object has in a field changes what a file says."""
    default = field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
    if default is dataclasses.MISSING or (value := getattr(given, field.name)) is default or value == default:
        return False
    with suppress(ConfigError):  # others need it
        return bool(tables(dataclasses.replace(given, **{field.name: default})) != tables(given))
    return True


def is_required(field: dataclasses.Field[Any]) -> bool:
    return field.default is field.default_factory is dataclasses.MISSING


def test_a_file_says_every_field_of_the_objects_in_python() -> None:
    logged = Recording(np.zeros((5, 1)), np.zeros((5, 1)), np.zeros((5, 1)), 0.1)
    problems = [*PROBLEMS.values(), pendulum(excitation=None, stabiliser=None, recording=logged)]
    scenarios = [scenario for problem in problems for scenario in problem.scenarios.values()]
    objects: Mapping[Any, Any] = {
        Problem: (problems, lambda problem: problem.tables()),
        Scenario: (scenarios, lambda scenario: scenario.table(["torque"])),
        Entry: ([DEEPC], lambda entry: entry.table()),
    }
    for kind, (given, tables) in objects.items():
        fields = [field for field in dataclasses.fields(kind) if not is_required(field)]
        silent = {f.name for f in fields if not any(is_said(value, f, tables) for value in given)}
        assert silent == set(), kind


def ids(resolved: Any) -> list[str]:
    return [
        case.id for problem in resolved.problems.values() for case in cases_of(problem, problem.plant.built())
    ]


@pytest.mark.filterwarnings("ignore:the reference of angle")
def test_what_python_says_runs_as_its_file_does(tmp_path: Path) -> None:
    """The same cases with the same ids, from the objects, their file, and the file read and written again."""
    several = Study(
        {"pendulum": pendulum(), "calm": pendulum(scenarios={}, isolated="auto")},
        {
            "pid": {"pendulum": Entry(controller=PID(), note="here"), "calm": PID()},
            "deepc": dataclasses.replace(DEEPC, seeds="all"),
        },
        report={"limitations": ["short"]},
    )
    for made in (study(), several):
        path = made.write(tmp_path / "study.toml")
        resolved = resolve_file(made._file)
        assert len(ids(resolved)) > 10
        assert ids(read_study(str(path))) == ids(resolved)
        again = Study.read(path).write(tmp_path / "elsewhere" / "study.toml")
        assert ids(read_study(str(again))) == ids(resolved)
        assert WholeStudy.of_tables(resolved.whole.tables()) == resolved.whole
    sections = read_study(str(study().write(tmp_path / "one.toml"))).problems["all"].study
    entry = sections.controllers["DeePC-short"]
    assert (entry.label, entry.note) == ("DeePC, short", "It sees four samples.")
    assert entry.search["lambda_g"].space == Log(1.0, 100.0)
    assert entry.search["initial_length"].space is None
    assert sections.bounds["angle"].min is None
    assert sections.scenarios["rough"].recording is not None
    assert math.isclose(sections.report.claims[3].within, 20.0)


def test_files_that_python_names_are_found_from_any_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Paths are relative to where the objects are made."""
    monkeypatch.chdir(tmp_path)
    tables = PROBLEMS["fmu"].tables() | {"logged": PROBLEMS["logged"].tables()}
    assert tables["plant"]["fmu"] == str(tmp_path / "plant.fmu")
    assert tables["recording"]["excitation"]["e"]["file"] == str(tmp_path / "a.csv")
    assert tables["scenarios"]["nominal"]["inputs"]["file"]["file"] == str(tmp_path / "a.csv")
    assert tables["logged"]["recording"]["file"] == [str(tmp_path / "log.csv")]
    parts = PROBLEMS["coupled"].tables()["plant"]["parts"]
    assert [part.get("fmu") for part in parts] == [str(tmp_path / "one.fmu"), None]
    swept = Study(PROBLEMS["logged"], {"pid": "pid"}, sweep={"recording.file": ["a.csv", "b.csv"]})
    file = tomllib.loads(swept.write(tmp_path / "below" / "study.toml").read_text("utf-8"))
    assert file["sweep"] == [{"recording.file": [str(tmp_path / "a.csv"), str(tmp_path / "b.csv")]}]
