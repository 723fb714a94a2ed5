"""Sampled blocks in C, written by hand: what an exported controller's files have in common."""

HEADER = """#ifndef CONTROLLER_H
#define CONTROLLER_H
#define CONTROLLER_MEMORY {memory}
typedef struct {{
    double memory[CONTROLLER_MEMORY];
    unsigned status, iterations, active_bounds;
}} ControllerState;
void controller_start(ControllerState *state);
unsigned controller_step(ControllerState *state, const double y[], const double r[], double u[]);
#endif
"""
SOURCE = """#include "controller.h"
#include <math.h>
#include <string.h>
void controller_start(ControllerState *state)
{{
    memset(state, 0, sizeof *state);
}}
unsigned controller_step(ControllerState *state, const double y[], const double r[], double u[])
{{
    {step}
    return state->status;
}}
"""


def block_files(step: str, memory: int = 1) -> dict[str, str]:
    """Return the files of a controller whose step consists of these statements, its memory 0 at first."""
    return {"controller.h": HEADER.format(memory=memory), "controller.c": SOURCE.format(step=step)}
