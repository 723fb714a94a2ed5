"""A plant's own equations in CasADi: sampled by Runge-Kutta steps, with a disturbance that explains the rest.

    x+ = F(x, u + d, t, w),   y = h(x, u + d, t, w)

The equations are those of a `PlantModel` of :mod:`fmu_plants`, found as a plug-in. The inputs carry the
disturbance d; where they outnumber the outputs, the outputs do. What acts besides, w, are the known
disturbances that are inputs of the plant, then what it reads from its tables, such as weather. Of a plant
that controls itself the inputs are the overrides of its actuators.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from importlib import import_module
from pathlib import Path
from typing import Any
from warnings import catch_warnings

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim import (
    ConfigError,
    FloatArray,
    FMUImportError,
    Loop,
    MissingLibraryError,
    Variable,
)
from ddpc_cosim.plugins import installed, load_plugin

_STEP_TIMES_POLE = 2.0
"""Runge-Kutta steps of fourth order are stable up to 2.78."""
_LONGEST_STIFF = 8.0
"""Sampling time times pole beyond which collocation need not converge: friction at rest is such a pole."""
_MOST_STEPS = 200
_STATE_NOISE = 1e-4
"""In parts of nominal values, per sample: a state that nothing drives must not be taken for known exactly."""
_RADAU = ((4 - 6**0.5) / 10, (4 + 6**0.5) / 10, 1.0)
"""Points of the collocation of order 5 that is stiffly accurate, Radau IIA."""


def _derivatives() -> FloatArray:
    """Return what values at 0 and at the points make of derivatives at the points, shape (4, 3)."""
    points = np.array([0.0, *_RADAU])
    powers = np.arange(len(points))
    of_values = np.linalg.inv(points[:, np.newaxis] ** powers)  # of a polynomial: its coefficients
    at_points = powers[1:] * points[1:, np.newaxis] ** (powers[1:] - 1)
    return (at_points @ of_values[1:]).T


_DERIVATIVES = _derivatives()


def casadi() -> Any:
    """Import CasADi.

    Raises
    ------
    MissingLibraryError
        It is not installed.
    """
    try:
        return import_module("casadi")
    except ImportError as error:
        raise MissingLibraryError.of("NMPC", "CasADi", "nmpc") from error


def find_model(model: str, fmu: str) -> Any:
    """Return a plant's model by its name or ``module:MODEL``; without, the one that an FMU was exported from.

    Raises
    ------
    PluginError
        There is none of this name.
    ConfigError
        The FMU is of no plant that is installed, or what is named has no equations.
    """
    if model:
        loaded = load_plugin("plants", model)
    elif fmu == "{plant}":
        raise ConfigError('NMPC: which plant? give model, for example model = "pendulum"')
    else:
        name = _model_name(fmu)
        known = {getattr(plugin.value, "name", ""): plugin.value for plugin in installed("plants")}
        if name not in known:
            raise ConfigError(f'NMPC: {Path(fmu).name} is of no installed plant; give model = "module:MODEL"')
        loaded = known[name]
    if not callable(getattr(loaded, "equations", None)):
        raise ConfigError(f'NMPC: model = "{model}" has no equations; needed: a PlantModel')
    return loaded


def _model_name(fmu: str) -> str:
    from ddpc_cosim import FMUPlant  # what runs FMUs, which reading a study does not need

    try:
        with (
            catch_warnings(action="ignore"),
            FMUPlant(fmu) as plant,
        ):  # the plant's own are told where it runs
            return plant.description.model_name
    except FMUImportError as error:
        raise ConfigError(f"NMPC: {fmu} is not an FMU that can be read: {error}") from error


def measured_signals(loop: Loop) -> tuple[Variable, ...]:
    """Return the outputs, then the measurements that are not outputs."""
    outputs = {variable.name for variable in loop.outputs}
    return (*loop.outputs, *(variable for variable in loop.measurements if variable.name not in outputs))


class PlantEquations:
    """A plant's equations, sampled for a loop.

    Parameters
    ----------
    model : PlantModel
        The plant.
    loop : Loop
        Its inputs and outputs are the model's, by name; further inputs rest at their start values. Of known
        disturbances that are outputs of the model, the equations say what they are.
    given : mapping of str to float
        Parameters, and inputs that the loop does not drive, that differ from the model's.

    Attributes
    ----------
    advance, output : casadi.Function
        x+ and what is measured, see :func:`measured_signals`, as functions of
        (x, u, d, t), and of w where there is one.
    start : array, shape (n,)
        States that the model starts from.
    nominal : array, shape (n,)
        Their nominal values.
    defects : casadi.Function
        What states at points of a sample, shape (n, points), leave of the equations, as a function of
        them and of the arguments of ``advance``; the last of them is x+.
    points : int
        How many points a sample has: those of a collocation, or, where poles are too fast, its end alone.
    disturbances : int
        Size of d.
    acting : int
        Size of w.

    Raises
    ------
    ConfigError
        Every signal that the model does not have, an actuator that it controls itself, or a function that
        CasADi does not have.
    """

    def __init__(self, model: Any, loop: Loop, given: Mapping[str, float]) -> None:
        ca = casadi()
        signals = measured_signals(loop)
        driven, disturbance_names = (
            [v.name for v in variables] for variables in (loop.inputs, loop.disturbances)
        )
        given_out = {variable.name for variable in (*model.states, *model.outputs)}
        self._known = [i for i, name in enumerate(disturbance_names) if name not in given_out]
        known = [disturbance_names[i] for i in self._known]
        _check_names(model, driven, known, [variable.name for variable in signals], given)
        self.tables = model.tables
        constants = {v.name: v.start for v in (*model.inputs, *model.parameters)} | dict(given)
        commands = [model.overrides.get(name, name) for name in driven]

        states = [state.name for state in model.states]
        acting = [*known, *(variable.name for variable in model.columns)]
        n, m, p, n_w = len(states), len(driven), len(loop.outputs), len(acting)
        self.acting = n_w
        x, u, t, w = ca.SX.sym("x", n), ca.SX.sym("u", m), ca.SX.sym("t"), ca.SX.sym("w", n_w)
        self.disturbances = m if m <= p else p
        d = ca.SX.sym("d", self.disturbances)
        arguments = [x, u, d, t, *([w] if acting else [])]
        applied = u + d if m <= p else u
        values = constants | dict(zip(commands, ca.vertsplit(applied), strict=True)) | {"time": t}
        values |= dict(zip(states, ca.vertsplit(x), strict=True))
        values |= dict(zip(acting, ca.vertsplit(w) if acting else (), strict=True))
        equations = model.equations(_Symbols([*values]))
        convert = _Converter(ca, values)
        outputs = {name: values[name] for name in states} | {
            name: convert(expression) for name, expression in equations.outputs.items()
        }
        slope = ca.Function(
            "slope", arguments, [ca.vertcat(*(convert(equations.derivatives[s]) for s in states))]
        )
        seen = ca.vertcat(*(outputs[variable.name] for variable in signals))
        if m > p:
            seen += ca.vertcat(d, ca.SX.zeros(len(signals) - p))
        self.output = ca.Function("output", arguments, [seen])
        self.start = np.array([state.start for state in model.states])
        self.nominal = np.array([state.nominal for state in model.states])
        rest, usual = (
            np.array([variable.start for variable in variables])
            for variables in (loop.inputs, loop.disturbances)
        )
        usual = self.of_acting(usual[np.newaxis], np.zeros(1))[0]

        def at(x: Any, t: Any) -> Any:
            return slope(x, u, d, t, *arguments[4:])

        at_start = self.start, rest, np.zeros(self.disturbances), 0.0, *_given(usual)
        poles = loop.sampling_time * _poles(ca, slope, at_start)
        fastest = np.abs(poles).max(initial=0.0)
        self.steps = int(np.clip(np.ceil(fastest / _STEP_TIMES_POLE), 2, _MOST_STEPS))
        h, end = loop.sampling_time / self.steps, x
        for i in range(self.steps):
            end = _runge_kutta(at, end, t + i * h, h)
        self.advance = ca.Function("advance", arguments, [end])

        swings = np.abs(poles.imag).max(initial=0.0)
        if fastest > _LONGEST_STIFF or swings > _STEP_TIMES_POLE:
            z = ca.SX.sym("z", n, 1)
            left = end - z
        else:
            z = ca.SX.sym("z", n, len(_RADAU))
            left = _collocation(ca, at, x, z, t, loop.sampling_time)
        self.points = z.shape[1]
        self.defects = ca.Function("defects", [z, *arguments], [ca.cse(left)])

    def of_acting(self, disturbances: FloatArray, times: FloatArray) -> FloatArray:
        """Return w at times [s], shape (samples, n_w), given the loop's disturbances then, (samples, n_d)."""
        return np.hstack([disturbances[:, self._known], *(table.at(times) for table in self.tables)])


