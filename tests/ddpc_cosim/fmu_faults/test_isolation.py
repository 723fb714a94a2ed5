"""FMUs in processes of their own: the same answers, whoever asks, and however the processes are started."""

import gc
import math
import pickle
import socket
import struct
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from fmus.builder import Fault

from ddpc_cosim import ConfigError, FMUImportError, FMUPlant, FMUStepError
from ddpc_cosim.errors import StepStatus
from ddpc_cosim.fmu.isolation import Frame, IsolatedSession
from ddpc_cosim.loop.safe_calls import CallsInTime
from ddpc_cosim.processes.worker import Channel

from .loop import H

U = np.ones(1)

pytestmark = pytest.mark.usefixtures("nothing_left")


def isolated(path: Path) -> FMUPlant:
    return FMUPlant(path, isolated=True, step_timeout=20.0)


@pytest.fixture
def session(faulty_fmus: dict[int, Path]) -> Iterator[FMUPlant]:
    session = isolated(faulty_fmus[2])
    yield session
    session.close()


class TestTheSameAsInThisProcess:
    @pytest.mark.parametrize("version", [2, 3])
    def test_what_it_says_of_itself(self, version: int, faulty_fmus: dict[int, Path]) -> None:
        here, there = FMUPlant(faulty_fmus[version]), isolated(faulty_fmus[version])
        assert there.description == here.description
        assert there.provenance() == here.provenance()
        assert (there.inputs, there.outputs, there.warnings) == (here.inputs, here.outputs, here.warnings)
        assert there.can_save_state == here.can_save_state
        here.close()
        there.close()

    def test_steps(self, faulty_fmus: dict[int, Path], session: FMUPlant) -> None:
        """Bit for bit, times included, also where the step size changes."""
        here = FMUPlant(faulty_fmus[2])
        np.testing.assert_array_equal(here.reset(t0=1.5), session.reset(t0=1.5))
        assert session.time == here.time == 1.5
        for u, h in ((0.3, 0.1), (-1.0, 0.1), (7.0, 0.25)):
            np.testing.assert_array_equal(here.step(np.array([u]), h), session.step(np.array([u]), h))
            assert session.time == here.time
        here.close()

    def test_every_answer_is_a_new_array(self, session: FMUPlant) -> None:
        session.reset()
        first = session.step(U, H)
        session.step(U, H)
        np.testing.assert_allclose(first, [H])

    @pytest.mark.parametrize("parameters", [{"falt": 1}, {"u": 1.0}, {"fault": 0.5}], ids=str)
    def test_errors(
        self, parameters: dict[str, float], faulty_fmus: dict[int, Path], session: FMUPlant
    ) -> None:
        here = FMUPlant(faulty_fmus[2])
        with pytest.raises(ConfigError) as expected:
            here.reset(parameters)
        with pytest.raises(ConfigError) as caught:
            session.reset(parameters)
        assert caught.value.faults == expected.value.faults
        here.close()

    def test_an_fmu_that_cannot_be_loaded(self, tmp_path: Path) -> None:
        path = tmp_path / "text.fmu"
        path.write_bytes(b"text")
        with pytest.raises(FMUImportError, match=r"^text\.fmu: not an FMU: File is not a zip file$"):
            isolated(path)

    def test_names_that_do_not_exist(self, faulty_fmus: dict[int, Path]) -> None:
        with pytest.raises(ConfigError) as error:
            FMUPlant(faulty_fmus[2], isolated=True, inputs=["v"], outputs=["z"])
        assert len(error.value.faults) == 2

    def test_it_cannot_step_before_reset(self, session: FMUPlant) -> None:
        with pytest.raises(ConfigError, match="step before reset"):
            session.step(U, H)

    def test_a_wrong_number_of_inputs_costs_nothing(self, session: FMUPlant) -> None:
        session.reset()
        with pytest.raises(ValueError, match="could not broadcast"):
            session.step(np.ones(3), H)
        np.testing.assert_allclose(session.step(U, H), [H])


