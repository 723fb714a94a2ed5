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
    size_t disturbances;      /* that are known, */
    size_t remembered;        /* and how many samples of their past end the lifted state */
    const double *e, *at_once; /* what they do to the next state, and less what they do to this one */
} Koopman;

typedef struct {
    double *begun;            /* whether there is a prediction */
    double *u;                /* m inputs applied last */
    double *z, *disturbance;  /* `lifted` each: the lifted state, and after it the disturbance */
    double *predicted;        /* the lifted state that was predicted of now */
    double *past;             /* with delays: outputs, and after them inputs, the newest first (size) */
    double *states;           /* depth x size, the newest first */
    double *y;                /* p, of this step only; then the disturbances now, at the last sample, and before */
    double *predictor;
} KoopmanMemory;

void step_koopman(const Koopman *koopman, const KoopmanMemory *held, const Sample *sample, double u[], Told *told);

#endif
