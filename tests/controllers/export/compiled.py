"""A controller's C code, compiled and called beside the Python controller that it comes from."""

import ctypes
import hashlib
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ddpc_controllers.export.code import STATUSES
from ddpc_cosim import (
    OK,
    Action,
    Controller,
    ControllerCode,
    FloatArray,
    Loop,
    Sample,
    Variable,
    further_arguments,
)

STRICT = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O2", "-ffp-contract=off")


@cache
def _folder() -> Path:
    import atexit

    folder = Path(tempfile.mkdtemp(prefix="controller-code-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def compiled(code: ControllerCode) -> ctypes.CDLL:
    """Return the code as a loaded library; kernels are compiled once for all controllers."""
    folder = _folder() / _digest(code.sources)
    library = folder / "controller.so"
    if not library.exists():
        folder.mkdir(exist_ok=True)
        for name, text in code.sources.items():
            (folder / name).write_text(text, encoding="utf-8")
        headers = {name: text for name, text in code.sources.items() if name.endswith(".h")}
        header = headers.pop("controller.h")
        objects = []
        for name, text in code.sources.items():
            if name.endswith(".c"):
                seen = headers | {name: text, "controller.h": header if '"controller.h"' in text else ""}
                objects.append(_folder() / f"{_digest(seen)}.o")
                if not objects[-1].exists():
                    _cc(folder, *STRICT, "-fPIC", "-c", name, "-o", str(objects[-1]))
        _cc(folder, "-shared", *map(str, objects), "-o", library.name, "-lm")
    return ctypes.CDLL(str(library))


def _digest(sources: Mapping[str, str]) -> str:
    return hashlib.sha256(repr(sorted(sources.items())).encode()).hexdigest()[:16]


def _cc(folder: Path, *arguments: str) -> None:
    done = subprocess.run(["cc", *arguments], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


class CompiledController:
    """The C code of a started controller, as a state to step."""

    def __init__(self, controller: Controller, loop: Loop) -> None:
        self.code, self._loop = controller.c_code(loop), loop
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
        self._further = further_arguments(loop, controller.horizon)
        self._doubles = ctypes.POINTER(ctypes.c_double)
        self._library.controller_start(ctypes.byref(self.state))

    def step(self, sample: Sample) -> FloatArray:
        """Return the inputs for a sample, shape (m,)."""
        y, r = self._arguments(sample)
        self.status = self._library.controller_step(
            ctypes.byref(self.state),
            y.ctypes.data_as(self._doubles),
            r.ctypes.data_as(self._doubles),
            self._u,
        )
        return np.array(self._u)

    def follow(self, sample: Sample, applied: FloatArray) -> FloatArray:
        """Let it follow a sample at which these inputs are applied; return what it answers, shape (m,)."""
        y, r = self._arguments(sample)
        self._u[:] = applied.tolist()
        self.status = self._library.controller_follow(
            ctypes.byref(self.state),
            y.ctypes.data_as(self._doubles),
            r.ctypes.data_as(self._doubles),
            self._u,
        )
        return np.array(self._u)

    def limits_at(self, sample: Sample) -> tuple[FloatArray, FloatArray]:
        """Return the limits of the inputs at a sample."""
        if self._loop.moving_limits:
            return sample.input_limits[0, :, 0], sample.input_limits[0, :, 1]
        return self._loop.bounds.u_min, self._loop.bounds.u_max

    def _arguments(self, sample: Sample) -> tuple[FloatArray, FloatArray]:
        y = np.append(sample.y, sample.measured[self._others])
        further = [getattr(sample, name)[: shape[0]].ravel() for name, shape in self._further.items()]
        r = [sample.setpoint, sample.reference[: self._preview].ravel(), *further]
        return np.ascontiguousarray(y), np.concatenate(r)

    @property
    def last_step(self) -> tuple[int, int, int]:
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
        self.c = self._other(loop)
        bounds, self.difference, self.steps, self.fallbacks = loop.bounds, 0.0, 0, 0
        self.limited = self.statuses = self.active = 0
        self.disagreements = list[tuple[int, str, int]]()
        self.span = np.array(
            [_size(v, *ends) for v, *ends in zip(loop.inputs, bounds.u_min, bounds.u_max, strict=True)]
        )
        self._bounds, self._moves = bounds, bool(loop.moving_limits)

    def _other(self, loop: Loop) -> Any:
        return CompiledController(self.controller, loop)

    def step(self, sample: Sample) -> Action:
        answer = self.controller.step(sample)
        action = answer if isinstance(answer, Action) else Action(answer)
        u = self.c.step(sample)
        low, high = self._bounds.u_min, self._bounds.u_max
        if self._moves:
            low, high = sample.input_limits[0].T
        wanted = np.clip(action.u, low, high)  # as the master does
        self.difference = max(self.difference, float(np.max(np.abs(u - wanted) / self.span)))
        if (action.status == OK) != (self.c.status == 0):
            self.disagreements.append((sample.k, action.status, self.c.status))
        self.steps, self.fallbacks = self.steps + 1, self.fallbacks + (self.c.status != 0)
        self.limited += bool(((u <= low) | (u >= high)).any())
        self.statuses, self.active = self.statuses | self.c.status, max(self.active, self.c.last_step[2])
        assert self.c.status & ~sum(STATUSES) == 0
        return Action(u, action.status) if self.drives else action


def _size(variable: Variable, low: float, high: float) -> float:
    """Return what an input is measured by: half its range, or its nominal value."""
    return (high - low) / 2 if np.isfinite(high - low) else abs(variable.nominal)
