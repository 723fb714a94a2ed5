/* A reference that is shifted until there is no offset: offset_free.py. */
#ifndef OFFSET_FREE_H
#define OFFSET_FREE_H

#include "sample.h"

typedef struct {
    size_t p, m, horizon;
    double phi, gain;
    const double *y_min, *y_max; /* limits of the outputs */
    const double *low, *high;    /* an input that is between them is free */
    const double *directions;    /* p x p for every set of free inputs: bit i of its number is input i */
} OffsetFree;

/* Estimate the disturbance; return what the controller inside is to see. The memory: whether an output is expected
 * (1), the set of free inputs (1), the disturbance, the output expected, and whether the reference is cut off (p
 * each), two samples (p each), the shifted references ((horizon + 1) x p). */
Sample shift_references(const OffsetFree *wrapper, double memory[], const Sample *sample);

/* Remember which inputs are free. */
void remember_free(const OffsetFree *wrapper, double memory[], const double u[]);

#endif
