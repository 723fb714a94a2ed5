"""Saving, restoring and serializing instances; instances beside one another."""

import ctypes
import threading

import numpy as np
from fmpy.fmi2 import fmi2Error, fmi2OK

TORQUES = np.random.default_rng(4).uniform(-3.5, 3.5, (60, 1))


def save(instance):
    state = ctypes.c_void_p()
    assert instance.call("fmi2GetFMUstate", ctypes.byref(state)) == fmi2OK
    return state


def free(instance, state):
    assert instance.call("fmi2FreeFMUstate", ctypes.byref(state)) == fmi2OK
    assert state.value is None


def serialize(instance, state):
    size = ctypes.c_size_t()
    assert instance.call("fmi2SerializedFMUstateSize", state, ctypes.byref(size)) == fmi2OK
    buffer = ctypes.create_string_buffer(size.value)
    assert instance.call("fmi2SerializeFMUstate", state, buffer, size) == fmi2OK
    return buffer.raw


def test_a_restored_state_continues_bit_for_bit(pendulum):
    instance = pendulum().start()
    instance.run(TORQUES[:30], ["torque"])
    state = save(instance)
    once = instance.run(TORQUES[30:], ["torque"], first=30)
    assert instance.set({"mass": 3.0}) == fmi2OK
    assert instance.call("fmi2SetFMUstate", state) == fmi2OK
    again = instance.run(TORQUES[30:], ["torque"], first=30)
    np.testing.assert_array_equal(again, once)
    free(instance, state)


def test_a_state_can_be_saved_over_an_older_one(pendulum):
    instance = pendulum().start()
    state = save(instance)
    address = state.value
    instance.run(TORQUES[:5], ["torque"])
    assert instance.call("fmi2GetFMUstate", ctypes.byref(state)) == fmi2OK
    assert state.value == address
    once = instance.run(TORQUES[5:10], ["torque"], first=5)
    assert instance.call("fmi2SetFMUstate", state) == fmi2OK
    np.testing.assert_array_equal(instance.run(TORQUES[5:10], ["torque"], first=5), once)
    free(instance, state)


def test_a_serialized_state_continues_in_another_instance_bit_for_bit(pendulum):
    first, second = pendulum().start(), pendulum()
    first.run(TORQUES[:30], ["torque"])
    assert first.set({"damping": 0.1}) == fmi2OK
    state = save(first)
    content = serialize(first, state)
    free(first, state)
    restored = ctypes.c_void_p()
    size = ctypes.c_size_t(len(content))
    assert second.call("fmi2DeSerializeFMUstate", content, size, ctypes.byref(restored)) == fmi2OK
    assert second.call("fmi2SetFMUstate", restored) == fmi2OK
    np.testing.assert_array_equal(
        second.run(TORQUES[30:], ["torque"], first=30), first.run(TORQUES[30:], ["torque"], first=30)
    )
    assert serialize(second, restored) == content
    free(second, restored)


def test_serialized_states_of_other_models_are_refused(pendulum):
    instance = pendulum().start()
    state = save(instance)
    content = serialize(instance, state)
    restored = ctypes.c_void_p()
    for wrong in (content[:-1], b"{other" + content[6:], b""):
        size = ctypes.c_size_t(len(wrong))
        assert instance.call("fmi2DeSerializeFMUstate", wrong, size, ctypes.byref(restored)) == fmi2Error
        assert "not a state of model pendulum" in instance.messages[-1][2]
    buffer = ctypes.create_string_buffer(4)
    assert instance.call("fmi2SerializeFMUstate", state, buffer, ctypes.c_size_t(4)) == fmi2Error
    free(instance, state)


def test_missing_states_are_refused(pendulum):
    instance = pendulum().start()
    assert instance.call("fmi2GetFMUstate", None) == fmi2Error
    assert instance.call("fmi2SetFMUstate", None) == fmi2Error
    assert instance.call("fmi2FreeFMUstate", None) == fmi2OK
    assert instance.call("fmi2FreeFMUstate", ctypes.byref(ctypes.c_void_p())) == fmi2OK


def test_a_saved_state_leads_back_from_a_failed_step(escape):
    escape.start()
    state = save(escape)
    assert escape.step(0.0, 2.0) == fmi2Error
    assert escape.call("fmi2SetFMUstate", state) == fmi2OK
    assert escape.step(0.0, 0.5) == fmi2OK
    free(escape, state)


def test_a_reset_instance_repeats_itself_bit_for_bit(pendulum):
    instance = pendulum().start({"angle": 0.5}, tolerance=1e-6, stop=10.0)
    loose = instance.run(TORQUES, ["torque"])
    assert instance.call("fmi2Reset") == fmi2OK
    tight = instance.start().run(TORQUES, ["torque"])
    assert instance.call("fmi2Reset") == fmi2OK
    np.testing.assert_array_equal(
        instance.start({"angle": 0.5}, tolerance=1e-6).run(TORQUES, ["torque"]), loose
    )
    np.testing.assert_array_equal(pendulum().start().run(TORQUES, ["torque"]), tight)


def test_interleaved_instances_do_not_disturb_each_other(pendulum):
    alone = [pendulum().start().run(sign * TORQUES, ["torque"]) for sign in (1, -2)]
    pair = [pendulum().start(), pendulum().start()]
    rows = [
        [
            instance.run(sign * TORQUES[k : k + 1], ["torque"], first=k)
            for sign, instance in zip((1, -2), pair, strict=True)
        ]
        for k in range(len(TORQUES))
    ]
    for index in range(2):
        np.testing.assert_array_equal(np.vstack([row[index] for row in rows]), alone[index])


def test_instances_in_threads_do_not_disturb_each_other(pendulum):
    alone = pendulum().start().run(TORQUES, ["torque"])
    instances = [pendulum().start() for _ in range(4)]
    results = [None] * 4

    def work(index):
        results[index] = instances[index].run(TORQUES, ["torque"])

    threads = [threading.Thread(target=work, args=[index]) for index in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for result in results:
        np.testing.assert_array_equal(result, alone)
