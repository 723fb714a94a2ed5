"""Other programs are run for what they print, and nothing of them goes on."""

import subprocess
import sys

import pytest

from fmu_plants.commands import captured


def test_the_output_may_be_in_any_encoding():
    program = "import sys; sys.stdout.buffer.write(b'a\\xff'); print('why', file=sys.stderr); sys.exit(3)"
    done = captured([sys.executable, "-c", program], 60.0)
    assert (done.returncode, done.stdout, done.stderr.split()) == (3, "a\N{REPLACEMENT CHARACTER}", ["why"])


@pytest.mark.parametrize("raised", [subprocess.TimeoutExpired("python", 60.0), KeyboardInterrupt()])
def test_one_that_is_late_or_interrupted_is_ended(raised, monkeypatch):
    started = []

    def interrupt(process, timeout):
        started.append(process)
        raise raised

    monkeypatch.setattr(subprocess.Popen, "communicate", interrupt)
    with pytest.raises(type(raised)):
        captured([sys.executable, "-c", "import threading; threading.Event().wait()"], 60.0)
    (process,) = started
    assert process.returncode not in (0, None)


def test_one_that_is_not_there_is_an_error():
    with pytest.raises(OSError, match="no-such-program"):
        captured(["no-such-program"], 60.0)
