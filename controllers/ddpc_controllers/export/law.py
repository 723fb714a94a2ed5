"""A condensed problem in C: ``runtime/law.c`` with the tables of a law and of the easier ones after it."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy  # whose parts are imported when they are first used
from numpy.typing import NDArray

from ddpc_controllers.export.code import Code, qp_memory
from ddpc_controllers.optimisation.condensing import CondensedProblem
from ddpc_controllers.optimisation.qp import FEASIBLE, AdaptiveQP, Law, ParametricQP
from ddpc_cosim import ConfigError

_OPPOSITE = 1e-13
_ROUNDING = 1e-15
_EPSILON = np.finfo(float).eps


class LawInC(NamedTuple):
    """A law in C, for ``solve_law(pointer, parameters, memory, answer, told)``.

    Parameters
    ----------
    pointer : str
        Expression of its tables.
    memory : int
        How many numbers it remembers, zero at first.
    """

    pointer: str
    memory: int


def add_law(code: Code, law: Law, answers: int, moving: bool = False) -> LawInC:
    """Add a law and the easier ones after it to the code.

    Parameters
    ----------
    code : Code
        Where its tables go.
    law : Law
        The law of a started controller.
    answers : int
        How many numbers of an answer are needed: the first ones, which begin with the inputs.
    moving : bool
        Whether limits of the inputs move: then who asks keeps them.

    Raises
    ------
    ConfigError
        The law cannot be exported, and why.
    """
    if isinstance(law, AdaptiveQP):
        raise ConfigError(
            "online_data cannot be exported: the data are factorised anew while the loop runs, with "
            "decisions on their rank, and take as much memory as the recording: use online_data = 'frozen'"
        )
    if not isinstance(law, ParametricQP):
        raise ConfigError(
            "regulariser = 'l1' cannot be exported: its problem has no condensed form, and more variables "
            "the longer the recording: use another regulariser"
        )
    code.kernel("law")
    stages, easier = [law], law.easier()
    while isinstance(easier, ParametricQP):
        stages.append(easier)
        easier = easier.easier()
    sides = [_sides(stage.problem) for stage in stages]
    upper = [rows for rows, _ in sides]
    affine = _affine_laws(code, [stage.problem for stage in stages], upper, answers)
    added = LawInC("NULL", 0)
    for stage, rows, name in zip(reversed(stages), reversed(sides), reversed(affine), strict=True):
        conflicts = len(law.problem.conflict_law) if stage is law else 0
        limits = {} if moving else stage.limits.tables()
        pointer, memory = _add(code, stage.problem, rows, limits, answers, name, conflicts, added.pointer)
        added = LawInC(pointer, added.memory + memory)
    return added


def _affine_laws(
    code: Code, problems: Sequence[CondensedProblem], upper: Sequence[NDArray[np.intp]], answers: int
) -> list[str]:
    """Add the unconstrained optima; where bounds give way at a cost, that is as it was before."""
    names, before = list[str](), np.empty((0, 0))
    for problem, kept in zip(problems, upper, strict=True):
        rows = np.concatenate([problem.excess_law[kept], problem.move_law[:answers]])
        if names and np.array_equal(rows, before):
            names.append(names[-1])
            continue
        before = rows
        names.append(code.doubles(rows if names else np.concatenate([rows, problem.conflict_law])))
    return names


def _add(
    code: Code,
    problem: CondensedProblem,
    sides: tuple[NDArray[np.intp], NDArray[np.intp]],
    limits: Mapping[str, Sequence[float]],
    answers: int,
    affine: str,
    conflicts: int,
    easier: str,
) -> LawInC:
    """Add one law."""
    upper, lower = sides
    law, gain = problem.excess_law[upper], problem.excess_gain[upper]
    size = np.linalg.norm(gain, axis=1)
    size[size == 0.0] = 1.0
    # Both sides of a bound are one row: where the other one's excess begins is a limit of this one's.
    limit = np.full(len(upper), -np.inf)
    both = lower >= 0
    limit[both] = (problem.excess_law[lower[both], -1] + law[both, -1]) / size[both]
    # A solution lies in the range of gain', of as few coordinates as there are independent bounds. The factor
    # is triangular, and what is rounding becomes zero: half of the gain, which takes no room in an archive.
    scaled = (gain / size[:, np.newaxis]).T
    directions, factor, order = scipy.linalg.qr(scaled, mode="economic", pivoting=True, check_finite=False)
    diagonal = np.abs(factor.diagonal())
    unknowns = int(np.count_nonzero(diagonal > _EPSILON * max(gain.shape) * diagonal[:1]))
    rows = np.empty((len(gain), unknowns))
    rows[order] = factor[:unknowns].T
    rows = np.concatenate([rows, problem.move_gain[:answers] @ directions[:, :unknowns]])
    rows[np.abs(rows) <= _ROUNDING * np.linalg.norm(rows, axis=1, keepdims=True)] = 0.0
    tables = {
        "scale": 1.0 / size,
        "gain": rows,
        "lower": limit,
        "upper": np.zeros(len(upper)),
        **limits,
    }
    name = code.constant(
        "Law",
        parameters=law.shape[1],
        bounds=len(gain),
        size=unknowns,
        answers=answers,
        inputs=len(limits.get("low", ())),
        conflicts=conflicts,
        law=affine,
        tolerance=FEASIBLE,
        **{table: code.doubles(values) for table, values in tables.items()},
        easier=easier,
    )
    return LawInC(f"&{name}", 2 * len(gain) + unknowns + qp_memory(unknowns))


def _sides(problem: CondensedProblem) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows that are not the other side of an earlier one, and their other sides, -1 for none."""
    rows = np.concatenate([problem.excess_law[:, :-1], problem.excess_gain], axis=1)
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    size[size == 0.0] = 1.0
    rows /= size
    # Products tell which pairs are worth looking at: those of unit rows that are opposite are -1.
    opposite = rows @ rows.T < _OPPOSITE - 1.0 + rows.shape[1] * _EPSILON
    zero = ~rows.any(axis=1)
    opposite |= np.logical_and.outer(zero, zero)
    one, another = np.nonzero(opposite)
    alike = (one < another) & (np.abs(rows[one] + rows[another]).max(axis=1, initial=0.0) <= _OPPOSITE)
    others, second = dict[int, int](), set[int]()
    for i, other in zip(one[alike].tolist(), another[alike].tolist(), strict=True):
        if i not in others and not second & {i, other}:
            others[i] = other
            second.add(other)
    kept = [i for i in range(len(rows)) if i not in second]
    return np.array(kept, dtype=np.intp), np.array([others.get(i, -1) for i in kept], dtype=np.intp)
