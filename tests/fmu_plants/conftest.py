"""FMUs built once per session, and instances of them at the level of the standard's functions."""

import ctypes
import sys
import zipfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import fmpy
import fmpy.fmi2 as fmi2
import fmpy.fmi3 as fmi3
import numpy as np
import pytest

from fmu_plants import Equations, Parameter, PlantModel, Symbols, Variable, build_fmu
from fmu_plants.pendulum import MODEL

collect_ignore = ["test_cache_posix.py", "export/test_compiler_posix.py"] if sys.platform == "win32" else []
collect_ignore += [] if sys.platform == "linux" else ["export/test_binaries.py"]


class Library:
    """The shared library of an extracted FMU."""

    def __init__(self, fmu: Path, folder: Path) -> None:
        with zipfile.ZipFile(fmu) as archive:
            archive.extractall(folder)
        self.description = fmpy.read_model_description(str(fmu))
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        is_fmi2 = self.description.fmiVersion == "2.0"
        name = self.description.coSimulation.modelIdentifier + fmpy.sharedLibraryExtension
        place = fmpy.platform if is_fmi2 else fmpy.platform_tuple
        self.functions = ctypes.CDLL(str(folder / "binaries" / place / name))
        kinds = ("2Instantiate",) if is_fmi2 else ("3InstantiateCoSimulation", "3InstantiateModelExchange")
        for kind in kinds:
            getattr(self.functions, f"fmi{kind}").restype = ctypes.c_void_p


class Instance:
    """One instance; every call returns the status of the standard, and messages are kept."""

    def __init__(
        self,
        library: Library,
        *,
        logging: bool = True,
        guid: str | None = None,
        kind: int = fmi2.fmi2CoSimulation,
        location: str = "",
    ) -> None:
        self.library = library
        self.messages: list[tuple[int, str, str]] = []

        def log(_: object, __: bytes, status: int, category: bytes, message: bytes) -> None:
            self.messages.append((status, category.decode(), message.decode()))

        self.callbacks = fmi2.fmi2CallbackFunctions(logger=fmi2.fmi2CallbackLoggerTYPE(log))
        self.component = library.functions.fmi2Instantiate(
            b"plant",
            kind,
            (guid or library.description.guid).encode(),
            location.encode(),
            ctypes.byref(self.callbacks),
            0,
            int(logging),
        )

    def call(self, name: str, *arguments: Any) -> int:
        return int(getattr(self.library.functions, name)(ctypes.c_void_p(self.component), *arguments))

    def setup(self, *, tolerance: float | None = None, start: float = 0.0, stop: float | None = None) -> int:
        return self.call(
            "fmi2SetupExperiment",
            int(tolerance is not None),
            ctypes.c_double(tolerance or 0.0),
            ctypes.c_double(start),
            int(stop is not None),
            ctypes.c_double(stop or 0.0),
        )

    def start(self, values: dict[str, float] | None = None, **experiment: float) -> "Instance":
        """Bring the instance to its first communication point."""
        assert self.setup(**experiment) == fmi2.fmi2OK
        assert self.set(values or {}) == fmi2.fmi2OK
        assert self.call("fmi2EnterInitializationMode") == fmi2.fmi2OK
        assert self.call("fmi2ExitInitializationMode") == fmi2.fmi2OK
        return self

    def set(self, values: dict[str, float]) -> int:
        return self.set_references([self.library.references[name] for name in values], list(values.values()))

    def set_references(self, references: Sequence[int], values: Sequence[float]) -> int:
        n = len(references)
        references_, values_ = (ctypes.c_uint * n)(*references), (ctypes.c_double * n)(*values)
        return self.call("fmi2SetReal", references_, ctypes.c_size_t(n), values_)

    def get_with_status(self, *names: str) -> tuple[int, np.ndarray]:
        n = len(names)
        references = (ctypes.c_uint * n)(*(self.library.references[name] for name in names))
        values = (ctypes.c_double * n)()
        return self.call("fmi2GetReal", references, ctypes.c_size_t(n), values), np.array(values)

    def get(self, *names: str) -> np.ndarray:
        status, values = self.get_with_status(*names)
        assert status == fmi2.fmi2OK, self.messages
        return values

    def step(self, time: float, size: float) -> int:
        return self.call("fmi2DoStep", ctypes.c_double(time), ctypes.c_double(size), 1)

    def last_successful_time(self) -> float:
        value = ctypes.c_double()
        assert self.call("fmi2GetRealStatus", fmi2.fmi2LastSuccessfulTime, ctypes.byref(value)) == fmi2.fmi2OK
        return value.value

    def run(self, inputs: np.ndarray, names: Sequence[str], size: float = 0.1, first: int = 0) -> np.ndarray:
        """Hold each row of the inputs (T, m) for one step; return the outputs after each, shape (T, p)."""
        rows = []
        for k, row in enumerate(inputs, first):
            assert self.set(dict(zip(names, row, strict=True))) == fmi2.fmi2OK
            assert self.step(k * size, size) == fmi2.fmi2OK, self.messages
            rows.append(self.get(*self.outputs()))
        return np.array(rows)

    def outputs(self) -> list[str]:
        return [unknown.variable.name for unknown in self.library.description.outputs]

    def free(self) -> None:
        self.library.functions.fmi2FreeInstance(ctypes.c_void_p(self.component))


