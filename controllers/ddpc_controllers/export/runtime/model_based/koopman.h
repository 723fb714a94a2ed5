/* Koopman model predictive control: KoopmanMPC and LiftedState in koopman_mpc.py. */
#ifndef KOOPMAN_H
#define KOOPMAN_H

#include "lift.h"
#include "predictor.h"

typedef struct {
    size_t p, q, m;
    size_t delays;            /* past outputs and inputs in the state; 0: the state is all that is measured */
    size_t size, depth;       /* signals of a state, and how many states are lifted together */
    size_t lifted;            /* numbers of the lifted state */
    size_t term_count;
    const Term *const *terms;
    const double *a, *b, *c;  /* its model */
    double gain;              /* share of an error that counts as a disturbance */
    const Predictor *predictor;
} Koopman;

/* The memory: whether there is a prediction (1), the inputs applied last (m), the lifted state, the disturbance and
 * the state predicted (`lifted` each), the newest outputs and after them the newest inputs (size, without delays
 * none), the newest states (depth x size), scratch (p); then that of the predictor. The newest are first. */
void step_koopman(const Koopman *koopman, double memory[], const Sample *sample, double u[], Told *told);

#endif
