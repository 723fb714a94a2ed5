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
} Wkpc;

/* The memory: the law's parameters (past x lifted states, inputs, outputs, references and 1), whether the past is
 * still to be filled (1), the newest samples (depth x q, the newest first), the newest value of every measurement
 * (q), the law's answer (m + p), a state (lifted), outputs (p); then that of the law. */
void step_wkpc(const Wkpc *wkpc, double memory[], const Sample *sample, double u[], Told *told);

#endif
