"""DeePC (8) against the authors' own program, and what it asks of its data."""

from dataclasses import replace

import numpy as np
import pytest

from ddpc_controllers import DeePC, published
from ddpc_controllers.published import PublishedDeePC, padded_with_zeros
from ddpc_cosim import DataError, FloatArray, Recording

from .full_problem import FullDeePC
from .loops import (
    ANGLE,
    DATA,
    DEGREE,
    PRINTED,
    Run,
    close_loop,
    paper_reference,
    pendulum,
    pendulum_loop,
    printed_deepc,
)


def run(controller: DeePC, recording: Recording) -> Run:
    """Close the paper's loop on the pendulum."""
    return close_loop(controller, pendulum_loop(recording), pendulum, ANGLE, paper_reference())


def test_the_published_program_is_reproduced_row_by_row(paper_recording: Recording) -> None:
    program = np.loadtxt(DATA / "deepc_published_code.csv", delimiter=",", skiprows=1)
    here = run(PublishedDeePC(), paper_recording)
    assert np.abs(here.y[:, 0] / DEGREE - program[:, 2]).max() < 1e-5
    assert np.abs(here.u[:, 0] - program[:, 3]).max() < 1e-6
    assert set(here.status) == {"ok"}


class Padded(DeePC):
    """Only one of the published program's departures."""

    def _stack(self, recording: Recording) -> FloatArray:
        return super()._stack(padded_with_zeros(recording, self.initial_length))


@pytest.mark.parametrize(
    ("controller", "degrees"),
    [
        (Padded(**PRINTED), 624.71),
        (Padded(**PRINTED, affine_sum="all"), 609.52),
        (printed_deepc(), 456.08),
        (printed_deepc(affine_sum="all"), 459.28),
    ],
)
def test_each_departure_of_the_published_program_has_its_effect(
    paper_recording: Recording, controller: DeePC, degrees: float
) -> None:
    assert run(controller, paper_recording).absolute_error == pytest.approx(degrees, abs=0.05)


def test_the_published_sum_without_the_padding(
    paper_recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(published, "padded_with_zeros", lambda recording, samples: recording)
    assert run(PublishedDeePC(), paper_recording).absolute_error == pytest.approx(466.08, abs=0.05)


def test_a_loop_can_go_on_where_the_recording_ended(paper_recording: Recording) -> None:
    loop = replace(pendulum_loop(paper_recording, degrees=120.0), continues_recording=True)
    here = close_loop(printed_deepc(), loop, pendulum, ANGLE, paper_reference(), steps=1)
    full = FullDeePC(printed_deepc(), paper_recording, loop.bounds)
    first = full.solve(paper_recording.u[-3:], paper_recording.y[-3:], paper_reference()[1:6])
    assert here.u[0] == pytest.approx(first.u[0], abs=1e-7)


def test_the_recording_is_diagnosed(paper_recording: Recording) -> None:
    controller = printed_deepc()
    controller.start(pendulum_loop(paper_recording))
    figures = controller.diagnostics()
    assert figures["pe_order_needed"] == 3 + 5 + 3
    assert figures["pe_order"] == 100
    assert (figures["data_rank"], figures["data_rows"], figures["data_columns"]) == (16, 16, 193)
    assert figures["smallest_singular_value"] > 0.0


def test_an_input_that_hardly_varies_is_refused_with_the_orders(paper_recording: Recording) -> None:
    time = np.arange(200)[:, np.newaxis]
    u = np.sin(0.5 * time) + np.sin(1.3 * time)
    poor = Recording(u, paper_recording.y, paper_recording.measured, 0.1)
    with pytest.raises(DataError, match=r"exciting of order 4, needed 11 \(depth 8 \+ assumed order 3\)"):
        printed_deepc().start(pendulum_loop(poor))


def test_the_assumed_order_decides_how_much_excitation_is_needed(paper_recording: Recording) -> None:
    controller = printed_deepc(assumed_order=2)
    controller.start(pendulum_loop(paper_recording))
    assert controller.diagnostics()["pe_order_needed"] == 10


def test_a_recording_shorter_than_the_depth_needs_is_refused(paper_recording: Recording) -> None:
    short = Recording(
        *(a[:20] for a in (paper_recording.u, paper_recording.y, paper_recording.measured)), 0.1
    )
    with pytest.raises(DataError, match=r"has 20 samples; .* takes at least 21"):
        printed_deepc().start(pendulum_loop(short))
