"""An identified model as an FMU: sampled, for Co-Simulation, without noise."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from ddpc_cosim.errors import ConfigError, CosimError
from ddpc_cosim.identification.innovation import InnovationModel, PlantModel, StaticMap
from ddpc_cosim.identification.koopman import LiftedModel
from ddpc_cosim.variables import FloatArray, Variable
from fmu_plants.export import Progress, export_block
from fmu_plants.export.sampled_block import SampledBlock
from fmu_plants.model import ExportError, ExportUsageError, identifier

_HEADER = """/* A sampled plant, with its state in `memory`. */
#ifndef CONTROLLER_H
#define CONTROLLER_H

enum {{ CONTROLLER_MEMORY = {states} }};

typedef struct {{
    unsigned status, iterations, active_bounds; /* always 0 */
    double memory[CONTROLLER_MEMORY];
}} ControllerState;

void controller_start(ControllerState *state);
unsigned controller_step(ControllerState *state, const double y[], const double r[], double u[]);
void controller_outputs(const ControllerState *state, double u[]);

#endif
"""
_SOURCE = """/* {words} */
#include "controller.h"

#include <string.h>

enum {{ N_STATES = {states}, N_INPUTS = {inputs}, N_OUTPUTS = {outputs} }};

{tables}
/* Lines between points, and the outer ones beyond them. */
static double on_lines(const double x[], const double y[], size_t n, double at)
{{
    size_t left = 0;
    while (left + 2 < n && at >= x[left + 1]) ++left;
    return y[left] + (y[left + 1] - y[left]) / (x[left + 1] - x[left]) * (at - x[left]);
}}

void controller_start(ControllerState *state)
{{
    memset(state, 0, sizeof *state);
    memcpy(state->memory, start, sizeof start);
}}

/* Go on to the next instant, driven by y. */
unsigned controller_step(ControllerState *state, const double y[], const double r[], double u[])
{{
    double v[N_INPUTS], next[N_STATES];
    (void)r;
    (void)u;
    for (size_t j = 0; j < N_INPUTS; ++j) {{
        const size_t n = input_points[j + 1] - input_points[j];
        const double *x = input_x + input_points[j], *mapped = input_y + input_points[j];
        v[j] = (n ? on_lines(x, mapped, n, y[j]) : y[j]) - input_rest[j];
    }}
    for (size_t i = 0; i < N_STATES; ++i) {{
        next[i] = 0.0;
        for (size_t j = 0; j < N_STATES; ++j) next[i] += a[i * N_STATES + j] * state->memory[j];
        for (size_t j = 0; j < N_INPUTS; ++j) next[i] += b[i * N_INPUTS + j] * v[j];
    }}
    memcpy(state->memory, next, sizeof next);
    return 0;
}}

void controller_outputs(const ControllerState *state, double u[])
{{
    for (size_t i = 0; i < N_OUTPUTS; ++i) {{
        const size_t n = output_points[i + 1] - output_points[i];
        double sum = output_rest[i];
        for (size_t j = 0; j < N_STATES; ++j) sum += c[i * N_STATES + j] * state->memory[j];
        u[i] = n ? on_lines(output_x + output_points[i], output_y + output_points[i], n, sum) : sum;
    }}
}}
"""
_LIFTED_SOURCE = """/* {words} */
#include "controller.h"

#include <string.h>

enum {{
    N_STATES = {states},
    N_INPUTS = {inputs},
    N_OUTPUTS = {outputs},
    N_PAST_OUTPUTS = {past_outputs}, /* of the state; inputs follow */
    N_USED = {used},
    N_MONOMIALS = {monomials},
    DEGREE = {degree}
}};

{tables}
void controller_start(ControllerState *state)
{{
    memset(state, 0, sizeof *state);
    memcpy(state->memory, start, sizeof start);
}}

/* Go on to the next instant, driven by y. */
unsigned controller_step(ControllerState *state, const double y[], const double r[], double u[])
{{
    double now[N_OUTPUTS], *inputs = state->memory + N_PAST_OUTPUTS;
    (void)r;
    (void)u;
    controller_outputs(state, now);
    memmove(inputs + N_INPUTS, inputs, (N_STATES - N_PAST_OUTPUTS - N_INPUTS) * sizeof *inputs);
    memcpy(inputs, y, N_INPUTS * sizeof *y);
    memmove(state->memory + N_OUTPUTS, state->memory, (N_PAST_OUTPUTS - N_OUTPUTS) * sizeof *now);
    memcpy(state->memory, now, sizeof now);
    return 0;
}}

