"""What FMUs print: in this process it is theirs to print; from a process of their own nothing comes out."""

from pathlib import Path

import numpy as np
import pytest
from fmus.builder import Fault

from ddpc_cosim import FMUPlant

from .loop import H

_MEGABYTES = 100_000_000


@pytest.mark.parametrize(("isolated", "printed"), [(False, _MEGABYTES), (True, 0)])
def test_what_an_fmu_writes_to_its_standard_output(
    isolated: bool, printed: int, faulty_fmus: dict[int, Path], capfd: pytest.CaptureFixture[str]
) -> None:
    with FMUPlant(faulty_fmus[2], isolated=isolated) as plant:
        plant.reset({"fault": int(Fault.FLOOD_DESCRIPTOR)})
        print("one", flush=True)
        plant.step(np.ones(1), H)
        print("two", flush=True)
    output = capfd.readouterr().out
    assert output.startswith("one\n")
    assert output.endswith("two\n")
    assert len(output) == printed + len("one\ntwo\n")
