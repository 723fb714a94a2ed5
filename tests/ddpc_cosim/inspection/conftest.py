"""ELF files, what linkers leave open, and mount flags are matters of Linux."""

import sys

collect_ignore = [] if sys.platform == "linux" else ["test_linux.py", "test_sources_linux.py"]