void controller_outputs(const ControllerState *state, double u[])
{{
    double seen[N_USED + 1];
    for (size_t i = 0; i < N_USED; ++i) {{
        double value = state->memory[used[i]];
        if (value < low[i]) value = low[i];
        if (value > high[i]) value = high[i];
        seen[i] = (value - means[i]) / sizes[i];
    }}
    seen[N_USED] = 1.0;
    memset(u, 0, N_OUTPUTS * sizeof *u);
    for (size_t j = 0; j < N_MONOMIALS; ++j) {{
        double product = 1.0;
        for (size_t i = 0; i < DEGREE; ++i) product *= seen[factors[j * DEGREE + i]];
        for (size_t i = 0; i < N_OUTPUTS; ++i) u[i] += w[i * N_MONOMIALS + j] * product;
    }}
}}
"""


def export_identified(
    model: PlantModel,
    inputs: Sequence[Variable],
    outputs: Sequence[Variable],
    path: str | Path,
    fmi_version: str = "2.0",
    *,
    words: str = "A plant identified from data",
    platforms: str | Sequence[str] | None = None,
    progress: Progress | None = None,
) -> Path:
    """Write a model as a standalone FMU for Co-Simulation, to be stepped at its sampling time.

    It is what :class:`~ddpc_cosim.identification.plant.IdentifiedPlant` is without noise: it starts at rest
    at the start values of the inputs, holds its inputs from instant to instant, and shows at an instant the
    outputs in the state there.

    Parameters
    ----------
    model : PlantModel
        The model.
    inputs, outputs : sequence of Variable
        Its inputs, disturbances after those that are driven, and outputs.
    path : str or Path
        The file to write, after which the FMU is named; an existing one is replaced. Its folder must exist.
    fmi_version : str
        ``"2.0"`` or ``"3.0"``.
    words : str
        What the FMU says of itself.
    platforms, progress
        As of :func:`fmu_plants.export_fmu`.

    Raises
    ------
    ConfigError
        There is no such version or platform, or the file cannot be written.
    CosimError
        There is no compiler, or it fails.
    """
    block = SampledBlock(
        identifier(Path(path).stem),
        f"{words}: sampled every {model.sampling_time:g} s",
        model.sampling_time,
        measurements=inputs,
        references=(),
        controls=outputs,
        sources=_sources(model, np.array([variable.start for variable in inputs]), words),
        is_plant=True,
    )
    try:
        return export_block(block, path, fmi_version, platforms=platforms, progress=progress)
    except ExportUsageError as error:
        raise ConfigError(str(error)) from error
    except ExportError as error:
        raise CosimError(str(error)) from error


def _sources(model: PlantModel, start: FloatArray, words: str) -> dict[str, str]:
    """Return the C files of a model that starts at rest at inputs, disturbances after those driven."""
    m = len(model.u_0)
    x_0 = model.rest(start[:m], start[m:])
    plain = words.replace("*/", "")
    if isinstance(model, LiftedModel):
        source = _lifted_source(model, x_0, plain)
    else:
        assert isinstance(model, InnovationModel)
        source = _linear_source(model, x_0, plain)
    return {"controller.h": _HEADER.format(states=model.order), "plant.c": source}


def _lifted_source(model: LiftedModel, x_0: FloatArray, words: str) -> str:
    q = len(model.used)
    degree = max(map(len, model.lift.factors))
    # Those of lower degree are products with the 1 behind what is lifted.
    factors = [[*term, *[q] * (degree - len(term))] for term in model.lift.factors]
    tables = {
        "w": model.w.ravel(),
        "means": model.means,
        "sizes": model.sizes,
        "low": model.low,
        "high": model.high,
        "start": x_0,
    }
    lines = [_table("double", name, map(repr, values.tolist())) for name, values in tables.items()]
    lines.append(_table("size_t", "used", map(str, model.used.tolist())))
    lines.append(_table("size_t", "factors", (str(i) for term in factors for i in term)))
    p = len(model.w)
    return _LIFTED_SOURCE.format(
        words=words,
        states=model.order,
        inputs=len(model.u_0) + len(model.d_0),
        outputs=p,
        past_outputs=model.lags * p,
        used=q,
        monomials=len(factors),
        degree=degree,
        tables="\n".join([*lines, ""]),
    )


def _linear_source(model: InnovationModel, x_0: FloatArray, words: str) -> str:
    m, n_d = len(model.u_0), len(model.d_0)
    tables = {
        "a": model.a.ravel(),
        "b": np.hstack([model.b, model.e]).ravel(),
        "c": model.c.ravel(),
        "input_rest": np.concatenate([model.u_0, model.d_0]),
        "output_rest": model.y_0,
        "start": x_0,
    }
    lines = [_table("double", name, map(repr, values.tolist())) for name, values in tables.items()]
    lines += _map_tables("input", model.input_map, m + n_d)
    lines += _map_tables("output", model.output_map, len(model.y_0))
    sizes = {"states": model.order, "inputs": m + n_d, "outputs": len(model.y_0)}
    return _SOURCE.format(**sizes, words=words, tables="\n".join([*lines, ""]))


def _map_tables(kind: str, static: StaticMap | None, signals: int) -> list[str]:
    """Return where the points of each signal's curve begin, and all of them; no curve has no points."""
    points = [] if static is None else list(static.points)
    values = [] if static is None else list(static.values)
    sizes = [len(x) for x in points] + [0] * (signals - len(points))
    begins = np.concatenate([[0], np.cumsum(sizes)])
    return [
        _table("size_t", f"{kind}_points", map(str, begins.tolist())),
        _table("double", f"{kind}_x", map(repr, np.concatenate([*points, [0.0]]).tolist())),
        _table("double", f"{kind}_y", map(repr, np.concatenate([*values, [0.0]]).tolist())),
    ]


def _table(kind: str, name: str, numbers: Iterable[str]) -> str:
    listed = list(numbers)
    return f"static const {kind} {name}[{len(listed)}] = {{{', '.join(listed)}}};"
