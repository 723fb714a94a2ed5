"""States of FMUs as bytes: another instance, also in another process, goes on from them to the last bit."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmus.builder import Fault, keeping_fmu

from ddpc_cosim import ConfigError, FMUPlant, FMUStepError
from ddpc_cosim.files.plain_data import from_bytes, to_bytes

H = 0.3
FORCES = np.sin(np.arange(20.0))[:, np.newaxis]


def rows(plant: FMUPlant, inputs: np.ndarray) -> np.ndarray:
    return np.array([plant.step(u, H) for u in inputs])


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize(
    ("model", "kind"),
    [
        ("lag", "co-simulation"),
        ("lag", "model-exchange"),
        ("stair", "co-simulation"),
        ("stair", "model-exchange"),
        ("ball", "model-exchange"),
        ("relay", "model-exchange"),
    ],
)
def test_another_instance_goes_on(tmp_path: Path, version: str, model: str, kind: Any) -> None:
    """Events of state, time and steps before and after; time too."""
    path = keeping_fmu(tmp_path, version, model)
    with FMUPlant(path, fmi_type=kind) as first, FMUPlant(path, fmi_type=kind) as second:
        first.reset(t0=5.0)
        last = rows(first, FORCES[:9])[-1]
        content = first.serialise_state()
        second.reset(t0=5.0)
        np.testing.assert_array_equal(second.deserialise_state(content), last)
        assert second.time == first.time
        np.testing.assert_array_equal(rows(second, FORCES[9:]), rows(first, FORCES[9:]))
        assert second.time == first.time


def test_an_integrator_begins_anew_where_no_input_changes(tmp_path: Path) -> None:
    """It has a memory of its own, which is no part of an FMU's state: equal within its tolerance."""
    path = keeping_fmu(tmp_path, "2.0", "lag")
    how: Any = {"fmi_type": "model-exchange", "tolerance": 1e-9}
    with FMUPlant(path, **how) as first, FMUPlant(path, **how) as second:
        first.reset()
        rows(first, np.ones((5, 1)))
        second.reset()
        second.deserialise_state(first.serialise_state())
        np.testing.assert_allclose(rows(second, np.ones((5, 1))), rows(first, np.ones((5, 1))), rtol=1e-7)
        exact = 1 - np.exp(-H * 10)
        assert second.outputs_at(np.ones(1)) == pytest.approx([exact], abs=1e-7)


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("there", ["first", "second"])
def test_it_leaves_and_enters_processes(tmp_path: Path, version: str, there: str) -> None:
    path = keeping_fmu(tmp_path, version, "lag")
    with (
        FMUPlant(path, isolated=there == "first") as first,
        FMUPlant(path, isolated=there == "second") as second,
    ):
        first.reset({"rate": 2.0})
        second.reset({"rate": 2.0})
        last = rows(first, FORCES[:7])[-1]
        np.testing.assert_array_equal(second.deserialise_state(first.serialise_state()), last)
        np.testing.assert_array_equal(rows(second, FORCES[7:]), rows(first, FORCES[7:]))


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_one_that_no_process_can_return_is_refused_in_words_and_the_run_goes_on(
    tmp_path: Path, version: str
) -> None:
    path = keeping_fmu(tmp_path, version, "lag", fault=Fault.LARGE_STATE)
    with FMUPlant(path, isolated=True) as isolated, FMUPlant(path) as plant:
        for each in (isolated, plant):
            each.reset()
        with pytest.raises(ConfigError, match=r"has 179 MB as bytes.* can return 134 MB: .*isolated = False"):
            isolated.serialise_state()
        assert len(plant.serialise_state()) > 1 << 27
        np.testing.assert_array_equal(rows(isolated, FORCES), rows(plant, FORCES))


@pytest.mark.parametrize("kind", ["co-simulation", "model-exchange"])
def test_other_inputs_may_be_driven_afterwards(tmp_path: Path, kind: Any) -> None:
    """x' = u - x. What was driven and is not any more keeps its last value; what is driven counts at once."""
    path = keeping_fmu(tmp_path, "2.0", "lag")
    decay, how = np.exp(-H), {"fmi_type": kind, "tolerance": 1e-9}
    with FMUPlant(path, **how) as driven, FMUPlant(path, inputs=[], **how) as resting:
        driven.reset()
        driven.step(np.array([3.0]), H)
        resting.reset()
        x = resting.deserialise_state(driven.serialise_state())
        assert x == pytest.approx([3 * (1 - decay)], abs=1e-7)
        x = resting.step(np.empty(0), H)
        assert x == pytest.approx([3 * (1 - decay**2)], abs=1e-7)
        driven.reset()
        driven.deserialise_state(resting.serialise_state())
        assert driven.step(np.zeros(1), H) == pytest.approx(decay * x, abs=1e-7)


@pytest.mark.parametrize(
    ("claims", "lacking"), [((), "canGetAndSetFMUstate"), (("GetAndSet",), "canSerializeFMUstate")]
)
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_what_an_fmu_does_not_claim_is_said(tmp_path: Path, version: str, claims: Any, lacking: str) -> None:
    with FMUPlant(keeping_fmu(tmp_path, version, "lag", claims)) as plant:
        assert not plant.can_serialise_state
        with pytest.raises(ConfigError, match=f"cannot save its state as bytes .{lacking} is false"):
            plant.serialise_state()


def test_an_empty_claim_is_an_error_of_the_fmu(tmp_path: Path) -> None:
    with FMUPlant(keeping_fmu(tmp_path, "2.0", "lag", able=False)) as plant:
        plant.reset()
        with pytest.raises(FMUStepError, match="fmi2GetFMUstate"):
            plant.serialise_state()


@pytest.mark.parametrize("isolated", [False, True])
def test_bytes_that_are_no_state_are_refused(tmp_path: Path, isolated: bool) -> None:
    """What is wrong with all of it, with the numbers of the run, or with what the FMU made."""
    with FMUPlant(keeping_fmu(tmp_path, "2.0", "lag"), isolated=isolated) as plant:
        plant.reset()
        rows(plant, FORCES[:3])
        state = from_bytes(plant.serialise_state())
        wrong: list[object] = [
            b"",
            [],
            {},
            3,
            {**state, "run": None},
            {**state, "run": state["run"][:-1]},
            {**state, "run": (float("nan"), *state["run"][1:])},
            {**state, "run": ("text", *state["run"][1:])},
            {**state, "fmu": "text"},
        ]
        for value in wrong:
            with pytest.raises(ConfigError, match="the state is not one of this"):
                plant.deserialise_state(to_bytes(value))
        with pytest.raises(
            ConfigError, match="the state is not one of this plant: ValueError: it is not plain"
        ):
            plant.deserialise_state(b"pickle")
        with pytest.raises(
            ConfigError, match="saved of the FMU run for model-exchange, and this runs for co"
        ):
            plant.deserialise_state(to_bytes({**state, "type": "model-exchange"}))
        with pytest.raises(FMUStepError, match=r"fmi2DeSerializeFMUstate.*this is not a state of mine"):
            plant.deserialise_state(to_bytes({**state, "fmu": state["fmu"][:-1]}))
