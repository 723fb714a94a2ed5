/* A loop in scaled signals: what Scales.step does in Python. */
#ifndef SCALED_H
#define SCALED_H

#include "sample.h"

typedef struct {
    size_t p, q, m, horizon;
    const double *y, *measured, *u;           /* the scales */
    const double *low, *high;                 /* limits of the inputs, in their units */
    const double *near_low, *near_high;       /* beyond them an input is at its limit */
} Scaled;

/* Numbers that `scale_sample` needs. */
#define SCALED_MEMORY(p, q, m, horizon) ((p) + (q) + ((horizon) + 1) * (p) + (m))

Sample scale_sample(const Scaled *scaled, const Sample *sample, double memory[]);

/* Bring scaled inputs into their units; those at a limit but for rounding are exactly there. */
void unscale_inputs(const Scaled *scaled, double u[]);

#endif
