"""Started controllers as C code: one step function for each, and hand-written kernels in ``runtime/``."""
