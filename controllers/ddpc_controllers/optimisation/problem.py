"""Tracking problems such as (8), written down in named variables as the papers print them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, Protocol

import numpy as np

from ddpc_controllers.checks import weight_matrices
from ddpc_controllers.data.windows import resting_input, setpoint_bounds
from ddpc_controllers.optimisation.condensing import Condenser, Regularisation
from ddpc_cosim import Bounds, FloatArray, Loop, Weight

Blocks = Mapping[str, FloatArray]
"""Coefficient blocks by the name of the variable or parameter that they multiply."""


class _Bounded(NamedTuple):
    """A bounded quantity: its name, its coefficients and its limits, one for each row."""

    name: str
    blocks: Blocks
    lower: FloatArray
    upper: FloatArray


@dataclass
class Problem:
    """A quadratic problem in named variables, affine in named parameters.

    Parameters
    ----------
    rows : mapping of str to int
        Sizes of the data rows ``h = M g`` (pasts, u, y), stacked in this order in M.
    free : mapping of str to int
        Sizes of the other variables (artificial setpoints); the combination g itself goes without saying.
    parameters : mapping of str to int
        Sizes of what changes from sample to sample, stacked in this order in p; the last is the constant 1.
    """

    rows: Mapping[str, int]
    free: Mapping[str, int]
    parameters: Mapping[str, int]
    _costs: list[tuple[FloatArray, Blocks, Blocks]] = field(default_factory=list, init=False, repr=False)
    _equalities: list[tuple[Blocks, Blocks]] = field(default_factory=list, init=False, repr=False)
    _bounds: list[_Bounded] = field(default_factory=list, init=False, repr=False)
    _regularisation: Regularisation | None = field(default=None, init=False, repr=False)
    _about: str = field(default="", init=False, repr=False)

    def regularise(self, weight: float | Regularisation, about: str = "") -> None:
        """Add ``weight |g|^2`` to the cost, or what a regularisation makes of it.

        ``about`` names a parameter that holds data rows: their combination takes the place of g = 0.
        """
        if not isinstance(weight, Regularisation):
            weight = Regularisation((sum(self.rows.values()),), (weight,))
        self._regularisation, self._about = weight, about

    def penalise(self, weight: FloatArray, variables: Blocks, target: Blocks) -> None:
        """Add ``|sum variables - sum target|^2`` to the cost, each sample weighted by ``weight``."""
        samples = _row_count(variables) // len(weight)
        roots: FloatArray = np.kron(np.eye(samples, dtype=np.float64), _square_root(weight)).astype(
            np.float64
        )
        self._costs.append((roots, variables, target))

    def equate(self, variables: Blocks, target: Blocks) -> None:
        """Require ``sum variables = sum target``."""
        self._equalities.append((variables, target))

    def bound(
        self, variable: str, lower: FloatArray, upper: FloatArray, less: Blocks | None = None, name: str = ""
    ) -> None:
        """Keep every sample of a variable within limits; infinite where there is none.

        With ``less`` it is the variable minus these others; ``name`` is what messages call it.
        """
        size = {**self.rows, **self.free}[variable]
        blocks = {variable: np.eye(size)}
        for other, block in (less or {}).items():
            blocks[other] = blocks.get(other, 0.0) - block
        samples = size // len(lower)
        self._bounds.append(
            _Bounded(name or variable, blocks, np.tile(lower, samples), np.tile(upper, samples))
        )

    def prepare(self, move: str, inputs: int, outputs: int = 0) -> Condenser:
        """Assemble what does not depend on the data.

        The first ``inputs`` entries of ``move`` are applied. After them the first ``outputs`` entries of y
        are asked for, and, where the regularisation is about earlier data rows, all new ones.
        """
        variables = _places({**self.rows, **self.free})
        parameters = _places(self.parameters)
        row_count = sum(self.rows.values())
        origin = np.zeros((row_count, sum(self.parameters.values())))
        wanted = np.vstack([_selection(move, variables)[:inputs], _selection("y", variables)[:outputs]])
        if self._about:
            origin[:, parameters[self._about]] = np.eye(row_count)
            wanted = np.vstack([wanted, np.eye(row_count, wanted.shape[1])])

        def assembled(left: Blocks, right: Blocks) -> tuple[FloatArray, FloatArray]:
            rows = _row_count(left)
            return _assemble(left, variables, rows), _assemble(right, parameters, rows)

        costs = [(root, *assembled(left, right)) for root, left, right in self._costs]
        equalities = [assembled(left, right) for left, right in self._equalities]
        return Condenser(
            row_count=row_count,
            regularisation=self._regularisation or Regularisation((row_count,), (0.0,)),
            origin=origin,
            residual=np.vstack([root @ left for root, left, _ in costs]),
            target=np.vstack([root @ right for root, _, right in costs]),
            equality=np.vstack([left for left, _ in equalities]),
            equality_target=np.vstack([right for _, right in equalities]),
            bounded=np.vstack([_assemble(b.blocks, variables, len(b.lower)) for b in self._bounds]),
            lower=np.concatenate([b.lower for b in self._bounds]),
            upper=np.concatenate([b.upper for b in self._bounds]),
            labels=(*self._labels("upper"), *self._labels("lower")),
            move=wanted,
        )

    def _labels(self, side: Literal["lower", "upper"]) -> Iterator[str]:
        """Name the finite limits on one side."""
        for bounded in self._bounds:
            limits: FloatArray = getattr(bounded, side)
            yield from [f"{bounded.name} at its {side} bound"] * int(np.isfinite(limits).sum())


def _square_root(weight: FloatArray) -> FloatArray:
    """Return F with F'F = W."""
    values, vectors = np.linalg.eigh(weight)
    root: FloatArray = np.sqrt(np.maximum(values, 0.0))[:, np.newaxis] * vectors.T
    return root


