/* A model's tracking problem, condensed: from a state and a reference to the next inputs. */
#ifndef PREDICTOR_H
#define PREDICTOR_H

#include "law.h"

typedef struct {
    size_t n, m, references;          /* states, inputs, and numbers of the references */
    const double *low, *high, *rates; /* limits of the inputs and of their changes */
    const Law *law;
    size_t ahead;                     /* parameters of what is known of the time ahead, after the references */
    const double *near;               /* where limits of the inputs move: how far from one an input still is at it */
} Predictor;

/* `memory` is that of the law and n + m + references + ahead + 1 numbers before it, which end with what is known of the
 * time ahead and 1, and limits that move, the lower ones first. */
void solve_predictor(const Predictor *predictor, const double state[], const double last[], const double reference[],
                     double memory[], double u[], Told *told);

#endif
