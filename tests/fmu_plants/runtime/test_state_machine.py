"""What may be called when (FMI 2.0, section 4.2.4), and what is refused with a reason."""

import ctypes
import math

import numpy as np
import pytest
from fmpy.fmi2 import (
    fmi2Discard,
    fmi2Error,
    fmi2LastSuccessfulTime,
    fmi2OK,
    fmi2Terminated,
    fmi2Warning,
)

NONE = ctypes.c_size_t(0)
ONE = ctypes.c_size_t(1)


def assert_refused(instance, status, *words):
    """The call failed and its message, the last one, says why."""
    assert status == fmi2Error
    logged, category, message = instance.messages[-1]
    assert (logged, category) == (fmi2Error, "logStatusError")
    for word in words:
        assert word in message


def test_life_of_an_instance(pendulum):
    instance = pendulum()
    assert instance.setup(stop=1.0, tolerance=1e-8) == fmi2OK
    assert instance.set({"mass": 2.0, "angle": 0.1, "gravity": 9.8}) == fmi2OK
    assert instance.call("fmi2EnterInitializationMode") == fmi2OK
    assert instance.set({"torque": 1.0}) == fmi2OK
    assert instance.get("mass", "angle", "gravity", "torque") == pytest.approx([2.0, 0.1, 9.8, 1.0], abs=0)
    assert instance.call("fmi2ExitInitializationMode") == fmi2OK
    assert instance.step(0.0, 0.5) == fmi2OK
    assert instance.get("time")[0] == 0.5
    assert instance.call("fmi2Terminate") == fmi2OK
    assert instance.get("time")[0] == 0.5
    assert instance.messages == []


@pytest.mark.parametrize(
    ("reach", "illegal"),
    [
        ("instantiated", ["fmi2ExitInitializationMode", "fmi2Terminate", "step", "get"]),
        ("initialization", ["setup", "fmi2EnterInitializationMode", "fmi2Terminate", "step"]),
        ("stepping", ["setup", "fmi2EnterInitializationMode", "fmi2ExitInitializationMode"]),
        ("terminated", ["setup", "fmi2EnterInitializationMode", "fmi2Terminate", "step", "set"]),
    ],
)
def test_calls_out_of_order_are_refused_and_change_nothing(pendulum, reach, illegal):
    instance = pendulum()
    reached = {
        "instantiated": [],
        "initialization": ["fmi2EnterInitializationMode"],
        "stepping": ["fmi2EnterInitializationMode", "fmi2ExitInitializationMode"],
        "terminated": ["fmi2EnterInitializationMode", "fmi2ExitInitializationMode", "fmi2Terminate"],
    }[reach]
    assert instance.setup() == fmi2OK
    for name in reached:
        assert instance.call(name) == fmi2OK
    special = {
        "setup": instance.setup,
        "step": lambda: instance.step(0.0, 0.1),
        "set": lambda: instance.set({"torque": 1.0}),
        "get": lambda: instance.get_with_status("angle")[0],
    }
    for name in illegal:
        status = special[name]() if name in special else instance.call(name)
        assert_refused(instance, status, "cannot be called")
    rest = ["fmi2EnterInitializationMode", "fmi2ExitInitializationMode", "fmi2Terminate"][len(reached) :]
    assert [instance.call(name) for name in rest] == [fmi2OK] * len(rest)


def test_initialization_needs_an_experiment(pendulum):
    instance = pendulum()
    assert_refused(instance, instance.call("fmi2EnterInitializationMode"), "fmi2SetupExperiment")


@pytest.mark.parametrize(
    ("experiment", "word"),
    [
        ({"start": math.nan}, "start time"),
        ({"start": 1.0, "stop": 0.5}, "stop time"),
        ({"stop": math.nan}, "stop time"),
        ({"tolerance": -1e-6}, "tolerance"),
        ({"tolerance": math.inf}, "tolerance"),
    ],
)
def test_impossible_experiments_are_refused(pendulum, experiment, word):
    instance = pendulum()
    assert_refused(instance, instance.setup(**experiment), word)


@pytest.mark.parametrize("size", [0.0, -0.1, math.nan, math.inf])
def test_impossible_step_sizes_are_refused(pendulum, size):
    instance = pendulum().start()
    assert_refused(instance, instance.step(0.0, size), "step size")
    assert instance.step(0.0, 0.1) == fmi2OK


