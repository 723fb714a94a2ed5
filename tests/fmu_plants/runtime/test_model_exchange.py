"""Model Exchange: modes (FMI 2.0, section 3.2.3; FMI 3.0, section 3.2), states, derivatives, events."""

import ctypes
import math

import numpy as np
import pytest
from fmpy.fmi2 import fmi2Discard, fmi2Error, fmi2EventInfo, fmi2ModelExchange, fmi2OK
from scipy.integrate import solve_ivp

TWO = ctypes.c_size_t(2)


class Exchange:
    """The functions of Model Exchange by their names in FMI 3.0, for either version."""

    def __init__(self, instance, version):
        self.instance, self.version = instance, version

    def call(self, name, *arguments):
        if self.version == 2:
            name = name.replace("GetContinuousStateDerivatives", "GetDerivatives")
        return self.instance.call(f"fmi{self.version}{name}", *arguments)

    def update(self):
        """Go through event mode once; return the flags and the time of the next event."""
        if self.version == 2:
            info = fmi2EventInfo(*[1] * 5, 9.9)
            status = self.call("NewDiscreteStates", ctypes.byref(info))
            return status, [bool(getattr(info, name)) for name, _ in fmi2EventInfo._fields_[:5]]
        flags = (ctypes.c_bool * 5)(*[True] * 5)
        places = [ctypes.byref(flags, index) for index in range(5)]
        status = self.call("UpdateDiscreteStates", *places, ctypes.byref(ctypes.c_double()))
        return status, list(flags)

    def completed_step(self):
        size = ctypes.sizeof(ctypes.c_int if self.version == 2 else ctypes.c_bool)
        flags = (ctypes.c_char * (2 * size))(*b"\1" * 2 * size)
        places = [ctypes.byref(flags, index * size) for index in range(2)]
        return self.call("CompletedIntegratorStep", 1, *places), flags.raw

    def numbers(self, name, n=2):
        values = (ctypes.c_double * n)()
        return self.call(name, values, ctypes.c_size_t(n)), np.array(values)

    def set_states(self, x):
        return self.call("SetContinuousStates", (ctypes.c_double * len(x))(*x), ctypes.c_size_t(len(x)))

    def slope(self, time, x):
        assert self.call("SetTime", ctypes.c_double(time)) == fmi2OK
        assert self.set_states(x) == fmi2OK
        status, dx = self.numbers("GetContinuousStateDerivatives")
        assert status == fmi2OK
        return dx

    def refused(self, status, *words):
        return status == fmi2Error and all(word in self.instance.messages[-1][2] for word in words)


@pytest.fixture(params=[2, 3], ids=["FMI 2.0", "FMI 3.0"])
def exchange(request, pendulum, pendulum3):
    """A pendulum that has left initialization mode."""
    instance = pendulum(kind=fmi2ModelExchange) if request.param == 2 else pendulum3(exchange=True)
    return Exchange(instance, request.param)


def test_life_of_an_instance(exchange):
    exchange.instance.start({"angle": 0.3})
    assert exchange.update() == (fmi2OK, [False] * 5)
    assert exchange.call("EnterContinuousTimeMode") == fmi2OK
    assert exchange.call("SetTime", ctypes.c_double(0.1)) == fmi2OK
    assert exchange.set_states([0.5, -1.0]) == fmi2OK
    status, flags = exchange.completed_step()
    assert (status, set(flags)) == (fmi2OK, {0})
    assert exchange.call("EnterEventMode") == fmi2OK
    assert exchange.instance.set({"mass": 2.0, "torque": 1.0}) == fmi2OK
    assert exchange.update() == (fmi2OK, [False] * 5)
    assert exchange.call("EnterContinuousTimeMode") == fmi2OK
    assert exchange.instance.get("time", "angle", "mass") == pytest.approx([0.1, 0.5, 2.0], abs=0)
    assert exchange.call("Terminate") == fmi2OK
    assert exchange.instance.get("angle")[0] == 0.5
    assert exchange.instance.messages == []


def test_calls_out_of_order_are_refused(exchange):
    steps = ["EnterEventMode", "EnterContinuousTimeMode"]
    for name in steps:
        assert exchange.refused(exchange.call(name), "before initialization")
    exchange.instance.start()
    assert exchange.refused(exchange.call("EnterEventMode"), "in event mode")
    assert exchange.refused(exchange.set_states([0.0, 0.0]), "in event mode")
    assert exchange.refused(exchange.completed_step()[0], "in event mode")
    assert exchange.refused(exchange.instance.step(0.0, 0.1), "in event mode")
    assert exchange.call("EnterContinuousTimeMode") == fmi2OK
    assert exchange.refused(exchange.call("EnterContinuousTimeMode"), "in continuous-time mode")
    assert exchange.refused(exchange.update()[0], "in continuous-time mode")


