"""How optional packages are installed, for messages about one that is missing."""


def how_to_install(extra: str) -> str:
    """Return the commands that install an extra of this project, which is installed from a checkout."""
    return f'`pip install ".[{extra}]"` or `uv sync --extra {extra}`, in a checkout of ddpc-cosim'