def test_a_step_must_begin_where_the_last_one_ended(pendulum):
    instance = pendulum().start(start=1.0)
    assert_refused(instance, instance.step(0.0, 0.1), "the instance is at 1")
    assert_refused(instance, instance.step(math.nan, 0.1), "the instance is at 1")
    assert instance.step(1.0, 0.1) == fmi2OK
    assert instance.step(1.1, 0.1) == fmi2OK  # not what 1.0 + 0.1 gives, to the last bit
    assert_refused(instance, instance.step(1.1, 0.1), "the instance is at 1.2")


def test_time_that_an_importer_adds_up_is_accepted(pendulum):
    instance = pendulum().start(stop=200.0)
    time = 0.0
    for _ in range(2000):
        assert instance.step(time, 0.1) == fmi2OK
        time += 0.1
    assert time != 200.0


def test_no_step_goes_beyond_the_stop_time(pendulum):
    instance = pendulum().start(stop=0.3)
    for k in range(3):
        assert instance.step(k * 0.1, 0.1) == fmi2OK
    assert_refused(instance, instance.step(0.3, 0.1), "stop time 0.3")


def test_an_instance_of_another_model_is_not_made(pendulum):
    instance = pendulum(guid="{other}")
    assert instance.component is None
    assert "GUID" in instance.messages[-1][2]


def test_what_is_computed_or_fixed_cannot_be_set(pendulum):
    instance = pendulum().start()
    for name in ("gravity", "angle", "angular_velocity"):
        assert_refused(instance, instance.set({name: 1.0}), name, "initialization")
    for name in ("der(angle)", "time"):
        assert_refused(instance, instance.set({name: 1.0}), name, "computed")


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_values_that_are_not_finite_are_refused_as_a_whole(pendulum, value):
    instance = pendulum().start()
    assert_refused(instance, instance.set({"mass": 2.0, "torque": value}), "torque", "not finite")
    assert instance.get("mass", "torque") == pytest.approx([1.0, 0.0], abs=0)


def test_unknown_value_references_are_refused(pendulum):
    instance = pendulum().start()
    assert_refused(instance, instance.set_references([999], [1.0]), "999")
    value = ctypes.c_double()
    status = instance.call("fmi2GetReal", (ctypes.c_uint * 1)(999), ONE, ctypes.byref(value))
    assert_refused(instance, status, "999")


def test_a_parameter_outside_its_range_is_discarded(pendulum):
    instance = pendulum().start()
    assert instance.set({"mass": 0.0}) == fmi2Discard
    assert "mass" in instance.messages[-1][2]
    assert instance.messages[-1][:2] == (fmi2Discard, "logStatusDiscard")
    assert instance.get("mass")[0] == 1.0


def test_an_input_outside_its_range_is_used_with_a_warning(escape):
    escape.start()
    assert escape.set({"push": 1.5}) == fmi2Warning
    assert escape.messages[-1][:2] == (fmi2Warning, "logStatusWarning")
    assert escape.get("held")[0] == 1.5


def test_missing_arrays_are_refused(pendulum):
    instance = pendulum().start()
    assert_refused(instance, instance.call("fmi2GetReal", None, ONE, None), "NULL")
    assert_refused(instance, instance.call("fmi2SetReal", None, ONE, None), "NULL")
    assert_refused(instance, instance.call("fmi2GetRealStatus", fmi2LastSuccessfulTime, None), "NULL")
    assert instance.call("fmi2GetReal", None, NONE, None) == fmi2OK
    assert instance.call("fmi2SetReal", None, NONE, None) == fmi2OK


@pytest.mark.parametrize("kind", ["Integer", "Boolean", "String"])
def test_there_are_no_variables_of_other_types(pendulum, kind):
    instance = pendulum().start()
    reference, buffer = (ctypes.c_uint * 1)(1), (ctypes.c_void_p * 1)()
    for access in ("Get", "Set"):
        assert instance.call(f"fmi2{access}{kind}", None, NONE, None) == fmi2OK
        assert_refused(instance, instance.call(f"fmi2{access}{kind}", reference, ONE, buffer), "Real")


