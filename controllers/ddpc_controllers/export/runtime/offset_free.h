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

typedef struct {
    double *begun;                 /* whether an output is expected */
    double *free;                  /* the set of free inputs */
    double *disturbance, *expected; /* p each */
    double *cut_off;               /* p: whether a limit cuts the reference off */
    double *off, *correctable;     /* p each, of this step only */
    double *shifted;               /* (horizon + 1) x p: the setpoint and the references */
} OffsetFreeMemory;

/* Estimate the disturbance; return what the controller inside is to see. */
Sample shift_references(const OffsetFree *wrapper, const OffsetFreeMemory *held, const Sample *sample);

/* Remember which inputs are free. */
void remember_free(const OffsetFree *wrapper, const OffsetFreeMemory *held, const double u[]);

#endif