class Instance3:
    """The same for FMI 3.0."""

    def __init__(
        self, library: Library, *, exchange: bool = False, token: str | None = None, path: str = ""
    ) -> None:
        self.library = library
        self.messages: list[tuple[int, str, str]] = []

        def log(_: object, status: int, category: bytes, message: bytes) -> None:
            self.messages.append((status, category.decode(), message.decode()))

        self.logger = fmi3.fmi3LogMessageCallback(log)
        guid = (token or library.description.guid).encode()
        if exchange:
            arguments = [b"plant", guid, b"", False, True, None, self.logger]
            self.component = library.functions.fmi3InstantiateModelExchange(*arguments)
        else:
            plain = [b"plant", guid, path.encode(), False, True]
            arguments = [*plain, False, False, None, ctypes.c_size_t(0)]
            self.component = library.functions.fmi3InstantiateCoSimulation(
                *arguments, None, self.logger, None
            )

    def call(self, name: str, *arguments: Any) -> int:
        return int(getattr(self.library.functions, name)(ctypes.c_void_p(self.component), *arguments))

    def initialize(
        self, *, tolerance: float | None = None, start: float = 0.0, stop: float | None = None
    ) -> int:
        return self.call(
            "fmi3EnterInitializationMode",
            tolerance is not None,
            ctypes.c_double(tolerance or 0.0),
            ctypes.c_double(start),
            stop is not None,
            ctypes.c_double(stop or 0.0),
        )

    def start(self, values: dict[str, float] | None = None, **experiment: float) -> "Instance3":
        """Bring the instance to its first communication point, or into event mode."""
        assert self.set(values or {}) == fmi3.fmi3OK
        assert self.initialize(**experiment) == fmi3.fmi3OK
        assert self.call("fmi3ExitInitializationMode") == fmi3.fmi3OK
        return self

    def set(self, values: dict[str, float]) -> int:
        n = len(values)
        references = (ctypes.c_uint * n)(*(self.library.references[name] for name in values))
        numbers = (ctypes.c_double * n)(*values.values())
        return self.call("fmi3SetFloat64", references, ctypes.c_size_t(n), numbers, ctypes.c_size_t(n))

    def get_with_status(self, *names: str) -> tuple[int, np.ndarray]:
        n = len(names)
        references = (ctypes.c_uint * n)(*(self.library.references[name] for name in names))
        values = (ctypes.c_double * n)()
        status = self.call("fmi3GetFloat64", references, ctypes.c_size_t(n), values, ctypes.c_size_t(n))
        return status, np.array(values)

    def get(self, *names: str) -> np.ndarray:
        status, values = self.get_with_status(*names)
        assert status == fmi3.fmi3OK, self.messages
        return values

    def step(self, time: float, size: float) -> int:
        self.flags = (ctypes.c_bool * 3)(True, True, True)
        self.last_time = ctypes.c_double()
        flags = [ctypes.byref(self.flags, index) for index in range(3)]
        return self.call(
            "fmi3DoStep",
            ctypes.c_double(time),
            ctypes.c_double(size),
            True,
            *flags,
            ctypes.byref(self.last_time),
        )

    def free(self) -> None:
        self.library.functions.fmi3FreeInstance(ctypes.c_void_p(self.component))