class _Symbols:
    """The symbols that a plant's equations are given."""

    def __init__(self, names: Sequence[str]) -> None:
        symbol = import_module("sympy").Symbol
        self._symbols = {name: symbol(name, real=True) for name in names}

    def __getitem__(self, name: str) -> Any:
        return self._symbols[name]

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return self._symbols[name]


class _Converter:
    """SymPy expressions in CasADi's."""

    def __init__(self, ca: Any, values: Mapping[str, Any]) -> None:
        self._ca, self._values = ca, values
        self._sympy: Any = import_module("sympy")

    def __call__(self, expression: Any) -> Any:
        """Return an expression of the symbols' values."""
        sympy, ca = self._sympy, self._ca
        expression = sympy.sympify(expression)
        if expression.is_Symbol:
            return self._values[expression.name]
        if expression.is_number:
            return float(expression)
        if isinstance(expression, sympy.Piecewise):
            return self._piecewise(expression.args)
        parts = [self(part) for part in expression.args]
        many = {"Add": ca.plus, "Mul": ca.times, "Max": ca.fmax, "Min": ca.fmin}
        renamed = {"Pow": "power", "Abs": "fabs", "ceiling": "ceil", "StrictGreaterThan": "gt"}
        renamed |= {"GreaterThan": "ge", "StrictLessThan": "lt", "LessThan": "le"}
        name = type(expression).__name__
        if name in many:
            return reduce(many[name], parts)
        function = getattr(ca, renamed.get(name, name), None)
        if function is None:
            raise ConfigError(f"NMPC: the model's equations use {name}, which is not converted to CasADi")
        return function(*parts)

    def _piecewise(self, pieces: Sequence[Any]) -> Any:
        (value, condition), *others = pieces
        if condition == True or not others:  # noqa: E712 - SymPy's own truth
            return self(value)
        return self._ca.if_else(self(condition), self(value), self._piecewise(others))


