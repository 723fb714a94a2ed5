"""One closed loop, from what it is made of to the trace that it leaves behind."""
