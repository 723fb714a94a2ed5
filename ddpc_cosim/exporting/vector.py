"""A test vector: what a controller answers to recorded samples, started anew again and again.

A controller by itself may be unstable, though with its plant it is not. Fed with recorded samples from one
start on, roundings grow in it without a bound. Here the past of every sample is a few recorded ones after a
start, within which they cannot.
"""

import io
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.controller import OK, Controller, Loop, Sample, further_arguments
from ddpc_cosim.files.tables import write_rows
from ddpc_cosim.loop.safe_calls import ask_controller, clip_inputs, horizon_of, start_controller
from ddpc_cosim.loop.trace import Trace
from ddpc_cosim.observation import Observation
from ddpc_cosim.variables import FloatArray, names
from fmu_plants.export.sampled_block import SampledBlock

SAMPLES = 100
"""Of the recorded run so many are in a vector."""
_FROM_A_START = 10


def vector_of(block: SampledBlock, make: Callable[[], Controller], loop: Loop, trace: Trace) -> str:
    """Return the test vector of a controller's code as the text of a CSV file.

    Each row has in its columns ``start`` (1: ``controller_start`` is called before), the arguments y and r of
    ``controller_step`` in their order, u as Python answers, and ``fallback`` (1: the status is not 0).

    Parameters
    ----------
    block : SampledBlock
        What the controller became.
    make : callable
        Makes the controller.
    loop : Loop
        The loop that it was started with, with its random numbers as they were before.
    trace : Trace
        A run of the same case: its samples are those of the vector.
    """
    signals = (*block.measurements, *block.references, *block.controls)
    text = io.StringIO()
    rows = ([repr(value) for value in row] for row in _rows(make, loop, trace))
    write_rows(text, ["start", *(variable.name for variable in signals), "fallback"], rows)
    return text.getvalue()


def _rows(make: Callable[[], Controller], loop: Loop, trace: Trace) -> Iterator[list[float | int]]:
    seen = _measured(loop, trace)
    for k in range(min(SAMPLES, len(trace))):
        begins = k % _FROM_A_START == 0
        if begins:
            controller = make()
            start_controller(controller, replace(loop, rng=deepcopy(loop.rng)))
            horizon = horizon_of(controller)
            preview = min(loop.preview, horizon)
            further = further_arguments(loop, horizon)
        ahead = np.arange(horizon + 1)
        rows, known = (np.minimum(k + ks, len(trace) - 1) for ks in (ahead, np.minimum(ahead, preview)))
        wanted = trace.reference[known[1:]]
        i = k % _FROM_A_START
        sample = Sample(
            i,
            i * loop.sampling_time,
            seen[k],
            trace.measured[k].copy(),
            wanted,
            trace.reference[k].copy(),
            **_ahead(trace, rows, known, further),
        )
        limits = loop.bounds.u_min, loop.bounds.u_max
        if loop.moving_limits:
            limits = trace.input_limits[k, :, 0], trace.input_limits[k, :, 1]
        decision = clip_inputs(ask_controller(controller, sample, len(loop.inputs)), *limits)
        observation = Observation(loop, horizon).with_all_limits(sample)
        yield [int(begins), *observation.tolist(), *decision.u.tolist(), int(decision.status != OK)]


def _ahead(
    trace: Trace, rows: NDArray[np.intp], known: NDArray[np.intp], further: Mapping[str, tuple[int, ...]]
) -> dict[str, Any]:
    """Return what a sample says besides: at rows, or as far as the reference is known. No forecast errs."""
    fields = {
        "disturbance": (trace.d, rows[0]),
        "forecast": (trace.d, rows[1:]),
        "band_now": (trace.band, rows[0]),
        "band": (trace.band, known[1:]),
        "price": (trace.price, rows),
        "input_limits": (trace.input_limits, known),
        "output_limits": (trace.output_limits, known[1:]),
    }
    return {name: fields[name][0][fields[name][1]] for name in further}


def _measured(loop: Loop, trace: Trace) -> FloatArray:
    """Return the controlled outputs as measured, shape (K, p)."""
    outputs, measurements = names(loop.outputs), names(loop.measurements)
    seen = trace.y.copy()
    for i, name in enumerate(outputs):
        if name in measurements:
            seen[:, i] = trace.measured[:, measurements.index(name)]
    return seen