def _check_names(
    model: Any,
    driven: Sequence[str],
    disturbances: Sequence[str],
    signals: Sequence[str],
    given: Mapping[str, float],
) -> None:
    acting = {*driven, *disturbances}
    known = {
        "input": ([*(v.name for v in model.inputs), *model.overrides], driven),
        "input that is not driven, as a known disturbance is,": (
            [v.name for v in model.inputs if v.name not in driven],
            disturbances,
        ),
        "output": ([v.name for v in (*model.states, *model.outputs)], signals),
        "parameter": ([v.name for v in (*model.parameters, *model.inputs) if v.name not in acting], given),
    }
    faults = [
        f'NMPC: model {model.name} has no {what} "{name}"; it has: {", ".join(names) or "none"}'
        for what, (names, wanted) in known.items()
        for name in dict.fromkeys(wanted)
        if name not in names
    ]
    faults += [
        f'NMPC: model {model.name} controls "{name}" itself, whose rules no plan has; drive it, too'
        for name in model.overrides
        if name not in driven
    ]
    if faults:
        raise ConfigError(faults)


def _poles(ca: Any, slope: Any, point: Sequence[Any]) -> NDArray[np.complex128]:
    """Return the eigenvalues where the plant starts [1/s], shape (n,)."""
    arguments = slope.sx_in()
    jacobian = ca.Function("jacobian", arguments, [ca.jacobian(slope(*arguments), arguments[0])])
    return np.linalg.eigvals(jacobian(*point).full()).astype(np.complex128)