def _places(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Return where each named block stands in the stacked vector."""
    places = {}
    start = 0
    for name, size in sizes.items():
        places[name] = slice(start, start + size)
        start += size
    return places


def _row_count(blocks: Blocks) -> int:
    return len(next(iter(blocks.values())))


def _assemble(blocks: Blocks, places: Mapping[str, slice], rows: int) -> FloatArray:
    """Write named blocks side by side, zero elsewhere."""
    matrix = np.zeros((rows, max(place.stop for place in places.values())))
    for name, block in blocks.items():
        matrix[:, places[name]] += block
    return matrix


def _selection(name: str, places: Mapping[str, slice]) -> FloatArray:
    """Return the rows that select one variable from the stacked vector."""
    size = places[name].stop - places[name].start
    return _assemble({name: np.eye(size)}, places, size)


SUM_G = "sum_g"
"""The data row that holds the sum of the entries of g."""


_PREFERENCE = 1e-6


class TrackingWeights(Protocol):
    """The weights of (8)."""

    output_weight: Weight
    setpoint_weight: Weight
    input_weight: Weight


class TrackingSettings(TrackingWeights, Protocol):
    """The settings that decide the problem."""

    initial_length: int
    horizon: int
    artificial_setpoint: bool
    terminal_equality: bool
    setpoint_margin: float
    soft_output_bounds: float


def write_tracking_problem(
    settings: TrackingSettings,
    loop: Loop,
    past: Mapping[str, int],
    parameters: Mapping[str, int],
    rates: FloatArray | None,
) -> Problem:
    """Write down cost, terminal condition and bounds.

    Parameters
    ----------
    settings : TrackingSettings
        Which parts the problem has, and their weights.
    loop : Loop
        Its signals and their limits.
    past : mapping of str to int
        Sizes of the data rows above those of u and y: the past, and the sum of g where it has a row. The
        past inputs and the sum are required here; the past outputs are the caller's.
    parameters : mapping of str to int
        Sizes of the parameters.
    rates : array, shape (m,), or None
        Largest change of each input per sample.

    Raises
    ------
    ConfigError
        Every weight that does not fit the number of signals.
    """
    m, p, horizon = len(loop.inputs), len(loop.outputs), settings.horizon
    sizes = {"u_s": m, "y_s": p} if settings.artificial_setpoint else {}
    soft = settings.soft_output_bounds
    free = sizes | (excess_variables(sizes, horizon, p) if soft > 0.0 else {})
    problem = Problem(rows={**past, "u": horizon * m, "y": horizon * p}, free=free, parameters=parameters)

    problem.equate({"u_ini": np.eye(past["u_ini"])}, {"u_ini": np.eye(past["u_ini"])})
    if SUM_G in past:
        problem.equate({SUM_G: np.eye(1)}, {"one": np.eye(1)})
    penalise_tracking(problem, settings, resting_input(loop), p)
    if settings.terminal_equality:
        end_at_setpoints(problem, settings.initial_length, {"u": m, "y": p})
    bound_signals(problem, loop.bounds, settings.setpoint_margin, soft)
    if rates is not None:
        _bound_rates(problem, horizon, rates)
    return problem


def excess_variables(setpoints: Mapping[str, int], horizon: int, outputs: int) -> dict[str, int]:
    """Return the sizes of what soft output bounds are exceeded by: the outputs, and their setpoint."""
    return {"y_excess": horizon * outputs} | ({"y_s_excess": outputs} if "y_s" in setpoints else {})


def penalise_tracking(problem: Problem, weights: TrackingWeights, rest: FloatArray, outputs: int) -> None:
    """Add the cost for the artificial setpoints that the problem has.

    With u_s and y_s it is that of (8), with u_s that of (11), with none that of the regulation form [8], the
    inputs weighed from ``rest``, shape (m,).
    """
    m, p, horizon = len(rest), outputs, problem.rows["u"] // len(rest)
    every_u, every_y = np.eye(horizon * m), np.eye(horizon * p)
    held_u, held_y = np.tile(np.eye(m), (horizon, 1)), np.tile(np.eye(p), (horizon, 1))
    q, s, r = weight_matrices(
        output_weight=(weights.output_weight, p),
        setpoint_weight=(weights.setpoint_weight, p),
        input_weight=(weights.input_weight, m),
    )
    if "y_s" in problem.free:
        problem.penalise(q, {"y": every_y, "y_s": -held_y}, {})  # |y_k - y_s|_Q^2
        problem.penalise(s, {"y_s": held_y}, {"r": every_y})  # |r_t+k - y_s|_S^2
    else:
        problem.penalise(q, {"y": every_y}, {"r": every_y})  # |y_k - r_t+k|_Q^2
    if "u_s" in problem.free:
        problem.penalise(r, {"u": every_u, "u_s": -held_u}, {})  # |u_k - u_s|_R^2
    else:
        problem.penalise(r, {"u": every_u}, {"one": held_u @ rest[:, np.newaxis]})  # |u_k|_R^2, off rest


def prefer_rest(problem: Problem, input_weight: Weight, rest: FloatArray, outputs: int) -> None:
    """Where inputs outnumber outputs, choose among setpoints u_s alike in cost the one nearest to rest."""
    m = len(rest)
    if "u_s" not in problem.free or m <= outputs:
        return
    (r,) = weight_matrices(input_weight=(input_weight, m))
    problem.penalise(_PREFERENCE * r, {"u_s": np.eye(m)}, {"one": rest[:, np.newaxis]})


def end_at_setpoints(problem: Problem, samples: int, widths: Mapping[str, int]) -> None:
    """Require that the horizon's last samples equal the artificial setpoints that the problem has."""
    for name, width in widths.items():
        if f"{name}_s" in problem.free:
            last = np.eye(problem.rows[name])[-samples * width :]
            problem.equate({name: last, f"{name}_s": -np.tile(np.eye(width), (samples, 1))}, {})


def bound_signals(problem: Problem, bounds: Bounds, margin: float, soft: float) -> None:
    """Bound inputs, outputs and artificial setpoints; soft output bounds give way at a quadratic cost.

    The setpoint's output bounds give way with them: the terminal condition would make them hard again.
    """
    setpoint = setpoint_bounds(bounds, margin)
    problem.bound("u", bounds.u_min, bounds.u_max)
    problem.bound("y", bounds.y_min, bounds.y_max, _excess(problem, "y", soft, len(bounds.y_min)))
    if "u_s" in problem.free:
        problem.bound("u_s", setpoint.u_min, setpoint.u_max)
    if "y_s" in problem.free:
        problem.bound("y_s", setpoint.y_min, setpoint.y_max, _excess(problem, "y_s", soft, len(bounds.y_min)))


def _excess(problem: Problem, name: str, soft: float, width: int) -> dict[str, FloatArray] | None:
    """Weigh what a soft bound is exceeded by, and return it; None where the bound is hard."""
    excess = f"{name}_excess"
    if excess not in problem.free:
        return None
    blocks = {excess: np.eye(problem.free[excess])}
    problem.penalise(soft * np.eye(width), blocks, {})
    return blocks


def _bound_rates(problem: Problem, horizon: int, rates: FloatArray) -> None:
    """Bound the change of every input from the sample before; the first from the newest past input."""
    m = len(rates)
    before = np.eye(horizon * m, k=-m)
    newest = np.zeros((horizon * m, problem.rows["u_ini"]))
    newest[:m, -m:] = np.eye(m)
    problem.bound("u", -rates, rates, {"u": before, "u_ini": newest}, name="change of u")