class TestTheProcesses:
    def test_several_at_once(self, faulty_fmus: dict[int, Path]) -> None:
        """What happens to one does not happen to another."""
        sessions = [isolated(faulty_fmus[2]) for _ in range(3)]
        for session, fault in zip(sessions, (Fault.NO_FAULT, Fault.CALL_ABORT, Fault.NO_FAULT), strict=True):
            session.reset({"fault": int(fault)})
        sessions[0].step(U, H)
        with pytest.raises(FMUStepError, match=r"SIGABRT|exit code"):
            sessions[1].step(U, H)
        for session in (sessions[0], sessions[2]):
            session.step(U, H)
        assert [round(session.time / H) for session in sessions] == [2, 0, 1]
        for session in sessions:
            session.close()

    def test_a_thread_that_has_ended(self, faulty_fmus: dict[int, Path]) -> None:
        """The process belongs to this one, not to the thread that asked for it."""
        opened: list[FMUPlant] = []

        def open_session() -> None:
            opened.append(isolated(faulty_fmus[2]))
            opened[0].reset()

        thread = threading.Thread(target=open_session)
        thread.start()
        thread.join()
        np.testing.assert_allclose(opened[0].step(U, H), [H])
        opened[0].close()

    def test_one_that_is_forgotten(self, faulty_fmus: dict[int, Path], scratch: Path) -> None:
        """Its process ends and its files go with the object."""
        session = isolated(faulty_fmus[2])
        assert len(list(scratch.iterdir())) == 1
        del session
        gc.collect()
        assert list(scratch.iterdir()) == []

    def test_files_that_the_fmu_makes(self, session: FMUPlant, scratch: Path) -> None:
        """Temporary files of the FMU's own lie in its folder, and go with it (the fixture checks that)."""
        session.reset({"fault": int(Fault.LEAVE_A_FILE)})
        session.step(U, H)
        assert [len(list(folder.glob("left-*"))) for folder in scratch.iterdir()] == [1]


def test_an_interrupt_ends_the_process(session: FMUPlant, monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise the answer that is still to come would be taken for the next one's."""
    session.reset()

    def interrupted(frame: Frame, channel: Channel, seconds: float) -> int:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Frame, "receive", interrupted)
        with pytest.raises(KeyboardInterrupt):
            session.step(U, H)
    np.testing.assert_allclose(session.reset(), [0.0])
    np.testing.assert_allclose(session.step(U, H), [H])


class Evil:
    """What runs code in whoever unpickles it."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, tuple[Path]]:
        return Path.touch, (self.path,)


HEAD = struct.Struct("=q")
ENDLESS = b'{"result": [{"shape": [1]}, 1%s]}\n' % (400 * b"0") + bytes(8)


@pytest.mark.parametrize(
    "words",
    [
        "pickle",
        HEAD.pack(2 << 30),
        HEAD.pack(1 << 60),
        HEAD.pack(5) + b"[1,2]",
        HEAD.pack(2) + b"{}",
        HEAD.pack(3) + b"\xff{}",
        HEAD.pack(13) + b'{"result": 1}',
        HEAD.pack(20) + b'{"result": [[1], []]}'[:20],
        HEAD.pack(20) + b'{"result": ["x", 0]}',
        HEAD.pack(len(ENDLESS)) + ENDLESS,
    ],
    ids=str,
)
def test_an_fmu_that_writes_into_its_channel_is_a_crash(
    words: bytes | str, faulty_fmus: dict[int, Path], tmp_path: Path
) -> None:
    """What comes from its process is neither unpickled nor trusted in its length."""
    harm = tmp_path / "harm"
    content = pickle.dumps(Evil(harm))
    written = HEAD.pack(len(content)) + content if isinstance(words, str) else words
    ours, theirs = socket.socketpair()
    with ours, isolated(faulty_fmus[2]) as session:
        session.reset()
        remote = session._session
        assert isinstance(remote, IsolatedSession)
        assert remote._worker is not None
        remote._worker.channel.socket.close()
        remote._worker.channel.socket = ours
        theirs.sendall(written)
        theirs.shutdown(socket.SHUT_WR)
        with pytest.raises(FMUStepError, match="crashed in step") as error:
            session.step(U, H)
        theirs.close()
    assert error.value.status is StepStatus.CRASHED
    assert not harm.exists()


@pytest.mark.parametrize("limit", [0.0, -1.0, math.nan, math.inf])
def test_an_impossible_limit(limit: float, faulty_fmus: dict[int, Path]) -> None:
    with pytest.raises(ConfigError, match=r"step_timeout = .* is not possible; allowed: a finite number > 0"):
        FMUPlant(faulty_fmus[2], isolated=True, step_timeout=limit)


def test_a_limit_longer_than_a_system_waits(faulty_fmus: dict[int, Path]) -> None:
    with FMUPlant(faulty_fmus[2], isolated=True, step_timeout=1e300) as session:
        session.reset()
        np.testing.assert_allclose(session.step(U, H), [H])
    with CallsInTime(1e300) as in_time:
        assert in_time(lambda: 1) == 1
