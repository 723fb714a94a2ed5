/* The linear-quadratic regulator with integral action: what LQR does in Python. */
#ifndef REGULATOR_H
#define REGULATOR_H

#include "observer.h"

typedef struct {
    const Observer *observer;
    const double *u_0;             /* inputs at the operating point */
    const double *state_gain;      /* m x n, its last column zero */
    const double *sum_gain;        /* m x p */
    const double *sums_of_inputs;  /* p x m: the sums that bring inputs about */
    const double *low, *high;      /* limits of the inputs */
} Regulator;

/* `sums` are 1 + p numbers: whether there are sums of the errors yet, and they; `scratch` m + p numbers. */
void regulate(const Regulator *regulator, const ObserverMemory *held, double sums[], double scratch[], const Sample *sample,
              double u[], Told *told);

#endif
