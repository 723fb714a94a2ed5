"""FMI 3.0: what may be called when (section 2.3), and what is refused with a reason."""

import ctypes
import math

import numpy as np
import pytest
from fmpy.fmi3 import fmi3Discard, fmi3Error, fmi3OK

NONE, ONE, TWO = (ctypes.c_size_t(n) for n in range(3))
INTEGERS = [f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)]
OTHER_TYPES = ["Float32", *INTEGERS, "Boolean", "String"]


def assert_refused(instance, status, *words):
    """The call failed and its message, the last one, says why."""
    assert status == fmi3Error
    logged, category, message = instance.messages[-1]
    assert (logged, category) == (fmi3Error, "logStatusError")
    for word in words:
        assert word in message


def test_life_of_an_instance(pendulum3):
    instance = pendulum3()
    assert instance.set({"mass": 2.0, "angle": 0.1, "gravity": 9.8}) == fmi3OK
    assert instance.initialize(tolerance=1e-8, stop=1.0) == fmi3OK
    assert instance.set({"torque": 1.0}) == fmi3OK
    assert instance.get("mass", "angle", "gravity", "torque") == pytest.approx([2.0, 0.1, 9.8, 1.0], abs=0)
    assert instance.call("fmi3ExitInitializationMode") == fmi3OK
    assert instance.step(0.0, 0.5) == fmi3OK
    assert list(instance.flags) == [False, False, False]
    assert instance.last_time.value == 0.5
    assert instance.call("fmi3Terminate") == fmi3OK
    assert instance.get("time")[0] == 0.5
    assert instance.call("fmi3Reset") == fmi3OK
    assert instance.start().get("mass")[0] == 1.0
    assert instance.messages == []


def test_both_versions_compute_the_same_to_the_last_bit(pendulum, pendulum3):
    torques = np.random.default_rng(6).uniform(-3.5, 3.5, (50, 1))
    by_fmi2 = pendulum().start().run(torques, ["torque"])
    instance = pendulum3().start()
    for k, torque in enumerate(torques):
        assert instance.set({"torque": torque[0]}) == fmi3OK
        assert instance.step(k * 0.1, 0.1) == fmi3OK
        np.testing.assert_array_equal(instance.get("angle", "angular_velocity"), by_fmi2[k])


def test_calls_out_of_order_are_refused(pendulum3):
    instance = pendulum3()
    assert_refused(instance, instance.call("fmi3ExitInitializationMode"), "before initialization")
    assert_refused(instance, instance.step(0.0, 0.1), "before initialization")
    assert_refused(instance, instance.call("fmi3Terminate"), "before initialization")
    assert instance.initialize() == fmi3OK
    assert_refused(instance, instance.initialize(), "in initialization mode")
    assert instance.call("fmi3ExitInitializationMode") == fmi3OK
    assert_refused(instance, instance.call("fmi3EnterEventMode"), "between communication steps")
    assert_refused(instance, instance.call("fmi3EnterStepMode"), "no event mode")
    assert instance.call("fmi3Terminate") == fmi3OK
    assert_refused(instance, instance.step(0.0, 0.1), "after the instance was terminated")


@pytest.mark.parametrize(
    ("experiment", "word"),
    [
        ({"start": math.nan}, "start time"),
        ({"start": 1.0, "stop": 0.5}, "stop time"),
        ({"tolerance": -1e-6}, "tolerance"),
    ],
)
def test_impossible_experiments_are_refused(pendulum3, experiment, word):
    instance = pendulum3()
    assert_refused(instance, instance.initialize(**experiment), word)
    assert instance.initialize() == fmi3OK


def test_impossible_steps_and_values_are_refused(pendulum3):
    instance = pendulum3().start(stop=1.0)
    assert_refused(instance, instance.step(0.0, -0.1), "step size")
    assert_refused(instance, instance.step(0.3, 0.1), "the instance is at 0")
    assert_refused(instance, instance.step(0.0, 2.0), "stop time")
    assert_refused(instance, instance.set({"torque": math.nan}), "torque", "not finite")
    assert_refused(instance, instance.set({"gravity": 1.0}), "gravity", "initialization")
    assert instance.set({"mass": 0.0}) == fmi3Discard
    assert instance.step(0.0, 1.0) == fmi3OK


def test_a_step_without_room_for_its_answers_is_refused(pendulum3):
    instance = pendulum3().start()
    status = instance.call("fmi3DoStep", ctypes.c_double(0.0), ctypes.c_double(0.1), True, *[None] * 4)
    assert_refused(instance, status, "NULL")
    assert instance.get("time")[0] == 0.0


def test_an_instance_of_another_model_is_not_made(pendulum3):
    for exchange in (False, True):
        instance = pendulum3(token="{other}", exchange=exchange)
        assert instance.component is None
        assert "token" in instance.messages[-1][2]


def test_scheduled_execution_is_refused(pendulum3_library, pendulum3):
    instance = pendulum3()
    instantiate = pendulum3_library.functions.fmi3InstantiateScheduledExecution
    instantiate.restype = ctypes.c_void_p
    token = pendulum3_library.description.guid.encode()
    assert instantiate(b"plant", token, b"", False, True, None, instance.logger, None, None, None) is None
    assert "no Scheduled Execution" in instance.messages[-1][2]