def test_what_cannot_be_set_in_a_mode_is_refused(exchange):
    exchange.instance.start()
    assert exchange.refused(exchange.instance.set({"angle": 1.0}), "initialization")
    assert exchange.call("EnterContinuousTimeMode") == fmi2OK
    assert exchange.instance.set({"torque": 1.0}) == fmi2OK
    assert exchange.refused(exchange.instance.set({"mass": 2.0}), "mass", "event mode")
    assert exchange.refused(exchange.call("SetTime", ctypes.c_double(math.nan)), "time is not finite")
    assert exchange.refused(exchange.set_states([0.0, math.inf]), "angular_velocity", "not finite")


def test_states_nominals_and_derivatives(exchange):
    exchange.instance.start({"angle": 0.3, "angular_velocity": 2.0, "torque": 1.0})
    slope = -9.81 / 0.2 * np.sin(0.3) - 0.4 / 0.2 * 2.0 + 1.0 / 0.2
    for name, expected in [
        ("GetContinuousStates", [0.3, 2.0]),
        ("GetNominalsOfContinuousStates", [1.0, 1.0]),
        ("GetContinuousStateDerivatives", [2.0, slope]),
    ]:
        status, values = exchange.numbers(name)
        assert status == fmi2OK
        assert values == pytest.approx(expected, rel=1e-14)
        assert exchange.refused(exchange.numbers(name, 3)[0], "2 continuous states, not 3")
    assert exchange.numbers("GetEventIndicators", 0)[0] == fmi2OK
    assert exchange.refused(exchange.numbers("GetEventIndicators", 1)[0], "no event indicators")


def test_an_integrator_of_the_importer_finds_the_solution(exchange):
    """The pendulum from 1 rad, integrated by SciPy from the derivatives of the FMU and from (22)."""
    exchange.instance.start({"angle": 1.0, "torque": 0.5})
    assert exchange.call("EnterContinuousTimeMode") == fmi2OK

    def formula(_, x):
        return [x[1], -9.81 / 0.2 * np.sin(x[0]) - 0.4 / 0.2 * x[1] + 0.5 / 0.2]

    ends = [
        solve_ivp(slope, (0.0, 5.0), [1.0, 0.0], method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
        for slope in (exchange.slope, formula)
    ]
    assert ends[0] == pytest.approx(ends[1], abs=1e-10)


def test_a_saved_state_remembers_the_mode(exchange):
    exchange.instance.start()
    assert exchange.call("EnterContinuousTimeMode") == fmi2OK
    state = ctypes.c_void_p()
    suffix = "FMUstate" if exchange.version == 2 else "FMUState"
    assert exchange.call(f"Get{suffix}", ctypes.byref(state)) == fmi2OK
    assert exchange.call("EnterEventMode") == fmi2OK
    assert exchange.call(f"Set{suffix}", state) == fmi2OK
    assert exchange.set_states([0.1, 0.2]) == fmi2OK
    assert exchange.call(f"Free{suffix}", ctypes.byref(state)) == fmi2OK


def test_numbers_of_states_and_event_indicators(pendulum3):
    instance = pendulum3(exchange=True)
    for name, expected in [("ContinuousStates", 2), ("EventIndicators", 0)]:
        number = ctypes.c_size_t(9)
        assert instance.call(f"fmi3GetNumberOf{name}", ctypes.byref(number)) == fmi2OK
        assert number.value == expected


def test_discrete_states_are_evaluated_in_initialization_and_event_mode_only(pendulum3):
    instance = pendulum3(exchange=True)
    assert instance.call("fmi3EvaluateDiscreteStates") == fmi2Error
    instance.start()
    assert instance.call("fmi3EvaluateDiscreteStates") == fmi2OK


def test_a_derivative_that_is_not_finite_asks_for_a_smaller_step(escape_exchange):
    """x' = x^2 overflows at 1e200."""
    instance = escape_exchange.start({"x": 1e200})
    value = ctypes.c_double()
    status = instance.call("fmi2GetDerivatives", ctypes.byref(value), ctypes.c_size_t(1))
    assert status == fmi2Discard
    assert "the derivative of x is not finite" in instance.messages[-1][2]


def test_co_simulation_does_not_have_continuous_time(pendulum):
    instance = pendulum().start()
    for name, arguments in [
        ("fmi2EnterEventMode", []),
        ("fmi2EnterContinuousTimeMode", []),
        ("fmi2SetTime", [ctypes.c_double(1.0)]),
        ("fmi2GetContinuousStates", [(ctypes.c_double * 2)(), TWO]),
    ]:
        assert instance.call(name, *arguments) == fmi2Error
        assert "between communication steps" in instance.messages[-1][2]
