"""Scaling by nominal values: the units of a plant decide nothing but the units of the answer."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ddpc_controllers import (
    LQR,
    MFAC,
    MFAPC,
    MPC,
    PID,
    KoopmanMPC,
    Scaled,
    StateSpace,
)
from ddpc_controllers.scaling import ScaleBy, Scales
from ddpc_cosim import Action, Bounds, ConfigError, Controller, FloatArray, Loop, Recording, Sample, Variable

from .loops import LinearPlant, make_loop, printed_deepc, printed_wkpc, regulating_gamma_ddpc, regulating_spc

UNITS = [(np.array([1e-4, 1e5]), np.array([1e5, 1e-4])), (np.array([3.5, 0.7]), np.array([57.3, 9.0]))]
"""Sizes of two inputs and of two outputs."""

METHODS: list[Callable[[], Controller]] = [
    lambda: printed_deepc(lambda_g=1.0),
    lambda: printed_deepc(lambda_g=1.0, regulariser="projection", soft_output_bounds=1e3),
    lambda: printed_deepc(lambda_g=1.0, online_data="sliding-window"),
    lambda: regulating_spc(),
    lambda: regulating_gamma_ddpc(beta_2=0.1),
    lambda: printed_wkpc(),
    lambda: MPC(),
    lambda: KoopmanMPC(state="delays"),
    lambda: LQR(),
    lambda: MFAPC(form="ffdl", initial_gradient=1.0),
    lambda: MFAC(initial_gradient=1.0),
]


def plant_and_recording() -> tuple[LinearPlant, FloatArray, FloatArray]:
    rng = np.random.default_rng(4)
    plant = LinearPlant.random(rng, order=3, inputs=2, outputs=2)
    u, state, y = rng.uniform(-1.0, 1.0, (300, 2)), np.zeros(3), np.empty((300, 2))
    for k in range(300):
        y[k] = plant.c @ state
        state = plant.advance(state, u[k])
    return plant, u, y + 1e-3 * rng.standard_normal(y.shape)


def loop_in(u_size: FloatArray, y_size: FloatArray) -> Loop:
    """Return the loop of one plant whose signals are measured in units of these sizes."""
    _, u, y = plant_and_recording()
    limit = np.array([1.0, 0.5])
    outputs = tuple(Variable(f"y{i}", nominal=size) for i, size in enumerate(y_size.tolist()))
    return Loop(
        sampling_time=0.1,
        inputs=tuple(Variable(f"u{i}", nominal=size) for i, size in enumerate(u_size.tolist())),
        outputs=outputs,
        measurements=outputs,
        bounds=Bounds(-limit * u_size, limit * u_size, np.full(2, -60.0) * y_size, np.full(2, 60.0) * y_size),
        recording=Recording(u * u_size, y * y_size, y * y_size, 0.1),
        rng=np.random.default_rng(5),
    )


def inputs_of(controller: Controller, loop: Loop, u_size: FloatArray, y_size: FloatArray) -> FloatArray:
    """Close the loop over 40 samples; return the inputs in parts of their sizes, time along axis 0."""
    plant, _, _ = plant_and_recording()
    controller.start(loop)
    state, rows = np.zeros(3), []
    for k in range(40):
        y = plant.c @ state * y_size
        reference = np.tile(np.array([1.0, -0.5]) * y_size, (controller.horizon, 1))
        answer = controller.step(Sample(k, 0.1 * k, y, y, reference, reference[0]))
        u = answer.u if isinstance(answer, Action) else answer
        assert np.all(u >= loop.bounds.u_min)
        assert np.all(u <= loop.bounds.u_max)
        rows.append(u / u_size)
        state = plant.advance(state, u / u_size)
    return np.array(rows)


@pytest.mark.parametrize(("u_size", "y_size"), UNITS)
@pytest.mark.parametrize("method", METHODS, ids=lambda make: type(make()).__name__)
def test_the_units_of_the_plant_do_not_matter(
    method: Callable[[], Controller], u_size: FloatArray, y_size: FloatArray
) -> None:
    ones = np.ones(2)
    expected = inputs_of(method(), loop_in(ones, ones), ones, ones)
    inputs = inputs_of(method(), loop_in(u_size, y_size), u_size, y_size)
    assert np.ptp(expected) > 0.1  # the loop does something
    assert inputs == pytest.approx(expected, abs=1e-6)


def test_without_scaling_weights_are_for_units() -> None:
    u_size, y_size = UNITS[1]
    weights = {
        "output_weight": (100.0 / y_size**2).tolist(),
        "setpoint_weight": (300.0 / y_size**2).tolist(),
        "input_weight": (10.0 / u_size**2).tolist(),
    }
    loop = loop_in(u_size, y_size)
    by_hand = inputs_of(printed_deepc(scaling="none", slack=False, **weights), loop, u_size, y_size)
    scaled = inputs_of(printed_deepc(slack=False), loop, u_size, y_size)
    assert by_hand == pytest.approx(scaled, abs=1e-6)


def test_ranges_can_take_the_place_of_nominal_values() -> None:
    u_size, y_size = UNITS[1]
    loop = loop_in(u_size, y_size)
    half = replace(
        loop,
        inputs=tuple(
            replace(v, nominal=float(high)) for v, high in zip(loop.inputs, loop.bounds.u_max, strict=True)
        ),
        outputs=tuple(
            replace(v, nominal=float(high)) for v, high in zip(loop.outputs, loop.bounds.y_max, strict=True)
        ),
    )
    by_range = inputs_of(regulating_spc(scaling="range"), loop, u_size, y_size)
    assert np.array_equal(by_range, inputs_of(regulating_spc(), half, u_size, y_size))


@pytest.mark.parametrize(
    "make",
    [
        lambda rates: printed_deepc(rate_bounds=rates, lambda_g=1.0),
        lambda rates: MPC(rate_bounds=rates),
        lambda rates: KoopmanMPC(state="delays", rate_bounds=rates),
        lambda rates: MFAPC(rate_bounds=rates, initial_gradient=1.0),
        lambda rates: MFAC(rate_bounds=rates, initial_gradient=1.0),
    ],
)
def test_rate_bounds_are_in_the_units_of_the_inputs(make: Callable[[list[float]], Controller]) -> None:
    u_size, y_size = UNITS[0]
    rates = [0.01 * 1e-4, 0.02 * 1e5]
    u = inputs_of(make(rates), loop_in(u_size, y_size), u_size, y_size)
    largest = np.abs(np.diff(np.vstack([np.zeros(2), u]), axis=0)).max(axis=0)
    assert largest == pytest.approx([0.01, 0.02], rel=1e-9)


def test_dither_is_in_the_unit_of_the_input() -> None:
    u_size, y_size = UNITS[1]
    calm = printed_deepc(lambda_g=1.0, online_data="sliding-window", excitation_floor=1.0)
    shaken = replace(calm, dither=(0.01 * u_size).tolist())
    loop = loop_in(u_size, y_size)
    first = inputs_of(shaken, loop, u_size, y_size)[0] - inputs_of(calm, loop, u_size, y_size)[0]
    assert 0.0 < np.abs(first).max() <= 0.01


def test_a_given_model_is_in_units() -> None:
    plant, _, _ = plant_and_recording()
    u_size, y_size = UNITS[0]

    def model(u: FloatArray, y: FloatArray) -> StateSpace:
        return StateSpace(
            a=plant.a.tolist(),
            b=(plant.b / u).tolist(),
            c=(plant.c * y[:, np.newaxis]).tolist(),
            sampling_time=0.1,
        )

    ones = np.ones(2)
    for make in (lambda m: MPC(model=m), lambda m: LQR(model=m)):
        expected = inputs_of(make(model(ones, ones)), loop_in(ones, ones), ones, ones)
        inputs = inputs_of(make(model(u_size, y_size)), loop_in(u_size, y_size), u_size, y_size)
        assert inputs == pytest.approx(expected, abs=1e-6)


def test_a_scaled_loop_is_not_scaled_again() -> None:
    u_size, y_size = UNITS[1]
    loop = loop_in(u_size, y_size)
    inside = inputs_of(Scaled(controller=regulating_spc(), scale_by="nominal"), loop, u_size, y_size)
    assert np.array_equal(inside, inputs_of(regulating_spc(), loop, u_size, y_size))


def test_gains_in_units_are_not_scaled() -> None:
    u_size, y_size = UNITS[1]
    loop = loop_in(u_size, y_size)
    PID(proportional=0.01).start(loop)
    pid = PID(proportional=0.01)
    pid.start(loop)
    answer = pid.step(Sample(0, 0.0, np.zeros(2), np.zeros(2), y_size[np.newaxis], y_size))
    assert answer == pytest.approx(np.minimum(0.01 * y_size, loop.bounds.u_max))


@pytest.mark.parametrize("nominal", [0.0, np.nan, np.inf])
def test_a_nominal_value_that_cannot_be_a_scale_is_named(nominal: float) -> None:
    ones = np.ones(2)
    loop = loop_in(ones, ones)
    bad = replace(
        loop,
        inputs=tuple(replace(v, nominal=nominal) for v in loop.inputs),
        outputs=tuple(replace(v, nominal=nominal) for v in loop.outputs),
    )
    with pytest.raises(ConfigError) as caught:
        printed_deepc().start(bad)
    assert len(caught.value.faults) == 4
    assert '"u0" cannot be scaled: its nominal value is' in caught.value.faults[0]
    printed_deepc(scaling="none").start(bad)
    printed_deepc(scaling="range").start(bad)


@pytest.mark.parametrize(
    ("scaling", "size", "words"),
    [
        (
            "nominal",
            1e5,
            '1e+05 times its nominal value of 1: set it, or scaling = "range"',
        ),
        (
            "none",
            1e5,
            '1e+05 times its unit: choose scaling = "nominal" or "range"',
        ),
        ("range", 1e-5, "1/1e+05 of half its range, 1: set bounds that it comes close to"),
    ],
)
def test_a_signal_far_from_its_scale_is_told_what_that_is(scaling: ScaleBy, size: float, words: str) -> None:
    rows = np.array([[-size, 1.0], [size, 1.0]])
    loop = make_loop(Recording(rows, rows, rows, 0.1), np.ones(2), np.full(2, np.inf))
    nominal = 1.0 if scaling == "nominal" else 3.0
    loop = replace(loop, inputs=tuple(replace(variable, nominal=nominal) for variable in loop.inputs))
    misfit = Scales(loop, scaling).misfits()[0].replace(", on which the weights rest", "")
    assert f'the input "u0" is {words}' in misfit
