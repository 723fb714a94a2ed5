"""Built-in studies: one TOML file each, found by entry point like anyone's."""

from pathlib import Path

paper = Path(__file__).with_name("paper.toml")