def test_what_the_capability_flags_deny_is_refused(pendulum):
    instance = pendulum().start()
    reference, order, value = (ctypes.c_uint * 1)(1), (ctypes.c_int * 1)(1), (ctypes.c_double * 1)()
    for name in ("fmi2SetRealInputDerivatives", "fmi2GetRealOutputDerivatives"):
        assert instance.call(name, None, NONE, None, None) == fmi2OK
        assert_refused(instance, instance.call(name, reference, ONE, order, value), name)
    assert_refused(instance, instance.call("fmi2CancelStep"), "pending")


def test_status_inquiries(pendulum):
    instance = pendulum().start()
    assert instance.step(0.0, 0.1) == fmi2OK
    assert instance.last_successful_time() == 0.1
    terminated = ctypes.c_int(7)
    assert instance.call("fmi2GetBooleanStatus", fmi2Terminated, ctypes.byref(terminated)) == fmi2OK
    assert terminated.value == 0
    for kind in ("", "Real", "Integer", "Boolean", "String"):
        assert instance.call(f"fmi2Get{kind}Status", 0, ctypes.byref(ctypes.c_double())) == fmi2Discard


def test_versions(pendulum_library):
    for name, text in [("fmi2GetVersion", b"2.0"), ("fmi2GetTypesPlatform", b"default")]:
        function = pendulum_library.functions[name]
        function.restype = ctypes.c_char_p
        assert function() == text


def test_a_failed_integration_names_its_time_and_leaves_the_last_good_point(escape):
    """x' = x^2 from 1 is 1 / (1 - t)."""
    escape.start()
    assert escape.step(0.0, 0.5) == fmi2OK
    assert_refused(escape, escape.step(0.5, 1.0), "integration failed at time 1:")
    assert escape.last_successful_time() == 0.5
    assert escape.get("x")[0] == pytest.approx(2.0, abs=1e-8)
    assert_refused(escape, escape.step(0.5, 0.1), "after a failed step")
    assert escape.call("fmi2Reset") == fmi2OK
    assert escape.start({"gain": 0.5}).step(0.0, 1.0) == fmi2OK
    assert escape.get("x")[0] == pytest.approx(2.0, abs=1e-8)


def test_a_derivative_that_is_not_finite_fails_the_step(escape):
    escape.start({"x": 1e200})
    assert_refused(escape, escape.step(0.0, 0.1), "time 0", "not finite")


def test_a_step_of_stiff_equations_ends_with_an_error_not_never(pendulum):
    """Damping this high lets an explicit method advance by nanoseconds only."""
    instance = pendulum().start({"angle": 1.0, "damping": 1e9})
    assert_refused(instance, instance.step(0.0, 10.0), "too many internal steps")
    assert instance.last_successful_time() == 0.0


def test_an_output_that_is_not_finite_is_an_error(escape):
    escape.start({"x": -1.0})
    status, values = escape.get_with_status("root", "x")
    assert_refused(escape, status, "root", "not finite")
    assert np.isnan(values[0])
    assert values[1] == -1.0


def test_why_a_call_failed_is_logged_without_debug_logging_too(pendulum):
    instance = pendulum(logging=False).start()
    assert instance.step(0.0, -1.0) == fmi2Error
    assert [category for _, category, _ in instance.messages] == ["logStatusError"]


def test_categories_choose_what_is_logged(pendulum):
    instance = pendulum(logging=False).start()

    def choose(on, *categories):
        names = (ctypes.c_char_p * len(categories))(*categories)
        return instance.call("fmi2SetDebugLogging", on, ctypes.c_size_t(len(categories)), names)

    def logged():
        instance.messages.clear()
        instance.set({"mass": 0.0})
        instance.step(0.0, -1.0)
        return [category for _, category, _ in instance.messages]

    assert choose(1, b"logStatusError") == fmi2OK
    assert logged() == ["logStatusError"]
    assert choose(1, b"logStatusDiscard", b"logStatusWarning") == fmi2OK
    assert logged() == ["logStatusDiscard"]
    for everything in (choose(1), choose(1, b"logAll")):
        assert everything == fmi2OK
        assert logged() == ["logStatusDiscard", "logStatusError"]
    assert_refused(instance, choose(1, b"logStatusError", b"chatter"), "category")
    assert logged() == ["logStatusDiscard", "logStatusError"]
    assert choose(0) == fmi2OK
    assert logged() == []
