"""A plant's FMU and a controller's C code in one closed loop, which Python only prepares."""
