"""The sandbox is a matter of systems that have it; what others say of it is in test_sandbox.py."""

from ddpc_cosim.processes.sandbox import missing

collect_ignore = ["test_within_the_sandbox.py", "test_compiling_in_the_sandbox.py"] if missing() else []
