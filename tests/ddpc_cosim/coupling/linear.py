"""Linear plants in Python, exact over every step."""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, cast

import numpy as np
from scipy.linalg import expm

from ddpc_cosim import Plant
from ddpc_cosim.variables import FloatArray, Variable


class LinearPlant(Plant):
    """dx' = A x + B u, y = C x + D u."""

    def __init__(
        self,
        a: Any = (),
        b: Any = (),
        c: Any = (),
        d: Any = (),
        x0: Any = (),
        inputs: Sequence[str | Variable] = ("u",),
        outputs: Sequence[str | Variable] = ("y",),
    ) -> None:
        n, m, p = len(x0), len(inputs), len(outputs)
        shapes = ((n, n), (n, m), (p, n), (p, m))
        self.matrices = tuple(
            np.reshape(np.array(given, dtype=float), shape) if np.size(given) else np.zeros(shape)
            for given, shape in zip((a, b, c, d), shapes, strict=True)
        )
        self.x0, self.x = np.array(x0, dtype=float), np.zeros(n)
        self.inputs = tuple(v if isinstance(v, Variable) else Variable(v) for v in inputs)
        self.outputs = tuple(v if isinstance(v, Variable) else Variable(v) for v in outputs)
        self.dependencies = {
            out.name: frozenset(known.name for known, gain in zip(self.inputs, row, strict=True) if gain)
            for out, row in zip(self.outputs, self.matrices[3], strict=True)
        }
        self.calls: list[str] = []
        self.parameters: dict[str, Any] = {}
        self._over = cache(self._discrete)

    def _discrete(self, h: float) -> tuple[FloatArray, FloatArray]:
        a, b, _, _ = self.matrices
        n, m = b.shape
        both = expm(h * np.block([[a, b], [np.zeros((m, n + m))]]))
        return both[:n, :n], both[:n, n:]

    def reset(self, parameters: Mapping[str, Any] | None = None, t0: float = 0.0) -> FloatArray:
        self.x, self.parameters = self.x0.copy(), dict(parameters or {})
        return self.outputs_at(np.array([variable.start for variable in self.inputs]))

    def step(self, u: FloatArray, h: float) -> FloatArray:
        self.calls.append("step")
        a, b = self._over(h)
        self.x = a @ self.x + b @ u
        return cast("FloatArray", self.matrices[2] @ self.x + self.matrices[3] @ u)

    def outputs_at(self, u: FloatArray) -> FloatArray:
        self.calls.append("outputs_at")
        return cast("FloatArray", self.matrices[2] @ self.x + self.matrices[3] @ u)

    can_save_state = True

    def save_state(self) -> object:
        return self.x.copy()

    def restore_state(self, state: object) -> None:
        self.x = cast("FloatArray", state).copy()

    def set_parameters(self, parameters: Mapping[str, Any]) -> None:
        self.parameters.update(parameters)

    def close(self) -> None:
        self.calls.append("close")


def gain(factor: float, **names: Any) -> LinearPlant:
    """Return y = factor * u."""
    return LinearPlant(d=[[factor]], **names)


def lag(time_constant: float = 1.0, x0: float = 0.0) -> LinearPlant:
    """Return y' = (u - y) / time_constant."""
    return LinearPlant([[-1.0 / time_constant]], [[1.0 / time_constant]], [[1.0]], x0=[x0])
