"""Linear models: from matrices, an FMU or a recording, and the observers built on them."""
