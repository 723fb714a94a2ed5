/* PID control of pairs of an output and an input: pid.py. */
#ifndef PID_H
#define PID_H

#include "sample.h"

#include <stdbool.h>

typedef struct {
    size_t p, m;
    const size_t *inputs; /* the input of each output */
    const double *proportional, *integral, *derivative, *filter_time, *tracking; /* of each loop */
    const double *low, *high; /* limits of the input of each loop */
    double sampling_time, setpoint_share;
    bool clamping;
    bool moves;               /* whether limits of the inputs move */
    size_t disturbances, lags; /* that are fed forward, and lags of each */
    const double *poles;      /* of the lags */
    const double *forward;    /* what of them goes to each loop: p x lags x disturbances */
} PID;

typedef struct {
    double *begun;   /* whether `bias` is known, -1: it follows from the last inputs, as its own; and whether `before` is */
    double *elapsed; /* since `before` [s] */
    double *u;       /* m inputs */
    double *before, *bias, *rate; /* p values each: y, I and D; after the last ones limits that move, the lower ones
                                   * first, and disturbances that are fed forward: now, at first, and their lags */
} PIDMemory;

void pid_step(const PID *pid, const PIDMemory *held, const Sample *sample, double u[], Told *told);

#endif