def test_one_value_per_variable(pendulum3):
    instance = pendulum3().start()
    references, values = (ctypes.c_uint * 2)(1, 2), (ctypes.c_double * 2)()
    for access in ("Get", "Set"):
        status = instance.call(f"fmi3{access}Float64", references, TWO, values, ONE)
        assert_refused(instance, status, "1 values for 2 variables")


@pytest.mark.parametrize("kind", OTHER_TYPES)
def test_there_are_no_variables_of_other_types(pendulum3, kind):
    instance = pendulum3().start()
    reference, buffer = (ctypes.c_uint * 1)(1), (ctypes.c_void_p * 1)()
    for access in ("Get", "Set"):
        name = f"fmi3{access}{kind}"
        assert instance.call(name, None, NONE, None, NONE) == fmi3OK
        assert_refused(instance, instance.call(name, reference, ONE, buffer, ONE), "Float64")


def test_there_are_no_binary_variables_and_no_clocks(pendulum3):
    instance = pendulum3().start()
    reference, buffer = (ctypes.c_uint * 1)(1), (ctypes.c_void_p * 2)()
    for access in ("Get", "Set"):
        status = instance.call(f"fmi3{access}Binary", reference, ONE, buffer, buffer, ONE)
        assert_refused(instance, status, "Float64")
        assert_refused(instance, instance.call(f"fmi3{access}Clock", reference, ONE, buffer), "no clocks")
    for name in ("IntervalDecimal", "IntervalFraction", "ShiftDecimal", "ShiftFraction"):
        for access in ("Get", "Set"):
            status = instance.call(f"fmi3{access}{name}", reference, ONE, buffer, buffer, buffer)
            assert_refused(instance, status, "no clocks")
    activation = instance.call("fmi3ActivateModelPartition", 1, ctypes.c_double(0.0))
    assert_refused(instance, activation, "no clocks")


def test_what_the_capability_flags_deny_is_refused(pendulum3):
    instance = pendulum3().start()
    reference, buffer = (ctypes.c_uint * 1)(1), (ctypes.c_void_p * 1)()
    for name in ("fmi3EnterConfigurationMode", "fmi3ExitConfigurationMode"):
        assert_refused(instance, instance.call(name), "no structural parameters")
    derivatives = instance.call("fmi3GetOutputDerivatives", reference, ONE, buffer, buffer, ONE)
    assert_refused(instance, derivatives, "no derivatives")
    dependencies = instance.call("fmi3GetNumberOfVariableDependencies", 1, buffer)
    assert_refused(instance, dependencies, "scalars")
    dependencies = instance.call("fmi3GetVariableDependencies", 1, *[buffer] * 4, NONE)
    assert_refused(instance, dependencies, "scalars")


def test_saved_states_continue_bit_for_bit_here_and_elsewhere(pendulum3):
    first, second = pendulum3().start({"torque": 1.0, "angle": 0.4}), pendulum3()
    assert first.step(0.0, 0.7) == fmi3OK
    state, copy, size = ctypes.c_void_p(), ctypes.c_void_p(), ctypes.c_size_t()
    assert first.call("fmi3GetFMUState", ctypes.byref(state)) == fmi3OK
    assert first.call("fmi3SerializedFMUStateSize", state, ctypes.byref(size)) == fmi3OK
    content = ctypes.create_string_buffer(size.value)
    assert first.call("fmi3SerializeFMUState", state, content, size) == fmi3OK
    assert second.call("fmi3DeserializeFMUState", content, size, ctypes.byref(copy)) == fmi3OK
    assert second.call("fmi3SetFMUState", copy) == fmi3OK
    ends = []
    for instance in (first, second):
        assert instance.step(0.7, 0.7) == fmi3OK
        ends.append(instance.get("angle", "angular_velocity"))
    assert first.call("fmi3SetFMUState", state) == fmi3OK
    assert first.step(0.7, 0.7) == fmi3OK
    ends.append(first.get("angle", "angular_velocity"))
    np.testing.assert_array_equal(ends[1], ends[0])
    np.testing.assert_array_equal(ends[2], ends[0])
    assert first.call("fmi3FreeFMUState", ctypes.byref(state)) == fmi3OK
    assert second.call("fmi3FreeFMUState", ctypes.byref(copy)) == fmi3OK


def test_a_state_of_the_other_interface_type_is_refused(pendulum3):
    stepping, exchanging = pendulum3().start(), pendulum3(exchange=True).start()
    state = ctypes.c_void_p()
    assert stepping.call("fmi3GetFMUState", ctypes.byref(state)) == fmi3OK
    assert_refused(exchanging, exchanging.call("fmi3SetFMUState", state), "other interface type")
    assert stepping.call("fmi3FreeFMUState", ctypes.byref(state)) == fmi3OK


def test_version(pendulum3_library):
    function = pendulum3_library.functions.fmi3GetVersion
    function.restype = ctypes.c_char_p
    assert function() == b"3.0"


def test_calls_without_an_instance_fail_quietly(pendulum3_library):
    functions = pendulum3_library.functions
    assert functions.fmi3Terminate(None) == fmi3Error
    assert functions.fmi3GetFloat64(None, None, NONE, None, NONE) == fmi3Error
    assert functions.fmi3GetClock(None, None, NONE, None) == fmi3Error
    functions.fmi3FreeInstance(None)
