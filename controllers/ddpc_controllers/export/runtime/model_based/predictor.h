/* A model's tracking problem, condensed: from a state and a reference to the next inputs. */
#ifndef PREDICTOR_H
#define PREDICTOR_H

#include "law.h"

typedef struct {
    size_t n, m, references;          /* states, inputs, and numbers of the references */
    const double *low, *high, *rates; /* limits of the inputs and of their changes */
    const Law *law;
} Predictor;

/* `memory` is that of the law and n + m + references + 1 numbers before it. */
void solve_predictor(const Predictor *predictor, const double state[], const double last[], const double reference[],
                     double memory[], double u[], Told *told);

#endif
