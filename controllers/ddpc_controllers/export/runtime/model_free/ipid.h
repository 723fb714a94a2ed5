/* Intelligent PID control: ipid.py. */
#ifndef IPID_H
#define IPID_H

#include "sample.h"

typedef struct {
    size_t p, order, samples; /* outputs, which are as many as inputs; nu; sampling intervals of the window */
    double sampling_time, kp, ki, kd;
    const double *of_outputs, *of_inputs; /* (order + 1) x (samples + 1), and x samples: estimates of the window */
    const double *alpha, *inverse;        /* p x p */
} IPID;

typedef struct {
    double *begun;          /* whether the window is filled; -1: and the integral follows from the last inputs, as its own */
    double *window_y;       /* (samples + 1) x p, oldest first */
    double *window_u;       /* samples x p */
    double *u, *integral;   /* p values each */
    double *limits;         /* 2 p: of the inputs now, the lower ones first */
    double *estimates;      /* (order + 1) x p: y, its derivatives, and F */
    double *y, *correction; /* p values each, of this step only */
} IPIDMemory;

void ipid_step(const IPID *ipid, const IPIDMemory *held, const Sample *sample, double u[], Told *told);

#endif