def _runge_kutta(slope: Callable[[Any, Any], Any], x: Any, t: Any, h: float) -> Any:
    k1 = slope(x, t)
    k2 = slope(x + h / 2 * k1, t + h / 2)
    k3 = slope(x + h / 2 * k2, t + h / 2)
    k4 = slope(x + h * k3, t + h)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def _collocation(ca: Any, slope: Callable[[Any, Any], Any], x: Any, inside: Any, t: Any, h: float) -> Any:
    """Return what a polynomial from x on through further states leaves of the equations there, times h."""
    points = ca.horzcat(x, inside)
    slopes = [slope(z, t + c * h) for z, c in zip(ca.horzsplit(inside), _RADAU, strict=True)]
    return points @ _DERIVATIVES - h * ca.horzcat(*slopes)


def _given(w: FloatArray) -> tuple[FloatArray, ...]:
    return (w,) if w.size else ()


class ExtendedKalmanFilter:
    """The states of a plant's equations and their disturbance, estimated from what is measured.

    Parameters
    ----------
    plant : PlantEquations
        The equations.
    loop : Loop
        Nominal values of its signals are what the noise is in parts of.
    process_noise, disturbance_noise, measurement_noise : float
        Standard deviations of what is added to the inputs, of the change of the disturbance per sample, and
        of what is measured.

    Attributes
    ----------
    x, d : array, shapes (n,) and (disturbances,)
        The estimate.
    """

    def __init__(
        self,
        plant: PlantEquations,
        loop: Loop,
        process_noise: float,
        disturbance_noise: float,
        measurement_noise: float,
    ) -> None:
        ca = casadi()
        symbols = plant.advance.sx_in()
        x, u, d, *_ = symbols
        z = ca.vertcat(x, d)
        self._ahead, self._seen = (
            ca.Function("model", symbols, [value, ca.jacobian(value, z), ca.jacobian(value, u)])
            for value in (plant.advance(*symbols), plant.output(*symbols))
        )
        signals = measured_signals(loop)
        carrier = loop.inputs if plant.disturbances == len(loop.inputs) else loop.outputs
        sd = measurement_noise * np.abs([variable.nominal for variable in signals])
        change = disturbance_noise * np.abs([variable.nominal for variable in carrier])
        self._drive = (process_noise * np.abs([variable.nominal for variable in loop.inputs])) ** 2
        self._noise, self._wander = np.diag(sd**2), np.append((_STATE_NOISE * plant.nominal) ** 2, change**2)
        self.x, self.d = plant.start.copy(), np.zeros(plant.disturbances)
        self._covariance = np.diag(self._wander)

    def correct(self, measured: FloatArray, u: FloatArray, w: FloatArray, t: float) -> None:
        """Take what is measured, (s,), as far as it is finite, after inputs u, (m,), and w, (n_w,)."""
        expected, c, _ = (matrix.full() for matrix in self._seen(self.x, u, self.d, t, *_given(w)))
        known = np.isfinite(measured)
        c, surprise = c[known], (measured - expected[:, 0])[known]
        spread = c @ self._covariance
        gain = np.linalg.solve(spread @ c.T + self._noise[np.ix_(known, known)], spread).T
        self._covariance = self._covariance - gain @ spread
        change = gain @ surprise
        self.x, self.d = self.x + change[: len(self.x)], self.d + change[len(self.x) :]

    def predict(self, u: FloatArray, w: FloatArray, t: float) -> None:
        """Go on by one sample with inputs u, shape (m,), and known disturbances w, shape (n_w,)."""
        x, of_z, b = (matrix.full() for matrix in self._ahead(self.x, u, self.d, t, *_given(w)))
        n = len(self.x)
        a = np.vstack([of_z, np.eye(len(self.d), n + len(self.d), n)])
        covariance = a @ self._covariance @ a.T + np.diag(self._wander)
        covariance[:n, :n] += (b * self._drive) @ b.T
        self._covariance, self.x = (covariance + covariance.T) / 2, x[:, 0]
