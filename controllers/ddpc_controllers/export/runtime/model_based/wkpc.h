/* Willems-Koopman predictive control: wkpc.py. */
#ifndef WKPC_H
#define WKPC_H

#include "law.h"
#include "lift.h"

typedef struct {
    size_t p, q, m;
    size_t past, horizon;     /* samples */
    size_t depth, lifted;     /* how many samples of q signals are lifted together, to how many numbers */
    size_t term_count;
    const Term *const *terms;
    size_t shared;            /* how many measurements are outputs, and which of both: */
    const size_t *measured, *outputs;
    const Law *law;           /* answers with inputs and the outputs predicted of now */
    size_t disturbances;      /* that are known, the past of which is as long as the others */
    size_t ahead;             /* all parameters between the references and the 1, which this past begins */
    const double *near;       /* where limits of the inputs move: how far from one an input still is at it */
} Wkpc;

typedef struct {
    double *z, *u, *y, *reference; /* the law's parameters: past (lifted, m, p wide), references, what is known of the
                                    * time ahead, and 1; after them limits that move, the lower ones first */
    double *resting;               /* whether the past is still to be filled */
    double *samples;               /* depth x q, the newest first */
    double *newest;                /* the newest value of every measurement (q) */
    double *answer, *state, *now;  /* m + p, lifted and p, of this step only */
    double *law;
} WkpcMemory;

void step_wkpc(const Wkpc *wkpc, const WkpcMemory *held, const Sample *sample, double u[], Told *told);

#endif
