/* Predictive control with recorded windows (DeePC, SPC, gamma-DDPC): the past and the plan around a law. */
#ifndef WINDOW_H
#define WINDOW_H

#include "law.h"

typedef struct {
    size_t m, p;               /* numbers of inputs and outputs */
    size_t past_u, past_y;     /* samples of the past window */
    size_t horizon, steps;     /* samples predicted, and inputs of a plan that are applied */
    bool current;              /* the output measured now ends the past window */
    const double *low, *high;  /* limits of the inputs */
    const double *rates;       /* largest change of each input */
    const Law *law;            /* it answers with `steps` inputs and as many outputs, of now first */
    size_t disturbances;       /* that are known, the past of which has past_u samples */
    size_t ahead;              /* all parameters between the references and the 1, which this past begins */
    const double *near;        /* where limits of the inputs move: how far from one an input still is at it */
} Window;

/* The memory: the law's parameters (past inputs and outputs, references, what is known of the time ahead, 1); limits
 * that move, of `steps` samples, first the lower ones; whether the past is still to be filled; how many
 * inputs of the plan are left; the outputs forecast; the answer; the memory of the law. */
void step_window(const Window *window, double memory[], const Sample *sample, double u[], Told *told);

#endif
