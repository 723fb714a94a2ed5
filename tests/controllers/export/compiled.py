"""A controller's C code, compiled and called beside the Python controller that it comes from."""

import ctypes
import hashlib
import shutil
import subprocess
import tempfile
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

from ddpc_controllers.export.code import STATUSES
from ddpc_cosim import OK, Action, Controller, ControllerCode, FloatArray, Loop, Sample, Variable

STRICT = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O2", "-ffp-contract=off")


@cache
def _folder() -> Path:
    import atexit

    folder = Path(tempfile.mkdtemp(prefix="controller-code-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def compiled(code: ControllerCode) -> ctypes.CDLL:
    """Return the code as a loaded library."""
    digest = hashlib.sha256(repr(sorted(code.sources.items())).encode()).hexdigest()[:16]
    folder = _folder() / digest
    library = folder / "controller.so"
    if not library.exists():
        folder.mkdir(exist_ok=True)
        for name, text in code.sources.items():
            (folder / name).write_text(text, encoding="utf-8")
        sources = [name for name in code.sources if name.endswith(".c")]
        command = ["cc", *STRICT, "-fPIC", "-shared", *sources, "-o", library.name, "-lm"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(library))


class CompiledController:
    """The C code of a started controller, as a state to step."""

    def __init__(self, controller: Controller, loop: Loop) -> None:
        self.code = controller.c_code(loop)
        self._library = compiled(self.code)
        sizes = dict(
            line.split()[1:]
            for line in self.code.sources["controller.h"].splitlines()
            if "#define CONTROLLER_" in line and len(line.split()) == 3
        )
        self._memory = int(sizes["CONTROLLER_MEMORY"])
        self.state = (ctypes.c_double * (self._memory + 2))()  # and three unsigned
        self._u = (ctypes.c_double * int(sizes["CONTROLLER_INPUTS"]))()
        outputs = [variable.name for variable in loop.outputs]
        self._others = [i for i, v in enumerate(loop.measurements) if v.name not in outputs]
        self._preview = min(loop.preview, controller.horizon)
        self._doubles = ctypes.POINTER(ctypes.c_double)
        self._library.controller_start(ctypes.byref(self.state))

    def step(self, sample: Sample) -> FloatArray:
        """Return the inputs for a sample, shape (m,)."""
        y = np.ascontiguousarray(np.append(sample.y, sample.measured[self._others]))
        r = np.ascontiguousarray(np.vstack([sample.setpoint, sample.reference[: self._preview]]))
        self.status = self._library.controller_step(
            ctypes.byref(self.state),
            y.ctypes.data_as(self._doubles),
            r.ctypes.data_as(self._doubles),
            self._u,
        )
        return np.array(self._u)

    @property
    def told(self) -> tuple[int, int, int]:
        """Status, iterations and active bounds of the last step."""
        status, iterations, active = np.frombuffer(self.state, np.uint32)[2 * self._memory :][:3].tolist()
        return status, iterations, active


@dataclass(kw_only=True)
class Beside(Controller):
    """A controller in Python that runs the loop, with its C code beside it that sees the same samples.

    The one that does not drive the plant is in no loop: where a controller by itself is unstable, roundings
    grow in it, and two loops are to be compared.
    """

    controller: Controller
    horizon: int = field(init=False)
    drives: bool = False
    """Whether the C code runs the loop, and Python sees its samples."""

    def __post_init__(self) -> None:
        self.horizon = self.controller.horizon

    @property
    def uses_recording(self) -> bool:
        return self.controller.uses_recording

    @property
    def accepts_missing(self) -> bool:
        return self.controller.accepts_missing

    def start(self, loop: Loop) -> None:
        self.controller.start(loop)
        self.c = CompiledController(self.controller, loop)
        bounds, self.difference, self.steps, self.fallbacks = loop.bounds, 0.0, 0, 0
        self.limited = self.statuses = self.active = 0
        self.disagreements = list[tuple[int, str, int]]()
        self._span = np.array(
            [_size(v, *ends) for v, *ends in zip(loop.inputs, bounds.u_min, bounds.u_max, strict=True)]
        )
        self._bounds = bounds

    def step(self, sample: Sample) -> Action:
        answer = self.controller.step(sample)
        action = answer if isinstance(answer, Action) else Action(answer)
        u = self.c.step(sample)
        wanted = np.clip(action.u, self._bounds.u_min, self._bounds.u_max)  # as the master does
        self.difference = max(self.difference, float(np.max(np.abs(u - wanted) / self._span)))
        if (action.status == OK) != (self.c.status == 0):
            self.disagreements.append((sample.k, action.status, self.c.status))
        self.steps, self.fallbacks = self.steps + 1, self.fallbacks + (self.c.status != 0)
        self.limited += bool(((u <= self._bounds.u_min) | (u >= self._bounds.u_max)).any())
        self.statuses, self.active = self.statuses | self.c.status, max(self.active, self.c.told[2])
        assert self.c.status & ~sum(STATUSES) == 0
        return Action(u, action.status) if self.drives else action


def _size(variable: Variable, low: float, high: float) -> float:
    """Return what an input is measured by: half its range, or its nominal value."""
    return (high - low) / 2 if np.isfinite(high - low) else abs(variable.nominal)