@pytest.fixture(scope="session", autouse=True)
def zig_cache(own_cache_folder: None, pytestconfig: pytest.Config) -> Iterator[None]:
    """Keep what zig prepares for each platform from one run of the tests to the next."""
    with pytest.MonkeyPatch.context() as patch:
        if (cache := getattr(pytestconfig, "cache", None)) is not None:
            patch.setenv("ZIG_GLOBAL_CACHE_DIR", str(cache.mkdir("zig")))
            patch.setenv("ZIG_LOCAL_CACHE_DIR", str(cache.mkdir("zig")))
        yield


@pytest.fixture
def no_compilation(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """Let FMUs have an empty library; return the list of what would have been compiled."""
    calls: list[object] = []

    def pretend(*arguments: object, **_: object) -> bytes:
        calls.append(arguments)
        return b""

    monkeypatch.setattr("fmu_plants.export.compile_library", pretend)
    return calls


@pytest.fixture
def open_fmu(tmp_path: Path) -> Iterator[Callable[..., Instance]]:
    """Extract FMUs and open an instance of each, freed after the test."""
    instances: list[Instance] = []

    def open_instance(fmu: Path, **options: Any) -> Instance:
        instances.append(Instance(Library(fmu, tmp_path / f"extracted-{len(instances)}"), **options))
        return instances[-1]

    yield open_instance
    for instance in instances:
        instance.free()


@pytest.fixture(scope="session")
def pendulum_library(pendulum_fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Library:
    return Library(pendulum_fmu, tmp_path_factory.mktemp("pendulum"))


@pytest.fixture
def pendulum(pendulum_library: Library) -> Iterator[Callable[..., Instance]]:
    """Open instances of the pendulum that are freed after the test."""
    instances: list[Instance] = []

    def open_instance(**options: Any) -> Instance:
        instances.append(Instance(pendulum_library, **options))
        return instances[-1]

    yield open_instance
    for instance in instances:
        instance.free()


@pytest.fixture(scope="session")
def pendulum3_fmu(own_cache_folder: None) -> Path:
    return build_fmu(MODEL, "3.0")


@pytest.fixture(scope="session")
def pendulum3_library(pendulum3_fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Library:
    return Library(pendulum3_fmu, tmp_path_factory.mktemp("pendulum3"))


@pytest.fixture
def pendulum3(pendulum3_library: Library) -> Iterator[Callable[..., Instance3]]:
    """Open instances of the pendulum for FMI 3.0 that are freed after the test."""
    instances: list[Instance3] = []

    def open_instance(**options: Any) -> Instance3:
        instances.append(Instance3(pendulum3_library, **options))
        return instances[-1]

    yield open_instance
    for instance in instances:
        instance.free()


def _escape_equations(v: Symbols) -> Equations:
    from sympy import sqrt

    return Equations({"x": v.gain * v.x**2}, {"root": sqrt(v.x), "held": v.push})


ESCAPE = PlantModel(
    name="escape",
    description="x' = gain x^2: leaves every bound at t = 1 from x = 1",
    states=(Variable("x", start=1.0),),
    inputs=(Variable("push", min=-1.0, max=1.0),),
    outputs=(Variable("root"), Variable("held")),
    parameters=(Parameter("gain", min=0.0, max=10.0, start=1.0),),
    equations=_escape_equations,
)


@pytest.fixture(scope="session")
def escape_library(own_cache_folder: None, tmp_path_factory: pytest.TempPathFactory) -> Library:
    return Library(build_fmu(ESCAPE), tmp_path_factory.mktemp("escape"))


@pytest.fixture
def escape_exchange(escape_library: Library) -> Iterator[Instance]:
    """An instance for Model Exchange."""
    instance = Instance(escape_library, kind=fmi2.fmi2ModelExchange)
    yield instance
    instance.free()


@pytest.fixture
def escape(escape_library: Library) -> Iterator[Instance]:
    instance = Instance(escape_library)
    yield instance
    instance.free()


@pytest.fixture
def cache(monkeypatch, tmp_path):
    monkeypatch.setenv("DDPC_COSIM_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"
